"""Settings of every stage, frozen, with TOML in and out."""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from dataclasses import dataclass, field, fields
from numbers import Integral, Real
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

MASKS = ("hue", "rarity", "anomaly", "none")
DETECTORS = ("network", "rarity", "anomaly")

MOST_TILT_DEG = 60.0
"""Tilt of a focal plane beyond which cameras would look along it."""

_MOST_STEPS = 10_000
_MOST_SMOOTHING_BINS = 40.0
"""The width of the colour histogram: more smoothing only costs time."""


@dataclass(frozen=True)
class PhotoSettings:
    """How photos are taken in.

    Args:
        scale: Factor on width and height while decoding, 0 < scale <= 1; 1 keeps every pixel.
        level: Level exposure and white balance across the frames, for all but the plain mean.
    """

    scale: float = 1.0
    level: bool = True

    def __post_init__(self) -> None:
        _check_types(self, "photos")
        _require(0.0 < self.scale <= 1.0, "photos.scale", "a factor in (0, 1]", self.scale)


@dataclass(frozen=True)
class MaskSettings:
    """Which pixels count, and how much.

    Args:
        method: "hue" (the paper's 2-sigma cut), "rarity" (weight by rareness of colour),
            "anomaly" (RX) or "none".
        sigmas: Half width of the hue cut.
        statistics: "circular" or "linear" (the paper's).
        scope: "image" or "flight".
        brighten: Whether kept dark pixels are brightened (section 3.1 of the paper).
        target_value: Value below which a pixel counts as dark, 0..1.
        gamma: Exponent of the brightening, 0..1.
        max_gain: Largest factor of the brightening.
        rarity_threshold: Probability of a colour bin below which a colour has full weight.
        grey_rarity_threshold: The same for grey levels of grey photos.
        rarity_exponent: Exponent of the rarity weight.
        rarity_smoothing_bins: Sigma of the smoothing of the colour histogram [bins].
        anomaly_quantile: Share of the pixels that the RX mask cuts.
        hue_from_deg: First hue of a cut set by hand [deg], which replaces mean and sigmas; with
            hue_to_deg only.
        hue_to_deg: Last hue of that cut [deg]; hues run upwards from the first one, over 360 where
            it is the greater one.
        keep_colours: Colours "#rrggbb" that no mask takes away.
        keep_distance: How unlike a colour to keep may be: chroma relative to lightness, as in the
            rarity histogram, and an eighth of the difference in lightness.
    """

    method: str = "hue"
    sigmas: float = 2.0
    statistics: str = "circular"
    scope: str = "image"
    brighten: bool = True
    target_value: float = 0.25
    gamma: float = 0.6
    max_gain: float = 3.0
    rarity_threshold: float = 2e-4
    grey_rarity_threshold: float = 1.25e-3
    rarity_exponent: float = 1.5
    rarity_smoothing_bins: float = 1.0
    anomaly_quantile: float = 0.99
    hue_from_deg: float | None = None
    hue_to_deg: float | None = None
    keep_colours: tuple[str, ...] = ()
    keep_distance: float = 6.0

    def __post_init__(self) -> None:
        _check_types(self, "mask")
        _one_of(self.method, "mask.method", MASKS)
        _one_of(self.statistics, "mask.statistics", ("circular", "linear"))
        _one_of(self.scope, "mask.scope", ("image", "flight"))
        _require(self.sigmas > 0.0, "mask.sigmas", "a positive number", self.sigmas)
        _require(0.0 < self.target_value <= 1.0, "mask.target_value", "(0, 1]", self.target_value)
        _require(0.0 < self.gamma <= 1.0, "mask.gamma", "a number in (0, 1]", self.gamma)
        _require(self.max_gain >= 1.0, "mask.max_gain", "at least 1", self.max_gain)
        for name in ("rarity_threshold", "grey_rarity_threshold", "rarity_exponent"):
            value = getattr(self, name)
            _require(value > 0.0, f"mask.{name}", "a positive number", value)
        smoothing = self.rarity_smoothing_bins
        expected = f"between 0 and {_MOST_SMOOTHING_BINS:g} bins"
        usable = 0.0 <= smoothing <= _MOST_SMOOTHING_BINS
        _require(usable, "mask.rarity_smoothing_bins", expected, smoothing)
        quantile = self.anomaly_quantile
        _require(0.0 < quantile < 1.0, "mask.anomaly_quantile", "between 0 and 1", quantile)
        cut = (self.hue_from_deg, self.hue_to_deg)
        _require((cut[0] is None) == (cut[1] is None), "mask", "hue_from_deg and hue_to_deg", cut)
        for hue in cut:
            usable = hue is None or 0.0 <= hue <= 360.0
            _require(usable, "mask.hue_from_deg and hue_to_deg", "hues of 0 to 360 degrees", hue)
        for colour in self.keep_colours:
            usable = re.fullmatch(r"#[0-9a-fA-F]{6}", colour) is not None
            _require(usable, "mask.keep_colours", 'colours like "#c81e1e"', colour)
        _require(self.keep_distance > 0.0, "mask.keep_distance", "positive", self.keep_distance)


