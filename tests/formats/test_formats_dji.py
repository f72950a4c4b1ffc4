from __future__ import annotations

import csv
import struct

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hsvaos
from hsvaos.flight import FlightError
from hsvaos.formats.dji import Angles, camera_rotation, gimbal_angles, position
from hsvaos.formats.dji_camera import dji_camera, full_diagonal_px
from hsvaos.formats.exif import PhotoTags, read_tags, xmp_values
from hsvaos.geodesy import geodetic_from_ned, ned_from_geodetic

NOISE = np.random.default_rng(2).integers(0, 256, (30, 40, 3), dtype=np.uint8)
DOWN = {"GimbalYawDegree": "+30.0", "GimbalPitchDegree": "-90.0", "GimbalRollDegree": "0.0"}
HERE = {"GpsLatitude": "46.84", "GpsLongitude": "-91.99"}
HIGH = {"AbsoluteAltitude": "+198.5", "RelativeAltitude": "+40.0"}


def exif_block(order="<", second=7):
    """Exif of a camera at 46 deg 30' N, 91 deg 59' 40.8" W, 12 m below the sea."""

    def entry(tag, kind, count, value):
        return struct.pack(order + "HHI", tag, kind, count) + value

    def short(value):
        return struct.pack(order + "HH", value, 0)

    heap = b""
    tables = [6, 3, 6]  # entries of the three directories
    starts = [8, 8 + 2 + 12 * 6 + 4, 8 + 2 + 12 * 6 + 4 + 2 + 12 * 3 + 4]
    heap_at = starts[2] + 2 + 12 * tables[2] + 4

    def far(content):
        nonlocal heap
        offset = struct.pack(order + "I", heap_at + len(heap))
        heap += content
        return offset

    def fractions(*values):
        return far(b"".join(struct.pack(order + "II", round(v * 1000), 1000) for v in values))

    time = f"2016:06:23 12:00:{second:02d}\0".encode()
    entries = [
        [
            entry(0x010F, 2, 4, b"DJI\0"),
            entry(0x0110, 2, 7, far(b"FC300S\0")),
            entry(0x0112, 3, 1, short(6)),
            entry(0x8769, 4, 1, struct.pack(order + "I", starts[1])),
            entry(0x8825, 4, 1, struct.pack(order + "I", starts[2])),
            entry(0x9999, 77, 1, short(0)),  # of a type that does not exist
        ],
        [
            entry(0x9003, 2, len(time), far(time)),
            entry(0x920A, 5, 1, fractions(3.61)),
            entry(0xA405, 3, 1, short(20)),
        ],
        [
            entry(1, 2, 2, b"N\0\0\0"),
            entry(2, 5, 3, fractions(46, 30, 0)),
            entry(3, 2, 2, b"W\0\0\0"),
            entry(4, 5, 3, fractions(91, 59, 40.8)),
            entry(5, 1, 1, b"\x01\0\0\0"),
            entry(6, 5, 1, fractions(12.0)),
        ],
    ]
    body = b"".join(
        struct.pack(order + "H", len(rows)) + b"".join(rows) + b"\0" * 4 for rows in entries
    )
    start = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8)
    return b"Exif\0\0" + start + body + heap


def photo(path, values, exif=b"", form="attributes", pixels=NOISE):
    """Write a JPEG with an XMP packet of the values."""
    if form == "attributes":
        inner = "".join(f'\n drone-dji:{key}="{value}"' for key, value in values.items())
        inner = f"<rdf:Description {inner}></rdf:Description>"
    else:
        inner = "".join(f"<dji:{key}>{value}</dji:{key}>\n" for key, value in values.items())
        inner = f"<rdf:Description>{inner}</rdf:Description>"
    xmp = f"http://ns.adobe.com/xap/1.0/\0<x:xmpmeta><rdf:RDF>{inner}</rdf:RDF></x:xmpmeta>"
    jpeg = cv2.imencode(".jpg", pixels)[1].tobytes()
    blocks = [block for block in (exif, xmp.encode()) if block]
    segments = b"".join(b"\xff\xe1" + struct.pack(">H", len(b) + 2) + b for b in blocks)
    path.write_bytes(jpeg[:2] + segments + jpeg[2:])


