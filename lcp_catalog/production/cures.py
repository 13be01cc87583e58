"""What helps a build that has no points, or keeps little of its promise: the changes of its configuration that a cause
suggests are tried on a part of the region, and those that help are named, with their effect there and their price.
The price is in the measure of work that a plan divides its areas by, nodes times conditions (`area_job.AreaJob.work`).
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..catalog.catalogue import Catalog
from ..catalog.promise import kept_promise
from ..catalog.schema import COVERAGE_STATUS, NO_CELL, Cause
from ..catalog.stored import StoredFile, stored_catalog
from ..catalog.sun_cells import SunCells
from ..choices import MOON_MAP
from ..ephemeris.solar_position import highest_sun_deg
from ..errors import ConfigError, LcpError
from ..landmarks.located import reach_of
from ..terrain.area import Area
from ..terrain.terrain import native_dem
from ..terrain.useful_cell import resolves
from .area_job import conditions_at
from .point_config import SPACING_MIN_NODES, PointConfig

if TYPE_CHECKING:
    from .config import BuildConfig
    from .run import Build

log = logging.getLogger(__name__)

_COUNTS = 0.1
"""Least share that a cause needs for its cures to be named."""

_KEPT = 0.5
"""Share of its promise below which a build is warned of."""

TRY_S = 30.0
"""Most time, by default, in which changes are tried."""

_NAMED, _TRIED, _PLACES, _SEED = 2, 5, 2, 1
"""Changes that are named and that are tried, places where, and the seed of their choice."""

_SIDES = 48, 256
"""Least and greatest side of the ground at a place, nodes. On Hadley's 60 km in cells of 237 m half the search radius kept 8
more percent of the promise on 51 nodes, 9 on 127; larger patches 9 and 9; more candidates a cell -1 and 1, so they are not
tried (2026-11-27).
"""

_MEANT, _BEGUN = 0.6, 0.7
"""Part of the time that is planned for (kernels are loaded, too), and the part of a change's own time that must be left for it
to be begun: the first one, of the build as it is, takes longer than the others.
"""

_SMALLER = 0.9
"""Greatest part of a search radius that counts as a smaller one."""

_HIGH_DEG = 65.0
"""A high Sun that is tried where shadows prevail."""

_GAIN = 0.02
"""Least gain in the share of the promise that counts as help."""

_SMALL, _PATCHES, _CLOSER = 6, 5, 6
"""Patches across a footprint below which advice is given, and as many as are advised; part of a patch that is advised as spacing.
40 km at Hadley, Suns of 45 to 60 deg, straight down: located with 0.00 in cells of 474 m, patches of 15 km; of 237 m with 0.02 at
the default spacing and search radius; with 0.21, 0.66, 0.82 at 4, 2, 1.2 km within 4 km. All views: 0.90 at 1.2 km within 4 km,
0.54 at 1.3 km within 8 km (2026-11-29).
"""

_HELP = {
    "nodata": "the DEM has no heights there: another area or DEM helps",
    "dark": "the ground is dark, or without any contrast",
    "featureless": "the ground has too little texture for the errors of heights and image: known `errors.height_sigma_m` or a "
    "smaller `errors.sensor_noise` help",
    "ambiguous": "the ground looks like other ground within `points.search_m`",
    "dependent": "terrain outside the patches shadows or hides them: a higher `points.max_dependence` or higher "
    "`sun.elevations_deg` help",
    "marginal": "points are usable under the Suns that were evaluated, but not surely between them",
    "few": "usable points lie too thinly for the footprint of the promise: a camera that sees more ground, or a finer DEM helps",
    "not_examined": "candidates that seem usable were not evaluated: `points.passes` 1 evaluates all",
    "size": "`points.max_points` or `points.max_bytes` is reached",
}
"""Why points are lacking, by `schema.COVERAGE_STATUS` and `schema.Cause`, and what else helps."""

_LONE = (
    "two elevations of the Sun (of {} deg) have no third beside them, and a point does not count where it has the Sun below the "
    "lower or above the higher one that is between them at the middle of a footprint: `sun.elevations_deg` {} comes before a "
    "camera that sees more ground, or a finer DEM"
)
"""Why few usable points count between two elevations alone."""


@dataclass(frozen=True)
class Cure:
    """Changes of a configuration against a cause, and their work as a multiple of the build's."""

    changes: Mapping[str, Any]
    cause: str
    work: float

    def __str__(self) -> str:
        return " and ".join(
            f"`{name}` {_text(name, value)}" for name, value in self.changes.items()
        )


