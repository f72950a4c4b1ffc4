"""From photos to weights: levelling, the hue cut, rarity, RX, and brightening."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.hue_statistics import HueStatistics
from hsvaos.kernels.anomaly import rx_masks
from hsvaos.kernels.color import brighten
from hsvaos.kernels.hue_mask import apply_hue_cut, measure_hue
from hsvaos.kernels.hue_pack import cut_and_pack
from hsvaos.kernels.keep import keep_colours
from hsvaos.kernels.levels import channel_quantiles, level_gains
from hsvaos.kernels.packing import Packed
from hsvaos.kernels.rarity import rarity_weights
from hsvaos.photos import Photos, Progress
from hsvaos.rarity_model import RarityModel
from hsvaos.settings import MaskSettings, Settings

STEPS = 4


@dataclass(frozen=True, eq=False)
class Masks:
    """Everything that weighs the pixels of a flight. Arrays are Warp arrays on the device.

    Args:
        gains: Shape (N, 3), factors that level the photos; None where they are not levelled.
        hue: Shape (N, H, W), uint8, the hue cut; None for grey photos.
        rarity: Shape (N, H, W), float32, rarity weights.
        rarity_model: The histogram of the levelled photos that they follow.
        anomaly: Shape (N, H, W), uint8, RX masks; None unless asked for.
        brightened: Photos levelled, and their kept dark pixels brightened; None where not wanted,
            and where `packed` holds them.
        packed: These brightened photos under the hue cut, as an `Integrator` takes them, where cut
            and brightening were made in one pass.
        hue_stats: Statistics of each photo; empty for grey photos.
        hue_histogram: Shape (B,), float64, over the flight; None for grey photos.
        stats: What reports say of the mask.
        notes: What the user should know.
    """

    gains: NDArray[np.float64] | None
    hue: Any
    rarity: Any
    rarity_model: RarityModel
    anomaly: Any
    brightened: Any
    packed: Packed | None
    hue_stats: list[HueStatistics]
    hue_histogram: NDArray[np.float64] | None
    stats: dict[str, Any]
    notes: tuple[str, ...]

    @classmethod
    def of_rarity(
        cls, gains: NDArray[np.float64] | None, weights: Any, model: RarityModel
    ) -> Masks:
        """Return masks of rarity alone, see `weigh_rarity`."""
        return cls(gains, None, weights, model, None, None, None, [], None, {}, ())

    def chosen(self, method: str) -> Any:
        """Return the weights of a mask by name; None where every valid pixel counts."""
        return {"hue": self.hue, "rarity": self.rarity, "anomaly": self.anomaly}.get(method)


def make_masks(photos: Photos, settings: Settings, progress: Progress | None = None) -> Masks:
    """Weigh every pixel of a flight in every way that the pictures of a run need.

    Args:
        photos: The photos.
        settings: The settings; the methods only decide whether RX masks are made too.
        progress: Told of every step.
    """
    step = _Steps(progress)
    mask, valid = settings.mask, photos.valid
    gains = levelled(photos, settings)
    step("levelling exposure")
    hue, histogram, brightened, packed = None, None, None, None
    stats: list[HueStatistics] = []
    if photos.is_colour:
        how = (mask.sigmas, mask.statistics, mask.scope)
        stats, histogram = measure_hue(photos.images, *how, valid=valid, gains=gains)
        stats = by_hand(mask, stats)
        hue, brightened, packed = cut_hues(photos, mask, stats, gains)
    step("cutting hues")
    rarity, model = weigh_rarity(photos, mask, gains)
    step("weighing rarity")
    anomaly = None
    if "anomaly" in (mask.method, settings.detect.method):
        anomaly = find_anomalies(photos, mask, gains)
    step("finding anomalies")
    summary, notes = _summary(photos, mask, hue, stats, anomaly)
    pictures = (hue, rarity, model, anomaly, brightened, packed)
    return Masks(gains, *pictures, stats, histogram, summary, notes)


def levelled(photos: Photos, settings: Settings) -> NDArray[np.float64] | None:
    """Return factors that level the photos, shape (N, 3); None where they stay as they are."""
    if not (settings.photos.level and photos.is_colour):
        return None
    return level_gains(channel_quantiles(photos.images, valid=photos.valid))


def by_hand(mask: MaskSettings, stats: list[HueStatistics]) -> list[HueStatistics]:
    """Return the statistics that cut the hues set by hand, or the measured ones if none are."""
    if mask.hue_from_deg is None or mask.hue_to_deg is None:
        return stats
    width = (mask.hue_to_deg - mask.hue_from_deg) % 360.0
    if width == 0.0 and mask.hue_to_deg != mask.hue_from_deg:
        width = 360.0
    return [
        replace(
            one,
            mean_deg=(mask.hue_from_deg + 0.5 * width) % 360.0,
            sigma_deg=0.5 * width / mask.sigmas,
            statistics="circular",
            sigmas=mask.sigmas,
            informative=True,
            reason="",
        )
        for one in stats
    ]


def cut_hues(
    photos: Photos,
    mask: MaskSettings,
    stats: list[HueStatistics],
    gains: NDArray[np.float64] | None,
) -> tuple[Any, Any, Packed | None]:
    """Make the hue cut, and brighten what it keeps; see `Masks`.

    Args:
        photos: Colour photos.
        mask: The settings.
        stats: Statistics of each photo.
        gains: See `levelled`.

    Returns:
        The masks, and the brightened photos: as images, or packed, or neither.
    """
    images, valid = photos.images, photos.valid
    amount = {"target_value": mask.target_value, "gamma": mask.gamma, "max_gain": mask.max_gain}
    if mask.brighten and not mask.keep_colours:
        both = cut_and_pack(images, stats, valid=valid, gains=gains, brightening=amount)
        if both is not None:
            return both[0], None, both[1]
    hue = apply_hue_cut(images, stats, valid=valid, gains=gains)
    hue = _with_kept_colours(photos, mask, hue, gains)
    return hue, brighten(images, hue, gains=gains, **amount) if mask.brighten else None, None


def weigh_rarity(
    photos: Photos, mask: MaskSettings, gains: NDArray[np.float64] | None = None
) -> tuple[Any, RarityModel]:
    """Return rarity weights and their model; see `Masks`."""
    threshold = mask.rarity_threshold if photos.is_colour else mask.grey_rarity_threshold
    weights, model = rarity_weights(
        photos.images,
        threshold=threshold,
        exponent=mask.rarity_exponent,
        smoothing_bins=mask.rarity_smoothing_bins,
        dtype="float32",
        valid=photos.valid,
        gains=gains,
    )
    return _with_kept_colours(photos, mask, weights, gains), model


def find_anomalies(
    photos: Photos, mask: MaskSettings, gains: NDArray[np.float64] | None = None
) -> Any:
    """Return RX masks; see `Masks.anomaly`."""
    masks, _ = rx_masks(photos.images, mask.anomaly_quantile, valid=photos.valid)
    return _with_kept_colours(photos, mask, masks, gains)


def _with_kept_colours(
    photos: Photos, mask: MaskSettings, weights: Any, gains: NDArray[np.float64] | None
) -> Any:
    """Give the colours to keep their full weight; grey photos have none."""
    if not mask.keep_colours or not photos.is_colour:
        return weights
    colours = [
        [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)] for colour in mask.keep_colours
    ]
    return keep_colours(
        photos.images, weights, colours, mask.keep_distance, valid=photos.valid, gains=gains
    )


class _Steps:
    def __init__(self, progress: Progress | None) -> None:
        self.progress = progress
        self.done = 0

    def __call__(self, name: str) -> None:
        self.done += 1
        if self.progress is not None:
            self.progress(f"masking: {name}", self.done, STEPS)


def _summary(
    photos: Photos, mask: MaskSettings, hue: Any, stats: list[HueStatistics], anomaly: Any
) -> tuple[dict[str, Any], tuple[str, ...]]:
    summary: dict[str, Any] = {"method": mask.method}
    notes: list[str] = []
    if mask.method == "hue" and hue is None:
        notes.append("the photos are grey: hue says nothing, the mask keeps everything")
        summary["hue_informative"] = False
    if stats:
        silent = [s for s in stats if not s.informative]
        middle = sorted(stats, key=lambda s: s.sigma_deg)[len(stats) // 2]
        summary |= {
            "hue_mean_deg": middle.mean_deg,
            "hue_sigma_deg": middle.sigma_deg,
            "hue_statistics": mask.statistics,
            "sigmas": mask.sigmas,
            "chroma": float(np.mean([s.chroma for s in stats])),
            "within": float(np.mean([s.within for s in stats])),
            "hue_informative": len(silent) < len(stats),
            "frames_without_hue": len(silent),
        }
        if silent and mask.method == "hue":
            notes.append(
                f"hue says nothing in {len(silent)} of {len(stats)} photos, where the mask keeps "
                f"everything: {silent[0].reason}"
            )
    if stats and mask.hue_from_deg is not None and mask.hue_to_deg is not None:
        del summary["within"]  # of another cut
        notes.append(f"hues from {mask.hue_from_deg:.0f} to {mask.hue_to_deg:.0f} deg cut by hand")
    chosen = anomaly if mask.method == "anomaly" else hue if mask.method == "hue" else None
    if chosen is not None:
        summary["kept_share"] = kept_share(chosen)
    return summary, tuple(notes)


def kept_share(weights: Any) -> float:
    """Return the share of the pixels with any weight.

    Args:
        weights: Warp array, shape (N, H, W), uint8.
    """
    counts = [np.count_nonzero(weights[i].numpy()) for i in range(weights.shape[0])]
    return float(np.sum(counts)) / float(weights.size)


def as_bytes(weights: Any) -> NDArray[np.uint8]:
    """Return weights of a photo as uint8, 255 = weight 1.

    Args:
        weights: Warp array, shape (H, W), uint8 or float32 0..1.
    """
    values = weights.numpy()
    scaled = values if values.dtype == np.uint8 else np.rint(255.0 * values)
    return np.asarray(scaled, dtype=np.uint8)