@pytest.mark.parametrize("order", ["<", ">"])
def test_exif_of_both_byte_orders(tmp_path, order):
    photo(tmp_path / "a.jpg", {}, exif_block(order))
    tags = read_tags(tmp_path / "a.jpg")
    assert (tags.make, tags.model) == ("DJI", "FC300S")
    assert (tags.focal_mm, tags.focal_35mm) == (3.61, 20.0)
    assert tags.lat_deg == pytest.approx(46.5)
    assert tags.lon_deg == pytest.approx(-(91 + 59 / 60 + 40.8 / 3600))
    assert tags.height_m == -12.0
    assert tags.time_s is not None
    assert tags.time_s % 60 == 7.0


@given(st.binary(max_size=60), st.integers(0, 300))
def test_damaged_exif_is_no_crash(tmp_path_factory, noise, at):
    block = bytearray(exif_block())
    block[14 + at : 14 + at + len(noise)] = noise
    path = tmp_path_factory.mktemp("exif") / "a.jpg"
    photo(path, DOWN, bytes(block))
    assert read_tags(path).xmp["GimbalYawDegree"] == "+30.0"


@pytest.mark.parametrize("form", ["attributes", "elements"])
@pytest.mark.parametrize("longitude", ["GpsLongitude", "GpsLongtitude"])
def test_dialects_of_xmp(tmp_path, form, longitude):
    photo(tmp_path / "a.jpg", DOWN | {"GpsLatitude": "1.5", longitude: "-2.5"}, form=form)
    tags = read_tags(tmp_path / "a.jpg")
    assert position(tags) == (1.5, -2.5)
    assert gimbal_angles(tags) == Angles(30.0, -90.0, 0.0)


def test_xmp_that_is_no_xml():
    values = xmp_values(b"<x a:One='1' b:Two=\"&lt;2&gt;\" <broken <c:Three>3</c:Three>\xff\xfe")
    assert values == {"One": "1", "Two": "<2>", "Three": "3"}
    assert PhotoTags(xmp={"A": "nan", "B": "x", "C": "4"}).xmp_number("A", "B", "C") == 4.0


def test_long_words_in_xmp_take_no_time():
    assert xmp_values(b'<a b:Image="' + b"A" * 500_000 + b'" c:D="1">')["D"] == "1"
    assert xmp_values(b"A" * 500_000) == {}


def test_place_zero_is_no_fix():
    assert position(PhotoTags(lat_deg=0.0, lon_deg=0.0)) is None
    assert position(PhotoTags(lat_deg=91.0, lon_deg=1.0)) is None
    assert position(PhotoTags(lat_deg=None, lon_deg=1.0)) is None


def up_in_photo(rotation):
    return -rotation[:, 1]


@given(st.floats(-180, 180))
def test_looking_down_the_top_of_the_photo_points_to_yaw(yaw):
    rotation, flipped = camera_rotation(Angles(yaw, -90.0, 0.0), None)
    heading = [np.cos(np.radians(yaw)), np.sin(np.radians(yaw)), 0.0]
    np.testing.assert_allclose(up_in_photo(rotation), heading, atol=1e-12)
    np.testing.assert_allclose(rotation[:, 2], [0, 0, 1], atol=1e-12)
    assert not flipped


@given(st.floats(-180, 180), st.floats(-70, 30))
def test_looking_ahead_the_axis_points_to_yaw_and_pitch(yaw, pitch):
    rotation, _ = camera_rotation(Angles(yaw, pitch, 0.0), None)
    y, p = np.radians([yaw, pitch])
    axis = [np.cos(p) * np.cos(y), np.cos(p) * np.sin(y), -np.sin(p)]
    np.testing.assert_allclose(rotation[:, 2], axis, atol=1e-12)
    assert up_in_photo(rotation)[2] < 0.0
    assert rotation[2, 0] == pytest.approx(0.0, abs=1e-12)  # the horizon is level
    # A roll flipped by 180 degrees alone is set upright.
    again, flipped = camera_rotation(Angles(yaw, pitch, 180.0), None)
    np.testing.assert_allclose(again, rotation, atol=1e-12)
    assert flipped