@dataclass(frozen=True)
class Yield:
    """Points of a catalogue, conditions in which its promise is kept, and conditions."""

    points: int
    kept: int = 0
    conditions: int = 0

    @classmethod
    def of(cls, catalog: Catalog) -> Yield:
        """What a catalogue has."""
        told = catalog.promise
        if told is None or not len(catalog):
            return cls(len(catalog))
        cause = np.asarray(told.cause)
        return cls(len(catalog), int((cause == Cause.MET).sum()), int((cause != NO_CELL).sum()))

    def __add__(self, other: Yield) -> Yield:
        return Yield(
            self.points + other.points,
            self.kept + other.kept,
            self.conditions + other.conditions,
        )

    @property
    def share(self) -> float:
        """Share of the promise that is kept."""
        return self.kept / max(1, self.conditions)


def warn_of_small_footprint(region: Area, points: PointConfig, gsd_m: float) -> None:
    """Log what locates more frames of a stated footprint that is smaller than the region and holds few patches."""
    x0, x1, y0, y1 = region.extent_m
    footprint_m, nodes = 1e3 * (points.footprint_km or math.inf), points.patch_nodes - 1
    cell_m = min(gsd_m, footprint_m / (_PATCHES * nodes))
    small = footprint_m < min(x1 - x0, y1 - y0, _SMALL * nodes * gsd_m)
    if small and points.located is not None and (points.spacing_m is None or cell_m < gsd_m):
        log.warning(
            "a footprint of %g km holds few patches: more of its frames are located in cells of at most %.3g m, by patches that "
            "overlap (`points.spacing_m` %.2g km with `points.located_probability` %g) and, if the place is known to 1 km, by "
            "`points.search_m` %.2g km",
            points.footprint_km,
            cell_m,
            max(SPACING_MIN_NODES, nodes / _CLOSER) * cell_m / 1e3,
            points.located,
            max(nodes / 2 + 1, reach_of(cell_m)) * cell_m / 1e3,
        )


def warn_of_lone_elevations(config: BuildConfig) -> None:
    """Log that a promise of usable points hardly holds where its Suns lie between two elevations alone, beyond which no point is
    called usable. Points that locate a frame count there by their claims.
    """
    if more := _with_middles(config):
        log.warning(
            "two elevations of the Sun (of %s deg) have no third beside them: few usable points count for the promise between, "
            "where the Sun stands higher or lower at a point than at the middle of a footprint; add one: `sun.elevations_deg` %s",
            _text("", tuple(config.sun.elevations_deg)),
            _text("", more),
        )


def _with_middles(config: BuildConfig) -> tuple[float, ...]:
    """The elevations, and the middle of each two that bound a row of the Sun grid without a row beside it; empty if none do, or if
    points need not be usable.
    """
    if config.points.located is not None:
        return ()
    sun = config.sun
    cells = SunCells.of(sun.elevations_deg, sun.azimuths_deg)
    wide = np.pad(cells.above > np.arange(len(cells.above)), 1)
    lone = np.flatnonzero(wide[1:-1] & ~wide[:-2] & ~wide[2:])
    middles = (cells.elevation[lone] + cells.elevation[lone + 1]) / 2.0
    return tuple(sorted([*sun.elevations_deg, *middles.tolist()])) if len(lone) else ()


def _failing(catalog: Catalog) -> list[tuple[float, float]]:
    """Longitudes and latitudes of two places, by chance of those with heights where least is found."""
    told = catalog.promise if len(catalog) else None
    if told is None:
        rows = np.flatnonzero(np.asarray(catalog.coverage.status) != _NODATA)
    else:
        cause = np.asarray(told.cause)
        lacking = ((cause > Cause.NODATA) & (cause != NO_CELL)).mean(axis=(1, 2, 3))
        rows = np.flatnonzero(lacking >= max(np.median(lacking), 1e-9))
    places = catalog.coverage if told is None else told
    chosen = np.random.default_rng(_SEED).choice(rows, min(_PLACES, len(rows)), replace=False)
    return [(float(places.longitude[k]), float(places.latitude[k])) for k in chosen]


_NODATA = next(code for code, cause in COVERAGE_STATUS.items() if cause == "nodata")


