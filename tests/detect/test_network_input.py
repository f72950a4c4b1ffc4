import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.detect.network_input import CHANNELS, network_input


def scene(seed=0, height=200, width=240):
    rng = np.random.default_rng(seed)
    return rng.normal(100.0, 4.0, (height, width, 3)).astype(np.float32)


@given(st.floats(0.1, 20.0), st.floats(-50.0, 50.0))
def test_exposure_does_not_matter(gain, offset):
    image = scene()
    before, after = network_input(image), network_input(image * gain + offset)
    assert np.allclose(before[:9], after[:9], atol=2e-3)
    # a contrast may fall into the next bin of a histogram
    for name in ("plain surprise", "rare contrast"):
        off = np.abs(before - after)[CHANNELS.index(name)]
        assert np.mean(off > 0.05) < 0.01


@given(st.floats(0.1, 20.0))
def test_rarity_of_colours_knows_no_exposure(gain):
    image = scene()
    image[50:60, 50:60] += (40.0, 0.0, -40.0)
    before, after = network_input(image), network_input(image * gain)
    off = np.abs(before - after)[CHANNELS.index("rare colour")]
    assert np.mean(off > 0.05) < 0.01
    assert before[CHANNELS.index("rare colour"), 50:60, 50:60].mean() > 1.0


def test_a_half_of_another_exposure_leaves_the_other_half_as_it_is():
    image = scene(1, 200, 600)
    other = image.copy()
    other[:, 400:] = other[:, 400:] * 5.0 + 200.0
    before, after = network_input(image), network_input(other)
    # farther than the surround from the seam
    assert np.allclose(before[:9, :, :330], after[:9, :, :330], atol=2e-3)
    # its histogram is that of the whole image
    channel = CHANNELS.index("rare contrast")
    assert np.median(np.abs(before - after)[channel, :, :330]) < 0.1


def test_a_person_stands_out_and_a_lamp_beside_it_does_not_hide_it():
    image = scene(2)
    image[100:120, 60:70] += 30.0
    alone = network_input(image)[0, 100:120, 60:70].mean()
    image[100:120, 90:100] = 255.0
    beside = network_input(image)[0, 100:120, 60:70].mean()
    assert alone > 1.2
    assert beside > 0.5 * alone


def test_hue_stays():
    image = scene(3)
    image[50:60, 50:60] += (40.0, 0.0, -40.0)
    red, green, blue = network_input(image)[:3, 50:60, 50:60].mean(axis=(1, 2))
    assert red > 1.0
    assert abs(green) < 0.2
    assert blue < -1.0


def test_unknown_is_zero_and_never_nan():
    image = scene(4)
    image[:, :100] = np.nan
    rays = np.full(image.shape[:2], 20.0)
    rays[:60] = 0.0
    rarity = np.where(rays > 0, 0.1, np.nan)
    whole = network_input(image, rays, rarity)
    assert whole.shape == (len(CHANNELS), 200, 240)
    assert np.isfinite(whole).all()
    assert (whole[:7, :60] == 0.0).all()
    assert (whole[:6, :, :100] == 0.0).all()
    assert np.allclose(whole[7, 60:], np.log1p(20.0) / 4.0)
    assert (network_input(np.full((5, 5), np.nan)) == 0.0).all()
    assert (network_input(np.zeros((1, 1))) == 0.0).all()


def test_the_image_stands_in_for_the_plain_mean():
    image = scene(5)
    whole = network_input(image)
    assert np.array_equal(whole[0:3], whole[3:6])
    unknown = [CHANNELS.index(n) for n in ("rarity", "rays", "coherence", "coherent colour")]
    assert (whole[unknown] == 0.0).all()
    grey = network_input(image[..., 0])
    assert np.array_equal(grey[0], grey[1])


def test_the_ground_is_seen_as_if_nothing_stood_on_it():
    image, soil = scene(6), scene(7)
    soil[50:60, 50:60] += (40.0, 0.0, -40.0)
    rays = np.full(image.shape[:2], 30.0)
    reach = np.full(image.shape[:2], 6.0)
    reach[:, :30] = 0.0
    soil[:, :30] = 0.0  # what no ray of the ground reaches has no colour
    whole = network_input(image, rays, ground=(soil, reach))
    named = dict(zip(CHANNELS, whole, strict=True))
    assert named["ground red-green"][50:60, 50:60].mean() > 1.0
    assert named["ground blue-yellow"][50:60, 50:60].mean() < -1.0
    assert abs(named["ground light"][50:60, 50:60].mean()) < 1.0
    assert named["ground surprise"][50:60, 50:60].mean() > named["ground surprise"].mean() + 0.5
    colours = [
        named[f"ground {name}"] for name in ("light", "red-green", "blue-yellow", "surprise")
    ]
    assert all((one[:, :30] == 0.0).all() for one in colours)
    assert np.abs(named["ground light"][:, 31:40]).max() < 1.2  # no dark seam
    assert np.allclose(named["ground rays"][:, 30:], 0.5 * np.log1p(6.0))
    assert (network_input(image, rays, ground=(soil, 0.0 * reach))[19:] == 0.0).all()


def test_clothes_in_a_shadow_stand_out_as_in_the_sun():
    soil = scene(10)
    soil[:, 120:] *= 0.25
    soil[50:60, 50:60] *= (1.3, 1.0, 0.8)
    soil[50:60, 190:200] *= (1.3, 1.0, 0.8)
    whole = network_input(scene(11), ground=(soil, np.full(soil.shape[:2], 6.0)))
    for name, sign in (("ground red-green", 1.0), ("ground blue-yellow", -1.0)):
        channel = sign * whole[CHANNELS.index(name)]
        sun, shade = (channel[50:60, x : x + 10].mean() for x in (50, 190))
        assert min(sun, shade) > 0.8
        assert 0.6 < shade / sun < 1.6


def test_evidence_counts_by_the_rays_that_reach_the_ground():
    """Of two people the same share of ground rays shows one; a sixth of the rays reaches him."""
    rng = np.random.default_rng(8)
    image = scene(9)
    rays, reach = np.full(image.shape[:2], 30.0), np.full(image.shape[:2], 12.0)
    reach[:, 120:] = 2.0
    share = np.abs(rng.normal(0.01, 0.002, reach.shape))
    share[90:110, 40:60] = share[90:110, 180:200] = 0.5
    evidence = share * reach / rays
    both = network_input(image, rays, fragments=evidence, ground=(image, reach))
    named = dict(zip(CHANNELS, both, strict=True))
    well, hardly = (
        [named[name][90:110, x : x + 20].mean() for name in ("fragments", "ground fragments")]
        for x in (40, 180)
    )
    assert min(*well, *hardly) > 0.5
    assert hardly[1] / well[1] > hardly[0] / well[0]


@pytest.mark.parametrize(
    ("image", "more", "words"),
    [
        (np.zeros((4, 4, 2)), {}, "image must have shape"),
        (np.zeros((0, 4)), {}, "image must have shape"),
        (np.zeros((4, 4)), {"footprint": np.zeros((4, 5))}, "footprint must have the image's size"),
        (np.zeros((4, 4)), {"rarity": np.zeros(4)}, "rarity must have the image's size"),
        (np.zeros((4, 4)), {"plain": np.zeros((5, 4, 3))}, "plain must have the image's size"),
        (
            np.zeros((4, 4)),
            {"ground": (np.zeros((4, 4, 3)), np.zeros(4))},
            r"ground\[1\] must have the image's size",
        ),
    ],
)
def test_shapes_that_do_not_fit(image, more, words):
    with pytest.raises(ValueError, match=words):
        network_input(image, **more)
