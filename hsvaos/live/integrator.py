"""The integral image of the newest photos, renewed with every photo that comes in."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import Camera, VirtualCamera, check_pose
from hsvaos.detect.detections import Person
from hsvaos.flight import Origin
from hsvaos.live.detection import DetectionThread, LooksForPeople
from hsvaos.live.inbox import Arrival, Inbox
from hsvaos.live.latency import Latencies
from hsvaos.live.looking import LookThread
from hsvaos.live.result import LiveResult, LiveStats
from hsvaos.live.ring import Format, Out
from hsvaos.live.search import SearchThread
from hsvaos.live.window import Window, checked_valid
from hsvaos.nav.online import NoPoseError, OnlineFilter
from hsvaos.settings import MaskSettings, Settings
from hsvaos.surface import FocalPlane, FocalSurface, FocalTerrain

_DOWN = np.array(
    [[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, -20.0], [0.0, 0.0, 0.0, 1.0]]
)
"""A camera 20 m up that looks down, to warm up with."""


class LiveIntegrator:
    """Integral images while the photos come in, in bounded time and memory.

    `push` copies a photo into a bounded queue and returns at once; a thread masks it, puts it into
    the ring of the newest photos and renders their integral image. Where more come than it can
    take, the oldest that waits is dropped and counted. All memory of the size of photos and
    pictures is taken when the integrator is made, and all kernels are compiled then.

    Args:
        camera: The camera of all photos.
        surface: Focal plane or terrain; the ground at down = 0 by default.
        frames: Photos of the window.
        view: A view that rests (photos are then added and retired one by one); None for one
            that follows the newest photo.
        size: Longest side of a view that follows [px].
        mask: "hue", "rarity", "none", or settings. Statistics are those of the window with the
            new photo (scope "flight", the default here) or of the photo alone (scope "image").
        valid: Shape (H, W), uint8 or bool, pixels of every photo to use; None for all.
        channels: 3 for RGB photos, 1 for grey.
        dtype: "uint8"; or "uint16" for grey photos.
        waiting: Most photos that wait in the queue.
        navigator: Says where photos without a pose were taken.
        detector: Looks for people in a thread of its own, for example a `hsvaos.Detector`.
        search: Settings under which the photos of the window are searched instead, in a thread of
            its own, with all that `hsvaos.run` looks at: rarity, each single photo, the ground
            without trees. A search takes seconds. None for none.
        detect_every: Images from one that is looked at, or searched, to the next.
        on_result: Called in the integrator's thread with each result; its arrays are written over
            later, and the time it takes is part of the work.
        device: "cpu", "cuda:0", ...

    Raises:
        ValueError: If a parameter makes no sense.
        TypeError: If surface or view are none.
    """

    def __init__(
        self,
        camera: Camera,
        surface: FocalSurface | None = None,
        *,
        frames: int = 30,
        view: VirtualCamera | None = None,
        size: int = 512,
        mask: str | MaskSettings = "hue",
        valid: ArrayLike | None = None,
        channels: int = 3,
        dtype: str = "uint8",
        waiting: int = 2,
        navigator: OnlineFilter | None = None,
        detector: LooksForPeople | None = None,
        search: Settings | None = None,
        detect_every: int = 10,
        on_result: Callable[[LiveResult], None] | None = None,
        device: Any = "cpu",
    ) -> None:
        if size < 1 or detect_every < 1:
            raise ValueError(
                f"size and detect_every must be at least 1, got {size!r} and {detect_every!r}"
            )
        if detector is not None and search is not None:
            raise ValueError("detector and search: expected one of them, got both")
        if isinstance(mask, str):
            mask = MaskSettings(method=mask, scope="flight")
        self.navigator = navigator
        self._follow = following(camera, size)
        format = Format(camera, channels, dtype)
        follows = (self._follow.width, self._follow.height)
        shape = follows if view is None else _checked_view(view).size
        self._window = Window(format, frames, shape, mask, valid, device)
        self._look: tuple[VirtualCamera | None, FocalSurface] = (view, FocalPlane(0.0))
        self.look(view, FocalPlane(0.0) if surface is None else surface)
        self._inbox = Inbox(waiting, lambda: format.memory(self._window.device))
        self._outs = [Out.empty(shape, channels, self._window.device) for _ in range(2)]
        eye = VirtualCamera(self._follow, _DOWN) if view is None else view
        self._window.warm_up(eye, self._look[1], self._outs[0])
        self._lock = threading.Lock()
        self._latest: LiveResult | None = None
        self._every, self._on_result = detect_every, on_result
        self._integrated = self._lost = 0
        self._latencies, self._work_times = Latencies(), Latencies()
        self.recent = Latencies()
        self._error: Exception | None = None
        self._finder: LookThread | None = None
        if detector is not None:
            self._finder = DetectionThread(detector, shape, channels)
        elif search is not None:
            usable = None if valid is None else checked_valid(valid, format)
            searcher = SearchThread(format, frames, search, usable, self._window.device)
            searcher.warm_up(eye, self._look[1])
            searcher.start()
            self._finder = searcher
        self._thread = threading.Thread(target=self._work, name="hsvaos-live", daemon=True)
        self._thread.start()

    def look(self, view: VirtualCamera | None, surface: FocalSurface | None = None) -> None:
        """Change what the next image shows.

        Args:
            view: A view that rests, of the size of the first one; None to follow the photos.
            surface: Focal plane or terrain; None for the one there is.

        Raises:
            ValueError: If the view has another size.
            TypeError: If view or surface are none.
        """
        if view is not None and _checked_view(view).size != self._window.size:
            raise ValueError(
                f"view must have the size {self._window.size} of the first, got {view.size}"
            )
        follows = (self._follow.width, self._follow.height)
        if view is None and follows != self._window.size:
            raise ValueError("a live integrator with a view of its own cannot follow the photos")
        surface = self._look[1] if surface is None else surface
        if not isinstance(surface, (FocalPlane, FocalTerrain)):
            raise TypeError(
                f"surface must be a FocalPlane or FocalTerrain, got {type(surface).__name__}"
            )
        self._look = (view, surface)

    def push(
        self, image: Any, world_from_camera: ArrayLike | None = None, t_s: float = float("nan")
    ) -> int:
        """Hand over a photo; it is copied, and this returns before it is integrated.

        Args:
            image: Shape (H, W, 3) RGB or (H, W) grey, on the host.
            world_from_camera: Shape (4, 4), its pose, world NED [m]; None to ask the navigator.
            t_s: Time of exposure, on the navigator's clock [s].

        Returns:
            The photo's number.

        Raises:
            ValueError: If photo or pose do not fit, or the integrator was closed.
            RuntimeError: If the integrator's thread failed; the cause says why.
        """
        arrived = time.monotonic()
        self._raise()
        photo, format = np.asarray(image), self._window.format
        if photo.shape != format.shape or photo.dtype.name != format.dtype:
            raise ValueError(
                f"image must have shape {format.shape} and type {format.dtype}, got "
                f"{photo.shape} and {photo.dtype.name}"
            )
        pose = None
        if world_from_camera is not None:
            pose = check_pose(world_from_camera, "world_from_camera")
        elif self.navigator is None:
            raise ValueError("world_from_camera must be a 4x4 pose: there is no navigator to ask")
        elif not np.isfinite(t_s):
            raise ValueError(f"t_s must be the time of exposure without a pose, got {t_s!r}")
        return self._inbox.put(photo, pose, float(t_s), arrived)

    def newest(self) -> int:
        """Return the number of the newest photo in the newest image; -1 before the first one."""
        latest = self._latest
        return -1 if latest is None else latest.number

    def latest(self) -> LiveResult | None:
        """Return a copy of the newest integral image; None before the first one.

        Raises:
            RuntimeError: If the integrator's thread failed; the cause says why.
        """
        self._raise()
        with self._lock:
            if self._latest is None:
                return None
            own = self._latest.image.copy(), self._latest.footprint.copy()
            return replace(self._latest, image=own[0], footprint=own[1])

    def drain(self, timeout_s: float | None = None) -> bool:
        """Wait until all photos handed over are integrated, or the time is over.

        Returns:
            Whether they are.

        Raises:
            RuntimeError: If the integrator's thread failed; the cause says why.
        """
        done = self._inbox.drain(timeout_s)
        if self._finder is not None:
            done = self._finder.rest(timeout_s) and done
        self._raise()
        return done

    @property
    def window(self) -> Window:
        """The photos in the window; not to be read while photos come in."""
        return self._window

    def persons(self, origin: Origin | None = None) -> tuple[Person, ...]:
        """Return who was found on the ground by all searches so far, likeliest first.

        Args:
            origin: Ties the local frame to the Earth, or None.
        """
        finder = self._finder
        return finder.persons(origin) if isinstance(finder, SearchThread) else ()

    def stats(self) -> LiveStats:
        """Return the counters."""
        finder = self._finder
        times = Latencies() if finder is None else finder.times
        with self._lock:
            return LiveStats(
                self._inbox.arrived,
                self._integrated,
                self._inbox.dropped,
                self._lost,
                len(times),
                0 if finder is None else finder.skipped,
                self._latencies.to_dict(),
                self._work_times.to_dict(),
                times.to_dict(),
            )

    def recent_latency(self) -> dict[str, Any]:
        """Return the latencies since the last call, like `LiveStats.latency`."""
        with self._lock:
            outcome = self.recent.to_dict()
            self.recent.clear()
            return outcome

    def close(self) -> None:
        """End the threads; photos that wait are let go."""
        self._inbox.close()
        self._thread.join()
        if self._finder is not None:
            self._finder.close()

    def __enter__(self) -> LiveIntegrator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _raise(self) -> None:
        error = self._error or (None if self._finder is None else self._finder.error)
        if error is not None:
            raise RuntimeError(f"the live integrator failed: {error}") from error

    def _work(self) -> None:
        try:
            while (arrival := self._inbox.take()) is not None:
                try:
                    self._integrate(arrival)
                finally:
                    self._inbox.give_back(arrival)
        except Exception as error:  # told to the next caller
            self._error = error
            self._inbox.close()

    def _integrate(self, arrival: Arrival) -> None:
        start = time.monotonic()
        pose = self._pose_of(arrival)
        if pose is None:
            return
        view, surface = self._look
        if view is None:
            view = VirtualCamera(self._follow, pose)
        out = self._outs[self._integrated % 2]
        self._window.step(arrival.image, pose, view, surface, out)
        image, footprint = out.numpy()
        end = time.monotonic()
        finds = None if self._finder is None else self._finder.latest
        latency = end - arrival.arrived_s
        result = LiveResult(
            image,
            footprint,
            arrival.number,
            arrival.t_s,
            latency,
            len(self._window),
            view,
            self._window.statistics,
            finds,
        )
        with self._lock:
            self._latest = result
            self._integrated += 1
            self._latencies.add(latency)
            self.recent.add(latency)
        if self._finder is not None:
            self._finder.take(arrival.number, arrival.image, pose)
            if (self._integrated - 1) % self._every == 0:
                self._finder.offer(result, surface, self._window.sampling_distance())
        if self._on_result is not None:
            self._on_result(result)
        with self._lock:
            self._work_times.add(time.monotonic() - start)

    def _pose_of(self, arrival: Arrival) -> NDArray[np.float64] | None:
        if arrival.pose is not None or self.navigator is None:
            return arrival.pose
        try:
            return self.navigator.world_from_camera(arrival.t_s)
        except NoPoseError:
            with self._lock:
                self._lost += 1
            return None


def following(camera: Camera, size: int) -> Camera:
    """Return the camera of a view that follows: without distortion, with a longest side [px]."""
    factor = size / max(camera.width, camera.height)
    width, height = (max(1, round(side * factor)) for side in (camera.width, camera.height))
    return camera.without_distortion().scaled(width, height)


def _checked_view(view: Any) -> VirtualCamera:
    if not isinstance(view, VirtualCamera):
        raise TypeError(f"view must be a VirtualCamera, got {type(view).__name__}")
    return view
