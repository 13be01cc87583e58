"""The table of all approximations: what each alternative to a configuration costs and changes."""

# ruff: noqa: E501 - sentences of the report
from __future__ import annotations

import math
from collections.abc import Callable

from ..approximations import APPROXIMATIONS
from ..plots.numbers import number
from .charts import Row, changed_share, number_or_dash, share_text, times
from .confirmation import PAIRS
from .knob_rows import NEAR_CELLS, UNSEEN_CHANGE
from .measurement import Trade
from .proposal import LEAST_USABLE, OTHER_GROUND, is_clear, other_ground

BEST = "best.toml"
"""File of the configuration to take for a budget."""

KNOBS_HEADING = "Every approximation"

KNOBS_EXPLAINED = (
    f"Each row changes one setting of your configuration and is computed on the same areas. Candidates within {NEAR_CELLS:g} cells of each other count as one place.",
    "time: processor time of all areas of the build, estimated from those measured, over that of your configuration (median of its runs); in brackets with the range "
    f"of these runs in both times, or, where a budget may take the alternative, that of up to {PAIRS} more pairs of runs. Brackets that include 1: no difference.",
    "conditions changed: of the Suns and views of places in both (and of the image scales, where these change), the share that is usable in one only; in brackets the 90 % interval: "
    f"from the scatter over the areas, and at least up to the share with what areas like none measured add, as many as may be unseen, if they change {100 * UNSEEN_CHANGE:g} % of their conditions. Between the Suns and views of a coarser grid claims are interpolated, without the margins of a query. A view or scale without a claim is not usable, and has no change of probability.",
    "points: chosen by spacing, in the measured areas alone; a change of the promise is known only where all areas are computed.",
    "worth of points: the sum of the usable shares of their conditions, over that of your configuration; in brackets the 90 % interval, from the scatter over the areas, "
    f"widened for changes that the measured areas happen not to show. Below {LEAST_USABLE:g} an alternative is not taken for a budget. A dash: not known; areas of another size have other borders, and "
    "two passes with a promise depend on the whole region, so that only all areas tell it.",
    "shift, wrong shadow: of images under the two lowest elevations of the Sun, seen from the view nearest to straight down; shift is the median over windows.",
    "Not taken for a budget, since their catalogue is not the one asked for: "
    + "; ".join(one.name for one in APPROXIMATIONS if one.switch and one.fineness is None)
    + ".",
)


def _time(row: Row) -> str:
    low, high = row["seconds_interval"] or (math.nan, math.nan)
    one = row.get("pairs") == 1
    around = "" if math.isnan(low) or one else f" ({times(low)}..{times(high)})"
    return times(row["seconds_relative"]) + (" (one pair of runs)" if one else around)


def _worth(row: Row) -> str:
    """What points are worth beside those of the configuration, and its interval."""
    around = None if row.get("default") else row["usable_interval"]
    between = f" ({around[0]:.2f} to {around[1]:.2f})" if around else ""
    return "–" if row["usable_ratio"] is None else f"{row['usable_ratio']:.2f}{between}"


def _value(row: Row) -> str:
    told = f" ({row['configured']})" if row["configured"] else ""
    short = f", on {row['areas']} of {row['areas_of']} areas"
    return f"{row['value']}{told}{short * (row['areas'] < row['areas_of'])}"


def _probabilities(row: Row) -> str:
    mean, greatest = row["detection_change_mean"], row["detection_change_max"]
    return f"{number_or_dash(mean)} ({number_or_dash(greatest)})"


KNOB_COLUMNS: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("approximation", lambda r: r["knob"] or "your configuration"),
    ("value (yours)", _value),
    ("time, relative", _time),
    ("conditions changed", changed_share),
    (
        "points (lost, gained)",
        lambda r: f"{r['points']} ({r['points_lost']}, {r['points_gained']})",
    ),
    ("worth of points", _worth),
    ("change of probability (greatest)", _probabilities),
    ("whole build, s", lambda r: number(r["build_seconds"], 3)),
    ("memory, MB", lambda r: f"{r['memory_mb']:.0f}"),
    ("file, MB", lambda r: f"{1e-6 * r['bytes']:.2f}"),
    ("sigma, times", lambda r: number_or_dash(r["sigma_ratio"], 3)),
    ("shift, cells", lambda r: number_or_dash(r["shift_cells"] and round(r["shift_cells"], 9))),
    ("wrong shadow", lambda r: share_text(r["sunlit_error_share"])),
    ("promise", lambda r: number_or_dash(r["promise_change"])),
)


def knob_cells(rows: list[Row]) -> tuple[list[str], list[list[str]]]:
    """Names of the columns and cells of all rows, without columns of which nothing is known."""
    cells = [(name, [text(row) for row in rows]) for name, text in KNOB_COLUMNS]
    known = [(name, texts) for name, texts in cells if set(texts) != {"–"}]
    return [name for name, _ in known], [
        list(row) for row in zip(*(t for _, t in known), strict=True)
    ]


