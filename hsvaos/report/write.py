"""The output folder of a run, every file whole or not there at all."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from hsvaos.flight import FlightError, Origin
from hsvaos.report import figures, geotiff
from hsvaos.report.atomic import atomic_path, check_writable, write_bytes
from hsvaos.report.draw import draw_boxes, draw_rings, draw_scale_and_north, with_legend
from hsvaos.report.finds import detections_geojson, detections_json
from hsvaos.report.ground import surface_down
from hsvaos.report.html import report_html
from hsvaos.report.places import box_around, places_of
from hsvaos.report.terrain import height_picture, write_terrain
from hsvaos.result import Result
from hsvaos.surface import FocalTerrain

FILE_NAMES = (
    "integral.png",
    "integral.npz",
    "detections.png",
    "rarity_map.png",
    "fragment_map.png",
    "ground.png",
    "footprint.png",
    "terrain.png",
    "terrain.npz",
    "detections.json",
    "detections.geojson",
    "settings.toml",
    "ortho.tif",
    "ortho_data.tif",
    "report.html",
)
"""Every file that `write_result` may write."""

_SHOWN = {"rarity": "rarity", "fragment": "evidence of pieces of people"}
"""What maps show, for their legends."""


def write_result(
    result: Result, folder: str | Path, *, want_geotiff: bool | None = None
) -> dict[str, Path]:
    """Write everything that a run leaves on disk.

    Files of an earlier run that this one does not write again (a GeoTIFF, say) are removed, so that
    the folder never mixes two runs.

    Args:
        result: The run.
        folder: Where to; made if missing.
        want_geotiff: True: a GeoTIFF of the ground grid is wanted; an error if it cannot be made.
            False: none. None: one if possible, else a note in the report where it is missing.

    Returns:
        The files written, by name.

    Raises:
        FlightError: If the folder cannot be written to, or a GeoTIFF that was asked for cannot be
            made.
        OSError: If a file cannot be written (the disk is full, say); names it.
    """
    folder = check_writable(folder, FILE_NAMES)
    written = _write_pictures(result, folder)
    written["integral.npz"] = _write_arrays(result, folder / "integral.npz")
    if isinstance(result.surface, FocalTerrain):
        written["terrain.npz"] = write_terrain(result.surface, folder / "terrain.npz")
    texts = {
        "detections.json": detections_json(result),
        "detections.geojson": detections_geojson(result),
        "settings.toml": result.settings.to_toml(),
    }
    for name, text in texts.items():
        written[name] = write_bytes(folder / name, text.encode("utf-8"))
    notes = []
    if want_geotiff is not False:
        missing = why_no_geotiff(result)
        if missing is None:
            written |= _write_geotiffs(result, folder)
        elif want_geotiff:
            raise FlightError(f"{folder / 'ortho.tif'}: cannot be made: {missing}")
        elif result.main.view.is_ortho:
            notes.append(f"No GeoTIFF was written: {missing}.")
    page = report_html(result, notes)
    written["report.html"] = write_bytes(folder / "report.html", page.encode("utf-8"))
    for name in set(FILE_NAMES) - set(written):
        (folder / name).unlink(missing_ok=True)
    return written


def why_no_geotiff(result: Result) -> str | None:
    """Return why a run yields no GeoTIFF, or None if it does."""
    if not result.main.view.is_ortho:
        return "the view is no ground grid (--view ortho)"
    if result.flight.origin is None:
        return "the flight has no WGS-84 origin"
    if not geotiff.has_geo():
        return "it needs rasterio and pyproj: pip install 'hsvaos[geo]'"
    try:
        _reference(result, result.flight.origin)
    except ValueError as error:
        return str(error)
    return None


def _reference(result: Result, origin: Origin) -> geotiff.GroundReference:
    return geotiff.ground_reference(result.main.view, origin, surface_down(result.surface))


def _write_geotiffs(result: Result, folder: Path) -> dict[str, Path]:
    main, origin = result.main, result.flight.origin
    if origin is None:
        raise FlightError(f"{folder}: a GeoTIFF needs a flight with a WGS-84 origin, got none")
    reference = _reference(result, origin)
    picture = figures.stretch(main.integral, main.footprint)
    data = folder / "ortho_data.tif"
    return {
        "ortho.tif": geotiff.write_ortho(folder / "ortho.tif", picture, reference),
        "ortho_data.tif": geotiff.write_ortho_data(
            data, main.integral, main.footprint, reference, main.rarity_map
        ),
    }


def _write_pictures(result: Result, folder: Path) -> dict[str, Path]:
    main = result.main
    integral = figures.stretch(main.integral, main.footprint)
    places = places_of(main.view, result.persons)
    without = ~np.isnan(places[:, 0]) & (box_around(places, main.detections.boxes_xyxy) < 0)
    found = draw_rings(draw_boxes(integral, main.detections), places[without])
    if main.view.is_ortho:
        found = draw_scale_and_north(found, main.view.gsd_m)
    low, high = figures.footprint_limits(main.footprint)
    seen = figures.covered(main.footprint)
    painted = figures.colour_map(main.footprint, seen, low, high, "viridis")
    pictures = {
        "integral.png": integral,
        "detections.png": found,
        "footprint.png": with_legend(painted, "viridis", low, high, "footprint [photos]"),
    }
    if "ground" in main.extra:
        image, rays = main.extra["ground"]
        pictures["ground.png"] = figures.stretch(image, figures.of_ground(rays))
    if isinstance(result.surface, FocalTerrain):
        heights, low, high = height_picture(result.surface)
        pictures["terrain.png"] = with_legend(heights, "viridis", low, high, "height [m]")
    seen = figures.covered(main.footprint if main.rays is None else main.rays)
    for values, name in ((main.rarity_map, "rarity"), (main.fragment_map, "fragment")):
        if values is not None:
            low, high = figures.shining_limits(values, seen)
            painted = figures.colour_map(values, seen, low, high, "inferno")
            pictures[f"{name}_map.png"] = with_legend(painted, "inferno", low, high, _SHOWN[name])
    return {
        name: write_bytes(folder / name, figures.encode(picture))
        for name, picture in pictures.items()
    }


def _write_arrays(result: Result, path: Path) -> Path:
    """Write the numbers as computed, and the view they belong to.

    `camera` is (width, height, fx, fy, cx, cy); a ground grid has `ortho` = (north0_m, east0_m,
    gsd_m) instead, pixel (c, r) being centred on north0_m - r gsd_m, east0_m + c gsd_m.
    """
    main = result.main
    view, origin = main.view, result.flight.origin
    arrays: dict[str, Any] = {
        "image": main.integral.astype(np.float32, copy=False),
        "footprint": main.footprint.astype(np.float32, copy=False),
        "world_from_camera": view.world_from_camera,
        "frame": np.array(main.frame),
        "mask": np.array(result.mask),
    }
    for name in ("rarity_map", "rays", "fragment_map"):
        values = getattr(main, name)
        if values is not None:
            arrays[name] = values.astype(np.float32, copy=False)
    if "ground" in main.extra:
        arrays["ground"], arrays["ground_rays"] = main.extra["ground"]
    if view.camera is None:
        north0, east0 = view.world_from_camera[:2, 3]
        arrays["ortho"] = np.array([north0, east0, view.gsd_m])
    else:
        c = view.camera
        arrays["camera"] = np.array([c.width, c.height, c.fx, c.fy, c.cx, c.cy], np.float64)
        arrays["distortion"] = np.array(c.distortion)
    if origin is not None:
        arrays["origin"] = np.array([origin.lat_deg, origin.lon_deg, origin.height_m])
    with atomic_path(path) as temporary, io.FileIO(temporary, "w") as file:
        np.savez(file, **arrays)  # not compressed: float noise hardly shrinks, and takes seconds
    return path
