"""Slow, obvious NumPy twins of the kernels: what tests and benchmarks compare with.

All of them compute in float64, take plain arrays, and use no table, no tiling and no threads.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import Camera, VirtualCamera
from hsvaos.surface import FocalPlane, FocalSurface, FocalTerrain

Array = NDArray[np.float64]


def unit(images: ArrayLike) -> Array:
    """Return images scaled to 0..1 by their type.

    Args:
        images: Any shape; uint8, uint16 or float (already 0..1).
    """
    values = np.asarray(images)
    white = {"uint8": 255.0, "uint16": 65535.0}.get(values.dtype.name, 1.0)
    return values.astype(np.float64) / white


def rgb_to_hsv(images: ArrayLike) -> Array:
    """Twin of `kernels.color.rgb_to_hsv`.

    Args:
        images: Shape (..., 3).

    Returns:
        Shape (..., 3): hue [0, 360) degrees, saturation, value.
    """
    rgb = unit(images)
    r, g, b = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    value = rgb.max(axis=-1)
    chroma = value - rgb.min(axis=-1)
    safe = np.where(chroma > 0.0, chroma, 1.0)
    hue = np.where(
        value == r, (g - b) / safe, np.where(value == g, 2.0 + (b - r) / safe, 4.0 + (r - g) / safe)
    )
    hue = np.where(chroma > 0.0, (60.0 * hue) % 360.0, 0.0)
    saturation = np.where(chroma > 0.0, chroma / np.where(value > 0.0, value, 1.0), 0.0)
    return np.stack([np.where(hue >= 360.0, 0.0, hue), saturation, value], axis=-1)


def hsv_to_rgb(hsv: ArrayLike) -> Array:
    """Twin of `kernels.color.hsv_to_rgb`, RGB in 0..1.

    Args:
        hsv: Shape (..., 3).
    """
    h, s, v = np.moveaxis(np.asarray(hsv, dtype=np.float64), -1, 0)

    def channel(n: float) -> Array:
        k = (n + h / 60.0) % 6.0
        return np.asarray(v - v * s * np.clip(np.minimum(k, 4.0 - k), 0.0, 1.0))

    return np.stack([channel(5.0), channel(3.0), channel(1.0)], axis=-1)


def brighten(
    images: ArrayLike,
    keep: ArrayLike,
    target_value: float,
    gamma: float,
    max_gain: float,
    gains: ArrayLike | None = None,
) -> Array:
    """Twin of `kernels.color.brighten`, in units of the images, not rounded.

    Args:
        images: Shape (N, H, W, 3) or (N, H, W).
        keep: Shape (N, H, W), 0 = leave as it is.
        target_value: See the kernel.
        gamma: See the kernel.
        max_gain: See the kernel.
        gains: Shape (N, 3), factors on the channels of each image.
    """
    values = np.asarray(images).astype(np.float64)
    scaled = unit(images)
    if gains is not None:
        factors = np.asarray(gains)[:, None, None]
        factors = factors if scaled.ndim == 4 else factors[..., 0]
        values, scaled = values * factors, scaled * factors
    value = scaled.max(axis=-1) if scaled.ndim == 4 else scaled
    dark = (np.asarray(keep) > 0) & (value > 0.0) & (value < target_value)
    gain = np.ones_like(value)
    gain[dark] = np.minimum((value[dark] / target_value) ** (gamma - 1.0), max_gain)
    return values * (gain[..., None] if scaled.ndim == 4 else gain)


def hue_histogram(
    image: ArrayLike, bins: int, statistics: str, valid: ArrayLike | None = None
) -> tuple[Array, float]:
    """Twin of `kernels.hue_mask.hue_histograms` for one image.

    Args:
        image: Shape (H, W, 3).
        bins: Number of bins over the circle.
        statistics: "circular" or "linear".
        valid: Shape (H, W), 0 = leave out.

    Returns:
        Histogram, shape (bins,), and mean chroma.
    """
    hsv = rgb_to_hsv(image)
    use = np.ones(hsv.shape[:2], bool) if valid is None else np.asarray(valid) > 0
    hue, chroma = hsv[..., 0][use], (hsv[..., 1] * hsv[..., 2])[use]
    weights = chroma if statistics == "circular" else np.ones_like(chroma)
    histogram, _ = np.histogram(hue, bins=bins, range=(0.0, 360.0), weights=weights)
    return histogram, float(chroma.mean()) if chroma.size else 0.0


def hue_distance(images: ArrayLike, mean_deg: float, statistics: str) -> Array:
    """Return the distance of each pixel's hue from a mean [deg]; inf where it has no hue.

    A pixel is kept where this exceeds sigmas * sigma.

    Args:
        images: Shape (..., 3).
        mean_deg: Mean hue [deg].
        statistics: "circular" or "linear".
    """
    hsv = rgb_to_hsv(images)
    distance = np.abs(hsv[..., 0] - mean_deg)
    if statistics == "circular":
        distance = np.where(hsv[..., 1] > 0.0, np.minimum(distance, 360.0 - distance), np.inf)
    return np.asarray(distance)


def channel_quantiles(image: ArrayLike, quantiles: Sequence[float]) -> Array:
    """Twin of `kernels.levels.channel_quantiles` for one image without masks.

    Args:
        image: Shape (H, W, 3).
        quantiles: Q shares, 0..1.

    Returns:
        Shape (Q, 3), 0..1.
    """
    flat = unit(image).reshape(-1, 3)
    return np.asarray(np.quantile(flat, quantiles, axis=0, method="inverted_cdf"))


def rgb_to_lab(images: ArrayLike) -> Array:
    """Twin of `kernels.lab.lab_pixel`: CIE Lab of sRGB under D65.

    Args:
        images: Shape (..., 3).
    """
    srgb = np.clip(unit(images), 0.0, 1.0)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    matrix = np.array(
        [
            [0.412453, 0.357580, 0.180423],
            [0.212671, 0.715160, 0.072169],
            [0.019334, 0.119193, 0.950227],
        ]
    )
    t = linear @ matrix.T / (0.950456, 1.0, 1.088754)
    f = np.where(t > 216.0 / 24389.0, np.cbrt(t), (24389.0 / 27.0 * t + 16.0) / 116.0)
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def rarity_coordinates(images: ArrayLike) -> Array:
    """Return lightness and chroma in bins, as real numbers; the bin is their floor, clipped.

    Args:
        images: Shape (..., 3).

    Returns:
        Shape (..., 3): lightness, a and b coordinates in bins.
    """
    lab = rgb_to_lab(images)
    scale = 40.0 / np.maximum(lab[..., 0], 8.0)
    a = (lab[..., 1] * scale + 48.0) * (40.0 / 96.0)
    b = (lab[..., 2] * scale + 48.0) * (40.0 / 96.0)
    return np.stack([lab[..., 0] / 10.0, a, b], axis=-1)


def colour_distance(images: ArrayLike, colour: ArrayLike) -> Array:
    """Twin of the distance in `kernels.keep`: how unlike a colour every pixel is.

    Args:
        images: Shape (..., 3), RGB; uint8, uint16 or float 0..1.
        colour: Shape (3,), sRGB 0..1.
    """

    def place(rgb: ArrayLike) -> Array:
        lab = rgb_to_lab(rgb)
        scale = 40.0 / np.maximum(lab[..., 0], 8.0)
        return np.stack([lab[..., 1] * scale, lab[..., 2] * scale, lab[..., 0] / 8.0], axis=-1)

    kept = place(np.asarray(colour, np.float64))
    return np.asarray(np.linalg.norm(place(images) - kept, axis=-1))


def rarity_bins(images: ArrayLike) -> NDArray[np.int64]:
    """Return the colour bin of each pixel, shape (...), twin of `kernels.rarity.colour_bin`."""
    level, a, b = np.moveaxis(np.floor(rarity_coordinates(images)).astype(np.int64), -1, 0)
    level, a, b = np.clip(level, 0, 9), np.clip(a, 0, 39), np.clip(b, 0, 39)
    return np.asarray((level * 40 + a) * 40 + b)


def rarity_table(
    counts: ArrayLike, threshold: float, exponent: float, smoothing_bins: float
) -> Array:
    """Twin of `kernels.rarity.model_from_counts`: the weight of each bin.

    Args:
        counts: Shape (L, A, B).
        threshold: p0.
        exponent: Of the weight.
        smoothing_bins: Sigma of the Gaussian [bins].
    """
    planes = np.asarray(counts, dtype=np.float64)
    radius = 4 * int(np.ceil(smoothing_bins))
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / smoothing_bins) ** 2)
    kernel /= kernel.sum()
    for axis in (1, 2):
        padded = np.pad(
            planes, [(radius, radius) if a == axis else (0, 0) for a in range(3)], mode="edge"
        )
        planes = np.apply_along_axis(np.convolve, axis, padded, kernel, mode="valid")
    p = planes / np.maximum(planes.sum(axis=(1, 2), keepdims=True), 1.0)
    return np.asarray(np.minimum(1.0, threshold / np.maximum(p, 1e-300)) ** exponent)


def rx_distances(image: ArrayLike) -> Array:
    """Twin of `kernels.anomaly.rx_distances` for one image, all pixels valid.

    Args:
        image: Shape (H, W, 3) or (H, W).
    """
    colours = unit(image)
    if colours.ndim == 2:
        colours = np.repeat(colours[..., None], 3, axis=-1)
    flat = colours.reshape(-1, 3)
    covariance = np.cov(flat.T, bias=True) + 1e-4 * np.eye(3)
    away = colours - flat.mean(axis=0)
    inverse = np.linalg.inv(covariance)
    return np.asarray(np.einsum("...i,ij,...j->...", away, inverse, away))


def intersect_plane(origins: Array, directions: Array, plane: FocalPlane, forward: bool) -> Array:
    """Return where rays meet a plane, NaN where they do not.

    Args:
        origins: Shape (..., 3) [m].
        directions: Shape (..., 3).
        plane: The focal plane.
        forward: Whether only points in front of the origin count.
    """
    slope = directions @ plane.normal
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((plane.point - origins) @ plane.normal) / slope
        t = np.where((np.abs(slope) < 1e-9) | (forward & (t <= 0.0)), np.nan, t)
    return origins + t[..., None] * directions


def terrain_down(north: Array, east: Array, terrain: FocalTerrain) -> Array:
    """Return the bilinear down of a height field, NaN outside and over holes.

    Args:
        north: Any shape [m].
        east: Same shape [m].
        terrain: The height field.
    """
    rows, columns = terrain.down_m.shape
    y = (north - terrain.north0_m) / terrain.spacing_m
    x = (east - terrain.east0_m) / terrain.spacing_m
    inside = (x >= 0.0) & (y >= 0.0) & (x <= columns - 1) & (y <= rows - 1)
    i = np.clip(np.floor(np.where(inside, y, 0.0)).astype(int), 0, rows - 2)
    j = np.clip(np.floor(np.where(inside, x, 0.0)).astype(int), 0, columns - 2)
    fy, fx = y - i, x - j
    d = terrain.down_m.astype(np.float64)
    upper = d[i, j] * (1.0 - fx) + d[i, j + 1] * fx
    lower = d[i + 1, j] * (1.0 - fx) + d[i + 1, j + 1] * fx
    return np.where(inside, upper * (1.0 - fy) + lower * fy, np.nan)


def intersect_terrain(
    origins: Array, directions: Array, terrain: FocalTerrain, samples: int = 4000
) -> Array:
    """Return where falling rays first go below a height field, NaN where they do not.

    Brute force: many even steps between the highest and the lowest level, then linear in between.

    Args:
        origins: Shape (P, 3) [m].
        directions: Shape (P, 3), falling.
        terrain: The height field without holes.
        samples: Steps a ray.
    """
    start = np.maximum((terrain.highest_m - 1e-3 - origins[:, 2]) / directions[:, 2], 0.0)
    stop = (terrain.lowest_m + 1e-3 - origins[:, 2]) / directions[:, 2]
    t = start[:, None] + (stop - start)[:, None] * np.linspace(0.0, 1.0, samples + 1)
    places = origins[:, None] + t[..., None] * directions[:, None]
    height = places[..., 2] - terrain_down(places[..., 0], places[..., 1], terrain)
    below = height >= 0.0
    first = np.argmax(below, axis=1)
    rows = np.arange(len(origins))
    before = np.maximum(first - 1, 0)
    h0, h1 = height[rows, before], height[rows, first]
    with np.errstate(invalid="ignore", divide="ignore"):
        part = np.where(first > 0, -h0 / (h1 - h0), 0.0)
    hit = t[rows, before] + part * (t[rows, first] - t[rows, before])
    usable = below.any(axis=1) & np.isfinite(h0)
    return origins + np.where(usable, hit, np.nan)[:, None] * directions


def focal_points(view: VirtualCamera, surface: FocalSurface) -> Array:
    """Twin of `kernels.rays.focal_points`, in world coordinates.

    Args:
        view: The virtual camera.
        surface: The focal surface.

    Returns:
        Shape (H, W, 3), float64, world NED [m]; NaN where a ray meets nothing.
    """
    v, u = np.mgrid[0 : view.height, 0 : view.width]
    origins, directions = view.rays(np.stack([u, v], axis=-1))
    if isinstance(surface, FocalPlane):
        return intersect_plane(origins, directions, surface, not view.is_ortho)
    if view.is_ortho:
        down = terrain_down(origins[..., 0], origins[..., 1], surface)
        points = np.stack([origins[..., 0], origins[..., 1], down], axis=-1)
        return np.where(np.isnan(down)[..., None], np.nan, points)
    flat = intersect_terrain(origins.reshape(-1, 3), directions.reshape(-1, 3), surface)
    return flat.reshape(origins.shape)


def sample(image: Array, weights: Array, pixels: Array) -> tuple[Array, Array]:
    """Return weighted bilinear samples and their weights; 0 outside the image's area.

    Args:
        image: Shape (H, W, C).
        weights: Shape (H, W).
        pixels: Shape (..., 2), x and y [px].

    Returns:
        Shapes (..., C) and (...): sum of weight x value, and sum of weights.
    """
    height, width = weights.shape
    x, y = pixels[..., 0], pixels[..., 1]
    with np.errstate(invalid="ignore"):
        inside = (x >= -0.5) & (y >= -0.5) & (x <= width - 0.5) & (y <= height - 0.5)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    total = np.zeros((*x.shape, image.shape[2]))
    weight = np.zeros(x.shape)
    for dy in (0, 1):
        for dx in (0, 1):
            share = np.abs(1 - dx - (x - left)) * np.abs(1 - dy - (y - top))
            row = np.clip(top + dy, 0, height - 1)
            column = np.clip(left + dx, 0, width - 1)
            part = np.where(inside, share * weights[row, column], 0.0)
            total += part[..., None] * image[row, column]
            weight += part
    return total, weight


def integrate(
    camera: Camera,
    images: ArrayLike,
    world_from_camera: ArrayLike,
    view: VirtualCamera,
    surface: FocalSurface,
    weights: ArrayLike | None = None,
    aperture_m: float | None = None,
    frames: Sequence[int] | None = None,
    gains: ArrayLike | None = None,
) -> tuple[Array, Array]:
    """Twin of `Integrator.integrate`.

    Args:
        camera: Camera of the photos.
        images: Shape (N, H, W, 3) or (N, H, W).
        world_from_camera: Shape (N, 4, 4).
        view: The virtual camera.
        surface: The focal surface.
        weights: Shape (N, H, W); uint8 (255 = 1), uint16 (65535 = 1) or float.
        aperture_m: Radius of the synthetic aperture [m].
        frames: Numbers of the photos to use.
        gains: Shape (N, 3), factors on the channels of each photo.

    Returns:
        image, shape (H, W, C), and footprint, shape (H, W), float64.
    """
    photos = np.asarray(images)
    stack = photos.astype(np.float64).reshape(*photos.shape[:3], -1)
    if gains is not None:
        stack = stack * np.asarray(gains)[:, None, None, : stack.shape[-1]]
    share = np.ones(photos.shape[:3]) if weights is None else unit(weights)
    poses = np.asarray(world_from_camera, dtype=np.float64)
    points = focal_points(view, surface)
    total = np.zeros((view.height, view.width, stack.shape[-1]))
    footprint = np.zeros((view.height, view.width))
    for n in range(len(stack)) if frames is None else frames:
        rotation, centre = poses[n, :3, :3], poses[n, :3, 3]
        near = np.ones(footprint.shape, bool)
        if aperture_m is not None:
            axis = points[..., :2] if view.is_ortho else view.world_from_camera[:2, 3]
            near &= np.linalg.norm(axis - centre[:2], axis=-1) <= aperture_m
        pixels = camera.project((points - centre) @ rotation)
        pixels[~near] = np.nan
        colour, weight = sample(stack[n], share[n], pixels)
        total += colour
        footprint += weight
    covered = footprint > 0.0
    total[covered] /= footprint[covered][:, None]
    total[~covered] = 0.0
    return total, footprint


def focus_measure(
    image: ArrayLike, footprint: ArrayLike, measure: str, core_px: int, ring_px: int
) -> float:
    """Twin of `kernels.sweep.focus_measure` for one plane.

    Args:
        image: Shape (H, W, C).
        footprint: Shape (H, W).
        measure: "kurtosis", "contrast" or "gradient".
        core_px: See the kernel.
        ring_px: See the kernel.
    """
    grey = np.asarray(image, dtype=np.float64).mean(axis=-1)
    weight = np.asarray(footprint, dtype=np.float64)
    least = 0.6 * weight.max()
    reach = max(core_px, ring_px)
    values, slopes = [], []
    for r in range(reach, grey.shape[0] - reach):
        for c in range(reach, grey.shape[1] - reach):
            around = [(0, 0), (-reach, 0), (reach, 0), (0, -reach), (0, reach)]
            if least <= 0.0 or any(weight[r + dr, c + dc] < least for dr, dc in around):
                continue
            core = [grey[r + i * core_px, c + j * core_px] for i in (-1, 0, 1) for j in (-1, 0, 1)]
            ring = []
            for k in range(16):
                angle = 2.0 * np.pi * k / 16
                dy = int(np.floor(ring_px * np.sin(angle) + 0.5))
                dx = int(np.floor(ring_px * np.cos(angle) + 0.5))
                ring.append(grey[r + dy, c + dx])
            values.append(np.mean(core) - np.mean(ring))
            gradient = (grey[r, c + 1] - grey[r, c - 1], grey[r + 1, c] - grey[r - 1, c])
            slopes.append(0.25 * (gradient[0] ** 2 + gradient[1] ** 2))
    if not values:
        return 0.0
    band_pass = np.array(values)
    second = np.mean(band_pass**2)
    if measure == "kurtosis":
        return float(np.mean(band_pass**4) / max(second**2, 1e-30))
    return float(np.sqrt(second)) if measure == "contrast" else float(np.mean(slopes))
