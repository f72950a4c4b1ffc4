"""Terrain files: GeoTIFF elevation models, .obj meshes and .npz height fields."""

from __future__ import annotations

import struct
import warnings
import zipfile
import zlib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.flight import FlightError, Origin
from hsvaos.formats.header import TIFF_STARTS
from hsvaos.formats.mesh import MOST_NODES, rasterise_mesh, read_obj
from hsvaos.geodesy import geodetic_from_ned, ned_from_geodetic
from hsvaos.surface import FocalTerrain

Array = NDArray[np.float64]

_BIGTIFF_STARTS = (b"II+\0", b"MM\0+")
_ZIP_START = b"PK\x03\x04"
_DAMAGED_ZIP = (
    OSError,
    EOFError,
    KeyError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
    NotImplementedError,  # a flag that says encrypted, or an unknown compression
    RuntimeError,
)
"""What zipfile and NumPy raise for damaged .npz files, beside ValueError."""


def read_terrain(
    path: str | Path, origin: Origin | tuple[float, float, float] | None = None
) -> FocalTerrain:
    """Read a terrain, its kind told by its content.

    Args:
        path: GeoTIFF elevation model (extra `geo`; needs the origin), `.obj` mesh with JKU's axes
            (x = east, y = south, z = down), or `.npz` with north_m, east_m and down_m.
        origin: Latitude [deg], longitude [deg] and height [m] of the world's origin. Heights of
            the model must be of the same kind as the origin's: no geoid is applied.

    Raises:
        FlightError: If the file cannot be read, its kind is not known, or an extra is missing.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            start = file.read(4)
    except FileNotFoundError:
        raise FlightError(f"{path}: no such terrain file") from None
    except OSError as error:
        raise FlightError(f"{path}: cannot be read ({error.strerror})") from None
    try:
        if start in (*TIFF_STARTS, *_BIGTIFF_STARTS):
            if origin is None:
                raise FlightError(f"{path}: a GeoTIFF terrain needs a flight with an origin")
            return _read_geotiff(path, origin if isinstance(origin, Origin) else Origin(*origin))
        if start == _ZIP_START:
            return _read_npz(path)
        if _looks_like_obj(path):
            return rasterise_mesh(*read_obj(path))
    except FlightError:
        raise
    except ValueError as error:
        raise FlightError(f"{path}: {error}") from None
    raise FlightError(
        f"{path}: expected a terrain (GeoTIFF, .obj or .npz), got a file that is none of them"
    )


def _looks_like_obj(path: Path) -> bool:
    if path.suffix.lower() == ".obj":
        return True
    with path.open("rb") as file:
        return any(line.startswith(b"v ") for line in file.read(4096).splitlines())


def _read_npz(path: Path) -> FocalTerrain:
    names = ("north_m", "east_m", "down_m")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
            missing = [name for name in names if name not in content]
            if missing:
                raise FlightError(
                    f"{path}: expected the arrays {', '.join(names)}; missing {', '.join(missing)}"
                )
            return FocalTerrain.from_arrays(*(content[name] for name in names))
    except _DAMAGED_ZIP as error:
        raise FlightError(f"{path}: malformed .npz ({error})") from None


def _geo_extra(path: Path) -> tuple[ModuleType, ModuleType]:
    try:
        import pyproj
        import rasterio
    except ImportError:
        raise FlightError(
            f"{path}: reading GeoTIFF needs the extra geo: pip install 'hsvaos[geo]'"
        ) from None
    return rasterio, pyproj


def _opened(rasterio: ModuleType, path: Path) -> Any:
    """Open a raster; that it has no place on the Earth is said by an error, not a warning."""
    warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
    return rasterio.open(path)


def _read_geotiff(path: Path, origin: Origin) -> FocalTerrain:
    rasterio, pyproj = _geo_extra(path)
    try:
        with warnings.catch_warnings(), _opened(rasterio, path) as file:
            if file.crs is None:
                raise FlightError(f"{path}: expected a GeoTIFF with a coordinate system, got none")
            crs = pyproj.CRS.from_wkt(file.crs.to_wkt())
            heights = file.read(1, masked=True).astype(np.float64).filled(np.nan)
            from_pixel = np.array(file.transform, dtype=np.float64).reshape(3, 3)
    except rasterio.errors.RasterioError as error:
        raise FlightError(f"{path}: cannot be read as GeoTIFF ({error})") from None
    if min(heights.shape) < 2 or not np.isfinite(heights).any():
        raise FlightError(f"{path}: expected heights, got none that are valid")
    heights[~np.isfinite(heights)] = np.nan
    crs = crs.sub_crs_list[0] if crs.is_compound else crs
    to_wgs84 = pyproj.Transformer.from_crs(crs, 4326, always_xy=True)
    to_model = pyproj.Transformer.from_crs(4326, crs, always_xy=True)

    # The regular grid that holds the model: its border in local coordinates, at its own spacing.
    middle = float(np.nanmedian(heights))
    rows, columns = heights.shape
    border = _border(rows, columns)
    x, y = _apply(from_pixel, border[:, 1] + 0.5, border[:, 0] + 0.5)
    lon, lat = to_wgs84.transform(x, y)
    edge = ned_from_geodetic(lat, lon, middle, origin)[:, :2]
    if not np.isfinite(edge).all():
        raise FlightError(f"{path}: its place on the Earth cannot be computed from {crs.name}")
    extent = edge.max(axis=0) - edge.min(axis=0)
    spacing = float(np.sqrt(extent.prod() / ((rows - 1) * (columns - 1))))
    count = np.floor(extent / spacing).astype(int) + 1
    if count.prod() > MOST_NODES:
        raise FlightError(f"{path}: {rows} x {columns} heights are too many: crop the model")
    north0, east0 = (float(value) for value in edge.min(axis=0))
    north = north0 + spacing * np.arange(max(count[0], 2))
    east = east0 + spacing * np.arange(max(count[1], 2))

    # Nodes are placed at the middle height: by another height they would move sideways by only
    # (height difference) x (distance) / (radius of the Earth), millimetres over a flight.
    down = np.empty((north.size, east.size), dtype=np.float32)
    to_pixel: Array = np.linalg.inv(from_pixel).astype(np.float64)
    for i, n in enumerate(north):
        ned = np.stack(
            [np.full(east.size, n), east, np.full(east.size, origin.height_m - middle)], axis=1
        )
        lat, lon, _ = geodetic_from_ned(ned, origin)
        x, y = to_model.transform(lon, lat)
        column, row = _apply(to_pixel, np.asarray(x), np.asarray(y))
        height = _bilinear(heights, row - 0.5, column - 0.5)
        down[i] = ned_from_geodetic(lat, lon, height, origin)[:, 2]
    if np.isnan(down).all():
        raise FlightError(f"{path}: expected heights, got none that are valid")
    return FocalTerrain(north0, east0, spacing, down)


def _apply(affine: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Return points moved by an affine map of the plane, shape (3, 3)."""
    (a, b, c), (d, e, f) = affine[:2]
    return a * x + b * y + c, d * x + e * y + f


