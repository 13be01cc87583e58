"""Measurement of time and errors of each accuracy tier against ``reference`` on a user's own build.

Each tier computes the same areas in a process of its own with one thread. The tiers take turns area
by area, so that changes in the machine's speed affect all of them. The images are compared
separately, on terrain that is made once.

Areas computed in processes of their own, with their time and memory.

Images of one area in every tier: their time, their errors against ``reference``, and a section
to show.

Comparison of reflectance models on the images of one area: time, and correlation of windows with
those of `REFERENCE_LAW`.

Navigation correlates windows of a render and an image with free gain and offset. The cost of a
simpler model is therefore the loss of correlation of its windows with those of the most complete
model, on this terrain with its shadows.

Changes of the chosen points between tiers: lost, gained and moved points, conditions, and sigma.
"""

from __future__ import annotations

import dataclasses
import math
import statistics
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..accuracy import DEFAULT_TIER, TIERS
from ..arrays import AnyArray, Array, Mask
from ..catalog.schema import evaluated, usable
from ..choices import LAWS_BY_COST, REFERENCE_LAW
from ..errors import AreaFailedError, ConfigError
from ..geometry.frames import lonlat_to_mcmf
from ..landmarks.selection import Places, nearest, stable_id
from ..memory import peak_mb
from ..photometry.laws import reflectance_model
from ..production.area_job import AreaJob, Candidates, area_sweep, run_area
from ..production.assembly import choose, spacing_m
from ..production.config import BuildConfig
from ..production.executor import children_start, processes
from ..production.finished_area import table_of
from ..production.run import Build
from ..production.sweep import Conditions, RenderedImage, Sweep
from ..threads import limit_threads
from ..validation.ground_comparison import compare

DETECTION_CHANGE = 0.05
"""Change of a detection probability from which it is counted."""


@dataclass(frozen=True)
class Change:
    """Change of a figure of the common points: median and 95th percentile of the absolute
    difference; None without points.
    """

    median: float | None
    p95: float | None

    @classmethod
    def of(cls, differences: AnyArray) -> Change:
        if not len(differences):
            return cls(None, None)
        low, high = np.percentile(np.abs(differences), [50.0, 95.0])
        return cls(float(low), float(high))


@dataclass(frozen=True)
class PointChanges:
    """Differences between the points chosen from two sets of candidates; a share of nothing is
    None.
    """

    points: int
    points_lost: int
    points_gained: int
    points_moved: int
    conditions_changed_share: float | None
    detection_changed_share: float | None
    detection_change_max: float | None
    localization_sigma_change_m: Change
    localization_sigma_change_share: Change


def compare_points(reference: Candidates, tier: Candidates, config: BuildConfig) -> PointChanges:
    """Compare the points that `assembly.choose` takes from either set, matched by their
    identifiers.

    Lost: only in the reference's catalogue; gained: only in the tier's; moved: lost points with a
    gained one within half the spacing. Conditions: those evaluated for candidates in both sets; of their
    detection probabilities at all image scales the share that changes by more than `DETECTION_CHANGE`, and
    the greatest change.
    Sigma: the catalogue's ``localization_sigma``, major axis, of common points.
    """
    ids = {"ours": _ids(tier), "exact": _ids(reference)}
    ours, exact = (choose(table_of(c, config), config) for c in (tier, reference))
    lost = exact[~np.isin(ids["exact"][exact], ids["ours"][ours])]
    gained = ours[~np.isin(ids["ours"][ours], ids["exact"][exact])]
    near_m = spacing_m(config) / 2.0
    _, away_m = nearest(
        Places(reference.lon_deg[lost], reference.lat_deg[lost]),
        Places(tier.lon_deg[gained], tier.lat_deg[gained]),
    )
    _, here, there = np.intersect1d(ids["ours"], ids["exact"], return_indices=True)
    both = np.isin(here, ours) & np.isin(there, exact)
    before = _sigma_m(reference, there[both])
    change = _sigma_m(tier, here[both]) - before
    claimed = _detection_changes(reference, there, tier, here)
    return PointChanges(
        points=len(ours),
        points_lost=len(lost),
        points_gained=len(gained),
        points_moved=int((away_m <= near_m).sum()),
        conditions_changed_share=_changed(reference, there, tier, here),
        detection_changed_share=float((claimed > DETECTION_CHANGE).mean())
        if len(claimed)
        else None,
        detection_change_max=float(claimed.max()) if len(claimed) else None,
        localization_sigma_change_m=Change.of(change),
        localization_sigma_change_share=Change.of(change / before),
    )


