"""Estimate of a build's size, time and memory, from a few of its areas that are computed."""

from __future__ import annotations

import logging
import math
import os
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from ..approximations import SWITCHES
from ..arrays import AnyArray, Index
from ..catalog.schema import evaluated, usable
from ..choices import HEIGHTFIELD_SIZE_MAX_KM, NO_MAP
from ..constants import MOON_RADIUS_M
from ..dem.public import dem_paths
from ..ephemeris.solar_position import highest_sun_deg
from ..errors import AreaFailedError
from ..geometry.frames import lonlat_to_mcmf, mcmf_to_lonlat
from ..landmarks.selection import Places, select
from ..memory import mapped_mb, peak_mb, resident_mb
from ..rendering.costs import WITHIN, priced
from ..rendering.decisions import Decision
from ..stages import shares_of_time
from ..terrain.area import Area
from ..threads import limit_threads
from .area_job import AreaJob, AreaResult, conditions_at, run_area
from .areas import AreaTask
from .assembly import BLOCK_BYTES, choose, spacing_m
from .build_decisions import turned_flags
from .executor import are_forked, children_start, processes, stop_early
from .finished_area import cell_stages, free_detection, record_type, table_of, units_of
from .planned_frames import SampledPoints, planned_frames
from .promise import PromiseChoice, PromisedPlaces
from .recipe import InputFiles
from .region_maps import COVERAGE_BYTES, COVERAGE_CELLS, overview_bytes
from .run import Build, BuildRun, Level, most_poleward
from .two_passes import areas_in_passes
from .warm_up import compile_kernels, missing

FILE_BYTES = 70_000
"""Size of a catalogue file without points: HDF5 structures and chunks (measured: 180 and 182 kB in the format of
HDF5 1.8; in that of 1.10 a small file is 110 kB smaller, the sample 139 kB)."""

STORED_SHARE = 0.8
"""Bytes in the file for each byte of patches and overview (measured on the same two builds, of 17 and
35 points: 0.80 and 0.81)."""

STORED_CLAIMS = 0.3
"""Bytes in the file for each byte of flags and packed claims (measured there: 0.26 and 0.33)."""

FORKED_MAPPED_MB = 40.0
"""Of the libraries' files in a worker that is forked. The process that plans has 150 MB of them in memory (114 and 115 MB
more than a worker on the sample, 114 MB with cells of 118 m), and 60 to 106 MB more of those that have just been installed."""

MERGE_MB = 20.0
"""Memory of the merge of the smallest build beside that of the plan."""

BLOCK_COPIES = 3.0
"""Bytes in memory for each byte of the block of records that is written."""

CANDIDATE_BYTES = 280
"""Memory for each candidate while the points are chosen."""

COVERAGE_COPIES = 1.3
"""Bytes in memory for each byte of the coverage by condition. These four figures were fitted to five runs of
``benchmarks/speed/merge.py`` (1875 to 1 000 000 points, records of 434 and 15 382 bytes): they state the peak to
-12 and +16 MB."""

SPREAD_AREAS = 3
"""Areas that are computed besides the middle one and the smallest."""

EDGE_SPACINGS = 0.75
"""Spacings by which the sides of an area seem longer when its points are chosen alone. With it, 34 points
are expected of nine areas (tests/data/nine_areas.toml) that have 32; without it, 61."""

CHOICE_CANDIDATES = 3000
"""Candidates of which all are looked at to tell how many points a promise takes; of more those of a part of the region."""

_PART_FOOTPRINTS = 2.0
"""Footprints along a side of that part, which said 1.08 to 1.27 times as many points as the whole in four cases."""

_WITHIN = WITHIN | {
    "cell size": "in all others, which grow with the number of cells",
    "Suns": "in all others, which grow with the number of Suns",
    "one direction per area": "it saves that of more directions",
}
"""Where the time of effects without work of their own is counted in a build."""

_CLAIM_BYTES = 6
"""Bytes of the claims of one condition and image scale: probability 1, sigmas 2 each, angle 1."""


@dataclass(frozen=True)
class Start:
    """Time that a build takes beside its areas, seconds, and the processor time of all its processes: imports, plan, kernels that
    are loaded, processes, choice and file; not the sums of input files.
    """

    seconds: float
    cpu_s: float


