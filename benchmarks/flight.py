"""The C reference of the flight file beside Python, and what it needs on board: the two tables of docs/howto/flight.md.

A site of 15 x 15 patches of Hadley, chosen blindly, in photographs and in simulated frames of all views and Suns of the sample's
catalogue, through a lens with distortion. With the same heights as the file both must agree point by point; with those of the
catalogue the rounding of heights is in the difference. Exit code 1 if a limit is not kept.
"""

from __future__ import annotations

import argparse
import itertools
import math
import platform
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numba import set_num_threads

from benchmarks.markdown import percent, table
from benchmarks.places import SAMPLE, shared_data
from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.exports.export import export
from lcp_catalog.geometry.frames import EnuFrame, direction_enu, mcmf_to_lonlat
from lcp_catalog.images.image_file import open_image
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.point_search import SearchImage
from tests.helpers import flight_c, flight_vector
from tests.helpers.flight_c import Difference, Frame, Reference

VIEWS = ((0, 0), (50, 0), (50, 90), (50, 180), (50, 270))
"""Off-nadir angle and azimuth: those of the default configuration."""
SUNS = (
    (5, (90, 270)), (10, (90, 105, 255, 270)), (15, (90, 105, 255, 270)), (20, (90, 105, 255, 270)),
    (30, (105, 120, 240, 255)), (45, (105, 120, 135, 225, 240, 255)),
    (60, (120, 135, 150, 165, 180, 195, 210, 225, 240)), (75, (165, 180, 195)),
)  # fmt: skip
"""Elevations and azimuths of the sample's catalogue under which claims are made."""
EVERY = 6
"""Of the points in a simulated frame every sixth is compared."""
HEAD = (
    *("heights", "frames", "points", "by both", "by one", "render, rms", "largest", "one pixel"),
    *(
        "match, px rms",
        "largest, px",
        "covariance, median",
        "largest",
        "beyond 2 %",
        "position, sigmas",
    ),
)
Found = dict[tuple[str, str], tuple[list[Difference], list[float]]]
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


def frames(folder: Path) -> Iterator[tuple[str, Frame, str, slice]]:
    """Name, frame, reflectance law, and which of the points in it are compared."""
    shared = shared_data() / "images" / "apollo15-metric-hadley"
    for picture in [SAMPLE / "AS15-M-0414.png", *sorted(shared.glob("AS15-M-1134.png"))]:
        camera = read_camera(picture.with_name(f"{picture.stem}_camera.json"))
        image = SearchImage.of(open_image(picture, camera))
        yield f"photograph {picture.stem}", Frame.of(image, camera), "lunar-lambert", slice(None)
    place = EnuFrame(*flight_vector.CENTRE, -1500.0)
    suns = [direction_enu(azimuth, up) for up, along in SUNS for azimuth in along]
    for k, ((off, turn), sun) in enumerate(itertools.product(VIEWS, suns)):
        camera = flight_c.bent(place, 100e3, off, turn, 25.0 * k, 640.0, (260, 250))
        lon, lat, _ = mcmf_to_lonlat(place.direction_to_mcmf(sun))
        camera, grey = flight_vector.simulated(
            camera, (float(lon), float(lat)), flight_vector.GSD_M, folder
        )
        known = camera.moved([60.0, -40.0, 30.0, 1e-3, -2e-3, 1e-3])
        law = "lommel-seeliger" if k % 2 else "lunar-lambert"
        frame = Frame.of(flight_vector.searched(grey, known), known)
        yield f"off nadir {off}, azimuth {turn}", frame, law, slice(k % EVERY, None, EVERY)


def compared(folder: Path) -> Found:
    """Every point compared in the frames of a name, by whether Python has the heights of the file or of the catalogue; and the
    sigmas between the example's position and `pose.solve`, a frame each.
    """
    catalog = flight_vector.site(15, 0.055)
    export(catalog, folder / "site.lcpf")
    reference = Reference(folder)
    if reference.open((folder / "site.lcpf").read_bytes()):
        raise SystemExit("the file cannot be opened")
    stored, numbers = flight_vector.as_stored(catalog, folder / "site.lcpf")
    out: Found = defaultdict(lambda: ([], []))
    for name, frame, law, part in frames(folder):
        rows = points_in_view(catalog, frame.sensor)[part].tolist()
        for heights, given in (("file", stored), ("catalogue", catalog)):
            found = [
                flight_c.difference(reference, numbers[row], frame, given, row, law, REACH)
                for row in rows
            ]
            sigmas = flight_c.position_sigmas(reference, frame, catalog.position_mcmf[rows], found)
            out[heights, name][0].extend(found)
            out[heights, name][1].append(sigmas)
    return out