@given(st.floats(-180, 180), st.floats(-80, 80))
def test_flipped_roll_looking_down(yaw, off):
    right, _ = camera_rotation(Angles(yaw, -90.0, 0.0), None)
    # The same attitude told the other way round, and a roll that is flipped alone.
    for told in (Angles(yaw + 180.0, -90.0, 180.0), Angles(yaw, -90.0, 180.0)):
        rotation, flipped = camera_rotation(told, yaw + off)
        np.testing.assert_allclose(rotation, right, atol=1e-12)
        assert flipped == (told.yaw == yaw)


def test_vehicle_angles_for_want_of_a_gimbal(tmp_path):
    values = {key.replace("Gimbal", "Flight"): value for key, value in DOWN.items()}
    photo(tmp_path / "a.jpg", values | HERE | HIGH)
    flight = hsvaos.open_flight(tmp_path, fov_deg=60)
    assert any("the vehicle's are taken" in note for note in flight.notes)


def test_a_folder_of_photos(tmp_path):
    for i, (second, high) in enumerate(((20, "+41.0"), (10, "+40.0"))):
        more = {"AbsoluteAltitude": str(158.5 + float(high)), "RelativeAltitude": high}
        photo(tmp_path / f"{i}.jpg", DOWN | HERE | more, exif_block(second=second))
    photo(tmp_path / "silent.jpg", {})
    cv2.imwrite(str(tmp_path / "mask.png"), NOISE[..., 0])
    flight = hsvaos.open_flight(tmp_path)
    assert (flight.format, flight.ground_down_m) == ("dji", 0.0)
    assert [(f.name, f.t_s) for f in flight.frames] == [("1.jpg", 0.0), ("0.jpg", 10.0)]
    assert flight.origin == hsvaos.Origin(46.84, -91.99, 158.5)
    np.testing.assert_allclose(flight.poses[:, :3, 3], [[0, 0, -40], [0, 0, -41]], atol=1e-6)
    assert flight.mask == tmp_path / "mask.png"
    for what in (
        "mask.png found",
        "1 photo left out",
        "level with take-off",
        "35 mm equivalent",
        "without RTK",
    ):
        assert any(what in note for note in flight.notes), what
    assert hsvaos.open_flight(tmp_path, ground_down_m=2.0).ground_down_m == 2.0
    assert hsvaos.open_flight(tmp_path, fov_deg=60).camera == hsvaos.Camera.from_fov(40, 30, 60)
    (tmp_path / "flight.toml").write_text("[camera]\nfov_deg = 70\n")
    assert hsvaos.open_flight(tmp_path).camera == hsvaos.Camera.from_fov(40, 30, 70)


def test_without_intrinsics_or_take_off(tmp_path):
    photo(tmp_path / "a.jpg", DOWN | HERE | {"AbsoluteAltitude": "120"})
    with pytest.raises(FlightError, match="camera without intrinsics: give --fov DEG"):
        hsvaos.open_flight(tmp_path)
    flight = hsvaos.open_flight(tmp_path, fov_deg=60)
    assert flight.ground_down_m is None
    assert any("height of the ground not known" in note for note in flight.notes)
    assert flight.origin.height_m == 120.0


def test_fixed_rtk_heights_beat_the_barometer(tmp_path):
    for name, absolute in (("a", "150.0"), ("b", "151.0")):
        more = {"AbsoluteAltitude": absolute, "RelativeAltitude": "50.0", "RtkFlag": "50"}
        photo(tmp_path / f"{name}.jpg", DOWN | HERE | more)
    flight = hsvaos.open_flight(tmp_path, fov_deg=60)
    assert np.ptp(flight.poses[:, 2, 3]) == pytest.approx(1.0)
    assert any("positions from RTK" in note for note in flight.notes)


