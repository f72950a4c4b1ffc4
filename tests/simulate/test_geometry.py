"""What is in the photos lies where the camera model says, and the integral shows it there."""

from __future__ import annotations

import numpy as np
import pytest

from hsvaos import FocalPlane, VirtualCamera
from hsvaos.camera import Camera
from hsvaos.kernels.integrate import Integrator
from hsvaos.nav import attitude
from hsvaos.simulate.buffers import depths, instance_numbers, ray_table
from hsvaos.simulate.forest import ForestSettings, grow_forest
from hsvaos.simulate.instances import Kind
from hsvaos.simulate.mission import Mission
from hsvaos.simulate.people import lay_person, stake_mesh
from hsvaos.simulate.photo import CameraEffects, expose
from hsvaos.simulate.scene import Scene
from hsvaos.simulate.simulation import Simulation

LENS = Camera(320, 240, 210.0, 212.0, 158.0, 121.5, (-0.11, 0.025, 0.002, -0.0015, 0.0))


def poses() -> list[np.ndarray]:
    found = []
    for n, e, roll, pitch, yaw in ((0, 0, 4, -6, 20), (3, -2, -8, 3, 200), (-4, 3, 2, 9, -75)):
        pose = np.eye(4)
        down = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
        turn = attitude.matrix(attitude.from_euler(*np.radians([roll, pitch, yaw])))
        pose[:3, :3] = turn @ down
        pose[:3, 3] = n, e, -14.0
        found.append(pose)
    return found


@pytest.fixture(scope="module")
def stakes() -> tuple[Scene, np.ndarray, list[int]]:
    forest = grow_forest(ForestSettings(seed=2, density=0.0, half_m=14.0, bushes=0.0, glades=0.0))
    instances = forest.instances.copy()
    mesh = instances.add_mesh(stake_mesh(height_m=1.0, plate_m=0.25))
    rng = np.random.default_rng(0)
    tops = np.concatenate([rng.uniform(-7, 7, (14, 2)), rng.uniform(-2.0, -0.8, (14, 1))], axis=1)
    numbers = [instances.add(mesh, Kind.STAKE, np.eye(3), top) for top in tops]
    return forest.scene(instances, sun_map_size=512, sky_map_size=128), tops, numbers


def test_known_points_are_found_where_the_distorted_camera_projects_them(
    stakes: tuple[Scene, np.ndarray, list[int]],
) -> None:
    scene, tops, numbers = stakes
    fine = LENS.scaled(LENS.width * 3, LENS.height * 3)
    rays, fine_rays = ray_table(LENS), ray_table(fine)
    errors = []
    for pose in poses():
        image = expose(
            np.ascontiguousarray(
                scene.radiance(LENS, pose, rays, scene.keys(LENS, pose, rays))[..., :3]
            ),
            CameraEffects(exposure_jitter_ev=0.0, full_well=1e6, read_noise=0.0, vignetting=0.0),
            0.15,
            np.zeros(2),
            np.random.default_rng(0),
        ).astype(float)
        shown = instance_numbers(scene.keys(fine, pose, fine_rays), fine)
        depth = depths(scene.keys(fine, pose, fine_rays), fine)
        for top, number in zip(tops, numbers, strict=True):
            local = (top - pose[:3, 3]) @ pose[:3, :3]
            pixel = LENS.project(local)
            if not ((pixel > 8).all() and (pixel < np.array([312, 232])).all()):
                continue
            # Exact: the plate's own pixels, three times finer than the photo.
            plate = (shown == number) & (np.abs(depth - local[2]) < 0.12)
            rows, columns = np.nonzero(plate)
            centre = (np.array([columns.mean(), rows.mean()]) + 0.5) / 3.0 - 0.5
            errors.append(centre - pixel)
            # In the photo: the centroid of the bright plate.
            x, y = np.rint(pixel).astype(int)
            part = image[y - 4 : y + 5, x - 4 : x + 5].mean(axis=2)
            weight = np.clip(part - np.quantile(part, 0.5), 0.0, None) ** 2
            yy, xx = np.mgrid[y - 4 : y + 5, x - 4 : x + 5]
            found = np.array([(weight * xx).sum(), (weight * yy).sum()]) / weight.sum()
            assert np.hypot(*(found - pixel)) < 0.6
    errors = np.array(errors)
    assert len(errors) >= 20
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.3
    assert np.abs(errors.mean(axis=0)).max() < 0.05