@dataclass(frozen=True)
class Trial:
    """Changes of a build that are tried on small parts of its region.

    ``measure``: makes small builds, for at most ``limit_s``; ``spent_s``: processor time of the whole build, 0: unknown.
    """

    build: Build
    measure: Callable[[BuildConfig], Yield]
    limit_s: float
    spent_s: float

    def warn(self, output: Path) -> None:
        """Log a warning about a catalogue without points, with its cells by cause, or one that keeps little of its promise;
        then what helps, with its effect and its price.
        """
        catalog = stored_catalog(StoredFile.of(output))
        promise = kept_promise(catalog)
        causes = {} if promise is None else promise["causes"]
        if len(catalog) and promise is not None and promise["kept_share"] < _KEPT:
            told = ", ".join(f"{why} {100.0 * share:.0f} %" for why, share in causes.items())
            log.warning(
                "%s: the promise is kept in %.0f %% of places, views and Suns (else %s)",
                output,
                100.0 * promise["kept_share"],
                told,
            )
        elif not len(catalog):
            status = np.asarray(catalog.coverage.status)
            counts = {cause: int((status == code).sum()) for code, cause in COVERAGE_STATUS.items()}
            causes = causes or {name: count for name, count in counts.items() if name in _HELP}
            told = ", ".join(f"{count} {cause}" for cause, count in counts.items() if count)
            log.warning("%s: holds no point; cells by cause: %s", output, told or "none")
        else:
            return
        if causes and max(causes.values()):
            log.warning("%s: %s", output, self.advice(causes, _failing(catalog)))

    def advice(self, causes: Mapping[str, float], places: Sequence[tuple[float, float]]) -> str:
        """What helps against causes (by name, the share of each) at places, or why nothing does."""
        main = max(causes, key=lambda name: causes[name])
        why = f"{main}: {_HELP[main]}"
        config = self.build.recipe.config
        if main == "few" and (more := _with_middles(config)):
            why = "few: " + _LONE.format(_text("", config.sun.elevations_deg), _text("", more))
        found = cures(self.build, causes)[:_TRIED]
        if not found:
            return f"no change of the configuration is known to help ({why})"
        if self.limit_s <= 0.0 or not places:
            return f"these may help (not tried): {self._priced(found[:_NAMED])} ({why})"
        side, few = self._affordable(found, len(places))
        if not few:
            return (
                f"these may help (not tried: it would take longer than {_seconds(self.limit_s)}; `try_cures_s` gives more "
                f"time): {self._priced(found[:_NAMED])} ({why})"
            )
        return self._told(side, few, places, why, found[len(few) :])

    def _told(
        self,
        side: int,
        found: Sequence[Cure],
        places: Sequence[tuple[float, float]],
        why: str,
        dear: Sequence[Cure],
    ) -> str:
        """The changes that help; ``dear``: others, for which there is no time."""
        log.info(
            "trying %d changes at %d places, for %.0f s", len(found), len(places), self.limit_s
        )
        until = time.monotonic() + self.limit_s
        before, took_s = self._yield({}, side, places)
        helps: list[tuple[Cure, str]] = []
        useless: list[Cure] = []
        untried: list[Cure] = []
        for cure in found:
            if before is None or time.monotonic() + _BEGUN * took_s * cure.work > until:
                untried.append(cure)
                continue
            after, _ = self._yield(cure.changes, side, places)
            if after is None:
                continue
            if effect := _effect(before, after):
                helps.append((cure, effect + self._with_both(cure)))
            else:
                useless.append(cure)
        km = side * self.build.recipe.gsd_m / 1e3
        where = f"tried on {len(places)} x {km:.3g} x {km:.3g} km of the region"
        parts = []
        if helps:
            named = "; ".join(f"{self._priced([cure])}: {text}" for cure, text in helps[:_NAMED])
            parts.append(f"{where}, these help: {named}")
        elif useless:
            parts.append(f"{where}, no change helps ({why})")
        else:
            parts.append(f"no change could be tried in {_seconds(self.limit_s)} ({why})")
        if useless:
            parts.append(f"without effect: {', '.join(map(str, useless))}")
        if untried or dear:
            parts.append(f"not tried: {self._priced([*untried, *dear])}")
        return "; ".join(parts)

    def _with_both(self, cure: Cure) -> str:
        """Advice beside larger cells: both sizes together keep what the smaller ones are good for."""
        cells_m = self.build.recipe.gsd_m, cure.changes.get("area.gsd_m", 0.0)
        if cells_m[1] <= cells_m[0]:
            return ""
        both = _text("area.levels_m", cells_m)
        return f"; with both, `area.levels_m` {both}, positions under low Suns are about as fine"

    def _priced(self, some: Sequence[Cure]) -> str:
        """Changes with what they cost: the work, and what it takes at the pace of this build."""
        return "; ".join(
            f"{cure} (against {cure.cause}) at {cure.work:.2g} times the work"
            + (f", {_seconds(cure.work * self.spent_s)} of processor time" if self.spent_s else "")
            for cure in some
        )

    def _affordable(self, found: Sequence[Cure], places: int) -> tuple[int, list[Cure]]:
        """The side of the ground at a place, nodes, and the changes that are tried there: as many as the time allows."""
        config = self.build.recipe.config
        halo = config.points.halo_nodes(config.gsd_m)
        jobs = self.build.levels[0].jobs
        nodes = sum(math.prod(job.task.window.grown(halo).shape) for job in jobs)
        node_s = self.spent_s / nodes
        x0, x1, y0, y1 = self.build.recipe.region.extent_m
        most = min(_SIDES[1], math.floor(min(x1 - x0, y1 - y0) / config.gsd_m))
        least = min(_SIDES[0], most)
        if not node_s:
            return least, list(found)
        left = list(found)
        while left:
            builds = places * (1.0 + sum(cure.work for cure in left))
            side = math.floor(math.sqrt(_MEANT * self.limit_s / builds / node_s)) - 2 * halo
            if side >= least:
                return min(side, most), left
            left.pop()  # the dearest
        return least, []

    def _yield(
        self, changes: Mapping[str, Any], side: int, places: Sequence[tuple[float, float]]
    ) -> tuple[Yield | None, float]:
        """What the places give with changes, and the time that it took; None for a configuration that is refused there."""
        build = self.build
        own = build.recipe.config
        km = side * build.recipe.gsd_m / 1e3
        given: dict[str, Any] = {"area.gsd_m": build.recipe.gsd_m, **changes, "area.size_km": km}
        x0, x1, y0, y1 = build.recipe.region.extent_m
        part = min(1.0, (1e3 * km) ** 2 / ((x1 - x0) * (y1 - y0)))
        for name in ("points.max_points", "points.max_bytes"):
            most = given.get(name, getattr(own.points, name.partition(".")[2]))
            if most is not None:
                given[name] = max(1, round(most * part))
        if own.points.promised:
            footprint_m = own.points.footprint_m(given["area.gsd_m"], min(x1 - x0, y1 - y0))
            given["points.footprint_km"] = footprint_m / 1e3
        total, start = Yield(0), time.monotonic()
        for place in places:
            try:
                total += self.measure(own.replaced({**given, "area.center_deg": place}))
            except LcpError as error:
                log.debug("not tried at %s: %s", place, error)
                return None, 0.0
        return total, time.monotonic() - start


