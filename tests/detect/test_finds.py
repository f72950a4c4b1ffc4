"""Peaks of a rarity map, their places, and finds merged over views."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import Camera, Detections, FocalPlane, Origin, VirtualCamera
from hsvaos.detect.anomaly import find_persons, local_z
from hsvaos.detect.locate import ViewFinds, box_places, merge_views, pose_spread
from hsvaos.kernels.rays import focal_points
from hsvaos.settings import DetectSettings

GSD = 0.05


def rarity_map(seed: int, at: tuple[int, int] | None, strength: float = 0.5) -> np.ndarray:
    """Noise as of a few rays, and a lying person of 1.5 m x 0.5 m."""
    values = np.random.default_rng(seed).exponential(0.05, (240, 260)).astype(np.float32)
    if at is not None:
        values[at[0] - 15 : at[0] + 15, at[1] - 5 : at[1] + 5] += strength
    return values


@given(seed=st.integers(0, 10**6), row=st.integers(40, 200), column=st.integers(40, 220))
def test_person_is_found_where_it_lies(seed: int, row: int, column: int) -> None:
    rays = np.full((240, 260), 10.0, np.float32)
    found = find_persons(rarity_map(seed, (row, column)), rays, GSD, DetectSettings())
    left, top, right, bottom = found.boxes_xyxy[0]
    assert (left + right) / 2 == pytest.approx(column, abs=4)
    assert (top + bottom) / 2 == pytest.approx(row, abs=8)
    assert found.scores[0] == found.scores.max()
    assert len(found) == 1


@given(seed=st.integers(0, 10**6))
def test_noise_has_no_persons(seed: int) -> None:
    rays = np.full((240, 260), 10.0, np.float32)
    assert len(find_persons(rarity_map(seed, None), rays, GSD, DetectSettings())) == 0


def test_unseen_pixels_neither_count_nor_are_found() -> None:
    values = rarity_map(0, (60, 60))
    rays = np.full(values.shape, 10.0, np.float32)
    rays[:, 130:] = 0.0
    values[:, 130:] = 50.0  # what lies there is no measurement
    z = local_z(values, rays, GSD)
    assert (z[:, 130:] == 0).all()
    found = find_persons(values, rays, GSD, DetectSettings())
    assert (found.boxes_xyxy[:, 0] < 130).all()
    assert len(found) == 1


def test_fine_views_are_coarsened_to_the_same_place() -> None:
    coarse = rarity_map(3, (100, 90))
    fine = np.kron(coarse, np.ones((5, 5), np.float32))
    rays = np.full(fine.shape, 10.0, np.float32)
    found = find_persons(fine, rays, GSD / 5, DetectSettings())
    left, top, right, bottom = found.boxes_xyxy[0]
    assert (left + right) / 2 == pytest.approx(5 * 90, abs=20)
    assert (top + bottom) / 2 == pytest.approx(5 * 100, abs=40)


@pytest.mark.parametrize("value", [0.0, 0.3])
def test_flat_maps_have_no_finds(value: float) -> None:
    flat = np.full((50, 60), value, np.float32)
    rays = np.full(flat.shape, 5.0, np.float32)
    assert len(find_persons(flat, rays, GSD, DetectSettings())) == 0
    assert len(find_persons(flat, 0 * rays, GSD, DetectSettings())) == 0
    tiny = flat[:1, :1]
    assert len(find_persons(tiny, rays[:1, :1], GSD, DetectSettings())) == 0


def detections(*boxes: tuple[float, float, float, float], scores: list[float]) -> Detections:
    return Detections(
        np.array(boxes, np.float32).reshape(-1, 4),
        np.array(scores, np.float32),
        np.zeros(len(scores), np.int64),
    )


def looking_down(north: float, east: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    pose[:3, 3] = [north, east, -20.0]
    return pose


def test_boxes_of_two_views_become_one_person_at_its_place() -> None:
    camera = Camera.from_fov(201, 201, 90.0)
    place = np.array([3.0, -2.0, 0.0])
    finds = []
    for north, east, score in ((0.0, 0.0, 8.0), (4.0, -5.0, 4.0)):
        view = VirtualCamera(camera, looking_down(north, east))
        u, v = view.project(place)
        found = detections((u - 4, v - 2, u + 4, v + 2), scores=[score])
        hits = focal_points(view, FocalPlane(0.0)).numpy().reshape(201, 201, 4)
        finds.append(ViewFinds(view, found, *box_places(found, hits, view)))
    (person,) = merge_views(finds, 1.8, 3.0, Origin(48.0, 14.0, 300.0))
    assert (person.north_m, person.east_m) == pytest.approx((3.0, -2.0), abs=0.15)
    assert person.views == 2
    assert person.score == 6.0
    assert 0.2 < person.std_m < 0.8
    assert person.covariance_m2 is not None
    covariance = np.array(person.covariance_m2)
    assert person.std_m == pytest.approx(np.sqrt(np.trace(covariance) / 2))
    np.testing.assert_array_equal(covariance, covariance.T)
    # boxes are twice as wide as high: wider east than north
    assert covariance[1, 1] > 2.0 * covariance[0, 0]
    assert person.lat_deg == pytest.approx(48.0 + 3.0 / 111200, abs=1e-6)
    assert person.lon_deg == pytest.approx(14.0 - 2.0 / 74600, abs=1e-6)


def test_box_covariance_is_that_of_a_place_anywhere_in_the_box() -> None:
    camera = Camera.from_fov(401, 401, 90.0)
    view = VirtualCamera(camera, looking_down(0.0, 0.0))
    hits = focal_points(view, FocalPlane(0.0)).numpy().reshape(401, 401, 4)
    found = detections((100, 150, 140, 160), scores=[0.5])
    _, covariances = box_places(found, hits, view)
    east, north = np.random.default_rng(0).uniform((-2.0, -0.5), (2.0, 0.5), (200_000, 2)).T
    np.testing.assert_allclose(covariances[0], np.cov(north, east), atol=0.01)
    # turned by 30 degrees the same box has the same spread along its own sides
    a = np.radians(30.0)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
    pose = looking_down(0.0, 0.0)
    pose[:3, :3] = turn @ pose[:3, :3]
    turned = VirtualCamera(camera, pose)
    hits = focal_points(turned, FocalPlane(0.0)).numpy().reshape(401, 401, 4)
    _, others = box_places(found, hits, turned)
    expected = turn[:2, :2] @ covariances[0] @ turn[:2, :2].T
    np.testing.assert_allclose(others[0], expected, atol=1e-6)


@given(seed=st.integers(0, 10**6))
def test_pose_covariance_reaches_the_ground(seed: int) -> None:
    """Against poses drawn at random, each casting its own ray through the box's middle."""
    rng = np.random.default_rng(seed)
    camera = Camera.from_fov(201, 201, 90.0)
    pose = looking_down(1.0, 2.0)
    tilt = np.radians(rng.uniform(-15.0, 15.0, 3))
    pose[:3, :3] = rotation(tilt) @ pose[:3, :3]
    view = VirtualCamera(camera, pose)
    hits = focal_points(view, FocalPlane(0.0)).numpy().reshape(201, 201, 4)
    row, column = rng.integers(40, 160, 2)
    found = detections((column, row, column, row), scores=[1.0])
    root = rng.normal(size=(6, 6)) * ([[0.1]] * 3 + [[0.005]] * 3)
    covariance = root @ root.T
    _, (got,) = box_places(found, hits, view, covariance)
    places = []
    for error in rng.multivariate_normal(np.zeros(6), covariance, 4000):
        moved = pose.copy()
        moved[:3, :3] = rotation(error[3:]) @ pose[:3, :3]
        moved[:3, 3] += error[:3]
        origin, direction = VirtualCamera(camera, moved).rays([column, row])
        places.append((origin - direction * origin[2] / direction[2])[:2])
    expected = np.cov(np.array(places).T)
    np.testing.assert_allclose(got, expected, atol=0.12 * np.trace(expected))


