"""Fly a simulated flight in real time and look through its canopy meanwhile.

    hsvaos simulate --people 4 -o flight
    python examples/live_simulated.py flight --rate 10 -o live.png

Without a folder it flies the small flight in the package.
"""

import argparse
import time

import cv2
import numpy as np

import hsvaos
from hsvaos.demo import FOLDER

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("flight", nargs="?", default=FOLDER)
parser.add_argument("--rate", type=float, default=10.0, help="photos a second")
parser.add_argument("--photos", type=int, help="photos to fly; all by default")
parser.add_argument("-o", "--out", default="live.png")
options = parser.parse_args()

flight = hsvaos.open_flight(options.flight)
ground = hsvaos.FocalPlane(flight.ground_down_m or 0.0)
count = min(options.photos or len(flight), len(flight))

with hsvaos.LiveIntegrator(flight.camera, ground, frames=30, size=512, mask="hue") as live:
    start = time.monotonic()
    for i, (photo, frame) in enumerate(zip(flight.images(workers=1), flight.frames, strict=True)):
        if i == count:
            break
        time.sleep(max(0.0, start + i / options.rate - time.monotonic()))
        live.push(photo, frame.world_from_camera, frame.t_s)  # returns at once
    live.drain()
    stats, result = live.stats(), live.latest()

latency = stats.latency
print(f"{stats.integrated} photos integrated, {stats.dropped} dropped")
print(f"latency p50 {latency['p50_ms']} ms, p99 {latency['p99_ms']} ms")
top = np.percentile(result.image[result.footprint > 0], 99.5)
picture = np.clip(result.image * (255.0 / top), 0, 255).astype(np.uint8)
cv2.imwrite(options.out, picture[..., ::-1])
print(f"look at {options.out}")
