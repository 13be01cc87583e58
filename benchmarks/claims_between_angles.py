"""Claims between grid angles: points of a catalogue evaluated under random Suns and views between those of its
grid, against `catalog.prediction.predict`.

    .venv/bin/python benchmarks/claims_between_angles.py [-o build/claims_between_angles] [--size 60] [--gsd 474]

A catalogue of the sample is built once. In each of its areas the same points are then evaluated by the build's own
code under random Suns (hour angle uniform, declination within +-1.54 deg, elevation within the grid) and random
views (off nadir up to 35 deg). The table says how many of 1000 random trials that are claimed usable are usable
there, how many of those usable there are claimed, and how far probabilities and sigmas are from the evaluated
ones. All trials are kept in `trials.npz`.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

from lcp_catalog.arrays import Array
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.hdf5 import open_catalog
from lcp_catalog.catalog.prediction import predict
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.landmarks.selection import nearest
from lcp_catalog.production.area_job import AreaJob, _Core, _halo, area_sweep
from lcp_catalog.production.config import (
    AreaConfig,
    BuildConfig,
    PointConfig,
    SunConfig,
    ViewConfig,
)
from lcp_catalog.production.evaluation import evaluate
from lcp_catalog.production.run import Build, run_build

DEM = Path(__file__).resolve().parents[1] / "sample_data" / "hadley_gld100_256ppd.tif"
OFF_NADIR_MAX_DEG = 35.0
TRIALS = 1000


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("-o", "--output", type=Path, default=Path("build/claims_between_angles"))
    parser.add_argument("--size", type=float, default=60.0)
    parser.add_argument("--gsd", type=float, help="default: the build's own choice")
    parser.add_argument("--patch", type=int, default=PointConfig().patch_nodes)
    parser.add_argument("--spacing", type=float, default=5.0)
    parser.add_argument("--suns", type=int, default=16)
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    points = PointConfig(patch_nodes=given.patch, spacing_m=given.spacing * 1e3)
    area = AreaConfig(center_deg=(3.5, 26.0), size_km=given.size, gsd_m=given.gsd)
    plan = Build.plan((DEM,), BuildConfig(area=area, points=points))
    path = given.output / f"{given.size:g}_{given.gsd or 0.0:g}_{given.patch}.h5"
    if not path.exists():
        run_build(plan, path)
    catalog = open_catalog(path)
    trials = gather(plan, catalog, given.suns, given.views, np.random.default_rng(given.seed))
    np.savez(given.output / "trials.npz", **trials)
    print(table(catalog, trials, np.random.default_rng(given.seed + 1)))


def gather(
    plan: Build, catalog: Catalog, suns: int, views: int, rng: np.random.Generator
) -> dict[str, Array]:
    """All trials of all areas: point, directions, and what the build finds there."""
    parts = []
    for job in plan.jobs:
        sun = random_suns(job.task.lat_deg, suns, catalog, rng)
        off, azimuth = rng.uniform(0.0, OFF_NADIR_MAX_DEG, views), rng.uniform(0.0, 360.0, views)
        found = evaluated_at(job, catalog, sun, np.stack([off, azimuth], axis=-1))
        if found is not None:
            parts.append(found)
        print(f"{job.task.name}: {0 if found is None else len(found['point'])} trials", flush=True)
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def random_suns(lat_deg: float, count: int, catalog: Catalog, rng: np.random.Generator) -> Array:
    """Elevations and azimuths (count, 2), degrees, as they occur at a latitude, elevations in the grid."""
    lat, found = np.radians(lat_deg), []
    low, high = catalog.sun_elevation[0], catalog.sun_elevation[-1]
    while len(found) < count:
        dec, hour = np.radians(rng.uniform(-1.54, 1.54)), rng.uniform(-np.pi, np.pi)
        up = np.sin(lat) * np.sin(dec) + np.cos(lat) * np.cos(dec) * np.cos(hour)
        north = np.cos(lat) * np.sin(dec) - np.sin(lat) * np.cos(dec) * np.cos(hour)
        east = -np.cos(dec) * np.sin(hour)
        elevation = np.degrees(np.arcsin(up))
        if low <= elevation <= high:
            found.append((elevation, np.degrees(np.arctan2(east, north)) % 360.0))
    return np.array(found)


def evaluated_at(
    job: AreaJob, catalog: Catalog, sun: Array, view: Array
) -> dict[str, Array] | None:
    """The area's points under each Sun (elevation, azimuth) and view (off nadir, azimuth); None without points."""
    order = np.argsort(sun[:, 0])
    sun = sun[order]
    grid = SunConfig(tuple(np.sort(sun[:, 1])), tuple(sun[:, 0]))
    looks = ViewConfig(tuple(view[:, 0]), tuple(view[:, 1]), (float("inf"),) * len(view))
    other = replace(job, config=replace(job.config, sun=grid, view=looks))
    sweep = area_sweep(other)
    conditions = replace(
        sweep.conditions, sun_azimuth_deg=sun[:, 1], reachable=np.eye(len(sun), dtype=bool)
    )
    sweep = replace(sweep, conditions=conditions)
    core = _Core(job, sweep.terrain, _halo(job))
    mine = np.argwhere(core.mine)
    places = core.lon[core.mine], core.lat[core.mine]
    node, away_m = nearest(catalog.longitude, catalog.latitude, *places)
    points = np.flatnonzero(away_m < 1.0)
    if not len(points):
        return None
    rows, cols = mine[node[points]].T
    found = evaluate(sweep, rows, cols, other.config, job.gsd_m, job.errors)
    n, v, k = np.indices((len(points), len(view), len(sun))).reshape(3, -1)
    return {
        "point": points[n],
        "sun": sun[k],
        "view": view[v],
        "condition": found.condition[n, v, k, k],
        "detection": found.detection[n, 0, v, k, k],
        "major": found.sigma_major_m[n, 0, v, k, k],
        "minor": found.sigma_minor_m[n, 0, v, k, k],
    }


