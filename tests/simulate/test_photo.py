from __future__ import annotations

import numpy as np
import pytest

from hsvaos.simulate.photo import CameraEffects, expose, expose_thermal, smear, tone

QUIET = CameraEffects(
    exposure_jitter_ev=0.0,
    full_well=1e7,
    read_noise=0.0,
    vignetting=0.0,
    defocus_px=0.0,
    f_number=0.7,
    pixel_um=50.0,
)


def dot() -> np.ndarray:
    image = np.full((41, 41, 3), 0.02, dtype=np.float32)
    image[20, 20] = 1.0
    return image


@pytest.mark.parametrize("motion", [(6.0, 0.0), (0.0, -4.0), (3.0, 4.0), (0.0, 0.0)])
def test_motion_spreads_light_without_moving_or_losing_it(motion: tuple[float, float]) -> None:
    blurred = smear(dot(), np.array(motion)) - 0.02
    weight = blurred[..., 0]
    assert weight.sum() == pytest.approx(0.98, rel=1e-4)
    yy, xx = np.mgrid[0:41, 0:41]
    x, y = (weight * xx).sum() / weight.sum(), (weight * yy).sum() / weight.sum()
    np.testing.assert_allclose([x, y], [20.0, 20.0], atol=1e-3)
    spread = np.sqrt((weight * ((xx - x) ** 2 + (yy - y) ** 2)).sum() / weight.sum())
    # A line of length L has the standard deviation L / sqrt(12); bilinear taps add a little.
    assert spread == pytest.approx(np.hypot(*motion) / np.sqrt(12), abs=0.35)


def test_blur_is_centred_and_vignetting_dims_the_corners_only() -> None:
    flat = np.full((64, 64, 3), 0.3, dtype=np.float32)
    rng = np.random.default_rng(0)
    effects = CameraEffects(exposure_jitter_ev=0.0, full_well=1e7, read_noise=0.0, vignetting=0.5)
    shown = expose(flat, effects, 1.0, np.zeros(2), rng).astype(float)
    assert shown[32, 32].mean() > 1.2 * shown[0, 0].mean()
    np.testing.assert_allclose(shown, shown[::-1, ::-1], atol=1.5)


def test_noise_grows_as_the_well_shrinks() -> None:
    flat = np.full((64, 64, 3), 0.3, dtype=np.float32)
    spread = []
    for well in (1e3, 1e4, 1e6):
        effects = CameraEffects(exposure_jitter_ev=0.0, full_well=well, vignetting=0.0)
        photo = expose(flat, effects, 1.0, np.zeros(2), np.random.default_rng(0))
        spread.append(float(photo.std()))
    assert spread[0] > 2.0 * spread[1] > 2.0 * spread[2]


def test_exposure_is_in_stops_and_the_tone_curve_rises() -> None:
    curve = tone(np.linspace(0.0, 8.0, 200, dtype=np.float32), 0.5)
    assert curve[0] == 0.0
    assert (np.diff(curve) >= 0.0).all()
    assert curve[-1] <= 1.0
    flat = np.full((16, 16, 3), 0.1, dtype=np.float32)
    rng = np.random.default_rng(0)
    twice = expose(flat, QUIET, 2.0, np.zeros(2), rng)
    from dataclasses import replace

    stop = expose(flat, replace(QUIET, exposure_ev=1.0), 1.0, np.zeros(2), rng)
    np.testing.assert_allclose(twice.astype(int), stop.astype(int), atol=1)


def test_warm_is_bright_in_a_thermal_photo() -> None:
    heat = np.full((40, 40), 15.0, dtype=np.float32)
    heat[15:25, 15:25] = 31.0
    photo = expose_thermal(heat, QUIET, (12.0, 34.0), np.zeros(2), np.random.default_rng(0))
    assert photo.shape == (40, 40)
    assert photo[18:22, 18:22].mean() == pytest.approx(255 * 19 / 22, abs=4)
    assert photo[:5, :5].mean() == pytest.approx(255 * 3 / 22, abs=4)


@pytest.mark.parametrize(
    "change",
    [{"defocus_px": -1.0}, {"vignetting": 1.0}, {"exposure_s": float("nan")}, {"full_well": 0.0}],
)
def test_bad_cameras_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        CameraEffects(**change)
