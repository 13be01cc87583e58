"""Time of `lcp query`: one frame, and a trajectory of 1000 frames, on a catalogue of 100 000 points.

    python -m benchmarks.speed query [POINTS]

Writes a synthetic catalogue (`tests/helpers/many_points.py`: the whole Moon between 60 S and 60 N, every
point usable everywhere) and one of the same points within 300 km, so that every frame sees thousands,
into a temporary folder. Times count from the import of the modules: opening the file, reading, the
answers as documents. Processor time includes that of the process that judges the file.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks import sections
from benchmarks.timing import processor_s
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.view import looking_camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.schema import USABLE, summarise_usable
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.geometry.frames import EnuFrame, enu_rotation, lonlat_to_mcmf
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.memory import peak_mb
from lcp_catalog.navigation.documents import document
from lcp_catalog.navigation.expected_position import Query, answers
from lcp_catalog.navigation.frame_points import PlannedImage
from tests.helpers import many_points

SUN = SunChoice(90.0, 30.0)


def usable(whole: Catalog) -> Catalog:
    """The points usable under every Sun and view."""
    condition = np.full(whole.condition.shape, USABLE, np.uint8)
    lowest, highest = summarise_usable(condition, whole.sun_elevation)
    likely = np.full_like(whole.detection_probability, 0.98, np.float32)
    return dataclasses.replace(
        whole,
        condition=condition,
        sun_elevation_min=lowest,
        sun_elevation_max=highest,
        detection_probability=likely,
        sigma_major=12.0 * likely,
        sigma_minor=9.0 * likely,
        sigma_angle=30.0 * likely,
    )


def near(whole: Catalog) -> Catalog:
    """The same points within about 300 km of 0 N 0 E."""
    lon, lat = (whole.longitude + 180.0) % 360.0 - 180.0, whole.latitude
    lon, lat = lon / 180.0 * 5.0, lat / 60.0 * 5.0
    return dataclasses.replace(
        whole,
        longitude=lon % 360.0,
        latitude=lat,
        position_mcmf=lonlat_to_mcmf(lon, lat, whole.elevation),
        rotation_mcmf_to_enu=enu_rotation(lon, lat),
    )


def camera(lon: float, lat: float, altitude_km: float, field_deg: float = 45.0) -> Camera:
    """A camera of 1024 x 1024 pixels that looks straight down."""
    height = 1e3 * altitude_km
    side = 2.0 * height * np.tan(np.radians(field_deg / 2.0))
    frame = EnuFrame(lon, lat)
    return looking_camera(frame, (0.0, 0.0, height), side / 1024.0, (side, side))


def timed(name: str, path: Path, cameras: list[Camera], query: Query) -> None:
    """One line on a query: seconds, points, peak memory of this process so far."""
    start, before = time.perf_counter(), processor_s()
    catalog = open_catalog(path, check=False)
    points, usable = 0, 0
    for answer in answers(catalog, _lit(cameras), query):
        document(answer, catalog)
        points, usable = points + answer.counts["in_view"], usable + answer.usable
    seconds = time.perf_counter() - start
    used = processor_s() - before
    print(
        f"{name}: {seconds:.2f} s, {used:.2f} s of a processor; {points / len(cameras):.0f} points in view "
        f"of a frame, {usable / len(cameras):.0f} usable; peak memory {peak_mb():.0f} MB",
        flush=True,
    )


def _lit(cameras: list[Camera]) -> Iterator[PlannedImage]:
    return (PlannedImage.lit(one, SUN) for one in cameras)


def write(count: int, moon: Path, region: Path) -> None:
    """Write both catalogues."""
    whole = usable(many_points.catalog(count))
    write_catalog(whole, moon)
    write_catalog(near(whole), region)


def main(words: Sequence[str]) -> int:
    parser = sections.parser("speed query", __doc__)
    parser.add_argument("points", nargs="?", type=int, default=100_000)
    parser.add_argument("--frames", type=int, default=1000, help="of a trajectory")
    given = parser.parse_args(words)
    count, frames = given.points, given.frames
    with tempfile.TemporaryDirectory() as folder:
        moon, region = Path(folder, "moon.h5"), Path(folder, "region.h5")
        writer = multiprocessing.get_context("spawn").Process(
            target=write, args=(count, moon, region)
        )  # its memory goes with it
        writer.start()
        writer.join()
        for name, path in (("whole Moon", moon), ("within 300 km", region)):
            for altitude_km in (30.0, 100.0):
                one = [camera(1.0, 2.0, altitude_km)]
                timed(f"{name}, one frame from {altitude_km:g} km", path, one, Query())
            timed(f"{name}, the best 50 from 100 km", path, one, Query(most=50))
        timed("whole Moon, one frame from 2000 km", moon, [camera(1.0, 2.0, 2000.0)], Query())
        for altitude_km in (10.0, 30.0):
            places = np.linspace(-4.0, 4.0, frames)
            along = [camera(float(lon), 1.0, altitude_km) for lon in places]
            name = f"within 300 km, {frames} frames from {altitude_km:g} km"
            timed(name, region, along, Query())
            timed(f"{name}, the best 50", region, along, Query(most=50))
        around = [camera(float(lon), 1.0, 100.0) for lon in np.linspace(0.0, 180.0, frames)]
        timed(f"whole Moon, {frames} frames along half an orbit", moon, around, Query())
    return 0