def _ids(candidates: Candidates) -> NDArray[np.int64]:
    return stable_id(candidates.lon_deg, candidates.lat_deg)


def _sigma_m(candidates: Candidates, rows: NDArray[np.int64]) -> AnyArray:
    """Largest major axis over usable conditions, as in the catalogue; every row has a usable
    condition.
    """
    evaluation = candidates.evaluation
    works = usable(evaluation.condition[rows])
    sigma_m = np.where(works, evaluation.sigma_major_m[rows, 0], -np.inf)
    return np.asarray(sigma_m.max(axis=(1, 2, 3)))


def _detection_changes(
    reference: Candidates, there: NDArray[np.int64], tier: Candidates, here: NDArray[np.int64]
) -> AnyArray:
    """Absolute changes of the detection probabilities that are stated in both."""
    exact, ours = reference.evaluation.detection[there], tier.evaluation.detection[here]
    change = np.abs(ours.astype(np.float64) - exact)
    return change[np.isfinite(change)]


def _changed(
    reference: Candidates, there: NDArray[np.int64], tier: Candidates, here: NDArray[np.int64]
) -> float | None:
    """Share of the conditions evaluated in both that are usable in one only; None without any."""
    exact, ours = reference.evaluation.condition[there], tier.evaluation.condition[here]
    judged = evaluated(exact) & evaluated(ours)
    if not judged.any():
        return None
    return float((usable(exact) != usable(ours))[judged].mean())


REFERENCE = "reference"

EDGE_NODES = 2
"""Largest distance in nodes from an edge of a shadow in the reference at which a wrong node counts
as at the edge.
"""

PICTURE_NODES = 160
"""Longest side of the section of an area that is shown, nodes."""


@dataclass
class ImageChanges:
    """Sums over the images of one tier compared with the reference; additive over areas."""

    seconds: float = 0.0
    judged: int = 0  # (node, Sun) pairs
    wrong: int = 0
    near_edge: int = 0
    looked: int = 0  # (node, view) pairs
    misseen: int = 0
    shared: int = 0  # nodes of all images that are visible in both
    squares: float = 0.0
    radiance: float = 0.0  # of the reference, summed over the same nodes

    def add(self, other: ImageChanges) -> None:
        for f in dataclasses.fields(self):
            setattr(self, f.name, getattr(self, f.name) + getattr(other, f.name))

    @property
    def sunlit_error_share(self) -> float:
        return self.wrong / max(self.judged, 1)

    @property
    def near_edge_share(self) -> float | None:
        return self.near_edge / self.wrong if self.wrong else None

    @property
    def visible_error_share(self) -> float:
        return self.misseen / max(self.looked, 1)

    @property
    def radiance_rmse(self) -> float:
        """Root mean square difference as a share of the mean radiance factor of the reference."""
        if not self.shared or not self.radiance:
            return 0.0
        return math.sqrt(self.squares / self.shared) / (self.radiance / self.shared)


@dataclass(frozen=True)
class ErrorPicture:
    """Section of an area under one low Sun: lit nodes of the reference, and the differences of each
    tier.

    lit: int8 (rows, cols), 1 lit, 0 dark, -1 without terrain; wrong[tier]: int8, +1 lit where the
    reference is dark, -1 dark where it is lit.
    """

    area: str
    sun_azimuth_deg: float
    sun_elevation_deg: float
    lit: NDArray[np.int8]
    wrong: dict[str, NDArray[np.int8]]
    wrong_nodes: int