def _effect(before: Yield, after: Yield) -> str:
    """What a change does for the better, empty for nothing."""
    if after.share >= before.share + _GAIN:
        return f"the promise is kept in {100.0 * after.share:.0f} % there ({100.0 * before.share:.0f} % without)"
    if not before.conditions and after.points > before.points:
        return f"{after.points} points there ({before.points} without)"
    return ""


def _seconds(seconds: float) -> str:
    """A time in words, to two digits below 10 s: never 0 s."""
    return f"{seconds:.2g} s" if seconds < 10.0 else f"{seconds:.0f} s"


def cures(build: Build, causes: Mapping[str, float]) -> list[Cure]:
    """The changes of a build that may help against causes, by name the shares of cells or conditions in which
    they prevail (`schema.COVERAGE_STATUS`, `schema.Cause`), the cheapest first.
    """
    config = build.recipe.config
    found: dict[str, Cure] = {}
    for cause in sorted(causes, key=lambda name: -causes[name]):
        if causes[cause] < _COUNTS * max(causes.values()):
            continue
        for changes in _against(build, cause):
            try:
                changed = config.replaced(changes)
                changed.points.check_cells(changed.area.gsd_m or build.recipe.gsd_m)
                cost = _work(build, changed) / _work(build, config)
            except ConfigError:  # a search radius below the patch, a cell that the spacing forbids
                continue
            cure = Cure(changes, cause, cost)
            found.setdefault(str(cure), cure)
    return sorted(found.values(), key=lambda cure: cure.work)


