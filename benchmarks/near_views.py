"""What views at finite altitude change in a build, and what they cost: an area of the sample's DEM seen
from several altitudes, against parallel rays from the same direction.

    .venv/bin/python benchmarks/near_views.py

Prints the share of conditions whose usability differs and the ratio of processor times (medians of
three interleaved runs on one thread).
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from statistics import median

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]

from build_tables import table

from lcp_catalog.catalog.schema import UNOCCLUDED, USABLE
from lcp_catalog.production.area_job import AreaJob, AreaResult, run_area
from lcp_catalog.production.config import (
    AreaConfig,
    BuildConfig,
    PointConfig,
    SunConfig,
    ViewConfig,
)
from lcp_catalog.production.run import Build
from lcp_catalog.production.sweep import view_angles_rad
from lcp_catalog.threads import limit_threads

DEM = ROOT / "sample_data" / "hadley_gld100_256ppd.tif"
ALTITUDES_KM = (1000.0, 400.0, 200.0, 100.0, 50.0, 25.0, 15.0)
CELL_M, ROUNDS = 474.0, 3


def config(off_nadir_deg: float, altitude_km: float) -> BuildConfig:
    return BuildConfig(
        area=AreaConfig(center_deg=(5.0, 25.0), size_km=60.0, gsd_m=CELL_M),
        sun=SunConfig(tuple(float(a) for a in range(0, 360, 30)), (5.0, 10.0, 20.0, 30.0)),
        view=ViewConfig((off_nadir_deg,), (90.0,), (altitude_km,)),
        points=PointConfig(spacing_m=7500.0),
    )


def job(off_nadir_deg: float, altitude_km: float) -> AreaJob:
    """The largest area of the region."""
    build = Build.plan([DEM], config(off_nadir_deg, altitude_km))
    return max(build.jobs, key=lambda one: one.work)


def timed(one: AreaJob) -> tuple[AreaResult, float]:
    start = time.process_time()
    return run_area(one), time.process_time() - start


def main() -> None:
    rows = []
    for off in (0.0, 40.0):
        plain = job(off, math.inf)
        for altitude in ALTITUDES_KM:
            near, ratios = job(off, altitude), []
            run_area(plain), run_area(near)
            for _ in range(ROUNDS):
                (first, before), (second, after) = timed(plain), timed(near)
                ratios.append(after / before)
            old, new = (r.candidates.evaluation.condition for r in (first, second))
            changed = (old == USABLE) != (new == USABLE)
            angle = math.degrees(max(view_angles_rad(near.config, CELL_M)))
            rows.append(
                [
                    f"{off:g}",
                    f"{altitude:g}",
                    f"{angle:.1f}",
                    str(changed.size),
                    str(int((old == USABLE).sum())),
                    str(int(changed.sum())),
                    str(int((((old ^ new) & UNOCCLUDED) > 0).sum())),
                    f"{median(ratios):.1f}",
                ]
            )
            print(*rows[-1], file=sys.stderr, flush=True)
    heads = ["off nadir, deg", "altitude, km", "directions vary by, deg", "conditions", "usable"]
    heads += ["usability differs", "occlusion differs", "time, ratio"]
    print(table(heads, rows))


if __name__ == "__main__":
    with limit_threads(1):
        main()