def compare_images(jobs: dict[str, AreaJob]) -> tuple[dict[str, ImageChanges], ErrorPicture | None]:
    """Compare the images of one area in every tier: time on one thread, differences from
    ``reference``, and a section to show.

    jobs: the same area by tier. All nodes of the area's window with its margin are compared;
    shadows in the view from the zenith.
    """
    with limit_threads(1):
        sweeps = _sweeps(jobs)
        changes = {tier: ImageChanges() for tier in sweeps}
        for sweep in sweeps.values():  # loads kernels and makes pyramids before the timing
            next(dataclasses.replace(sweep).images(), None)
        shown = _Shown(next(iter(jobs.values())).task.name)
        above = int(np.argmin(next(iter(sweeps.values())).conditions.off_nadir_deg))
        for images in _side_by_side(sweeps, changes):
            if images[REFERENCE].view == above:
                _judge_light(images, changes)
                shown.look(images, sweeps[REFERENCE].conditions)
            if images[REFERENCE].view < len(jobs[REFERENCE].recipe.config.view):
                _judge_radiance(images, changes)
    for tier, sweep in sweeps.items():
        for view in range(len(sweep.view_directions)):
            hidden, exact = sweep.unseen(view), sweeps[REFERENCE].unseen(view)
            changes[tier].looked += exact.size
            changes[tier].misseen += int((hidden != exact).sum())
    return changes, shown.picture()


def _sweeps(jobs: dict[str, AreaJob]) -> dict[str, Sweep]:
    """The area's sweep in every tier over one terrain, with a view from the zenith added if the
    build has none.
    """
    job = jobs[REFERENCE]
    exact = area_sweep(job)
    conditions = exact.conditions
    if not (conditions.off_nadir_deg == 0.0).any():
        conditions = dataclasses.replace(
            conditions,
            off_nadir_deg=np.append(conditions.off_nadir_deg, 0.0),
            view_azimuth_deg=np.append(conditions.view_azimuth_deg, 0.0),
            view_altitude_km=np.append(conditions.view_altitude_km, np.inf),
        )
    return {
        tier: dataclasses.replace(
            exact, conditions=conditions, accuracy=tiered.recipe.config.model.precision
        )
        for tier, tiered in jobs.items()
    }


def _side_by_side(
    sweeps: dict[str, Sweep], changes: dict[str, ImageChanges]
) -> Iterator[dict[str, RenderedImage]]:
    """Each image in every tier; its time is added to the tier's seconds."""
    streams = {tier: sweep.images() for tier, sweep in sweeps.items()}
    while True:
        images = {}
        for tier, stream in streams.items():
            start = time.perf_counter()
            image = next(stream, None)
            changes[tier].seconds += time.perf_counter() - start
            if image is None:
                return
            images[tier] = image
        yield images


def _judge_light(images: dict[str, RenderedImage], changes: dict[str, ImageChanges]) -> None:
    """Count the nodes that are lit in one image and dark in the other; views from the zenith, where
    only nodata is invisible.
    """
    exact = images[REFERENCE].radiance
    ground, lit = np.isfinite(exact), exact > 0.0
    for tier, image in images.items():
        wrong = ((image.radiance > 0.0) != lit) & ground
        changes[tier].judged += int(ground.sum())
        changes[tier].wrong += int(wrong.sum())
        changes[tier].near_edge += int(_at_edge(lit, ground, wrong).sum())


def _at_edge(lit: Mask, ground: Mask, nodes: Mask) -> Mask:
    """True (n,) for marked nodes with a node in the other state within `EDGE_NODES` rows and
    columns.
    """
    rows, cols = np.nonzero(nodes)
    found = np.zeros(len(rows), dtype=np.bool_)
    steps = range(-EDGE_NODES, EDGE_NODES + 1)
    for row_step in steps:
        for col_step in steps:
            r = np.clip(rows + row_step, 0, lit.shape[0] - 1)
            c = np.clip(cols + col_step, 0, lit.shape[1] - 1)
            found |= ground[r, c] & (lit[r, c] != lit[rows, cols])
    return found


def _judge_radiance(images: dict[str, RenderedImage], changes: dict[str, ImageChanges]) -> None:
    exact = images[REFERENCE].radiance
    for tier, image in images.items():
        both = np.isfinite(exact) & np.isfinite(image.radiance)
        ours, theirs = image.radiance[both].astype(np.float64), exact[both].astype(np.float64)
        changes[tier].shared += len(ours)
        changes[tier].squares += float(((ours - theirs) ** 2).sum())
        changes[tier].radiance += float(theirs.sum())


