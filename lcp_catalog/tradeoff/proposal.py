"""The configuration to take for a budget of time or of error, from the rows of a trade."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import Any

from ..errors import ConfigError
from .knobs import Row, Setting

SAVING = 0.03
"""Least share of the time that an alternative must save to be taken: less is noise."""

LEAST_USABLE = 0.95
"""Least number of points, each weighted by the usable share of its conditions, over that of the configuration, for an
alternative to be taken: other points are no loss where they are worth as much."""

OTHER_GROUND, LEAST_SHARE = 3.0, 0.005
"""How many times as many conditions as on one ground an alternative that leaves more out was found to change on another, at most
(0 to 2.9 times in 31 comparisons with the sample on six regions, three of them used for nothing else;
docs/measurements/tiers-on-a-scene.md, 35b57c98, 2026-11-28); and the share below which that says nothing: nearer far terrain
changed 0.02 % of them at one place near a pole and 2.2 % at another."""


def other_ground(row: Row) -> list[float] | None:
    """Shares of the conditions between which a configuration for a budget changes on other ground (`OTHER_GROUND`). None, as
    that is not known, where it changes few here (`LEAST_SHARE`), leaves less out than the user's, or may change more on other
    areas of this ground.
    """
    share, near = row["conditions_changed_share"] or 0.0, row["elsewhere"] or [0.0, 0.0]
    most = min(1.0, OTHER_GROUND * share)
    return None if share < LEAST_SHARE or row["finer"] or near[1] > most else [0.0, most]


def keeps_enough(row: Row) -> bool:
    """True if the points of an alternative are known to be worth nearly as much as those of the configuration
    (`LEAST_USABLE`).
    """
    ratio = row["usable_ratio"]
    return ratio is not None and float(ratio) >= LEAST_USABLE


def is_clear(row: Row) -> bool:
    """True if the interval of what the points of an alternative are worth is on one side of `LEAST_USABLE`."""
    around = row["usable_interval"]
    return around is None or not around[0] < LEAST_USABLE < around[1]


def saves(row: Row, noise: float) -> bool:
    """True if an alternative takes less time than the configuration: in every pair of runs, where it was measured again for that
    (``pairs``; 0: there was no time), or else by more than the noise of single runs.
    """
    pairs = row.get("pairs")
    if pairs is None:
        return bool(row["seconds_relative"] < 1.0 - noise)
    return pairs > 0 and bool(row["seconds_interval"][1] < 1.0 - SAVING)


def relative(rows: Sequence[Row], baseline_s: Sequence[float]) -> None:
    """Set the times of rows as shares of the configuration's, the first of them, for all areas of a build: its processor time is
    the median of runs between those of the others, each of as many areas; their range gives the interval, in which what was
    run once scatters as much (`scattered`).
    """
    usual, usual_s = rows[0], statistics.median(baseline_s)
    factor, around_s = usual_s / usual["seconds"], usual["build_interval"]
    start_s = usual["build_start_seconds"]
    areas_s = (usual["build_seconds"] - start_s) * factor
    usual |= {
        "seconds": usual_s,
        "build_seconds": areas_s + start_s,
        "build_interval": around_s and [(one - start_s) * factor + start_s for one in around_s],
    }
    scatter = scatter_of(baseline_s)
    for row in rows:
        row["build_interval"] = scattered(row["build_interval"], scatter)
        row["seconds_relative"] = (row["build_seconds"] - row["build_start_seconds"]) / areas_s
        own = [1.0, 1.0] if row is usual else scatter
        row["seconds_interval"] = [
            row["seconds_relative"] * usual_s / one * run
            for one, run in zip((max(baseline_s), min(baseline_s)), own, strict=True)
        ]


def scatter_of(baseline_s: Sequence[float]) -> list[float]:
    """The shortest and the longest of runs of the configuration, over their median."""
    return [most(baseline_s) / statistics.median(baseline_s) for most in (min, max)]


def scattered(around: Sequence[float] | None, scatter: Sequence[float]) -> list[float] | None:
    """The interval of a build's time, whose start and areas were run once each, with the `scatter_of` runs of one configuration:
    the machine's speed changes both alike.
    """
    return [one * times for one, times in zip(around, scatter, strict=True)] if around else None


def proposal(
    rows: Sequence[tuple[Setting, Row]], usual: Row, budget_s: float | None, error: float | None
) -> list[Setting]:
    """The settings to take together, at most one of an approximation: those that save most time for their error until the
    build takes ``budget_s`` of processor time, or as long as their errors are within ``error``; where it takes less, finer
    ones as long as it does, those first that change most for their time. Times multiply and errors add. A difference
    below that of runs of the configuration itself is none (`saves`).
    """
    noise = max(SAVING, usual["seconds_interval"][1] - usual["seconds_interval"][0])
    some = [
        (setting, row["seconds_relative"], row["conditions_changed_share"])
        for setting, row in rows
        if setting.turned and row["conditions_changed_share"] is not None and keeps_enough(row)
    ]
    start_s = usual["build_start_seconds"]
    areas_s = usual["build_seconds"] - start_s
    factor = max(0.0, budget_s - start_s) / areas_s if budget_s else 0.0
    if factor >= 1.0:
        return _finer_ones(some, factor, noise)
    taken: dict[str, Setting] = {}
    time_, wrong = 1.0, 0.0
    saving = [setting for setting, row in rows if saves(row, noise)]
    some = [one for one in some if one[0] in saving]
    some.sort(key=lambda one: (one[2] + 1e-9) / abs(math.log(one[1])))
    for setting, relative, share in some:
        if setting.knob in taken:
            continue
        if error is not None and wrong + share > error:
            continue
        if budget_s and time_ <= factor:
            break
        taken[setting.knob] = setting
        time_, wrong = time_ * relative, wrong + share
    return list(taken.values())


def _finer_ones(
    some: list[tuple[Setting, float, float]], factor: float, noise: float
) -> list[Setting]:
    """The finer settings within ``factor`` times the time, the last taken worth least."""
    taken: dict[str, Setting] = {}
    time_ = 1.0
    some = [(s, max(1.0, t), e) for s, t, e in some if s.finer and e > 0.0]
    some.sort(key=lambda one: -one[2] / (max(0.0, one[1] - 1.0) + noise))
    for setting, relative, _ in some:
        if setting.knob not in taken and time_ * relative <= factor:
            taken[setting.knob] = setting
            time_ *= relative
    return list(taken.values())


def together_row(usual: Row, rows: Sequence[Row]) -> Row:
    """What rows say together without a measurement: times, bytes and what is usable multiply; errors and other points add, up
    to all; of changes of the probability the greatest. No areas.
    """
    time_ = math.prod(row["seconds_relative"] for row in rows)
    wrong = sum(row["conditions_changed_share"] for row in rows)
    told = {"knob": "together", "value": "; ".join(f"{r['knob']}: {r['value']}" for r in rows)}
    start_s = max(row["build_start_seconds"] for row in rows or [usual])
    build_s = (usual["build_seconds"] - usual["build_start_seconds"]) * time_ + start_s
    times_ = {
        "seconds": usual["seconds"] * time_,
        "seconds_relative": time_,
        "build_seconds": build_s,
        "build_start_seconds": start_s,
    }
    own, rows = usual["points"], rows or [usual]
    lost, gained = (
        min(own, sum(row[name] for row in rows)) for name in ("points_lost", "points_gained")
    )
    changes_ = [
        row["detection_change_max"] for row in rows if row["detection_change_max"] is not None
    ]
    estimates = {
        "points": own - lost + gained,
        "points_lost": lost,
        "points_gained": gained,
        "matched_share": min(row["matched_share"] for row in rows),
        "usable_ratio": math.prod(row["usable_ratio"] for row in rows),
        "usable_interval": None,
        "detection_change_mean": None,
        "detection_change_max": max(changes_, default=None),
        "sigma_ratio": None,
        "bytes": round(usual["bytes"] * math.prod(row["bytes"] / usual["bytes"] for row in rows)),
        "memory_mb": max(row["memory_mb"] for row in rows),
    }
    return usual | told | times_ | estimates | {
        "default": False, "conditions_changed_share": wrong, "interval": None, "elsewhere": None,
        "build_interval": None, "areas": 0,
    }  # fmt: skip


def together(chosen: Sequence[Setting]) -> Setting:
    """Several settings as one."""
    values: dict[str, Any] = {}
    for one in chosen:
        values |= one.values
    return Setting("together", "; ".join(f"{one.knob}: {one.value}" for one in chosen), values)


def require_one(budget_s: float | None, error: float | None, limit_s: float = math.inf) -> None:
    """ConfigError for a budget of both time and error, for one that is not positive, or without time for alternatives."""
    if not limit_s >= 0.0:
        raise ConfigError("a time limit must be at least 0")
    if limit_s == 0.0 and (budget_s is not None or error is not None):
        raise ConfigError(
            "a budget or a greatest error needs a time limit above 0, within which alternatives are measured"
        )
    if budget_s is not None and error is not None:
        raise ConfigError("give a budget of time or a greatest error, not both")
    if (budget_s is not None and not budget_s > 0.0) or (
        error is not None and not 0.0 <= error <= 1.0
    ):
        raise ConfigError("a budget must be positive, an error a share from 0 to 1")