def test_errors_shared_by_all_photos_are_not_averaged_away() -> None:
    camera = Camera.from_fov(201, 201, 90.0)
    pose = looking_down(1.0, 2.0)
    poses = np.stack([pose] * 7)
    poses[3:, 0, 3] += 500.0  # these do not hold the place
    covariance = np.diag([0.3, 0.2, 0.4, 0.01, 0.02, 0.015]) ** 2
    covariances = np.stack([covariance] * 3 + [100.0 * np.eye(6)] * 4)
    place = np.array([2.5, 1.0, 0.0])
    got = pose_spread([place, [np.nan] * 3, [9e3, 0.0, 0.0]], camera, poses, covariances)
    view = VirtualCamera(camera, pose)
    hits = focal_points(view, FocalPlane(0.0)).numpy().reshape(201, 201, 4)
    column, row = view.project(place).round().astype(int)
    found = detections((column, row, column, row), scores=[1.0])
    _, (alone,) = box_places(found, hits, view, covariance)
    np.testing.assert_allclose(got[0], alone, rtol=0.05, atol=1e-3)
    assert got[0, 0, 0] > 0.09
    assert (got[1:] == 0.0).all()


def rotation(vector: np.ndarray) -> np.ndarray:
    matrix, _ = cv2.Rodrigues(np.asarray(vector, np.float64))
    return np.asarray(matrix)