class _Shown:
    """Images of the lowest Sun with an error in any tier, and of those the ones with the most wrong
    nodes.
    """

    def __init__(self, area: str) -> None:
        self._area = area
        self._kept: tuple[float, float, dict[str, RenderedImage]] | None = None
        self._rank: tuple[bool, float, int] = (True, math.inf, 0)

    def look(self, images: dict[str, RenderedImage], conditions: Conditions) -> None:
        exact = images[REFERENCE]
        elevation = float(conditions.sun_elevation_deg[exact.elevation])
        wrong = sum(int(np.count_nonzero(_difference(i, exact))) for i in images.values())
        rank = (wrong == 0, elevation, -wrong)
        if rank < self._rank:
            azimuth = float(conditions.sun_azimuth_deg[exact.azimuth])
            self._rank, self._kept = rank, (azimuth, elevation, dict(images))

    def picture(self) -> ErrorPicture | None:
        if self._kept is None:
            return None
        azimuth, elevation, images = self._kept
        exact = images[REFERENCE]
        wrong = {t: _difference(i, exact) for t, i in images.items() if t != REFERENCE}
        lit = np.where(np.isfinite(exact.radiance), exact.radiance > 0.0, -1).astype(np.int8)
        section = _busiest(np.abs(np.stack(list(wrong.values()))).sum(axis=0, dtype=np.int64))
        return ErrorPicture(
            self._area,
            azimuth,
            elevation,
            lit[section],
            {t: w[section] for t, w in wrong.items()},
            -self._rank[2],
        )


def _difference(image: RenderedImage, exact: RenderedImage) -> NDArray[np.int8]:
    lit, wanted = image.radiance > 0.0, exact.radiance > 0.0
    return lit.astype(np.int8) - wanted.astype(np.int8)


def _busiest(counts: NDArray[np.int64]) -> tuple[slice, slice]:
    """The section of at most `PICTURE_NODES` a side with the largest sum."""
    sums = np.pad(counts.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    height, width = (min(PICTURE_NODES, side) for side in counts.shape)
    inside = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width]
    inside = inside + sums[:-height, :-width]
    row, col = (int(i) for i in np.unravel_index(np.argmax(inside), inside.shape))
    return slice(row, row + height), slice(col, col + width)


PHASES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 180.0)
"""Edges of the bins of phase angle."""

WINDOW = 32
"""Side of a window, nodes."""

CONTRAST = 1e-4
"""Least standard deviation of a window, as a share of its mean."""


@dataclass
class ModelChanges:
    """Correlations with the reference model by model and phase bin, and seconds by model; additive
    over areas.
    """

    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(LAWS_BY_COST, 0.0))
    correlations: dict[tuple[str, int], list[Array]] = field(default_factory=dict)
    images: dict[int, int] = field(default_factory=dict)

    def add(self, other: ModelChanges) -> None:
        for law, seconds in other.seconds.items():
            self.seconds[law] += seconds
        for key, values in other.correlations.items():
            self.correlations.setdefault(key, []).extend(values)
        for phase, count in other.images.items():
            self.images[phase] = self.images.get(phase, 0) + count

    def rows(self) -> list[dict[str, Any]]:
        """One dictionary per model and phase bin that occurs, with statistics over the windows."""
        found = []
        for law in LAWS_BY_COST[:-1]:
            for phase in sorted(self.images):
                values = np.concatenate(self.correlations.get((law, phase), [np.empty(0)]))
                if not values.size:
                    continue
                found.append(
                    {
                        "reflectance": law,
                        "against": REFERENCE_LAW,
                        "phase_deg": list(PHASES_DEG[phase : phase + 2]),
                        "images": self.images[phase],
                        "windows": int(values.size),
                        "correlation_median": float(np.median(values)),
                        "correlation_p05": float(np.percentile(values, 5)),
                        "share_above_0_9": float(np.mean(values > 0.9)),
                    }
                )
        return found

    def times(self) -> dict[str, float]:
        """Time of all images with each model as a share of that with the reference model."""
        return {law: s / max(self.seconds[REFERENCE_LAW], 1e-12) for law, s in self.seconds.items()}


