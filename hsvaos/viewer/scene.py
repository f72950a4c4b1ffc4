"""What stands in the 3-D scene of one browser tab: photos, ground, finds and the picture itself.

World coordinates of the scene are the flight's: north, east, down.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from hsvaos.nav.attitude import from_matrix
from hsvaos.surface import FocalSurface
from hsvaos.viewer.geometry import Ground, corners_on, loop, outline, vertical_fov
from hsvaos.viewer.picture import Rgb, photo_picture
from hsvaos.viewer.render import Picture
from hsvaos.viewer.session import Find, Session

if TYPE_CHECKING:
    import viser

_THUMB_PX = 96
_JPEG_QUALITY = 85
_YELLOW, _WHITE, _CYAN, _GREY = (255, 214, 10), (255, 255, 255), (34, 184, 207), (120, 120, 120)


class Scene:
    """The scene of one tab.

    Args:
        client: The tab.
        session: The flight.
        ground: The ground it sees; None where it sees none.
        on_photo: Called with the number of a photo that was clicked.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        session: Session,
        ground: Ground | None,
        on_photo: Callable[[int], None],
    ) -> None:
        self._scene, self._session, self._ground = client.scene, session, ground
        self._groups = {
            name: self._scene.add_frame(f"/{name}", show_axes=False)
            for name in ("photos", "outline", "finds", "grid")
        }
        self._frusta: list[Any] = []
        self._chosen: int | None = None
        self._picture: Any = None
        self._finds: list[Any] = []
        self.frustum_m = 0.0
        self._shown: dict[str, bool] = {}
        self._size = 1.0 if ground is None else ground.size_m
        self._add_photos(on_photo)
        self._add_grid()

    def _add_photos(self, on_photo: Callable[[int], None]) -> None:
        session, camera = self._session, self._session.flight.camera
        places = session.places
        spread = float(np.linalg.norm(np.ptp(places, axis=0)))
        scale = self.frustum_m = max(0.35 * spread / max(len(places), 4) ** 0.5, 0.01 * self._size)
        for i, pose in enumerate(session.flight.poses):
            handle = self._scene.add_camera_frustum(
                f"/photos/{i:05d}",
                vertical_fov(camera),
                camera.width / camera.height,
                scale=scale,
                thickness=1.5,
                thickness_units="screen",
                color=_CYAN,
                image=shrunk(photo_picture(session.photos.images[i].numpy()), _THUMB_PX),
                format="jpeg",
                wxyz=from_matrix(pose[:3, :3]),
                position=pose[:3, 3],
                cast_shadow=False,
                receive_shadow=False,
            )
            handle.on_click(partial(_visit, on_photo, i))
            self._frusta.append(handle)

    def _add_grid(self) -> None:
        if self._ground is None:
            return
        cell = 10.0 ** np.floor(np.log10(self._ground.size_m / 4.0))
        side = float(cell * np.ceil(1.5 * self._ground.size_m / cell))
        self._scene.add_grid(
            "/grid/plane",
            width=side,
            height=side,
            plane="xy",
            cell_size=float(cell),
            section_size=float(5.0 * cell),
            cell_color=_WHITE,
            section_color=_WHITE,
            fade_distance=float(20.0 * side),
            shadow_opacity=0.0,
            position=self._ground.centre,
        )

    def show(self, groups: dict[str, bool]) -> None:
        """Show or hide parts of the scene: "photos", "outline", "finds" and "grid"."""
        for name, visible in groups.items():
            if self._shown.get(name) != visible:
                self._groups[name].visible = visible
                self._shown[name] = visible

    def choose_photo(self, index: int) -> None:
        """Mark a photo among the others."""
        if self._chosen is not None:
            self._frusta[self._chosen].color = _CYAN
        self._frusta[index].color = _YELLOW
        self._chosen = index

    def put_picture(self, picture: Picture) -> None:
        """Show a picture: behind the scene, or, from a ground grid, as a plane in it."""
        view = picture.view
        if not view.is_ortho:
            self._drop_plane()
            self._scene.set_background_image(picture.rgb, format="jpeg", jpeg_quality=_JPEG_QUALITY)
            return
        width, height = view.width * view.gsd_m, view.height * view.gsd_m
        pose = view.world_from_camera
        half = 0.5 * view.gsd_m * np.array([view.width - 1, view.height - 1])
        place = pose[:3, 3] + pose[:3, :2] @ half
        if self._picture is None:
            self._scene.set_background_image(None)
        self._picture = self._scene.add_image(  # same name: replaces the one before
            "/picture",
            picture.rgb,
            width,
            height,
            format="jpeg",
            jpeg_quality=_JPEG_QUALITY,
            wxyz=from_matrix(pose[:3, :3]),
            position=place,
            cast_shadow=False,
            receive_shadow=False,
        )

    def _drop_plane(self) -> None:
        if self._picture is not None:
            self._picture.remove()
            self._picture = None

    def put_outline(self, surface: FocalSurface, chosen: int) -> None:
        """Draw what all photos see of the ground, and what the chosen one sees."""
        flight = self._session.flight
        around = outline(flight, surface)
        corners = corners_on(flight, chosen, surface)
        for name, points, colour in (("all", around, _WHITE), ("photo", corners, _YELLOW)):
            if points is not None and len(points):
                self._scene.add_line_segments(
                    f"/outline/{name}",
                    loop(points),
                    colour,
                    thickness=2.0,
                    thickness_units="screen",
                )
            else:
                self._scene.remove_by_name(f"/outline/{name}")

    def put_finds(self, finds: Sequence[Find]) -> None:
        """Draw boxes with scores where something was found."""
        for handle in self._finds:
            handle.remove()
        self._finds = []
        if not finds:
            return
        boxes = np.concatenate([loop(find.corners) for find in finds])
        self._finds.append(
            self._scene.add_line_segments(
                "/finds/boxes", boxes, _YELLOW, thickness=3.0, thickness_units="screen"
            )
        )
        for i, find in enumerate(finds):
            top = find.corners[np.argmax(find.corners[:, 0])]
            text = f"{find.score:.2g}" if find.score < 1.0 else f"{find.score:.1f}"
            self._finds.append(
                self._scene.add_label(
                    f"/finds/{i}", text, position=top, anchor="bottom-center", font_screen_scale=1.2
                )
            )


def _visit(on_photo: Callable[[int], None], index: int, _: Any) -> None:
    on_photo(index)


def shrunk(picture: Rgb, longest: int) -> Rgb:
    """Return a picture shrunk, if needed, to a longest side [px]."""
    height, width = picture.shape[:2]
    scale = longest / max(height, width)
    if scale >= 1.0:
        return picture
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