def start_of(level: Level, jobs: int) -> Start:
    """What a build of a level in ``jobs`` processes takes beside its areas, on this machine now: a build of as many of its
    smallest areas, in a process of its own as that of the command is, less what these take when kernels are loaded. Errors as
    an area's; AreaFailedError if the process dies.
    """
    compile_kernels(missing("build-catalog"))
    some = sorted((job for job in level.jobs if job.work), key=lambda job: job.work)[:jobs]
    with tempfile.TemporaryDirectory() as folder, processes(1) as pool:
        begun = time.monotonic()
        try:
            with children_start():
                called = pool.submit(_small_build, replace(level, jobs=tuple(some)), jobs, folder)
            spent, own, again_s = called.result()
        except BrokenProcessPool as error:
            raise AreaFailedError("the process that measures the start of a build died") from error
        whole_s = time.monotonic() - begun - again_s
    return Start(max(0.0, whole_s - own.seconds / max(1, len(some))), max(0.0, spent - own.cpu_s))


def _small_build(level: Level, jobs: int, folder: str) -> tuple[float, Start, float]:
    """Build a level, from its plan to its file. Return the processor time of this process and those that it started; the time of
    the level's areas alone, when kernels are loaded; and the time that was taken for this.
    """
    logging.disable()  # what there is to say the caller has said
    planned = Build.plan(dem_paths(level.recipe.dems), level.recipe.config)
    build = replace(planned, levels=(level,), inputs=InputFiles())
    BuildRun(build, Path(folder, "c.h5"), jobs=jobs, advises=False).whole()
    stop_early()  # processes that have ended count
    spent, built_s = sum(os.times()[:4]), time.monotonic()
    with limit_threads(1):
        _compute(level.jobs)
        begun, begun_cpu_s = time.monotonic(), time.process_time()
        _compute(level.jobs)
        own = Start(time.monotonic() - begun, time.process_time() - begun_cpu_s)
    return spent, own, time.monotonic() - built_s


def _compute(jobs: Sequence[AreaJob]) -> None:
    """Compute areas as a build of them alone does."""
    if jobs[0].recipe.config.points.two_passes:
        areas_in_passes(jobs, len(jobs), lambda _, job: run_area(job))
        return
    for job in jobs:
        run_area(job)


def estimate(build: Build, workers: int, cluster: bool = False) -> dict[str, Any]:
    """The document of a plan: numbers of areas and conditions, and from a few computed areas the memory, time, file size and
    scene plan, each of its decisions with its switch and the share of the areas' time that it takes (`costs.priced`;
    ``matching_cost``: that of candidates, their search and claims; ``promise_kept``: roughly the share of the promise that is kept,
    3 percent too high to 39 too low in 12 builds of Hadley and Taurus-Littrow, a3164fb3). Areas that no configured Sun
    reaches are not among them. Of a build of several levels the sums, the decisions of the finest, and under ``levels`` the
    document of each with its ``gsd_m``, from fine to coarse.

    cluster: the workers are those of a dask cluster, which are not forked from a process of this build.
    """
    level = build.levels[0]
    start_s = start_of(level, 1 if cluster else min(workers, len(level.jobs))).seconds
    forked = are_forked() and not cluster
    levels = [_estimate(level, workers, start_s, forked) for level in build.levels]
    return levels[0] if len(levels) == 1 else _together(build, levels, start_s)