def compare_models(job: AreaJob) -> ModelChanges:
    """Compare the images of an area with each of `LAWS_BY_COST`, on one thread, the models in turn
    for each image.
    """
    found = ModelChanges()
    with limit_threads(1):
        sweep = area_sweep(job)
        sweeps = {
            law: dataclasses.replace(sweep, model=reflectance_model(law)) for law in LAWS_BY_COST
        }
        for ready in sweeps.values():  # one-time work before the timing
            next(dataclasses.replace(ready).images(), None)
        streams = {law: ready.images() for law, ready in sweeps.items()}
        while True:
            images = {}
            for law, stream in streams.items():
                start = time.perf_counter()
                image = next(stream, None)
                found.seconds[law] += time.perf_counter() - start
                if image is None:
                    return found
                images[law] = image
            _correlate(sweep, images, found)


def _correlate(sweep: Sweep, images: dict[str, RenderedImage], found: ModelChanges) -> None:
    exact = images[REFERENCE_LAW]
    sun = sweep.sun_directions[exact.elevation, exact.azimuth]
    camera = sweep.view_directions[exact.view]
    phase_deg = math.degrees(math.acos(min(1.0, max(-1.0, float(sun @ camera)))))
    phase = int(np.searchsorted(PHASES_DEG, phase_deg, side="right")) - 1
    phase = min(phase, len(PHASES_DEG) - 2)
    found.images[phase] = found.images.get(phase, 0) + 1
    for law in LAWS_BY_COST[:-1]:
        values = window_correlations(images[law].radiance, exact.radiance)
        found.correlations.setdefault((law, phase), []).append(values)


def window_correlations(ours: NDArray[np.floating], theirs: NDArray[np.floating]) -> Array:
    """Centred normalised correlations (n,) of the windows whose nodes are all visible and that have
    contrast in ``theirs``; 0 for a window without contrast in ``ours``.
    """
    if min(ours.shape) < WINDOW:
        return np.empty(0)
    found = compare(ours, theirs, gsd_m=1.0, size=WINDOW, step=WINDOW, least_valid=1.0)
    corners = zip(found.row, found.col, strict=True)
    means = np.array([theirs[r : r + WINDOW, c : c + WINDOW].mean() for r, c in corners])
    return found.correlation[found.contrast > CONTRAST * means]


@dataclass(frozen=True)
class TimedArea:
    """Candidates of an area, their wall and CPU time, and the peak memory of the process before and
    after, MB.
    """

    seconds: float
    cpu_seconds: float
    candidates: Candidates
    before_mb: float
    peak_mb: float


def timed_area(job: AreaJob) -> TimedArea:
    """Run `area_job.run_area` on one thread and measure wall time and CPU time; other load on the
    machine affects CPU time less.
    """
    before_mb = peak_mb()
    with limit_threads(1):
        wall, own = time.perf_counter(), time.process_time()
        result = run_area(job)
        wall, own = time.perf_counter() - wall, time.process_time() - own
    return TimedArea(wall, own, result.candidates, before_mb, peak_mb())