def test_a_persons_pixels_fill_its_projected_body() -> None:
    forest = grow_forest(ForestSettings(seed=2, density=0.0, half_m=14.0, bushes=0.0, glades=0.0))
    instances = forest.instances.copy()
    person = lay_person(0, forest.ground, 1.0, -2.0, 2)
    number = instances.add(instances.add_mesh(person.mesh), Kind.PERSON, np.eye(3), person.place)
    scene = forest.scene(instances)
    rays = ray_table(LENS)
    for pose in poses():
        alone = instance_numbers(scene.keys(LENS, pose, rays, only=[number]), LENS) == number
        points = (person.mesh.vertices() + person.place - pose[:3, 3]) @ pose[:3, :3]
        pixels = LENS.project(points)
        rows, columns = np.nonzero(alone)
        # The outermost pixel centres lie inside the projected body, by less than a pixel.
        for have, want in (
            (columns.min(), pixels[:, 0].min()),
            (rows.min(), pixels[:, 1].min()),
            (-columns.max(), -pixels[:, 0].max()),
            (-rows.max(), -pixels[:, 1].max()),
        ):
            assert -0.01 < have - want < 1.6
        outline = LENS.project((person.outline - pose[:3, 3]) @ pose[:3, :3])
        assert outline[:, 0].min() < columns.mean() < outline[:, 0].max()
        assert outline[:, 1].min() < rows.mean() < outline[:, 1].max()


def test_people_lie_on_the_ground() -> None:
    forest = grow_forest(ForestSettings(seed=4, density=0.0, half_m=14.0, relief_m=0.4))
    for k in range(12):
        person = lay_person(k, forest.ground, -6.0 + k, 5.0 - k, 4)
        points = person.mesh.vertices() + person.place
        height = forest.ground.down_at(points[:, 0], points[:, 1]) - points[:, 2]
        assert -0.10 < height.min() < 0.0
        assert 0.15 < height.max() < 0.95
        size = np.ptp(person.outline[:, :2], axis=0)
        assert size.min() > 0.3
        assert np.hypot(*size) < 2.9


def test_the_integral_shows_each_stake_at_its_place_within_2_cm() -> None:
    from tests.simulate.conftest import small_settings

    base = Camera.from_fov(512, 512, 64.0)
    camera = Camera(512, 512, base.fx, base.fy, 252.0, 259.0, (-0.10, 0.02, 0.0015, -0.001, 0.0))
    simulation = Simulation(
        small_settings(
            camera=camera,
            people=0,
            classes=None,
            stakes=3,
            mission=Mission(photos=9, hover_s=1.0),
            forest=ForestSettings(seed=8, density=110.0, leaf_density=0.3, bushes=0.0),
        )
    )
    images = np.stack([simulation.photo(k).image for k in range(len(simulation.poses))])
    integrator = Integrator(simulation.camera, images, simulation.poses)
    for north, east, down in simulation.stakes:
        gsd, size = 0.02, 41
        half = gsd * (size - 1) / 2
        view = VirtualCamera.ortho(north + half, east - half, gsd, size, size)
        image, footprint = integrator.integrate(view, FocalPlane(float(down)))
        assert footprint.max() >= 5
        # White shows in all channels; where the plate is more than half as bright as its middle.
        white = np.asarray(image).min(axis=2)
        low, high = np.quantile(white, 0.2), np.quantile(white, 0.95)
        plate = white > 0.5 * (low + high)
        rows, columns = np.nonzero(plate)
        off_north = ((size - 1) / 2 - rows.mean()) * gsd
        off_east = (columns.mean() - (size - 1) / 2) * gsd
        area = plate.sum() * gsd**2
        assert 0.054 < area < 0.135
        assert np.hypot(off_north, off_east) < 0.02
