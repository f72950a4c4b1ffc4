"""People in integral images, found by a network in ONNX: ours, or one of the usual families."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.detect.agree import agreed
from hsvaos.detect.classes import class_names, person_classes
from hsvaos.detect.detections import Detections
from hsvaos.detect.feed import OwnFeed, PhotoFeed, Tile
from hsvaos.detect.few_rays import doubted
from hsvaos.detect.layouts import class_count, layout_of
from hsvaos.detect.network import Network
from hsvaos.detect.second_look import PACKAGED_SECOND_LOOK, SecondLook
from hsvaos.detect.suppress import clipped, suppress, usable
from hsvaos.detect.view_input import ViewInput, checked_view

Array = NDArray[Any]

PACKAGED = Path(__file__).with_name("person.onnx")
"""Our own weights."""

PACKAGED_PICTURE = Path(__file__).with_name("person_picture.onnx")
"""Our own weights for colour images of whose flight nothing is known, with the same threshold."""

PACKAGED_GREY = Path(__file__).with_name("person_grey.onnx")
"""Our own weights for grey (thermal) images, with the same threshold."""

_FLOOR = 0.05
"""Score from which boxes count that another look may confirm."""

_BATCH_PIXELS = 2**21
"""Pixels at a time, in as many pictures as that takes."""


class Detector:
    """Finds people in integral images and photos.

    Attributes:
        layout: Name of the layout of the network.
        provider: Where it runs: "cuda", "tensorrt" or "cpu".
        people: Numbers of the classes that count as people.
        score: Score from which a box counts.
        notes: What was assumed or could not be used, one line each.
        photo_layers: What `detect` takes of single photos and the network looks at: some of
            "fragments", "fragment_coherence" and "ground".

    Args:
        model: ONNX file or its content; by default our own weights: one network for views of a
            flight whose rarity map is known, one for other colour images, and one for grey ones.
        layout: "auto", or a name in `layouts.LAYOUTS` where the network does not tell.
        score: Least score, 0..1; by default the one that belongs to the weights, or 0.25 for the
            YOLO families and 0.5 for RF-DETR and D-FINE.
        iou: Overlap from which two boxes are one person, 0..1; by default 0.25 for our own
            networks and 0.45 for others.
        person_class: Number or name of the class that is the person; by default by its name.
        size_px: Side of the input of networks that take any size and scale pictures to it; by
            default as trained, else 640.
        slice_px: Side of the windows into which large views are cut; 0 cuts none. By default
            windows of the size of the input once a view is 1.5 times as large; of 2048 pixels for
            our own networks, which scale nothing.
        provider: "cuda", "tensorrt" or "cpu"; by default the first one that is here.
        max_finds: People kept in a view.
        threads: CPU threads that the network uses; by default one a core.

    Raises:
        ValueError: If the network cannot be read, has no known layout or no person, or an argument
            is out of range.
        TypeError: If an argument is of another type.
    """

    def __init__(
        self,
        model: str | Path | bytes | None = None,
        layout: str = "auto",
        *,
        score: float | None = None,
        iou: float | None = None,
        person_class: int | str | None = None,
        size_px: int | None = None,
        slice_px: int | None = None,
        provider: str | None = None,
        max_finds: int = 300,
        threads: int | None = None,
    ) -> None:
        packaged = model is None
        if model is None:
            if not PACKAGED.is_file():
                raise ValueError(
                    f"this installation has no weights of its own ({PACKAGED.name} is missing): "
                    f"give an ONNX file as model"
                )
            model = PACKAGED
        self._network = Network(
            model, provider, None if threads is None else _count(threads, "threads", 1)
        )
        self._layout, shapes = layout_of(self._network, layout)
        self.layout, self.provider = self._layout.name, self._network.provider
        text = self._network.metadata.get("names")
        names = None if text is None else class_names(text, self._network.name)
        count = class_count(self._layout, shapes)
        self.people = person_classes(names, count, person_class, self._network.name)
        self.notes = self._network.notes
        if names is None and count is None and person_class is None:
            self.notes += ("the network names no classes: class 0 is taken for people, as in COCO",)
        self._iou = self._layout.iou if iou is None else _share(iou, "iou")
        self._most = _count(max_finds, "max_finds", 1)
        side = None if size_px is None else _count(size_px, "size_px", 32)
        part = None if slice_px is None else _count(slice_px, "slice_px", 0)
        if part is not None and 0 < part < 32:
            raise ValueError(f"slice_px must be 0 or at least 32, got {part}")
        self._feed: OwnFeed | PhotoFeed
        if self.layout == "hsvaos":
            self._feed = OwnFeed(self._network, self._layout, part)
        else:
            self._feed = PhotoFeed(self._network, self._layout, side, part)
        self.photo_layers = self._feed.photo_layers
        self.score = self._feed.score if score is None else _share(score, "score")
        self._asked_for = score is not None
        self._to_look_again: Callable[[], SecondLook] | None = None
        if packaged and PACKAGED_SECOND_LOOK.is_file():
            self._to_look_again = lambda: SecondLook(PACKAGED_SECOND_LOOK, provider, threads)
        self._others: dict[Path, Callable[[], Detector]] = {}
        for weights in (PACKAGED_PICTURE, PACKAGED_GREY) if packaged else ():
            if weights.is_file():
                self._others[weights] = partial(
                    Detector,
                    weights,
                    score=self.score,
                    iou=self._iou,
                    slice_px=slice_px,
                    provider=provider,
                    max_finds=max_finds,
                    threads=threads,
                )

    @cached_property
    def _second_look(self) -> SecondLook | None:
        """What looks again at views of which everything is known, read when the first one comes."""
        return None if self._to_look_again is None else self._to_look_again()

    @cached_property
    def _grey(self) -> Detector | None:
        """What looks at grey images in place of this one, read when the first one comes."""
        return self._others[PACKAGED_GREY]() if PACKAGED_GREY in self._others else None

    @cached_property
    def _of_pictures(self) -> Detector:
        """What looks at images of whose flight nothing is known, read when the first one comes."""
        return self._others[PACKAGED_PICTURE]() if PACKAGED_PICTURE in self._others else self

    def person_score(self, all_known: bool = False) -> float:
        """Return the score from which a box counts for a person over all views of a flight.

        That of the weights, or of their metadata, where no score was asked for; else that one.

        Args:
            all_known: Whether `detect` is given everything of these views, from the rarity map to
                the ground. Our own weights then look twice, and a second look knows better when it
                may be less sure.

        Raises:
            ValueError: If the network of the second look cannot be read.
        """
        if self._asked_for:
            return self.score
        second = self._second_look if all_known else None
        own = None if second is None else second.person_score
        return self._feed.person_score if own is None else own

    def detect(
        self,
        image: ArrayLike,
        *,
        footprint: ArrayLike | None = None,
        rarity: ArrayLike | None = None,
        plain: ArrayLike | None = None,
        coherence: tuple[ArrayLike, ArrayLike] | None = None,
        fragments: ArrayLike | None = None,
        fragment_coherence: tuple[ArrayLike, ArrayLike] | None = None,
        ground: tuple[ArrayLike, ArrayLike] | None = None,
        gsd_m: float | None = None,
        score: float | None = None,
    ) -> Detections:
        """Find the people in one view.

        Args:
            image: Shape (H, W, 3) RGB or (H, W) grey; uint8, uint16 or floats in units of the
                photos. NaN counts as not seen.
            footprint: Shape (H, W), rays of each pixel, 0 where there are none. By default every
                pixel is seen, by nobody knows how many. With `rarity`, finds on ground of fewer
                than 5 rays are doubted, see `few_rays`.
            rarity: Shape (H, W), mean rarity weight over the rays, for our own networks.
            plain: Like the image, the integral image without a mask, for our own networks.
            coherence: What `Integrator.coherence` returns, for our own networks.
            fragments: Shape (H, W), mean evidence of pieces of people over the rays (see
                `FragmentNet`), for our own network of colour images.
            fragment_coherence: What `Integrator.coherence` returns for photos weighed by that
                evidence, for our own network of colour images.
            ground: Integral image and footprint of the photos weighed by what the same network says
                of the ground, for our own network of colour images.
            gsd_m: Ground sampling distance [m/px]. Our own networks take 0.045 to 0.09, of grey
                images 0.07 to 0.146: beyond that the view is resampled. By default it is taken as
                it is. Grey images are looked at once more at .7 of that size.
            score: Least score, 0..1; by default the detector's.

        Returns:
            People, strongest first; scores are probabilities, all class ids 0.

        Raises:
            ValueError: If an array has a wrong shape, or the network cannot take the view.
            TypeError: If an array holds no such numbers.
        """
        return self.detect_batch(
            [image],
            footprints=None if footprint is None else [footprint],
            rarities=None if rarity is None else [rarity],
            plains=None if plain is None else [plain],
            coherences=None if coherence is None else [coherence],
            fragments=None if fragments is None else [fragments],
            fragment_coherences=None if fragment_coherence is None else [fragment_coherence],
            grounds=None if ground is None else [ground],
            gsd_m=gsd_m,
            score=score,
        )[0]

    def detect_batch(
        self,
        images: Iterable[ArrayLike],
        *,
        footprints: Sequence[ArrayLike | None] | None = None,
        rarities: Sequence[ArrayLike | None] | None = None,
        plains: Sequence[ArrayLike | None] | None = None,
        coherences: Sequence[tuple[ArrayLike, ArrayLike] | None] | None = None,
        fragments: Sequence[ArrayLike | None] | None = None,
        fragment_coherences: Sequence[tuple[ArrayLike, ArrayLike] | None] | None = None,
        grounds: Sequence[tuple[ArrayLike, ArrayLike] | None] | None = None,
        gsd_m: float | Sequence[float | None] | None = None,
        score: float | None = None,
    ) -> list[Detections]:
        """Find the people in several views, several at a time where the network allows it.

        Args:
            images: As `detect` takes them, one a view; sizes may differ.
            footprints: One a view, or None.
            rarities: One a view, or None.
            plains: One a view, or None.
            coherences: One pair a view, or None.
            fragments: One a view, or None.
            fragment_coherences: One pair a view, or None.
            grounds: One pair a view, or None.
            gsd_m: For all views, or one a view [m/px].
            score: Least score, 0..1; by default the detector's.

        Returns:
            People of each view.

        Raises:
            ValueError: As `detect`, or if there are not as many of each.
            TypeError: As `detect`.
        """
        pictures = list(images)
        count = len(pictures)
        parts = (
            _one_each(footprints, count, "footprints"),
            _one_each(rarities, count, "rarities"),
            _one_each(plains, count, "plains"),
            _one_each(coherences, count, "coherences"),
            _one_each(fragments, count, "fragments"),
            _one_each(fragment_coherences, count, "fragment_coherences"),
            _one_each(grounds, count, "grounds"),
        )
        many = isinstance(gsd_m, Sequence | np.ndarray) and not isinstance(gsd_m, str)
        distances = _one_each(gsd_m if many else [gsd_m] * count, count, "gsd_m")
        views = [checked_view(*arrays) for arrays in zip(pictures, *parts, strict=True)]
        least = self.score if score is None else _share(score, "score")
        if not self._others:
            return self._found(views, distances, least)
        kinds = [_kind(view) for view in views]
        finds: dict[int, Detections] = {}
        for kind in set(kinds):
            own = [k for k in range(count) if kinds[k] == kind]
            seen = [views[k] for k in own], [distances[k] for k in own]
            found = self._found_in(kind, *seen, least)
            finds |= dict(zip(own, found, strict=True))
        return [finds[k] for k in range(count)]

    def _found_in(
        self, kind: str, views: list[ViewInput], distances: list[Any], least: float
    ) -> list[Detections]:
        """Let the networks look that know such views."""
        if kind == "known colour":
            return self._found(views, distances, least)
        grey = None if kind == "lone colour" else self._grey
        if grey is None:
            return self._of_pictures._found(views, distances, least)
        if kind == "lone grey":
            return grey._found(views, distances, least)
        floor = min(_FLOOR, least)
        both = (network._found(views, distances, floor) for network in (self._of_pictures, grey))
        pairs = zip(*both, strict=True)
        return [agreed(a, b, self._iou, self._most).above(least) for a, b in pairs]

    def _found(
        self, views: list[ViewInput], distances: list[Any], least: float
    ) -> list[Detections]:
        """Run the network over views; `distances` are ground sampling distances or None."""
        scales = self._feed.scales
        if len(scales) == 1:
            return self._found_at(scales[0], views, distances, least)
        floor = min(_FLOOR, least)
        looks = [self._found_at(scale, views, distances, floor) for scale in scales]
        pairs = zip(*looks, strict=True)
        return [agreed(a, b, self._iou, self._most).above(least) for a, b in pairs]

    def _found_at(
        self, scale: float, views: list[ViewInput], distances: list[Any], least: float
    ) -> list[Detections]:
        boxes: list[list[Array]] = [[] for _ in views]
        scores: list[list[Array]] = [[] for _ in views]
        tiles = (
            tile
            for number, (view, distance) in enumerate(zip(views, distances, strict=True))
            for tile in self._feed.tiles(number, view, distance, scale)
        )
        for batch in self._batches(tiles):
            for tile, found, strength in zip(batch, *self._run(batch), strict=True):
                if tile.levels is not None and self._second_look is not None:
                    seen = tile.planes, tile.levels
                    found, strength = self._second_look.at(seen, found, strength)
                good = usable(found, strength, least)
                places, kept = tile.back(found[good])
                boxes[tile.view].append(places[kept])
                scores[tile.view].append(strength[good][kept])
        merged = (self._merged(*one) for one in zip(views, boxes, scores, strict=True))
        return [found.above(least) for found in merged]

    def _batches(self, tiles: Iterable[Tile]) -> Iterator[list[Tile]]:
        """Put tiles of one size together, as many as the network and memory allow."""
        batch: list[Tile] = []
        for tile in tiles:
            if batch and (
                batch[0].planes.shape != tile.planes.shape
                or len(batch) >= self._batch_size(tile.planes)
            ):
                yield batch
                batch = []
            batch.append(tile)
        if batch:
            yield batch

    def _batch_size(self, planes: Array) -> int:
        fixed = self._network.picture.shape[0]
        return fixed or max(1, _BATCH_PIXELS // (planes.shape[1] * planes.shape[2]))

    def _run(self, tiles: list[Tile]) -> tuple[Array, Array]:
        """Boxes in pixels of the input and scores, of each tile."""
        batch = (
            np.stack([tile.planes for tile in tiles]) if len(tiles) > 1 else tiles[0].planes[None]
        )
        missing = (self._network.picture.shape[0] or len(tiles)) - len(tiles)
        if missing > 0:
            batch = np.concatenate([batch, np.zeros((missing, *batch.shape[1:]), np.float32)])
        size = batch.shape[2], batch.shape[3]
        feeds = {self._network.picture.name: batch}
        if self.layout == "dfine":
            feeds["orig_target_sizes"] = np.array([[size[1], size[0]]] * len(batch), np.int64)
        outputs = self._network.run(feeds)
        with np.errstate(over="ignore", invalid="ignore"):  # such boxes are dropped later
            boxes, scores = self._layout.decode(outputs, size, self.people)
        if len(boxes) < len(tiles) or boxes.shape[:2] != scores.shape:
            raise ValueError(
                f"{self._network.name}: expected boxes and scores of {len(batch)} pictures, got "
                f"{boxes.shape} and {scores.shape}"
            )
        return boxes[: len(tiles)], scores[: len(tiles)]

    def _merged(self, view: ViewInput, boxes: list[Array], scores: list[Array]) -> Detections:
        if not boxes:
            return Detections.none()
        places, strengths = clipped(np.concatenate(boxes), np.concatenate(scores), view.size)
        if view.seen is not None:
            kept = _touches(places, view.seen)
            places, strengths = places[kept], strengths[kept]
        if view.rarity is not None and view.footprint is not None:  # then that counts rays
            strengths = doubted(places, strengths, view.footprint)
        iou = self._iou if self._layout.needs_nms or len(boxes) > 1 else None
        # from pixel k covering k to k + 1, as elsewhere, to pixel centres at integers
        return suppress(places - 0.5, strengths, iou, self._most)


def _kind(view: ViewInput) -> str:
    """What a view is, for networks that know one kind of view."""
    known = "lone" if view.rarity is None else "known"
    return f"{known} {'grey' if view.is_grey else 'colour'}"


def _touches(boxes: Array, seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether boxes hold a pixel that is seen."""
    low, high = np.floor(boxes[:, :2]).astype(int), np.ceil(boxes[:, 2:]).astype(int)
    corners = zip(low, high, strict=True)
    hit = [bool(seen[y0:y1, x0:x1].any()) for (x0, y0), (x1, y1) in corners]
    return np.array(hit, bool)


def _one_each(values: Any, count: int, name: str) -> list[Any]:
    if values is None:
        return [None] * count
    listed = list(values)
    if len(listed) != count:
        raise ValueError(
            f"{name} must have one entry for each of {count} images, got {len(listed)}"
        )
    return listed


def _share(value: float, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating):
        raise TypeError(f"{name} must be a number, got {value!r}")
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{name} must lie within 0 and 1, got {value!r}")
    return float(value)


def _count(value: int, name: str, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name} must be a whole number, got {value!r}")
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {value!r}")
    return int(value)