def knobs_said(trade: Trade) -> list[str]:
    """What was measured, and what to take for the budget, in sentences."""
    left = len(trade.not_measured.keys() - {one.name for one in APPROXIMATIONS})
    said = f"{len(trade.rows) - 1} alternative{'s' * (len(trade.rows) != 2)} measured{f', {left} not measured (listed below)' * bool(left)}."
    return [said, *best_said(trade)]


def best_said(trade: Trade) -> list[str]:
    """Sentences on the configuration to take for a budget: what it is, what holds for its scene and what for other ground."""
    best, asked = trade.best_row, trade.budget
    if best is None:
        return []
    said = []
    if asked.seconds and best["build_seconds"] > asked.seconds:
        said += [f"The budget of {number(asked.seconds, 3)} s is not reached by what was measured."]
        if asked.seconds <= best["build_start_seconds"]:
            said[0] += (
                f" Without its areas a build takes {number(best['build_start_seconds'], 2)} s."
            )
    if trade.untried:
        said += [
            f"{trade.untried} alternative{'s' * (trade.untried != 1)} that this answer could take "
            f"{'were' if trade.untried != 1 else 'was'} not measured, for want of time (a greater time limit)."
        ]
    if best["unconfirmed"]:
        said += [
            f"Not taken, since up to {PAIRS} more runs, each beside one of your configuration, did not all save time, or there was no time for "
            f"one: {'; '.join(best['unconfirmed'])}."
        ]
    if not best["value"]:
        why = (
            ""
            if asked.error is None
            else f"nothing measured saves time for certain, changes at most {share_text(asked.error)} and keeps what the points are worth; "
        )
        return [*said, f"To take ({BEST}): your configuration as it is, {why}{_build_time(best)}."]
    said += [f"To take ({BEST}): {best['value']}."]
    lost, gained = best["points_lost"], best["points_gained"]
    measured, places = f"measured together on {best['areas']} area{'s' * (best['areas'] != 1)}", ""
    if best["areas"]:
        places = (
            f" (of places in both); of {best['points'] - gained + lost} points {lost} {'is' if lost == 1 else 'are'} lost, {gained} gained, "
            f"in all worth {_worth(best)} of them (by the usable share of their conditions)"
        )
    elif "; " not in best["value"]:
        measured = "as its row says"
    else:
        measured = "not measured together, for want of time (a greater time limit), but by product and sum of the rows"
    said += [
        f"On this scene, {measured}: {_build_time(best)} "
        f"({times(best['seconds_relative'])} of the time of your configuration's areas), {changed_share(best)} of the conditions changed{places}."
    ]
    none = "No condition changes on these areas, so that no more were measured: the interval ends with what others may change."
    ended = is_clear(best) and not best["conditions_changed_share"]
    said += [none] * (ended and best["areas"] > 0 and max(best["interval"] or [0.0]) > 0.0)
    few = f"Whether its points are worth {LEAST_USABLE:g} so few do not tell: measure more areas."
    return said + [few] * (best["areas"] > 0 and not is_clear(best)) + _elsewhere(best)


def _build_time(row: Row) -> str:
    around = row["build_interval"]
    between = f" ({number(around[0], 3)} to {number(around[1], 3)})" if around else ""
    return (
        f"{number(row['build_seconds'], 3)} s{between} of processor time for the whole build in {row['build_jobs']} job{'s' * (row['build_jobs'] != 1)}, "
        f"with its start ({number(row['build_start_seconds'], 2)} s), without cures that are tried for a promise"
    )


def _elsewhere(row: Row) -> list[str]:
    """What holds beyond the areas that were measured."""
    near, far = row["elsewhere"], other_ground(row)
    said = []
    if near:
        said += [
            f"On as many other areas of such ground with these Suns {share_text(near[0])} to {share_text(near[1])} of the conditions change (90 % interval)."
        ]
    limit = (
        f"On other ground up to {OTHER_GROUND:g} times as much changed where it was compared ({share_text(far[1])}): measure there."
        if far
        else "How many change on other ground this does not say: measure there."
    )
    return [
        *said,
        f"{limit} The share of the areas' time may be another there, too; the start comes on top.",
    ]


def knobs_markdown(trade: Trade) -> list[str]:
    """Lines of the table of all approximations; none if they were not measured."""
    if not trade.rows:
        return []
    said, explained = (
        [f"- {one}" for one in some] for some in (knobs_said(trade), KNOBS_EXPLAINED)
    )
    lines = [f"## {KNOBS_HEADING}", "", *said, ""]
    names, rows = knob_cells(trade.rows)
    lines += [f"| {' | '.join(names)} |", "| --- | --- |" + " ---: |" * (len(names) - 2)]
    lines += [f"| {' | '.join(cells)} |" for cells in rows]
    left = [f"- {name}: {why}" for name, why in trade.not_measured.items()]
    below = [*explained, ""] if trade.rows[1:] else []
    return [*lines, "", *below, "Not measured:", "", *left, ""]