def test_pose_covariance_mistakes() -> None:
    camera = Camera.from_fov(21, 21, 90.0)
    view = VirtualCamera(camera, looking_down(0.0, 0.0))
    hits = focal_points(view, FocalPlane(0.0)).numpy().reshape(21, 21, 4)
    found = detections((3, 3, 5, 5), scores=[1.0])
    for wrong in (np.eye(3), np.full((6, 6), np.nan)):
        with pytest.raises(ValueError, match="pose_covariance must be 6 x 6"):
            box_places(found, hits, view, wrong)
    with pytest.raises(ValueError, match="ground grid"):
        box_places(found, hits, VirtualCamera.ortho(0, 0, 1, 21, 21), np.eye(6))


@pytest.mark.parametrize("scores", [(0.9, 0.6), (11.0, 6.5), (0.0, 0.0)])
def test_probabilities_and_local_z_are_merged_alike(scores: tuple[float, float]) -> None:
    view = VirtualCamera.ortho(10.0, 0.0, 0.1, 100, 100)
    hits = focal_points(view, FocalPlane(0.0)).numpy().reshape(100, 100, 4)
    first = detections((10, 10, 14, 14), (13, 10, 17, 14), scores=list(scores))
    second = detections((12, 10, 16, 14), scores=[scores[1]])
    finds = [ViewFinds(view, one, *box_places(one, hits, view)) for one in (first, second)]
    (person,) = merge_views(finds, 1.8, 0.0, None)
    assert person.score == pytest.approx(sum(scores) / 2.0)
    assert person.views == 2
    assert np.isfinite([person.std_m, person.north_m]).all()


def test_far_finds_stay_apart_and_boxes_without_ground_are_dropped() -> None:
    view = VirtualCamera.ortho(10.0, 0.0, 0.1, 100, 100)
    hits = focal_points(view, FocalPlane(0.0)).numpy().reshape(100, 100, 4).copy()
    hits[60:] = 0.0
    found = detections(
        (10, 10, 14, 14), (50, 10, 54, 14), (20, 80, 24, 84), scores=[7.0, 9.0, 20.0]
    )
    persons = merge_views([ViewFinds(view, found, *box_places(found, hits, view))], 1.8, 3.0, None)
    assert [p.score for p in persons] == [9.0, 7.0]
    assert persons[0].north_m == pytest.approx(10.0 - 1.2)
    assert persons[0].east_m == pytest.approx(5.2)
    assert persons[0].lat_deg is None


def test_what_other_views_do_not_find_scores_less() -> None:
    camera = Camera.from_fov(201, 201, 90.0)
    finds = []
    for north in (0.0, 3.0, 6.0, 100.0):  # the last one does not hold the place
        view = VirtualCamera(camera, looking_down(north, 0.0))
        hits = focal_points(view, FocalPlane(0.0)).numpy().reshape(201, 201, 4)
        u, v = view.project([2.0, 1.0, 0.0])
        seen = north == 3.0
        found = detections((u - 2, v - 2, u + 2, v + 2), scores=[9.0]) if seen else None
        found = found or Detections.none()
        finds.append(ViewFinds(view, found, *box_places(found, hits, view)))
    (person,) = merge_views(finds, 1.8, 2.0, None)
    assert person.score == pytest.approx(3.0)
    assert person.views == 1
    assert merge_views(finds, 1.8, 3.5, None) == ()


def test_lengths_that_differ_are_refused() -> None:
    with pytest.raises(ValueError, match="boxes"):
        Detections(np.zeros((2, 4), np.float32), np.zeros(1, np.float32), np.zeros(1, np.int64))
