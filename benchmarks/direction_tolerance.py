"""Decisions that change when an area's images are made for a Sun and views that are those of another
place: the cost of one Sun direction for a whole area.

    python benchmarks/direction_tolerance.py

The candidates of three areas of the sample are evaluated with all directions as they are at the
area's centre, and with all of them turned by an angle about four horizontal axes, as they are at
places that far from the centre. Prints the table of docs/measurements/direction-tolerance.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from lcp_catalog.catalog.schema import USABLE
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.production import area_job
from lcp_catalog.production.config import BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.evaluation import evaluate
from lcp_catalog.production.run import Build
from lcp_catalog.production.sweep import Sweep
from lcp_catalog.terrain.occlusion import occluded
from lcp_catalog.threads import limit_threads

SAMPLE = Path(__file__).resolve().parents[1] / "sample_data"
AREAS = ("r00163c00002", "r00165c00005", "r00163c00006")
ELEVATIONS = (5.0, 10.0, 20.0, 45.0)
TURNS_DEG = (0.25, 0.5, 1.0)
AXES_DEG = (20.0, 110.0, 200.0, 290.0)


@dataclass(frozen=True)
class TurnedSweep(Sweep):
    """A sweep whose Suns and views are all turned: the transposed ``turning`` (3, 3) is applied."""

    turning: tuple[tuple[float, ...], ...] = ()

    @cached_property
    def sun_directions(self) -> np.ndarray:
        conditions = self.conditions
        suns = direction_enu(conditions.sun_azimuth_deg, conditions.sun_elevation_deg[:, None])
        return np.ascontiguousarray(suns @ np.array(self.turning))

    @cached_property
    def view_directions(self) -> np.ndarray:
        conditions = self.conditions
        views = direction_enu(conditions.view_azimuth_deg, 90.0 - conditions.off_nadir_deg)
        return np.ascontiguousarray(views @ np.array(self.turning))

    def _shadows(self, azimuth: int, elevations: np.ndarray) -> np.ndarray:
        around = self.accuracy, self.window, self.far
        masks = [occluded(self.field, self.sun_directions[e, azimuth], *around) for e in elevations]
        return np.array(masks, dtype=np.uint8)


def about(azimuth_deg: float, angle_deg: float) -> tuple[tuple[float, ...], ...]:
    """Rotation by an angle about a horizontal axis (Rodrigues)."""
    east, north, _ = direction_enu(azimuth_deg, 0.0)
    cross = np.array([[0.0, 0.0, north], [0.0, 0.0, -east], [-north, east, 0.0]])
    angle = math.radians(angle_deg)
    turned = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    return tuple(map(tuple, turned.tolist()))


def changes(job: area_job.AreaJob) -> np.ndarray:
    """Share of the candidate-conditions whose decision changes, (turns, elevations), and behind them
    the usable share (elevations,), as one array (turns + 1, elevations).
    """
    plain = area_job.area_sweep(job)
    everywhere = np.ones_like(plain.conditions.reachable)
    plain = replace(plain, conditions=replace(plain.conditions, reachable=everywhere))
    core = area_job._Core(job, plain.terrain, area_job._halo(job))
    rows, cols = area_job._find(plain, core, job.config, job.gsd_m)
    lon, lat = core.lon[rows, cols], core.lat[rows, cols]
    errors = area_job._place_errors(job, lon, lat, area_job._patches(lon, lat, job).product)

    def usable(angle_deg: float, axis_deg: float) -> np.ndarray:
        given = {name: getattr(plain, name) for name in plain.__dataclass_fields__}
        sweep = TurnedSweep(**given, turning=about(axis_deg, angle_deg))
        found = evaluate(sweep, rows, cols, job.config, job.gsd_m, errors)
        return found.condition == USABLE

    before = usable(0.0, 0.0)
    turned = [
        [(usable(angle, axis) != before).mean(axis=(0, 1, 3)) for axis in AXES_DEG]
        for angle in TURNS_DEG
    ]
    return np.array([*np.mean(turned, axis=1), before.mean(axis=(0, 1, 3))])


def main() -> None:
    """Print the table."""
    config = replace(
        BuildConfig.from_toml(SAMPLE / "hadley.toml"),
        sun=SunConfig(tuple(np.arange(0.0, 360.0, 45.0)), ELEVATIONS),
        view=ViewConfig((0.0, 30.0), (0.0, 90.0), (math.inf, math.inf)),
    )
    plan = Build.plan([SAMPLE / "hadley_gld100_256ppd.tif"], config)
    with limit_threads(1):
        found = np.mean([changes(job) for job in plan.jobs if job.task.name in AREAS], axis=0)
    print("| Sun | usable | " + " | ".join(f"{turn:g} deg" for turn in TURNS_DEG) + " |")
    print("| --- " * (len(TURNS_DEG) + 2) + "|")
    for elevation, *shares, usable in zip(ELEVATIONS, *found, strict=True):
        changed = " | ".join(f"{100.0 * share:.2f} %" for share in shares)
        print(f"| {elevation:g} deg | {100.0 * usable:.0f} % | {changed} |")


if __name__ == "__main__":
    main()