@dataclass(frozen=True)
class FocusSettings:
    """Where the focal surface lies. At most one of down_m, terrain and autofocus.

    Args:
        down_m: Down of a horizontal focal plane [m]; by default the flight's ground.
        terrain: File of a terrain model, see `FocalTerrain.from_file`.
        autofocus: Search for the plane where small rare things are sharpest.
        from_m: Upper end of that search [m]; by default from the flight's geometry.
        to_m: Lower end of that search [m].
        steps: Planes of that search.
        pitch_deg: Tilt of a focal plane, rising towards the north [deg]; the plane turns about the
            point below the middle of the cameras.
        roll_deg: Tilt of a focal plane, falling towards the east [deg].
        offset_m: Shift of a terrain downwards [m].
        relief: Whether to find how high the ground is above and below the focal plane, see
            `relief.find_relief`. By default where the network looks into colour photos and neither
            down_m nor terrain is given.
    """

    down_m: float | None = None
    terrain: str | None = None
    autofocus: bool = False
    from_m: float | None = None
    to_m: float | None = None
    steps: int = 48
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    offset_m: float = 0.0
    relief: bool | None = None

    def __post_init__(self) -> None:
        _check_types(self, "focus")
        expected = "no terrain beside it: relief is found about a plane"
        _require(not self.relief or self.terrain is None, "focus.relief", expected, self.terrain)
        asked = [self.down_m is not None, self.terrain is not None, self.autofocus]
        _require(sum(asked) <= 1, "focus", "only one of down_m, terrain and autofocus", "several")
        expected = f"between 3 and {_MOST_STEPS} planes"
        _require(3 <= self.steps <= _MOST_STEPS, "focus.steps", expected, self.steps)
        for name in ("pitch_deg", "roll_deg"):
            tilt = getattr(self, name)
            expected = f"a tilt of at most {MOST_TILT_DEG:g} degrees"
            _require(abs(tilt) <= MOST_TILT_DEG, f"focus.{name}", expected, tilt)


@dataclass(frozen=True)
class ViewSettings:
    """What is rendered.

    Args:
        frame: "centre", "all" (every stored pose), "cover" (as few of them as hold all that any of
            them holds), "ortho", or the name or number of a frame.
        gsd_m: Ground sampling distance of the ground grid [m]; by default that of the photos, or
            coarser for grids of more than 16 million pixels.
        aperture_m: Radius of the synthetic aperture [m]; by default all photos count.
    """

    frame: str = "centre"
    gsd_m: float | None = None
    aperture_m: float | None = None

    def __post_init__(self) -> None:
        _check_types(self, "view")
        for name in ("gsd_m", "aperture_m"):
            value = getattr(self, name)
            _require(value is None or value > 0.0, f"view.{name}", "a positive length", value)


