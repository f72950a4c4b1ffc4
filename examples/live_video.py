"""Look through the canopy in a video, with poses from a file or from the drone's sensor log.

    python examples/live_video.py film.mp4 --poses poses.csv --fov 70 --down 0
    python examples/live_video.py film.mp4 --log flight --fov 70 --down 0

poses.csv is that of a flight folder (file,t_s,north_m,...; the names do not matter); a log is what
`hsvaos nav` reads. --start says when the film begins on their clock. A camera instead of a file:
give its number, and poses or samples as they come.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

import hsvaos
from hsvaos.formats.poses import read_poses
from hsvaos.formats.sensor_log import open_sensor_log
from hsvaos.live.path import PosePath
from hsvaos.live.play import Sensors
from hsvaos.nav.online import NoPoseError

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("video")
source = parser.add_mutually_exclusive_group(required=True)
source.add_argument("--poses", type=Path, help="poses.csv with times")
source.add_argument("--log", help="sensor log: a folder with imu.csv, a .ulg or a .bin")
parser.add_argument("--fov", type=float, required=True, help="horizontal field of view [deg]")
parser.add_argument("--down", type=float, default=0.0, help="down of the ground [m]")
parser.add_argument("--start", type=float, default=0.0, help="time of the first frame [s]")
parser.add_argument("--rate", type=float, default=10.0, help="most frames a second to integrate")
parser.add_argument("-o", "--out", default="live.png")
options = parser.parse_args()

film = cv2.VideoCapture(options.video)
if not film.isOpened():
    parser.error(f"{options.video}: expected a video that OpenCV can read")
width, height = (
    int(film.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
)
camera = hsvaos.Camera.from_fov(width, height, options.fov)

path = navigator = sensors = None
if options.poses:
    logged = [one for one in read_poses(options.poses) if one.world_from_camera is not None]
    path = PosePath([one.t_s for one in logged], [one.world_from_camera for one in logged])
else:
    log = open_sensor_log(options.log)
    navigator = hsvaos.OnlineFilter(mounting=log.mounting, origin=log.origin)
    sensors = Sensors(log, navigator)

ground = hsvaos.FocalPlane(options.down)
with hsvaos.LiveIntegrator(camera, ground, frames=30, navigator=navigator) as live:
    due, outside = -np.inf, 0
    while film.grab():
        t_s = options.start + film.get(cv2.CAP_PROP_POS_MSEC) / 1e3
        if t_s < due - 1e-3:
            continue  # decoding is what costs: skip what will not be used
        due = t_s + 1.0 / options.rate
        _, bgr = film.retrieve()
        rgb = np.ascontiguousarray(bgr[..., ::-1])
        try:
            if sensors is not None:
                sensors.until(t_s)
                navigator.wait()  # a file has the time to wait until the start is found
                live.push(rgb, t_s=t_s)
            else:
                live.push(rgb, path.at(t_s), t_s)
        except NoPoseError:
            outside += 1
            continue
        live.drain()  # a file waits; a camera would not, and the oldest would be dropped
    stats, result = live.stats(), live.latest()

print(f"{stats.integrated} frames integrated, {stats.dropped} dropped")
print(f"{outside + stats.without_pose} frames without a pose")
if result is None:
    parser.exit(1, "no frame had a pose: check --start\n")
print(f"latency p50 {stats.latency['p50_ms']} ms, p99 {stats.latency['p99_ms']} ms")
top = np.percentile(result.image[result.footprint > 0], 99.5)
picture = np.clip(result.image * (255.0 / top), 0, 255).astype(np.uint8)
cv2.imwrite(options.out, picture[..., ::-1])
print(f"look at {options.out}")