class Workers:
    """A spawned process for each name, or this process for all."""

    def __init__(self, isolated: bool) -> None:
        self._isolated, self._stack = isolated, ExitStack()
        self._pools: dict[str, ProcessPoolExecutor] = {}

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def call(self, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function in the named process. Raises its errors, and AreaFailedError if the
        process dies.
        """
        if not self._isolated:
            return function(*arguments)
        if name not in self._pools:
            self._pools[name] = self._stack.enter_context(processes(1))
        try:
            with children_start():
                called = self._pools[name].submit(function, *arguments)
            return called.result()
        except BrokenProcessPool as error:
            raise AreaFailedError(
                f"the process of {name} died (killed or out of memory); use a coarser `gsd_m` or a smaller area"
            ) from error


@dataclass
class Runs:
    """Results of the process of one tier."""

    areas: dict[str, list[TimedArea]] = field(default_factory=dict)  # by name, one per round
    base_mb: float = 0.0

    def add(self, area: str, outcome: TimedArea) -> None:
        self.areas.setdefault(area, []).append(outcome)

    def total(self, clock: str) -> float:
        """Seconds of all areas by a clock (a field of `TimedArea`), each the median over its
        rounds.
        """
        areas = self.areas.values()
        return sum(float(statistics.median(getattr(r, clock) for r in runs)) for runs in areas)

    @property
    def by_round(self) -> list[float]:
        """Wall time of all areas in each round."""
        return [sum(run.seconds for run in turn) for turn in zip(*self.areas.values(), strict=True)]

    @property
    def peak_mb(self) -> float:
        return max(run.peak_mb for runs in self.areas.values() for run in runs)

    @property
    def candidates(self) -> Candidates:
        everything: Candidates = _joined([runs[-1].candidates for runs in self.areas.values()])
        return everything


def _joined(parts: list[Any]) -> Any:
    """Concatenate dataclasses of arrays of the same type."""
    columns: dict[str, Any] = {}
    for field_ in dataclasses.fields(parts[0]):
        values = [getattr(part, field_.name) for part in parts]
        nested = dataclasses.is_dataclass(values[0])
        columns[field_.name] = (
            None if values[0] is None else _joined(values) if nested else np.concatenate(values)
        )
    return dataclasses.replace(parts[0], **columns)


Progress = Callable[[int, int], None]

AREAS, ROUNDS = 4, 2
"""Default number of areas, and of rounds for each."""


@dataclass(frozen=True)
class Trade:
    """Result of a measurement: one row per tier, the compared areas and conditions, an image, and
    the reflectance models.
    """

    rows: list[dict[str, Any]]
    compared: dict[str, Any]
    picture: ErrorPicture | None
    models: ModelChanges

    def document(self) -> dict[str, Any]:
        """The content of ``trade.json``."""
        laws = {"rows": self.models.rows(), "seconds_relative": self.models.times()}
        return {"rows": self.rows, "models": laws, "compared": self.compared}


def measure_trade(
    build: Build,
    areas: int = AREAS,
    rounds: int = ROUNDS,
    isolated: bool = True,
    progress: Progress = lambda done, total: None,
) -> Trade:
    """Compute some areas of a build in every tier and compare them.

    ``isolated``: each tier in a process of its own; otherwise ``memory_mb`` is None. Raises
    ConfigError for counts below 1, the library's errors of an area, and AreaFailedError if a
    process dies.
    """
    if areas < 1 or rounds < 1:
        raise ConfigError("`areas` and `rounds` must be at least 1")
    chosen = [build.jobs[i] for i in spread(build, areas)]
    jobs = [{tier: _in_tier(job, tier) for tier in TIERS} for job in chosen]
    steps = _Steps(progress, total=len(jobs) * (2 + rounds * len(TIERS)) + len(TIERS))
    with Workers(isolated) as workers:
        images, picture = _images(workers, jobs, steps)
        models = _models(workers, jobs, steps)
        runs = {tier: Runs() for tier in TIERS}
        for tier, run in runs.items():  # loads kernels, fills the file cache
            run.base_mb = workers.call(tier, timed_area, jobs[0][tier]).before_mb
            steps.one()
        for turn in range(rounds):
            for job in jobs:
                for tier in _taking_turns(turn):
                    runs[tier].add(job[tier].task.name, workers.call(tier, timed_area, job[tier]))
                    steps.one()
    return Trade(
        _rows(build, images, runs, isolated),
        _compared(build, chosen, rounds, isolated),
        picture,
        models,
    )


class _Steps:
    """Counter of the finished steps for the progress callback."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0
        progress(0, total)

    def one(self) -> None:
        self._done += 1
        self._progress(self._done, self._total)


def _taking_turns(turn: int) -> list[str]:
    """The tiers, starting with another one in each round."""
    names = list(TIERS)
    return names[turn % len(names) :] + names[: turn % len(names)]


def _in_tier(job: AreaJob, tier: str) -> AreaJob:
    recipe = job.recipe
    model = dataclasses.replace(recipe.config.model, accuracy=tier, tolerance=None)
    config = dataclasses.replace(recipe.config, model=model)
    return dataclasses.replace(job, recipe=dataclasses.replace(recipe, config=config))


def spread(build: Build, count: int) -> list[int]:
    """Indices of sample areas: the one nearest to the region's centre, then repeatedly the one
    farthest from those chosen.

    Areas with less than half of the nodes of the largest one are chosen last.
    """
    nodes = np.array([job.nodes for job in build.jobs])
    lon, lat = np.array([(job.task.lon_deg, job.task.lat_deg) for job in build.jobs]).T
    place, region = lonlat_to_mcmf(lon, lat), build.recipe.region
    centre = lonlat_to_mcmf(region.lon_deg, region.lat_deg)
    rank = np.where(2 * nodes >= nodes.max(), 0, 1)
    chosen: list[int] = []
    away = -np.linalg.norm(place - centre, axis=1)
    while len(chosen) < min(count, len(nodes)):
        free = np.setdiff1d(np.arange(len(nodes)), chosen)
        free = free[rank[free] == rank[free].min()]
        chosen.append(int(free[np.argmax(away[free])]))
        away = np.linalg.norm(place[:, None] - place[chosen], axis=2).min(axis=1)
    return chosen


# -- images


def _images(
    workers: Workers, jobs: list[dict[str, AreaJob]], steps: _Steps
) -> tuple[dict[str, ImageChanges], ErrorPicture | None]:
    """Comparison of all images of the areas; the picture is the one with the most wrong nodes."""
    totals = {tier: ImageChanges() for tier in TIERS}
    shown: ErrorPicture | None = None
    for number, tiers in enumerate(jobs):
        if not number:
            # compiles kernels here, not in the processes whose memory is measured
            workers.call("images", run_area, tiers["draft"])
        changes, picture = workers.call("images", compare_images, tiers)
        for tier, change in changes.items():
            totals[tier].add(change)
        if picture and (shown is None or picture.wrong_nodes > shown.wrong_nodes):
            shown = picture
        steps.one()
    return totals, shown


def _models(workers: Workers, jobs: list[dict[str, AreaJob]], steps: _Steps) -> ModelChanges:
    """Comparison of the reflectance models on the areas' images, in the default tier."""
    total = ModelChanges()
    for tiers in jobs:
        total.add(workers.call("images", compare_models, tiers[DEFAULT_TIER]))
        steps.one()
    return total


# -- the table


def _rows(
    build: Build, images: dict[str, ImageChanges], runs: dict[str, Runs], isolated: bool
) -> list[dict[str, Any]]:
    """One dictionary per tier, from ``draft`` to ``reference``."""
    found = {tier: run.candidates for tier, run in runs.items()}
    exact, exact_images = runs[REFERENCE], images[REFERENCE]
    rows = []
    for tier, run in runs.items():
        ratios = [a / b for a, b in zip(run.by_round, exact.by_round, strict=True)]
        change = images[tier]
        rows.append(
            {
                "accuracy": tier,
                "bound": TIERS[tier].node_error,
                "seconds": run.total("seconds"),
                "seconds_relative": run.total("seconds") / exact.total("seconds"),
                "seconds_relative_range": [min(ratios), max(ratios)],
                "cpu_seconds": run.total("cpu_seconds"),
                "cpu_relative": run.total("cpu_seconds") / exact.total("cpu_seconds"),
                "render_seconds": change.seconds,
                "render_relative": change.seconds / exact_images.seconds
                if exact_images.seconds
                else 1.0,
                "memory_mb": run.peak_mb if isolated else None,
                "memory_base_mb": run.base_mb if isolated else None,
                "sunlit_error_share": change.sunlit_error_share,
                "sunlit_error_near_edge_share": change.near_edge_share,
                "visible_error_share": change.visible_error_share,
                "radiance_rmse": change.radiance_rmse,
                **dataclasses.asdict(
                    compare_points(found[REFERENCE], found[tier], build.recipe.config)
                ),
            }
        )
    return rows


def _compared(build: Build, chosen: list[AreaJob], rounds: int, isolated: bool) -> dict[str, Any]:
    """The compared areas and conditions in plain values."""
    config, region = build.recipe.config, build.recipe.region
    return {
        "dems": [source["name"] for source in build.recipe.dems.sources()],
        "region": {
            "center_lon": region.lon_deg,
            "center_lat": region.lat_deg,
            **dict(zip(("west", "south", "east", "north"), region.bounds, strict=True)),
        },
        "gsd_m": config.gsd_m,
        "areas": len(chosen),
        "areas_of": len(build.jobs),
        "area_names": [job.task.name for job in chosen],
        "area_nodes": [job.nodes for job in chosen],
        "suns": sorted({int(job.conditions.reachable.sum()) for job in chosen}),
        "sun_azimuths_deg": list(config.sun.azimuths_deg),
        "sun_elevations_deg": list(config.sun.elevations_deg),
        "views": len(config.view),
        "view_off_nadir_deg": list(config.view.off_nadir_deg),
        "reflectance": build.recipe.law.model.name,
        "threads": 1,
        "rounds": rounds,
        "own_process": isolated,
    }