@dataclass(frozen=True)
class DetectSettings:
    """What counts as a find.

    Args:
        enabled: Whether to look for finds.
        method: "network" (the person network), or peaks without weights: "rarity" of the rarity
            map, "anomaly" of the share of rays that RX calls anomalous.
        inputs: What the network is shown: "all" (the rarity-weighted and the plain integral image,
            the rarity map, the number of rays, coherence, and what a second network sees in every
            photo), "integrals" (all but that, in half the time) or "image" (only the integral image
            of the chosen mask, as in the paper).
        model: File of another network (ONNX); by default the one in the package.
        layout: What its outputs mean, see `hsvaos.Detector`.
        min_score: Score of the network from which a box is a find; by default the model's own.
        person_score: Score from which a box counts for a person over all views, where it may be
            less sure; by default min_score if that is given, else the model's own.
        min_z: Local z from which a peak is a find.
        person_m: Length of a person, the size of a find's surround and of its box [m].
        min_rays: Rays a pixel needs to be judged by peaks; half the number of photos is always
            enough.
        max_finds: Strongest finds kept in a view.
        min_agreement: Share of person_score or min_z that a person's score, the mean over all
            views that hold its place, must reach.
    """

    enabled: bool = True
    method: str = "network"
    inputs: str = "all"
    model: str | None = None
    layout: str = "auto"
    min_score: float | None = None
    person_score: float | None = None
    min_z: float = 6.0
    person_m: float = 1.8
    min_rays: float = 6.0
    max_finds: int = 50
    min_agreement: float = 0.5

    def __post_init__(self) -> None:
        _check_types(self, "detect")
        _one_of(self.method, "detect.method", DETECTORS)
        _one_of(self.inputs, "detect.inputs", ("all", "integrals", "image"))
        for name in ("min_score", "person_score"):
            score = getattr(self, name)
            _require(score is None or 0.0 < score < 1.0, f"detect.{name}", "in (0, 1)", score)
        _require(self.min_z > 0.0, "detect.min_z", "a positive number", self.min_z)
        _require(self.person_m > 0.0, "detect.person_m", "a positive length", self.person_m)
        _require(self.min_rays >= 0.0, "detect.min_rays", "0 or more", self.min_rays)
        agreement = self.min_agreement
        _require(0.0 <= agreement <= 1.0, "detect.min_agreement", "a share, 0 to 1", agreement)
        _require(self.max_finds >= 1, "detect.max_finds", "at least 1", self.max_finds)


