"""The C reference of the flight file beside Python, and what it needs on board: the two tables of docs/howto/flight.md.

A site of 15 x 15 patches of Hadley, chosen blindly, in the sample's photograph and in simulated frames of several views and Suns
through a lens with distortion. Exit code 1 if a limit is not kept.
"""

from __future__ import annotations

import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.markdown import percent, table
from benchmarks.places import SAMPLE
from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.exports.export import export
from lcp_catalog.exports.flight import FlightFile
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.images.image_file import open_image
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.point_search import SearchImage
from tests.helpers import flight_c, flight_vector
from tests.helpers.flight_c import Difference, Frame, Reference

VIEWS = (  # off-nadir angle, azimuth, longitude and latitude of the subsolar point from the site's longitude
    (0.0, 0.0, 65.0, 1.0), (20.0, 90.0, -60.0, -1.0), (35.0, 200.0, 40.0, 0.0),
    (50.0, 300.0, 74.0, 1.0), (10.0, 120.0, -76.0, 0.5), (55.0, 45.0, 55.0, -1.5),
)  # fmt: skip
HEAD = (
    *("frame", "points", "by both", "by one", "render, rms", "match, px rms", "largest, px"),
    *("covariance, median", "beyond 2 %", "position, sigmas"),
)
REACH = 64
PATCH, SUB, SIDE, TAPS = 33, 3, 34, 18
"""Nodes, samples along a pixel, pixels of a template whose cells are pixels, samples under its point spread."""
CYCLES = 4
"""Clock cycles of a multiplication with its addition and its two reads: an assumption."""
BOARDS = {"RAD750, 200 MHz": 200e6, "GR740, one core of 250 MHz": 250e6}
PROBE = """#include "lcpf.h"
#include <stdio.h>
int main(void) { printf("%zu %zu", sizeof(lcpf_work) + sizeof(lcpf_point), sizeof(lcpf_claim) + sizeof(lcpf_match)); return 0; }
"""


def frames(folder: Path) -> Iterator[tuple[str, Frame, str]]:
    """Name, frame and reflectance law of each."""
    camera = read_camera(SAMPLE / "AS15-M-0414_camera.json")
    image = SearchImage.of(open_image(SAMPLE / "AS15-M-0414.png", camera))
    yield "photograph", Frame.of(image, camera), "lunar-lambert"
    place = EnuFrame(*flight_vector.CENTRE, -1500.0)
    for k, (off, azimuth, lon, lat) in enumerate(VIEWS):
        size = (260, 250)
        camera = flight_c.bent(place, 100e3, off, azimuth, 25.0 * k, 640.0, size)
        sun = (flight_vector.CENTRE[0] + lon, lat)
        camera, grey = flight_vector.simulated(camera, sun, flight_vector.GSD_M, folder)
        known = camera.moved([60.0, -40.0, 30.0, 1e-3, -2e-3, 1e-3])
        law = "lommel-seeliger" if k % 2 else "lunar-lambert"
        name = f"off nadir {off:.0f}, Sun {lon:.0f}"
        yield name, Frame.of(flight_vector.searched(grey, known), known), law


def compared(folder: Path) -> Iterator[tuple[str, list[Difference], float]]:
    """Name of every frame, every point in its view by both, and the sigmas between the example's position and `pose.solve`."""
    catalog = flight_vector.site(15, 0.055)
    export(catalog, folder / "site.lcpf")
    reference = Reference(folder)
    if reference.open((folder / "site.lcpf").read_bytes()):
        raise SystemExit("the file cannot be opened")
    ids = FlightFile.of(folder / "site.lcpf").points["point_id"].tolist()
    for name, frame, law in frames(folder):
        rows = points_in_view(catalog, frame.sensor).tolist()
        numbers = [ids.index(int(catalog.point_id[row])) for row in rows]
        found = [
            flight_c.difference(reference, number, frame, catalog, row, law, REACH)
            for number, row in zip(numbers, rows, strict=True)
        ]
        places = catalog.position_mcmf[rows]
        yield name, found, flight_c.position_sigmas(reference, frame, places, found)