def test_sources_of_intrinsics():
    wide, _ = dji_camera(PhotoTags(focal_35mm=20.0), 4000, 3000)
    cut, note = dji_camera(PhotoTags(focal_35mm=20.0), 4000, 2250)
    # A 16:9 photo is cut from the 4:3 one: the same focal length in pixels.
    assert wide.fx == cut.fx == pytest.approx(20.0 / 43.267 * 5000, rel=1e-4)
    assert "35 mm equivalent focal length 20 mm" in note
    assert full_diagonal_px(3648, 5472) == pytest.approx(np.hypot(5472, 3648))
    sensor, note = dji_camera(PhotoTags(model="FC6310", focal_mm=8.8, focal_35mm=24), 5472, 3648)
    assert sensor.fx == pytest.approx(3648.0)
    assert "13.2 mm wide sensor" in note
    millimetres = PhotoTags(focal_35mm=20, xmp={"CalibratedFocalLength": "3.61"})
    assert "35 mm" in dji_camera(millimetres, 4000, 3000)[1]
    assert dji_camera(PhotoTags(), 4000, 3000) is None


def test_calibration_of_the_full_photo_is_scaled_and_cut():
    xmp = {
        "CalibratedFocalLength": "3666.0",
        "CalibratedOpticalCenterX": "2736.0",
        "CalibratedOpticalCenterY": "1824.0",
    }
    full, _ = dji_camera(PhotoTags(xmp=xmp), 5472, 3648)
    assert (full.fx, full.cx, full.cy) == (3666.0, 2735.5, 1823.5)
    small, note = dji_camera(PhotoTags(xmp=xmp), 1368, 912)
    assert small == full.scaled(1368, 912)
    assert "scaled from 5472 x 3648" in note
    cut, _ = dji_camera(PhotoTags(xmp=xmp), 1368, 770)
    assert (cut.fx, cut.fy, cut.cx) == (small.fx, small.fy, small.cx)
    assert cut.cy == 384.5
    xmp |= {"DewarpData": "2020-01-01;3657.0,3650.0,-4.0,23.0,-0.26,0.11,0.001,0.0002,-0.03"}
    dewarp, note = dji_camera(PhotoTags(xmp=xmp), 5472, 3648)
    assert (dewarp.fx, dewarp.fy, dewarp.cx, dewarp.cy) == (3657.0, 3650.0, 2731.5, 1846.5)
    assert dewarp.distortion == (-0.26, 0.11, 0.001, 0.0002, -0.03)
    assert "calibration of 2020-01-01" in note
    assert not dji_camera(PhotoTags(xmp=xmp | {"DewarpFlag": "1"}), 5472, 3648)[0].has_distortion


def test_brighton_beach_lies_where_its_gps_says(data):
    flight = hsvaos.open_flight(data("brighton_beach"))
    assert (flight.format, len(flight), flight.ground_down_m) == ("dji", 6, 0.0)
    np.testing.assert_allclose(flight.poses[:, 2, 3], -40.0, atol=0.25)
    lat, lon, height = geodetic_from_ned(flight.poses[:, :3, 3], flight.origin)
    tags = [read_tags(frame.path) for frame in flight.frames]
    np.testing.assert_allclose(lat, [tag.lat_deg for tag in tags], atol=1e-9)
    np.testing.assert_allclose(lon, [tag.lon_deg for tag in tags], atol=1e-9)
    np.testing.assert_allclose(height, 198.5, atol=0.3)


def ground_points(flight, index, pixels):
    """North and east of pixels on the flight's ground plane [m]."""
    origins, directions = flight.view(index).rays(pixels)
    reach = (flight.ground_down_m - origins[:, 2]) / directions[:, 2]
    return (origins + reach[:, None] * directions)[:, :2]


def turned(flight, degrees):
    turn = np.eye(4)
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn[:2, :2] = [[cos, -sin], [sin, cos]]
    frames = []
    for frame in flight.frames:
        pose = turn @ frame.world_from_camera
        pose[:3, 3] = frame.world_from_camera[:3, 3]
        frames.append(hsvaos.Frame(frame.name, frame.path, pose))
    return flight.replace(frames=tuple(frames))