@dataclass(frozen=True)
class Settings:
    """All settings of a run; every stage has its own table in TOML.

    Args:
        photos: How photos are taken in.
        mask: Which pixels count.
        focus: Where the focal surface lies.
        view: What is rendered.
        detect: What counts as a find.

    Raises:
        ValueError: If a value is out of range; the message names the setting.
        TypeError: If it is of another type; whole numbers are taken where others are expected.
    """

    photos: PhotoSettings = field(default_factory=PhotoSettings)
    mask: MaskSettings = field(default_factory=MaskSettings)
    focus: FocusSettings = field(default_factory=FocusSettings)
    view: ViewSettings = field(default_factory=ViewSettings)
    detect: DetectSettings = field(default_factory=DetectSettings)

    def __post_init__(self) -> None:
        _check_types(self)

    def with_values(self, **tables: dict[str, Any]) -> Settings:
        """Return the settings with some values changed.

        Args:
            tables: Dictionaries of new values by table name; values of None change nothing.
        """
        changed = {
            name: dataclasses.replace(
                getattr(self, name), **{k: v for k, v in table.items() if v is not None}
            )
            for name, table in tables.items()
        }
        return dataclasses.replace(self, **changed)

    def with_focus(self, table: dict[str, Any]) -> Settings:
        """Return the settings with another focal surface; values of None are set too.

        Args:
            table: New values of [focus] by name.
        """
        return dataclasses.replace(self, focus=dataclasses.replace(self.focus, **table))

    def with_score(self, score: float) -> Settings:
        """Return the settings with another threshold of finds, in units of the method they name.

        Args:
            score: Score of the network, or local z of peaks.
        """
        name = "min_score" if self.detect.method == "network" else "min_z"
        return self.with_values(detect={name: score})

    def to_toml(self) -> str:
        """Return the settings as TOML, every default written out; what is not set is left out."""
        lines: list[str] = []
        for stage in fields(self):
            table = getattr(self, stage.name)
            lines.append(f"[{stage.name}]")
            for entry in fields(table):
                value = getattr(table, entry.name)
                if value is not None:
                    lines.append(f"{entry.name} = {_toml_value(value)}")
            lines.append("")
        return "\n".join(lines)

    @classmethod
    def from_toml(cls, text: str, where: str = "settings") -> Settings:
        """Read settings from TOML; what is not there keeps its default.

        Args:
            text: The TOML.
            where: What to call it in messages.

        Raises:
            ValueError: If it is no TOML, or a table, key, type or value is not known or allowed.
        """
        try:
            content = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise ValueError(f"{where}: no valid TOML: {error}") from None
        stages = {stage.name: stage.default_factory for stage in fields(cls)}
        _known(content, stages, where, "table")
        read = {}
        for name, table in content.items():
            kind: Any = stages[name]
            if not isinstance(table, dict):
                raise ValueError(f"{where}: {name} must be a table [{name}], got {table!r}")
            _known(table, get_type_hints(kind), f"{where}: [{name}]", "key")
            try:
                read[name] = kind(**table)
            except (TypeError, ValueError) as error:
                raise ValueError(f"{where}: {error}") from None
        return cls(**read)

    @classmethod
    def from_file(cls, path: str | Path) -> Settings:
        """Read settings from a TOML file.

        Raises:
            OSError: If it is there but cannot be read.
            ValueError: If there is no such file, or as `from_toml`.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except FileNotFoundError:
            raise ValueError(f"{path}: no such settings file") from None
        except UnicodeDecodeError:
            raise ValueError(f"{path}: expected a text file in UTF-8") from None
        return cls.from_toml(text, str(path))


def _require(condition: bool, name: str, expected: str, got: object) -> None:
    if not condition:
        raise ValueError(f"{name} must be {expected}, got {got!r}")


def _one_of(value: str, name: str, allowed: tuple[str, ...]) -> None:
    _require(value in allowed, name, "one of " + ", ".join(allowed), value)


def _known(given: dict[str, Any], allowed: dict[str, Any], where: str, what: str) -> None:
    unknown = [key for key in given if key not in allowed]
    if unknown:
        raise ValueError(f"{where}: no {what} {unknown[0]!r}; known are {', '.join(allowed)}")


def _check_types(settings: object, table: str = "") -> None:
    """Check the type of every field of a settings object, and take over numbers as their type."""
    for key, hint in get_type_hints(type(settings)).items():
        name = f"{table}.{key}" if table else key
        object.__setattr__(settings, key, _checked(getattr(settings, key), hint, name))


def _checked(value: Any, hint: Any, name: str) -> Any:
    if get_origin(hint) is tuple:  # a list in TOML
        if isinstance(value, (list, tuple)):
            return tuple(_checked(entry, get_args(hint)[0], name) for entry in value)
        raise TypeError(f"{name} must be a list, got {value!r}")
    kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
    if float in kinds and isinstance(value, Real) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        _require(math.isfinite(number), name, "a finite number", value)
        return number
    if int in kinds and isinstance(value, Integral) and not isinstance(value, bool):
        return int(value)
    if not any(type(value) is kind for kind in kinds):
        expected = " or ".join(k.__name__ for k in kinds if k is not type(None))
        raise TypeError(f"{name} must be {expected}, got {value!r}")
    return value


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{escaped}"'
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml_value(entry) for entry in value) + "]"
    return repr(value)
