"""What helps a build that has no points, or keeps little of its promise, and what that costs: in the measure of work
that a plan divides its areas by, nodes times conditions (`area_job.AreaJob.work`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..choices import MOON_MAP
from ..errors import ConfigError
from ..terrain.terrain import native_dem
from ..terrain.useful_cell import resolves
from .area_job import conditions_at

if TYPE_CHECKING:
    from .config import BuildConfig
    from .run import Build

_COUNTS = 0.1
"""Least share that a cause needs for its cures to be named."""


def cures(build: Build, causes: Mapping[str, float], most: int = 2) -> str:
    """The cheapest changes of a build that may help against causes, by name the shares of cells or conditions in which
    they prevail (`schema.COVERAGE_STATUS`, `schema.Cause`), each with its work as a multiple of the build's; empty for none.
    """
    config = build.recipe.config
    found: dict[str, float] = {}
    for cause in sorted(causes, key=lambda name: -causes[name]):
        if causes[cause] < _COUNTS * max(causes.values()):
            continue
        for changes in _against(build, cause):
            try:
                cost = _work(build, config.replaced(changes)) / _work(build, config)
            except ConfigError:  # a search radius below the patch, a cell that the spacing forbids
                continue
            text = " and ".join(f"`{name}` {_text(name, value)}" for name, value in changes.items())
            found.setdefault(f"{text} (against {cause}) at {cost:.2g} times the work", cost)
    cheapest = sorted(found, key=lambda text: found[text])[:most]
    return f"these may help (effects not computed): {'; '.join(cheapest)}" if cheapest else ""


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
    points, sun, cell_m = config.points, config.sun, build.recipe.gsd_m
    if cause in ("dark", "featureless") and config.model.albedo_file is None:
        yield {"model.albedo": MOON_MAP}
    if cause in ("featureless", "few", "ambiguous") and len(build.levels) == 1:
        dem = native_dem(build.recipe.dems, build.recipe.region)
        if resolves(dem, 0.5 * cell_m):
            yield {"area.gsd_m": 0.5 * cell_m}
    if cause == "ambiguous" and points.search_m is not None:
        yield {"points.search_m": 0.5 * points.search_m}
    if cause == "few" and points.spacing_m is not None:
        yield {"points.spacing_m": 0.5 * points.spacing_m}
    if cause == "dependent":
        yield {"points.max_dependence": min(1.0, 2.0 * points.max_dependence)}
    if cause == "dark":
        yield {"points.min_lit_share": 0.5 * points.min_lit_share}
    if cause == "marginal":
        middles = np.add(
            sun.azimuths_deg, np.diff([*sun.azimuths_deg, sun.azimuths_deg[0] + 360.0]) / 2.0
        )
        yield {"sun.azimuths_deg": tuple(sorted({*sun.azimuths_deg, *(middles % 360.0).tolist()}))}
    if cause == "size" and points.max_points is not None:
        yield {"points.max_points": 2 * points.max_points}


def _work(build: Build, config: BuildConfig) -> float:
    """Nodes times conditions of all areas under another configuration."""
    ratio = (build.recipe.gsd_m / (config.area.gsd_m or build.recipe.gsd_m)) ** 2
    counts = (job.nodes * conditions_at(job.task.lat_deg, config).count for job in build.jobs)
    return ratio * float(sum(counts)) or 1.0