def _estimate(level: Level, workers: int, start_s: float, forked: bool) -> dict[str, Any]:
    """`estimate` of a level that takes ``start_s`` besides its areas; ``forked``: its worker processes are."""
    config = level.recipe.config
    conditions = [job.conditions for job in level.jobs]
    halo = config.points.search_nodes(config.gsd_m) + config.points.half
    nodes = [math.prod(job.task.window.grown(halo).shape) for job in level.jobs]
    cells = sum(n * c.count for n, c in zip(nodes, conditions, strict=True))
    work = [job.work for job in level.jobs]
    order = sorted((k for k, w in enumerate(work) if w), key=work.__getitem__)
    sample = order[len(order) // 2]
    planned_mb = peak_mb(), resident_mb()
    measured = _spread(order, sample)
    seconds, results, costs = _measured(level, measured)
    ground = {k: level.jobs[k].nodes for k in order}
    share = sum(ground.values()) / sum(ground[k] for k in measured)
    candidates = share * sum(len(result.candidates) for result in results)
    chosen = [choose(table_of(result.candidates, config), config) for result in results]
    spacing = spacing_m(config)
    among = [_share_among_others(level, k, spacing) for k in measured]
    alone = [len(rows) * part for rows, part in zip(chosen, among, strict=True)]
    promised = _promised(level, dict(zip(measured, results, strict=True)), candidates)
    points = share * sum(alone) if promised is None else promised[0]
    here = min(workers, len(level.jobs)) == 1
    before_mb = (peak_mb(), resident_mb()) if here else planned_mb
    merge_mb = _merge_mb(level, points, candidates)
    unmapped_mb = mapped_mb() - FORKED_MAPPED_MB if forked and not here else 0.0
    found: dict[str, Any] = {
        "areas": len(level.jobs),
        "suns": max(c.count for c in conditions) // len(config.view),
        "views": len(config.view),
        "cell_renders": cells,
        "memory_mb_per_worker": round(peak_mb() - unmapped_mb),
        "memory_mb_parent": round(max(before_mb[0], before_mb[1] + merge_mb)),
        "seconds_estimate": round(
            start_s + _seconds(level, measured, seconds, min(workers, len(level.jobs))), 1
        ),
        "bytes_estimate": file_bytes(level, points),
        "decisions": [
            priced(one, costs, SWITCHES, _WITHIN)
            for one in (
                _cell_decision(level),
                _sun_decision(level),
                *results[0].plan.to_json()["decisions"],
            )
        ],
        "matching_cost": 1.0 - sum(costs.values()),
    }
    model = config.model
    own_deg, suns_deg = model.precision.own_sun_deg, config.sun.elevations_deg
    sun_deg, share = turned_flags(model.direction_tolerance_deg, own_deg, suns_deg)
    lowest_deg = sun_deg if max(suns_deg) > own_deg else None  # None: every Sun is a point's own
    found["one_direction"] = {"sun_elevation": lowest_deg, "flags_changed": share}
    if promised is not None:
        found["promise_kept"] = round(promised[1], 4)
    if config.points.located is not None:
        apart_m = config.points.least_distance_m(config.gsd_m)
        pools = [_apart(table_of(result.candidates, config), apart_m) for result in results]
        among = [_share_among_others(level, k, apart_m) for k in measured]
        samples = [
            SampledPoints(
                free_detection(seen)[rows], np.any(evaluated(seen.condition), axis=0), part
            )
            for seen, rows, part in zip(
                (result.candidates.evaluation for result in results), pools, among, strict=True
            )
        ]
        cells = sum(math.prod(level.jobs[k].task.window.shape) for k in measured)
        ground_m2, footprint_m = cells * level.recipe.gsd_m**2, _places(level).footprint_m
        found["located_by_sun"] = planned_frames(samples, ground_m2, footprint_m, config)
    if config.model.albedo_file is not None:
        found["albedo_worth"] = _albedo_worth(level, sample, results[0])
    return found


def file_bytes(level: Level, points: float) -> int:
    """Size of the file of a level with a number of points."""
    config = level.recipe.config
    layers = 1 if config.model.albedo_file is None else 2  # of a patch: heights, and brightness
    patch = config.points.patch_nodes**2 * 4 * layers
    shape = conditions_at(0.0, config).shape
    claims = math.prod(shape) * (1 + _CLAIM_BYTES * len(config.points.scales))
    maps = int(overview_bytes(level.recipe.region, level.recipe.gsd_m))
    return int(
        FILE_BYTES + STORED_SHARE * (points * patch + maps) + STORED_CLAIMS * points * claims
    )


def _albedo_worth(level: Level, index: int, mapped: AreaResult) -> list[dict[str, float]]:
    """What the albedo map is worth in an area whose result is ``mapped``, by ``sun_elevation``, degrees: the mean number
    of ``usable`` candidates in a condition that occurs, and their number ``without`` the map.
    """
    config = level.recipe.config.replaced({"model.albedo": NO_MAP})
    recipe = replace(level.recipe, config=config, albedo=None)
    plain = run_area(replace(level.jobs[index], recipe=recipe))
    counts = [_usable_by_sun(result) for result in (mapped, plain)]
    return [
        {"sun_elevation": elevation, "usable": round(own, 2), "without": round(other, 2)}
        for elevation, own, other in zip(config.sun.elevations_deg, *counts, strict=True)
        if math.isfinite(own + other)
    ]


def _usable_by_sun(result: AreaResult) -> list[float]:
    """Mean number of usable candidates in a condition that occurs, by Sun elevation; NaN where none occurs."""
    condition = result.candidates.evaluation.condition
    occurs = np.any(evaluated(condition), axis=0).sum(axis=(0, 2))
    number = usable(condition).sum(axis=(0, 1, 3))
    return [n / k if k else math.nan for n, k in zip(number.tolist(), occurs.tolist(), strict=True)]


def _spread(order: list[int], middle: int) -> list[int]:
    """The areas that are computed, of those in the ``order`` of their work: the middle one, some spread
    evenly over the region, and at last the smallest.
    """
    along = sorted(order)
    places = (int((k + 0.5) / SPREAD_AREAS * len(along)) for k in range(SPREAD_AREAS))
    return list(dict.fromkeys([middle, *(along[place] for place in places), order[0]]))


def _apart(table: AnyArray, distance_m: float) -> Index:
    """Rows of candidates no two of which are closer."""
    places = Places(table["lon_deg"], table["lat_deg"])
    return select(places, table["worth"], table["quality"], distance_m)


def _share_among_others(level: Level, index: int, distance_m: float) -> float:
    """Points of an area in the whole build over those of the area alone, which has more at its border:
    no other area's points are near. ``distance_m``: between points.
    """
    spacing = EDGE_SPACINGS * distance_m / level.recipe.gsd_m
    sides = level.jobs[index].task.window.shape
    return math.prod(side / (side + spacing) for side in sides)


def _places(level: Level) -> PromisedPlaces:
    config = level.recipe.config
    conditions, demand = math.prod(conditions_at(0.0, config).shape), units_of(config).demand
    return PromisedPlaces.of(
        level.recipe.region, config.points, level.recipe.gsd_m, conditions, demand
    )


def _promised(
    level: Level, results: dict[int, AreaResult], candidates: float
) -> tuple[float, float] | None:
    """Points that the promise takes of about so many candidates, and the share of it that they keep: those of the build's choice,
    if the candidates of the areas that were computed (``results``, by index) stood in turn in the others, too, at the same parts of
    these. Of a region with more than `CHOICE_CANDIDATES` a part in the middle is looked at, and what is promised
    in the whole beside it. None without a promise.
    """
    config, region = level.recipe.config, level.recipe.region
    if not config.points.promised:
        return None
    whole, part, jobs = _places(level), region, [job for job in level.jobs if job.work]
    size_km = 1e-3 * _PART_FOOTPRINTS * whole.footprint_m
    if candidates > CHOICE_CANDIDATES and size_km < HEIGHTFIELD_SIZE_MAX_KM / 2.0:
        at, about = (Area(region.lon_deg, region.lat_deg, times * size_km) for times in (1.0, 2.0))
        if at.bounds_m2 < region.bounds_m2:
            part = at
            near = [about.contains(job.task.lon_deg, job.task.lat_deg) for job in jobs]
            jobs = list(compress(jobs, near))
    points = replace(config.points, footprint_km=1e-3 * whole.footprint_m)
    choice = PromiseChoice.of(part, replace(config, points=points))
    if choice is None:
        return None
    known = [
        (level.jobs[k].task, table_of(one.candidates, config), cell_stages(one.candidates, config))
        for k, one in results.items()
    ]
    tables = []
    for number, job in enumerate(jobs):
        task, table, stages = known[number % len(known)]
        rows, table = _moved(table, task, job.task, config.gsd_m)
        inside = np.flatnonzero(part.contains(table["lon_deg"], table["lat_deg"]))
        choice.see(table[inside], stages[rows[inside]])
        tables.append(table[inside])
    rows, kept = choice.rows(np.concatenate(tables), points.max_points)
    promised, here = (
        places.demand.mean() * ground.bounds_m2 / places.radius_m**2
        for places, ground in ((whole, region), (choice.places, part))
    )
    return float(len(rows) * promised / here), kept


def _moved(table: AnyArray, task: AreaTask, to: AreaTask, gsd_m: float) -> tuple[Index, AnyArray]:
    """Candidates of an area at the same parts of another one's window: their rows in the table, fewer in a smaller window, and
    the table of these there.
    """
    own, new = task.window, to.window
    part = min(1.0, math.prod(new.shape) / math.prod(own.shape))
    rows = np.linspace(0, len(table), round(part * len(table)), endpoint=False).astype(np.int64)
    x, y, _ = task.frame.from_mcmf(lonlat_to_mcmf(table["lon_deg"], table["lat_deg"])).T[:, rows]
    scale = np.array(new.shape) / np.array(own.shape)
    x = (new.col0 + (x / gsd_m - own.col0) * scale[1]) * gsd_m
    y = -(new.row0 + (-y / gsd_m - own.row0) * scale[0]) * gsd_m
    z = -(x**2 + y**2) / (2.0 * MOON_RADIUS_M)
    there = table[rows]
    there["lon_deg"], there["lat_deg"], _ = mcmf_to_lonlat(
        to.frame.to_mcmf(np.stack([x, y, z], -1))
    )
    return rows, there


def _merge_mb(level: Level, points: float, candidates: float) -> float:
    """Memory that the choice of the points and the writing of the catalogue add, MB."""
    record = record_type(level.recipe.config).itemsize
    conditions = math.prod(conditions_at(0.0, level.recipe.config).shape)
    cells = min(COVERAGE_CELLS, level.recipe.region.bounds_m2 / spacing_m(level.recipe.config) ** 2)
    return MERGE_MB + 1e-6 * (
        BLOCK_COPIES * min(points * record, BLOCK_BYTES)
        + CANDIDATE_BYTES * candidates
        + COVERAGE_COPIES * min(cells * conditions, COVERAGE_BYTES)
    )


def _together(build: Build, levels: list[dict[str, Any]], start_s: float) -> dict[str, Any]:
    """The document of a build from those of its levels: one start, one file, processes for the largest."""
    again = len(levels) - 1
    total = {
        key: max(level[key] for level in levels)
        if key in ("suns", "views") or key.startswith("memory")
        else sum(level[key] for level in levels)
        for key, value in levels[0].items()
        if isinstance(value, int | float)
    }
    cells = [level.recipe.gsd_m for level in build.levels]
    return total | {
        "seconds_estimate": round(total["seconds_estimate"] - again * start_s, 1),
        "bytes_estimate": total["bytes_estimate"] - again * FILE_BYTES,
        "decisions": levels[0]["decisions"],
        "matching_cost": levels[0]["matching_cost"],
        "one_direction": levels[0]["one_direction"],
        **{
            key: value
            for key, value in levels[0].items()
            if key in ("albedo_worth", "located_by_sun", "promise_kept")
        },
        "levels": [{"gsd_m": m} | level for m, level in zip(cells, levels, strict=True)],
    }


def _seconds(level: Level, indices: list[int], measured: list[float], workers: int) -> float:
    """Time of a level's areas from the seconds of some, the smallest as the last: a constant for each
    area, and seconds proportional to its `AreaJob.work`.
    """
    work = np.array([job.work for job in level.jobs], dtype=np.float64)
    others = slice(0, max(1, len(indices) - 1))
    large, most = float(np.mean(work[indices[others]])), float(np.mean(measured[others]))
    small, least = float(work[indices[-1]]), measured[-1]
    rate = most / max(large, 1.0)
    if large > small:
        rate = min(rate, max(0.0, (most - least) / (large - small)))
    total = (most - rate * large) * len(work) + rate * work.sum()
    return float(total) / workers


def _cell_decision(level: Level) -> dict[str, Any]:
    """The choice of the cell, in the form of the scene plan's decisions."""
    reason = f"cells of {level.recipe.gsd_m:.5g} m: {level.cell.reason}"
    return asdict(Decision("cell size", True, reason, None, "m"))


def _sun_decision(level: Level) -> dict[str, Any]:
    """The grid of Suns, in the form of the scene plan's decisions."""
    sun, latitude = level.recipe.config.sun, most_poleward(level.recipe.region)
    listed = ", ".join(f"{elevation:g}" for elevation in sun.elevations_deg)
    reason = "as configured"
    if sun == replace(sun, elevations_deg=()).at(latitude):
        reason = (
            f"the default for regions up to latitude {latitude:.1f} deg, where the Sun's upper edge is at most "
            f"{highest_sun_deg(latitude):.1f} deg high"
        )
    count = len(sun.azimuths_deg)
    text = f"{count} azimuth{'s' * (count > 1)} at {listed} deg: {reason}"
    return asdict(Decision("Suns", True, text, None, "deg"))


def _measured(
    level: Level, indices: list[int]
) -> tuple[list[float], list[AreaResult], dict[str, float]]:
    """Seconds of areas, on one thread, when kernels are loaded; their results; and the shares of that time by effect
    (`stages.shares_of_time`).
    """
    seconds, results = [], []
    with limit_threads(1):
        run_area(level.jobs[indices[0]])
        with shares_of_time() as costs:
            for index in indices:
                start = time.perf_counter()
                results.append(run_area(level.jobs[index]))
                seconds.append(time.perf_counter() - start)
    return seconds, results, costs