def table(catalog: Catalog, trials: dict[str, Array], rng: np.random.Generator) -> str:
    """The figures as text."""
    sun = direction_enu(trials["sun"][:, 1], trials["sun"][:, 0])
    view = direction_enu(trials["view"][:, 1], 90.0 - trials["view"][:, 0])
    point = trials["point"].astype(np.int64)
    told = predict(catalog, point, sun, view, catalog.gsd[point])
    works = trials["condition"] == 31
    claimed = np.flatnonzero(told.usable)
    some = rng.choice(claimed, min(TRIALS, len(claimed)), replace=False)
    away = told.detection_probability - trials["detection"]
    known = np.isfinite(away)
    both = works & told.usable
    ratio = np.log(told.sigma_major_m[both] / trials["major"][both])
    lines = [
        f"{len(point)} trials of {len(catalog)} points, {known.mean():.1%} within what was evaluated",
        f"usable there: {works.mean():.1%}; claimed usable: {told.usable.mean():.1%}",
        f"of {len(some)} random claimed usable, usable there: {works[some].mean():.1%}",
        f"of all {len(claimed)} claimed usable, usable there: {works[claimed].mean():.1%}",
        f"of those usable there, claimed: {told.usable[works].mean():.1%}",
        f"probability, predicted less evaluated: mean {away[known].mean():+.3f}, rms {np.sqrt((away[known] ** 2).mean()):.3f}",
        f"sigma of the major axis, predicted over evaluated, usable: median {np.exp(np.median(ratio)):.2f}, "
        f"5..95 %: {np.exp(np.percentile(ratio, 5)):.2f} to {np.exp(np.percentile(ratio, 95)):.2f}",
        "",
        "| Sun elevation, deg | trials | usable there | claimed | usable of those claimed | claimed of those usable |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    elevation = trials["sun"][:, 0]
    for low, high in itertools.pairwise(catalog.sun_elevation):
        here = (elevation >= low) & (elevation < high)
        claim = here & told.usable
        if claim.any():
            lines.append(
                f"| {low:g} to {high:g} | {here.sum()} | {works[here].mean():.1%} | {claim.sum() / here.sum():.1%} "
                f"| {works[claim].mean():.1%} | {told.usable[works & here].mean():.1%} |"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