def figures(name: str, found: list[Difference], position: float) -> list[object]:
    """A row of the table of equality."""
    both = [one for one in found if np.isfinite(one.match_px)]
    apart = sum(one.found != (one.code == 0) for one in found if one.code in (0, 10))
    covariances = np.array([one.covariance_share for one in both])
    return [
        name, len(found), len(both), apart, percent(_rms([one.render_share for one in both]), 3),
        f"{_rms([one.match_px for one in both]):.4f}", f"{max(one.match_px for one in both):.3f}",
        percent(float(np.median(covariances)), 3), (covariances > 0.02).sum(), f"{position:.1e}",
    ]  # fmt: skip


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def operations() -> dict[str, tuple[float, float]]:
    """Multiplications for a point of each step, usual (four steps of the fit) and worst case."""
    area, blur = SIDE**2, 2 * (2 * TAPS * SIDE * SIDE * SUB + 3 * TAPS * SIDE**2) + 13 * SIDE**2
    clear = PATCH**2 * 3 * PATCH * 8
    peaks = (REACH + 1) ** 2 * (SIDE // 2 + 1) ** 2
    return {
        "light and shadow": (0.25 * clear, clear),
        "drawing": (area * SUB**2 * 24, area * SUB**2 * 48),
        "search": (peaks + 2 * 20 * area * 3, peaks + 6 * 49 * area * 3),
        "fit and covariance": (4 * blur + 113 * area * 6, 16 * blur + 113 * area * 6),
    }


def needs(folder: Path, found: list[Difference]) -> list[list[object]]:
    """Rows of the table of what it needs."""
    (folder / "probe.c").write_text(PROBE)
    probe = flight_c.compiled([folder / "probe.c"], folder / "probe")
    work, point = map(int, subprocess.check_output([str(probe)], text=True).split())
    made = flight_c.compiled([flight_c.SOURCE / "lcpf.c"], folder / "lcpf.o", "-O3", "-c")
    text = subprocess.check_output(["size", str(made)], text=True).splitlines()[1].split()[0]
    own, python = (
        np.percentile([1e3 * getattr(one, name) for one in found if one.code == 0], (50, 95))
        for name in ("c_seconds", "python_seconds")
    )
    steps = operations()
    usual, worst = np.sum(list(steps.values()), axis=0)
    rows: list[list[object]] = [
        ["code, -O3", f"{text} bytes"],
        ["static memory, 150 points a frame", f"{(work + 150 * point) / 1e3:.0f} kB"],
        [f"C, a point, {_processor()}", f"{own[0]:.2f} ms, 95 % below {own[1]:.2f} ms"],
        ["Python, a point alone, the same", f"{python[0]:.2f} ms, 95 % below {python[1]:.2f} ms"],
    ]
    for name, (low, high) in (steps | {"all; twice as many reads": (usual, worst)}).items():
        rows.append([f"multiplications, {name}", f"{low / 1e6:.1f} to {high / 1e6:.1f} million"])
    for board, clock in BOARDS.items():
        low, high = (1e3 * CYCLES * count / clock for count in (usual, worst))
        rows.append([f"estimate, {board}", f"{low:.0f} to {high:.0f} ms a point"])
    return rows


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines() if sys.platform == "linux" else []
    names = [line.partition(": ")[2] for line in lines if line.startswith("model name")]
    return (names or [platform.machine()])[0]


def main() -> int:
    if flight_c.COMPILER is None:
        print("no C compiler is installed: nothing is compared")
        return 0
    with TemporaryDirectory() as aside:
        results = list(compared(Path(aside)))
        every = [one for _, found, _ in results for one in found]
        total = ("all", every, float(np.nanmax([sigmas for *_, sigmas in results])))
        rows = [figures(*one) for one in (*results, total)]
        print(table(HEAD, rows), "\n")
        print(table(["what", "needed"], needs(Path(aside), every)))
    both = [one for one in every if np.isfinite(one.match_px)]
    kept = _rms([one.match_px for one in both]) <= 0.01 and total[2] <= 0.05
    kept = kept and _rms([one.render_share for one in both]) <= 0.005
    return 0 if kept and len(every) >= 1000 else 1


if __name__ == "__main__":
    sys.exit(main())
