"""From radiance to a photo: lens, motion, sensor, tone curve."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]

_WAVELENGTH_UM = 0.55


@dataclass(frozen=True)
class CameraEffects:
    """What a real camera does to the light.

    Args:
        defocus_px: Standard deviation of the defocus blur [px].
        f_number: Of the lens; with `pixel_um` it gives the diffraction blur.
        pixel_um: Pitch of the sensor's pixels [um].
        exposure_s: Exposure time [s]; what moves meanwhile is smeared.
        exposure_ev: Brighter (+) or darker (-) than the metered exposure [stops].
        exposure_jitter_ev: Standard deviation of the exposure from photo to photo [stops].
        full_well: Photons that saturate a pixel; sets the shot noise.
        read_noise: Electrons.
        vignetting: Light lost in the corners (0-1).
        contrast: Strength of the tone curve (0-1).

    Raises:
        ValueError: If a value is out of its range.
    """

    defocus_px: float = 0.35
    f_number: float = 4.0
    pixel_um: float = 3.3
    exposure_s: float = 1.0 / 800.0
    exposure_ev: float = 0.0
    exposure_jitter_ev: float = 0.04
    full_well: float = 9000.0
    read_noise: float = 4.0
    vignetting: float = 0.22
    contrast: float = 0.28

    def __post_init__(self) -> None:
        for name, low, high in (
            ("defocus_px", 0.0, 20.0),
            ("f_number", 0.7, 64.0),
            ("pixel_um", 0.5, 50.0),
            ("exposure_s", 0.0, 1.0),
            ("exposure_ev", -8.0, 8.0),
            ("exposure_jitter_ev", 0.0, 2.0),
            ("full_well", 100.0, 1e7),
            ("read_noise", 0.0, 1e3),
            ("vignetting", 0.0, 0.95),
            ("contrast", 0.0, 1.0),
        ):
            value = getattr(self, name)
            if not (np.isfinite(value) and low <= value <= high):
                raise ValueError(f"{name} must lie in {low:g} to {high:g}, got {value!r}")

    @property
    def blur_px(self) -> float:
        """Standard deviation of all blur that is alike everywhere [px].

        The Airy disk is taken as a Gaussian of 0.42 wavelengths times the f-number.
        """
        airy = 0.42 * _WAVELENGTH_UM * self.f_number / self.pixel_um
        return float(np.hypot(self.defocus_px, airy))


def smear(image: Image, motion_px: NDArray[np.float64]) -> Image:
    """Blur along a straight motion, centred, so that nothing shifts.

    Args:
        image: Shape (H, W) or (H, W, C), float32.
        motion_px: Shape (2,), motion during the exposure, x and y [px].
    """
    length = float(np.hypot(*motion_px))
    if length < 0.05:
        return image
    reach = int(np.ceil(length / 2)) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    steps = max(int(np.ceil(length * 8)), 9)
    for t in np.linspace(-0.5, 0.5, steps):
        x, y = motion_px * t + reach
        c, r = int(np.floor(x)), int(np.floor(y))
        fx, fy = x - c, y - r
        kernel[r, c] += (1 - fx) * (1 - fy)
        kernel[r, c + 1] += fx * (1 - fy)
        kernel[r + 1, c] += (1 - fx) * fy
        kernel[r + 1, c + 1] += fx * fy
    kernel /= kernel.sum()
    return np.asarray(cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REFLECT), np.float32)


def _blur(image: Image, sigma_px: float) -> Image:
    if sigma_px <= 0.05:
        return image
    soft = cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT)
    return np.asarray(soft, dtype=np.float32)


def tone(linear: Image, contrast: float) -> Image:
    """Return display values in [0, 1]: shoulder, sRGB curve, S-shaped contrast."""
    x = 1.0 - np.exp(-np.maximum(linear, 0.0))
    y = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1.0 / 2.4) - 0.055)
    smooth = y * y * (3.0 - 2.0 * y)
    return np.asarray(y + contrast * (smooth - y), dtype=np.float32)


def expose(
    radiance: Image,
    effects: CameraEffects,
    gain: float,
    motion_px: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return the photo of a radiance picture.

    Args:
        radiance: Shape (H, W, 3), float32, linear RGB.
        effects: The camera.
        gain: Exposure: radiance times gain is 1 at three quarters of the sensor's range.
        motion_px: Shape (2,), motion of the picture during the exposure [px].
        rng: Of noise and exposure.

    Returns:
        Shape (H, W, 3), uint8, RGB.
    """
    height, width = radiance.shape[:2]
    ev = effects.exposure_ev + effects.exposure_jitter_ev * float(rng.standard_normal())
    light = _blur(smear(radiance * np.float32(gain * 2.0**ev), motion_px), effects.blur_px)
    y = (np.arange(height, dtype=np.float32) - (height - 1) / 2) * (2.0 / max(height, width))
    x = (np.arange(width, dtype=np.float32) - (width - 1) / 2) * (2.0 / max(height, width))
    r2 = (y[:, None] ** 2 + x[None, :] ** 2) / np.float32(2.0)
    light = light * (1.0 - np.float32(effects.vignetting) * r2)[..., None]
    electrons = light * np.float32(effects.full_well / 4.0)
    sigma = np.sqrt(electrons + np.float32(effects.read_noise**2))
    electrons += sigma * rng.standard_normal(light.shape, dtype=np.float32)
    shown = tone(electrons * np.float32(4.0 / effects.full_well), effects.contrast)
    return np.asarray(np.clip(np.rint(shown * 255.0), 0, 255), dtype=np.uint8)


def expose_thermal(
    temperature_c: Image,
    effects: CameraEffects,
    span_c: tuple[float, float],
    motion_px: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return the grey photo of a thermal camera.

    Args:
        temperature_c: Shape (H, W), float32, surface temperature [deg C].
        effects: Blur of the camera; its sensor noise is replaced by 0.06 K.
        span_c: Temperatures shown as black and white [deg C].
        motion_px: Shape (2,), motion of the picture during the exposure [px].
        rng: Of the noise.

    Returns:
        Shape (H, W), uint8.
    """
    # Thermal lenses are softer than those of colour cameras.
    heat = _blur(smear(temperature_c, motion_px), float(np.hypot(effects.blur_px, 0.8)))
    noise = 0.06 * rng.standard_normal(heat.shape, dtype=np.float32)
    noise += 0.03 * rng.standard_normal((1, heat.shape[1]), dtype=np.float32)
    low, high = span_c
    shown = (heat + noise - np.float32(low)) / np.float32(high - low)
    return np.asarray(np.clip(np.rint(shown * 255.0), 0, 255), dtype=np.uint8)
