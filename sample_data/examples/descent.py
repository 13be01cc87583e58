"""A descent to Hadley from 100 to 5 km: build/descent/trajectory.csv and camera.json for `lcp query`."""

import csv
import json
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from lcp_catalog import Camera

FOLDER = Path("build/descent")
RADIUS_M = 1737.4e3
LON_DEG, LAT_DEG, HEIGHT_M = 3.6, 26.1, -1930.0  # of the landing site
START = datetime.fromisoformat("2026-01-27T12:00:00")
ALTITUDES_KM = np.round(np.geomspace(100.0, 5.0, 21), 1)  # above the landing site
STEP_S = 30
FOCAL_PX, SIDE_PX = 443.4, 512  # a field of view of 60 deg
MATRIX = [f"r{row}{column}" for row in "123" for column in "123"]


def camera(altitude_km: float) -> Camera:
    """The camera at an altitude of the descent; it looks straight down, and comes from the west."""
    west_m = 20e3 * (altitude_km - 5.0) / 95.0
    lat = np.radians(LAT_DEG)
    lon = np.radians(LON_DEG) - west_m / RADIUS_M / np.cos(lat)
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    rotation = np.stack([east, -np.cross(up, east), -up])  # right, down, ahead
    middle = (SIDE_PX - 1) / 2.0
    position = (RADIUS_M + HEIGHT_M + 1e3 * altitude_km) * up
    return Camera(position, rotation, FOCAL_PX, (middle, middle), (SIDE_PX, SIDE_PX))


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    with open(FOLDER / "trajectory.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_utc", "x_m", "y_m", "z_m", *MATRIX])
        for number, altitude_km in enumerate(ALTITUDES_KM):
            taken = camera(altitude_km)
            time = START + timedelta(seconds=STEP_S * number)
            place, turn = taken.position_mcmf_m, taken.rotation_mcmf_to_camera.ravel()
            table.writerow([time.isoformat(), *np.round(place, 3), *np.round(turn, 12)])
    with open(FOLDER / "camera.json", "w") as file:
        json.dump(camera(100.0).to_json(), file)


if __name__ == "__main__":
    main()
