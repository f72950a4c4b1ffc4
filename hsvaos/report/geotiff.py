"""GeoTIFF of the ground grid (extra `geo`): local NED metres tied to the Earth through UTM."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.flight import Origin
from hsvaos.report.atomic import atomic_path
from hsvaos.report.figures import Rgba, covered

_FIT_NODES = 9
"""Nodes a side at which the projection is sampled for the affine fit."""

_MAX_RESIDUAL_M = 0.05
"""Beyond this one affine transform no longer describes the grid well enough to point at a place."""


@dataclass(frozen=True)
class GroundReference:
    """Where a ground grid lies in a map projection.

    Args:
        epsg: EPSG code of the projected coordinate system (UTM, or UPS near the poles).
        affine: (a, b, c, d, e, f): easting = a col + b row + c, northing = d col + e row + f [m],
            where the top left *corner* of the top left pixel is at (0, 0), as in GDAL.
        residual_m: Largest distance of the affine from the exact projection over the grid [m].
    """

    epsg: int
    affine: tuple[float, float, float, float, float, float]
    residual_m: float


def has_geo() -> bool:
    """Whether the libraries of the extra `geo` are installed."""
    return all(find_spec(name) is not None for name in ("rasterio", "pyproj"))


def projected_epsg(lat_deg: float, lon_deg: float) -> int:
    """Return the EPSG code of the UTM zone of a place on WGS-84, or of UPS beyond 84 N / 80 S.

    The regular 6 degree zones are used everywhere: the exceptions around Norway serve map sheets
    and change no position.

    Args:
        lat_deg: Latitude [deg].
        lon_deg: Longitude [deg].
    """
    if lat_deg > 84.0:
        return 32661
    if lat_deg < -80.0:
        return 32761
    zone = int(((lon_deg + 180.0) % 360.0) // 6.0) + 1
    return (32600 if lat_deg >= 0.0 else 32700) + zone


def ground_reference(view: VirtualCamera, origin: Origin, down_m: float = 0.0) -> GroundReference:
    """Fit the affine transform from a ground grid's pixels to its UTM zone.

    North of the local frame is true north at the origin; a UTM grid is rotated against it by the
    meridian convergence and scaled by 0.9996 and up. Both are in the affine: grid nodes are taken
    from the tangent plane to the ellipsoid and projected exactly, then a least squares affine is
    fitted. What it misses (the change of convergence and scale across the grid) is `residual_m`,
    about 0.2 mm over 500 m and 2 cm over 5 km.

    Args:
        view: An orthographic view.
        origin: WGS-84 place of the local NED frame.
        down_m: Typical down of the focal surface [m]: verticals converge, by 16 mm a kilometre
            away for every 100 m of height.

    Raises:
        ValueError: If the view is no ground grid, or it is so large that the residual is above
            0.05 m.
    """
    if not view.is_ortho:
        raise ValueError("a GeoTIFF needs a ground grid (VirtualCamera.ortho), got a pinhole view")
    epsg = projected_epsg(origin.lat_deg, origin.lon_deg)
    corners = np.meshgrid(
        np.linspace(-0.5, view.width - 0.5, _FIT_NODES),
        np.linspace(-0.5, view.height - 0.5, _FIT_NODES),
    )
    pixels = np.stack(corners, axis=-1).reshape(-1, 2)
    ground = view.rays(pixels)[0]
    ground[:, 2] = down_m
    mapped = _project(ground, origin, epsg)
    # Fitting around the grid's centre keeps the numbers small and the fit accurate to nanometres.
    centre = mapped.mean(axis=0)
    design = np.column_stack([pixels + 0.5, np.ones(len(pixels))])
    fitted, *_ = np.linalg.lstsq(design, mapped - centre, rcond=None)
    residual = float(np.linalg.norm(design @ fitted - (mapped - centre), axis=1).max())
    if residual > _MAX_RESIDUAL_M:
        raise ValueError(
            f"the ground grid of {view.width * view.gsd_m:.0f} x {view.height * view.gsd_m:.0f} m "
            f"must be small enough to lie flat in EPSG:{epsg} within {_MAX_RESIDUAL_M} m, got "
            f"{residual:.2f} m: make it in parts"
        )
    (a, d), (b, e), (c, f) = fitted.tolist()
    return GroundReference(epsg, (a, b, c + float(centre[0]), d, e, f + float(centre[1])), residual)


def write_ortho(path: Path, picture: Rgba, reference: GroundReference) -> Path:
    """Write the picture of a ground grid as a GeoTIFF for looking at.

    Args:
        path: Where to, `.tif`.
        picture: Shape (H, W, 4), uint8 RGBA, alpha 0 where there is no sample.
        reference: Where it lies.

    Raises:
        OSError: If it cannot be written.
    """
    from rasterio.enums import ColorInterp

    colours = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha)
    bands = np.moveaxis(picture, -1, 0)
    return _write(path, bands, ("red", "green", "blue", "alpha"), reference, colours, None)


def write_ortho_data(
    path: Path,
    image: NDArray[np.float32],
    footprint: NDArray[np.float32],
    reference: GroundReference,
    rarity_map: NDArray[np.float32] | None = None,
) -> Path:
    """Write the numbers of a ground grid as a GeoTIFF of float32 bands, NaN where no sample.

    Args:
        path: Where to, `.tif`.
        image: Shape (H, W, C), the integral image.
        footprint: Shape (H, W), its sum of weights (0 stays 0 in its own band's place: NaN).
        reference: Where it lies.
        rarity_map: Shape (H, W), a further band, or None.

    Raises:
        OSError: If it cannot be written.
    """
    names = ["red", "green", "blue"] if image.shape[-1] == 3 else ["grey"]
    layers = [*np.moveaxis(image, -1, 0), footprint]
    names.append("footprint")
    if rarity_map is not None:
        layers.append(rarity_map)
        names.append("rarity_map")
    bands = np.where(covered(footprint), np.stack(layers), np.nan).astype(np.float32)
    return _write(path, bands, tuple(names), reference, None, float("nan"))


def _write(
    path: Path,
    bands: NDArray[Any],
    names: tuple[str, ...],
    reference: GroundReference,
    colours: tuple[Any, ...] | None,
    nodata: float | None,
) -> Path:
    import rasterio
    from rasterio.transform import Affine

    count, height, width = bands.shape
    with (
        atomic_path(path) as temporary,
        rasterio.open(
            temporary,
            "w",
            driver="GTiff",
            width=width,
            height=height,
            count=count,
            dtype=bands.dtype.name,
            crs=f"EPSG:{reference.epsg}",
            transform=Affine(*reference.affine),
            nodata=nodata,
            tiled=True,
            blockxsize=256,
            blockysize=256,
            compress="deflate",
            predictor=2 if bands.dtype == np.uint8 else 3,
            # Four bands without this would be called "undefined", and alpha lost to some readers.
            **({"photometric": "RGB", "alpha": "unassociated"} if colours else {}),
        ) as target,
    ):
        if colours is not None:
            target.colorinterp = colours
        target.write(bands)
        for number, name in enumerate(names, start=1):
            target.set_band_description(number, name)
        target.update_tags(
            SOFTWARE="hsvaos", AFFINE_RESIDUAL_M=f"{reference.residual_m:.4f}", AREA_OR_POINT="Area"
        )
    return path


def _project(ned: ArrayLike, origin: Origin, epsg: int) -> NDArray[np.float64]:
    """Project local NED points, shape (K, 3) [m], to easting and northing, shape (K, 2) [m]."""
    from pyproj import Transformer

    to_geodetic = Transformer.from_pipeline(
        "+proj=pipeline "
        f"+step +inv +proj=topocentric +ellps=WGS84 +lat_0={origin.lat_deg!r} "
        f"+lon_0={origin.lon_deg!r} +h_0={origin.height_m!r} "
        "+step +inv +proj=cart +ellps=WGS84 "
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    north, east, down = np.asarray(ned, dtype=np.float64).T
    lon, lat, _ = to_geodetic.transform(east, north, -down)
    to_map = Transformer.from_crs("EPSG:4326", f"EPSG:{epsg}", always_xy=True)
    easting, northing = to_map.transform(lon, lat)
    return np.column_stack([easting, northing])