def test_features_of_brighton_beach_agree_on_the_ground(data):
    """Matched features of neighbouring photos, back-projected to the ground, agree.

    GPS without RTK drifts by about half a metre between photos 7 s apart; 2.5 degrees of compass
    over a baseline of 13.7 m are 0.6 m; ground 2 m off take-off level is 13.7 * 2 / 40 = 0.7 m.
    Together about 1.1 m (measured: 1.0); the bound leaves half as much again.
    """
    flight = hsvaos.open_flight(data("brighton_beach")).subset([2, 3, 4])
    scale, features = 4, []
    for image in flight.images():
        small = cv2.resize(image, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
        grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
        points, descriptors = cv2.SIFT_create(3000).detectAndCompute(grey, None)
        pixels = np.array([p.pt for p in points]) * scale + (scale - 1) / 2
        features.append((pixels, descriptors))
    pairs = []
    for i in (0, 1):
        (a, a_features), (b, b_features) = features[i], features[i + 1]
        found = cv2.BFMatcher().knnMatch(a_features, b_features, k=2)
        good = [(m.queryIdx, m.trainIdx) for m, n in found if m.distance < 0.75 * n.distance]
        p, q = a[[g[0] for g in good]], b[[g[1] for g in good]]
        # Only a homography of the two photos sorts out false matches: no pose is used here.
        _, fits = cv2.findHomography(p, q, cv2.RANSAC, 20.0)
        pairs.append((i, p[fits.ravel() > 0], q[fits.ravel() > 0]))
    assert sum(len(p) for _, p, _ in pairs) > 100

    def disagreement(flight):
        apart = [ground_points(flight, i, p) - ground_points(flight, i + 1, q) for i, p, q in pairs]
        return float(np.median(np.linalg.norm(np.concatenate(apart), axis=1)))

    assert disagreement(flight) < 1.5
    # What is left is no matter of axes: compass and height of the ground take most of it away.
    assert disagreement(turned(flight, -2.5).replace(ground_down_m=-2.0)) < 0.5
    # Headings turned by a quarter or by half would be seen at once.
    for degrees in (90.0, 180.0, 270.0):
        assert disagreement(turned(flight, degrees)) > 10.0


def test_phantom_4_rtk_agrees_with_a_bundle_adjustment(data):
    """Position, attitude and lens of tilted photos equal those adjusted by OpenDroneMap."""
    pyproj = pytest.importorskip("pyproj")
    folder = data("odm_small")
    flight = hsvaos.open_flight(folder / "odm")
    assert (flight.format, len(flight)) == ("dji", 4)
    assert any("positions from RTK" in note for note in flight.notes)
    # Bundle adjusted focal length: 0.66646 of the width.
    assert flight.camera.fx == pytest.approx(0.66646 * 1368, rel=0.005)
    assert flight.camera.distortion[0] == pytest.approx(-0.2641, abs=0.01)

    utm = pyproj.Proj(32651)
    to_wgs84 = pyproj.Transformer.from_crs(32651, 4326, always_xy=True)
    with (folder / "odm_xyz_opk.csv").open() as file:
        rows = list(csv.DictReader(file, delimiter=" ", quotechar="'"))
    for row in rows:
        x, y, z = (float(row[key]) for key in "xyz")
        lon, lat = to_wgs84.transform(x, y)
        pose = flight.poses[flight.index(row["filename"])]
        place = ned_from_geodetic(lat, lon, z, flight.origin)
        np.testing.assert_allclose(pose[:3, 3], place, atol=0.1)
        # omega, phi, kappa: east-north-up grid from a camera with x right, y up, z backward.
        matrix = np.diag([1.0, -1.0, -1.0])
        for axis, key in ((2, "kappa"), (1, "phi"), (0, "omega")):
            turn = np.zeros(3)
            turn[axis] = np.radians(float(row[key]))
            matrix = cv2.Rodrigues(turn)[0] @ matrix
        convergence = np.radians(utm.get_factors(lon, lat).meridian_convergence)
        matrix = cv2.Rodrigues(np.array([0.0, 0.0, -convergence]))[0] @ matrix
        expected = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]) @ matrix
        angle = np.degrees(np.arccos((np.trace(expected.T @ pose[:3, :3]) - 1) / 2))
        assert angle < 2.0