def figures(heights: str, name: str, found: list[Difference], sigmas: list[float]) -> list[object]:
    """A row of the table of equality."""
    both = [one for one in found if np.isfinite(one.match_px)]
    render, pixel, match, covariance = (
        np.array([getattr(one, name) for one in both])
        for name in ("render_share", "pixel_share", "match_px", "covariance_share")
    )
    return [
        heights, name, len(found), len(both), apart(found), percent(_rms(render), 4),
        percent(render.max(), 3), percent(pixel.max(), 2), f"{_rms(match):.1e}", f"{match.max():.1e}",
        percent(float(np.median(covariance)), 4), percent(covariance.max(), 3), (covariance > 0.02).sum(),
        f"{max([one for one in sigmas if one >= 0.0], default=math.nan):.1e}",
    ]  # fmt: skip


def apart(found: list[Difference]) -> int:
    """Points that one of the two finds, the other not."""
    return sum(one.found != (one.code == 0) for one in found if one.code in (0, 10))


def _rms(values: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(np.array([*values])))))


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


def needs(folder: Path, runs: list[list[Difference]]) -> list[list[object]]:
    """Rows of the table of what it needs; of runs over the same points the fastest one of each counts."""
    (folder / "probe.c").write_text(PROBE)
    probe = flight_c.compiled([folder / "probe.c"], folder / "probe")
    work, point = map(int, subprocess.check_output([str(probe)], text=True).split())
    made = flight_c.compiled([flight_c.SOURCE / "lcpf.c"], folder / "lcpf.o", "-O3", "-c")
    text = subprocess.check_output(["size", str(made)], text=True).splitlines()[1].split()[0]
    seconds = np.array([[(one.c_seconds, one.python_seconds) for one in run] for run in runs])
    done = [one.code == 0 for one in runs[0]]
    own, python = 1e3 * np.percentile(seconds[:, done].min(axis=0), (50, 95), axis=0).T
    steps = operations()
    usual, worst = np.sum(list(steps.values()), axis=0)
    rows: list[list[object]] = [
        ["code, -O3", f"{text} bytes"],
        ["static memory, 150 points a frame", f"{(work + 150 * point) / 1e3:.0f} kB"],
        ["stack, without math.h", f"{flight_c.stack_bytes(folder, '-O3') / 1e3:.1f} kB"],
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
    argparse.ArgumentParser("python -m benchmarks.flight", description=__doc__).parse_args()
    if flight_c.COMPILER is None:
        print("no C compiler is installed: nothing is compared")
        return 0
    set_num_threads(1)  # processor time of threads that wait is no time of the matcher
    with TemporaryDirectory() as aside:
        results = compared(Path(aside))
        for heights in ("file", "catalogue"):
            of_these = [one for (given, _), one in results.items() if given == heights]
            every, sigmas = (list(itertools.chain(*parts)) for parts in zip(*of_these, strict=True))
            results[heights, "all"] = every, sigmas
        print(table(HEAD, [figures(*key, *found) for key, found in results.items()]), "\n")
        needed = needs(
            Path(aside), [results[heights, "all"][0] for heights in ("file", "catalogue")]
        )
        print(table(["what", "needed"], needed))
    wrong = [one for one in ("file", "catalogue") if not kept(*results[one, "all"], one == "file")]
    return 1 if wrong else 0


def kept(found: list[Difference], sigmas: list[float], same: bool) -> bool:
    """True if the limits are kept: with the same heights by every point, else by what the example believes on the whole."""
    both = [one for one in found if np.isfinite(one.match_px)]
    render = np.array([one.render_share for one in both])
    believed = [one.match_px for one in both if same or one.python.is_good]
    good = len(believed) >= 1000 and _rms(believed) <= 0.01
    good = good and np.nanmax(sigmas) <= 0.05 and _rms(render) <= 0.005
    exact = (
        render.max() <= 0.005
        and max(one.covariance_share for one in both) <= 0.02
        and not apart(found)
    )
    return bool(good and (exact or not same))


if __name__ == "__main__":
    sys.exit(main())
