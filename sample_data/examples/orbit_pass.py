"""A pass over the sample's region at 110 km: pass.csv and pass_camera.json for `lcp query`."""

import csv
import json
from datetime import datetime, timedelta

import numpy as np

from lcp_catalog import Camera

RADIUS_M, HEIGHT_M, SPEED_M_S = 1737.4e3, 110e3, 1600.0
START = datetime.fromisoformat("2026-01-27T00:00:00")
MATRIX = [f"r{row}{column}" for row in "123" for column in "123"]

with open("pass.csv", "w", newline="") as file:
    table = csv.writer(file)
    table.writerow(["time_utc", "x_m", "y_m", "z_m", *MATRIX])
    for seconds in range(0, 201, 5):
        lon = np.radians(3.5) + SPEED_M_S * (seconds - 100) / RADIUS_M / np.cos(np.radians(26.0))
        lat = np.radians(26.0)
        up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
        east = np.array([-np.sin(lon), np.cos(lon), 0.0])
        rotation = np.stack([east, -np.cross(up, east), -up])  # right, down, ahead
        position = (RADIUS_M + HEIGHT_M) * up
        time = START + timedelta(seconds=seconds)
        table.writerow([time.isoformat(), *np.round(position, 3), *np.round(rotation.ravel(), 12)])

camera = Camera(position, rotation, 340.0, (255.5, 255.5), (512, 512))
with open("pass_camera.json", "w") as file:
    json.dump(camera.to_json(), file)