def _border(rows: int, columns: int) -> Array:
    """Return row and column of the pixels along the edge of a raster, shape (K, 2)."""
    r, c = np.arange(rows), np.arange(columns)
    sides = [
        (np.zeros(columns), c),
        (np.full(columns, rows - 1), c),
        (r, np.zeros(rows)),
        (r, np.full(rows, columns - 1)),
    ]
    return np.concatenate([np.stack(np.broadcast_arrays(*side), axis=1) for side in sides]) * 1.0


def _bilinear(values: Array, row: Any, column: Any) -> Array:
    """Sample a raster; NaN outside and where a pixel that weighs in is NaN."""
    rows, columns = values.shape
    # Rounding of the two transforms may leave the outermost pixels by a hair.
    outside = (row < -1e-3) | (row > rows - 1 + 1e-3)
    outside |= (column < -1e-3) | (column > columns - 1 + 1e-3)
    row, column = np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)
    r, c = np.minimum(row.astype(int), rows - 2), np.minimum(column.astype(int), columns - 2)
    fr, fc = row - r, column - c
    total = np.zeros(row.shape)
    for dr, dc, weight in (
        (0, 0, (1 - fr) * (1 - fc)),
        (0, 1, (1 - fr) * fc),
        (1, 0, fr * (1 - fc)),
        (1, 1, fr * fc),
    ):
        # A neighbour of no weight may be a hole without making one here.
        total += np.where(weight > 1e-9, weight * values[r + dr, c + dc], 0.0)
    return np.where(outside, np.nan, total)
