"""From photos to weights: levelling, the hue cut, rarity, RX, and brightening."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.hue_statistics import HueStatistics
from hsvaos.kernels.anomaly import rx_masks
from hsvaos.kernels.color import brighten
from hsvaos.kernels.hue_mask import apply_hue_cut, measure_hue
from hsvaos.kernels.hue_pack import cut_and_pack
from hsvaos.kernels.levels import channel_quantiles, level_gains
from hsvaos.kernels.packing import Packed
from hsvaos.kernels.rarity import rarity_weights
from hsvaos.photos import Photos, Progress
from hsvaos.settings import MaskSettings, Settings

STEPS = 5


@dataclass(frozen=True, eq=False)
class Masks:
    """Everything that weighs the pixels of a flight. Arrays are Warp arrays on the device.

    Args:
        gains: Shape (N, 3), factors that level the photos; None where they are not levelled.
        hue: Shape (N, H, W), uint8, the hue cut; None for grey photos.
        rarity: Shape (N, H, W), float32, rarity weights.
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
    anomaly: Any
    brightened: Any
    packed: Packed | None
    hue_stats: list[HueStatistics]
    hue_histogram: NDArray[np.float64] | None
    stats: dict[str, Any]
    notes: tuple[str, ...]

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
    mask, images, valid = settings.mask, photos.images, photos.valid
    gains = None
    if settings.photos.level and photos.is_colour:
        gains = level_gains(channel_quantiles(images, valid=valid))
    step("levelling exposure")
    hue, histogram, packed = None, None, None
    amount = {"target_value": mask.target_value, "gamma": mask.gamma, "max_gain": mask.max_gain}
    stats: list[HueStatistics] = []
    if photos.is_colour:
        how = (mask.sigmas, mask.statistics, mask.scope)
        stats, histogram = measure_hue(images, *how, valid=valid, gains=gains)
        cut = None
        if mask.brighten:
            cut = cut_and_pack(images, stats, valid=valid, gains=gains, brightening=amount)
        hue, packed = cut or (apply_hue_cut(images, stats, valid=valid, gains=gains), None)
    step("cutting hues")
    threshold = mask.rarity_threshold if photos.is_colour else mask.grey_rarity_threshold
    rarity, _ = rarity_weights(
        images,
        threshold=threshold,
        exponent=mask.rarity_exponent,
        smoothing_bins=mask.rarity_smoothing_bins,
        dtype="float32",
        valid=valid,
        gains=gains,
    )
    step("weighing rarity")
    anomaly = None
    if "anomaly" in (mask.method, settings.detect.method):
        anomaly, _ = rx_masks(images, mask.anomaly_quantile, valid=valid)
    step("finding anomalies")
    brightened = None
    if mask.brighten and hue is not None and packed is None:
        brightened = brighten(images, hue, gains=gains, **amount)
    step("brightening")
    summary, notes = _summary(photos, mask, hue, stats, anomaly)
    return Masks(gains, hue, rarity, anomaly, brightened, packed, stats, histogram, summary, notes)


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