def _text(name: str, value: Any) -> str:
    """A value as an option takes it, a length with its unit: `points` have theirs in km there, and in m in a file."""
    if isinstance(value, tuple):
        numbers = [float(f"{one:g}") for one in value]
        steps = np.diff(numbers)
        if len(steps) > 1 and np.ptp(steps) < 1e-9:
            return f"{numbers[0]:g}:{numbers[-1]:g}:{steps[0]:g}"
        return ",".join(f"{one:g}" for one in numbers)
    if name.endswith("_m"):
        return f"{value / 1e3:g} km" if name.startswith("points.") else f"{value:g} m"
    return value if isinstance(value, str) else f"{value:g}"


def _against(build: Build, cause: str) -> Iterator[dict[str, Any]]:
    """Changes of the configuration against a cause."""
    config = build.recipe.config
    yield from _of_ground(build, config, cause)
    yield from _of_points(config.points, build.recipe.gsd_m, cause)
    yield from _of_suns(config, highest_sun_deg(abs(build.recipe.region.lat_deg)), cause)


def _of_ground(build: Build, config: BuildConfig, cause: str) -> Iterator[dict[str, Any]]:
    """Changes of what is known of the ground."""
    if cause in ("dark", "featureless") and config.model.albedo_file is None:
        yield {"model.albedo": MOON_MAP}
    if cause not in ("featureless", "few", "ambiguous") or len(build.levels) > 1:
        return
    cell_m = build.recipe.gsd_m
    if cause == "ambiguous":  # a patch of as many nodes shows four times the ground
        yield {"area.gsd_m": 2.0 * cell_m}
    if resolves(native_dem(build.recipe.dems, build.recipe.region), 0.5 * cell_m):
        yield {"area.gsd_m": 0.5 * cell_m}


def _of_points(points: PointConfig, cell_m: float, cause: str) -> Iterator[dict[str, Any]]:
    """Changes of what a point is."""
    if cause == "ambiguous":
        nodes = max(0.5 * points.search_nodes(cell_m), points.half)
        if nodes < _SMALLER * points.search_nodes(cell_m):
            yield {"points.search_m": float(f"{nodes * cell_m:.2g}")}
    if cause in ("ambiguous", "featureless"):
        yield {"points.patch_nodes": 2 * round(0.75 * points.patch_nodes) + 1}
    if cause == "few":
        closer_m = float(f"{0.5 * points.spacing_nodes(cell_m) * cell_m:.2g}")
        located = points.located  # a spacing alone would promise nothing
        promised = {} if located is None else {"points.located_probability": located}
        yield {"points.spacing_m": closer_m, **promised}
    if cause == "dependent":
        yield {"points.max_dependence": min(1.0, 2.0 * points.max_dependence)}
    if cause == "dark":
        yield {"points.min_lit_share": 0.5 * points.min_lit_share}
    if cause == "size" and points.max_points is not None:
        yield {"points.max_points": 2 * points.max_points}


def _of_suns(config: BuildConfig, highest_deg: float, cause: str) -> Iterator[dict[str, Any]]:
    """More Suns: higher ones, and those between."""
    sun = config.sun
    above = float(f"{min(highest_deg, _HIGH_DEG):.2g}")
    if cause in ("dependent", "dark", "featureless") and above > 1.2 * max(sun.elevations_deg):
        yield {"sun.elevations_deg": (*sun.elevations_deg, above)}
    if cause == "few" and (more := _with_middles(config)):
        yield {"sun.elevations_deg": more}
    if cause == "marginal":
        middles = np.add(
            sun.azimuths_deg, np.diff([*sun.azimuths_deg, sun.azimuths_deg[0] + 360.0]) / 2.0
        )
        yield {"sun.azimuths_deg": tuple(sorted({*sun.azimuths_deg, *(middles % 360.0).tolist()}))}


def _work(build: Build, config: BuildConfig) -> float:
    """Nodes times conditions of all areas under another configuration; of closer candidates, or larger ones, the most that
    they can add.
    """
    own, points = build.recipe.config.points, config.points
    ratio = (build.recipe.gsd_m / (config.area.gsd_m or build.recipe.gsd_m)) ** 2
    ratio *= (points.patch_nodes / own.patch_nodes) ** 2
    if points.spacing_m != own.spacing_m:
        cells = own.spacing_nodes(build.recipe.gsd_m) / points.spacing_nodes(build.recipe.gsd_m)
        ratio *= cells**2
    counts = (job.nodes * conditions_at(job.task.lat_deg, config).count for job in build.jobs)
    return ratio * float(sum(counts)) or 1.0
