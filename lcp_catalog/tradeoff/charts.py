"""Charts of a speed-accuracy measurement: errors over run time, with the Pareto front; and the texts of figures that
charts and tables share.
"""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
from markupsafe import Markup

from ..plots.axes import Axes, Axis
from ..plots.numbers import drawing, number, typeset

Row = dict[str, Any]


def times(ratio: float) -> str:
    return f"{ratio:.2f}" if ratio >= 0.095 else f"{ratio:.3f}"


def share_text(share: float | None) -> str:
    """A share in per cent with two significant digits; 0 only for exactly 0."""
    if share is None:
        return "–"
    return f"{np.format_float_positional(100.0 * share, precision=2, fractional=False, trim='-')} %"


def number_or_dash(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else typeset(number(value, digits))


def changed_share(row: Row) -> str:
    share = share_text(row["conditions_changed_share"])
    around = None if row.get("default") else row["interval"]
    if around is None:
        return share
    return f"{share} ({share_text(around[0]).removesuffix(' %')} to {share_text(around[1])})"


_NO_ERROR = 0.8
"""Decades below the error axis at which tiers without errors are drawn."""


def pareto(rows: list[Row]) -> Markup:
    """Plot of all tiers. A row gives two marks at ``sunlit_error_share``: the whole work
    (``cpu_relative``) and the images alone (``render_relative``). A line joins the Pareto front.
    """
    low, high = _time_limits([r[key] for r in rows for key in ("cpu_relative", "render_relative")])
    decades = _decades([r["sunlit_error_share"] for r in rows if r["sunlit_error_share"] > 0.0])
    axes = Axes(
        Axis(
            low, high, _time_ticks(low, high), "CPU time relative to reference", log=True, grid=True
        ),
        Axis(
            10.0 ** (decades[0] - 1),
            10.0 ** decades[1],
            [
                (_drawn(0.0, decades), "0"),
                *((10.0**k, _percent(k)) for k in range(decades[0], decades[1] + 1)),
            ],
            "share of nodes with a wrong shadow",
            log=True,
            grid=True,
        ),
        width=644.0,
        height=318.0,
        left=92.0,
        right=24.0,
        top=28.0,
        bottom=64.0,
    )
    best = front(rows)
    line = axes.line(
        [r["cpu_relative"] for r in best],
        [_drawn(r["sunlit_error_share"], decades) for r in best],
        "front",
    )
    marks = [
        _marks(axes, row, _drawn(row["sunlit_error_share"], decades), place)
        for row, place in zip(rows, _label_places(rows), strict=True)
    ]
    return axes.draw(
        Markup().join([line, *marks]), "error of every tier over its time", css="pareto"
    )


def front(
    rows: list[Row], time: str = "cpu_relative", error: str = "sunlit_error_share"
) -> list[Row]:
    """The Pareto front, fastest first: rows that no other row equals or beats in both time and
    error.
    """

    def beaten(row: Row) -> bool:
        mine = (row[time], row[error])
        theirs = ((r[time], r[error]) for r in rows if r is not row)
        return any(t <= mine[0] and e <= mine[1] and (t, e) != mine for t, e in theirs)

    return sorted((r for r in rows if not beaten(r)), key=lambda r: float(r[time]))


def _drawn(error: float, decades: tuple[int, int]) -> float:
    """Error at which a mark is drawn; 0, which a logarithmic axis lacks, below the lowest decade."""
    return error if error > 0.0 else 10.0 ** (decades[0] - _NO_ERROR)


def _decades(errors: list[float]) -> tuple[int, int]:
    """Exponents of the powers of ten around the errors, at least two decades."""
    logs = [math.log10(e) for e in errors] or [-3.0]
    low, high = math.floor(min(logs)), math.ceil(max(logs))
    return (low, high) if high - low > 1 else (high - 2, high)


def _time_limits(ratios: list[float]) -> tuple[float, float]:
    """Ticks around the ratios and around 1, the time of reference."""
    low, high = max(min(ratios), 1e-6), max(ratios)
    ticks = _steps(math.floor(math.log10(low)), math.ceil(math.log10(max(high, 1.0))) + 1)
    below = [t for t in ticks if t <= min(low, 0.5) * 0.95]
    above = [t for t in ticks if t >= max(high, 1.0) * 1.05]
    return below[-1] if below else ticks[0], above[0]


def _time_ticks(low: float, high: float) -> list[tuple[float, str]]:
    steps = _steps(math.floor(math.log10(low)), math.ceil(math.log10(high)))
    return [(t, number(t)) for t in steps if low * (1 - 1e-9) <= t <= high * (1 + 1e-9)]


def _steps(first: int, last: int) -> list[float]:
    """1, 2 and 5 times the powers of ten from below 10^first to 10^last."""
    return [step * 10.0**power for power in range(first - 1, last + 1) for step in (1, 2, 5)]


def _label_places(rows: list[Row]) -> list[int]:
    """Number of earlier rows with the same error: their labels are stacked."""
    return [
        sum(1 for r in rows[:i] if r["sunlit_error_share"] == row["sunlit_error_share"])
        for i, row in enumerate(rows)
    ]


def _marks(axes: Axes, row: Row, error: float, place: int) -> Markup:
    """Ring of the images and filled mark of the whole work, joined by a line, with the tier's name."""
    (images, whole), (y, _) = axes.at([row["render_relative"], row["cpu_relative"]], [error, error])
    wrong = f"{100.0 * row['sunlit_error_share']:.3g} % of the nodes wrong"
    circles = [
        (css, x, radius, f"{row['accuracy']}, {what}: {row[key]:.3g} of reference, {wrong}")
        for css, x, radius, what, key in (
            ("images", images, 5, "images alone", "render_relative"),
            ("whole", whole, 6, "whole work", "cpu_relative"),
        )
    ]
    return drawing("tier", row["accuracy"], y, 12 + 15 * place, circles)


def _percent(power: int) -> str:
    """10^power as a share in per cent, without an exponent."""
    return f"{100.0 * 10.0**power:.{max(0, -2 - power)}f} %"


def knobs_chart(rows: list[Row], best: Row | None = None) -> Markup:
    """Plot of the changed conditions of every row over its time, with the Pareto front; the first row is the user's
    configuration, ``best`` the one to take, if that is another.
    """
    some = [r for r in rows if r["conditions_changed_share"] is not None]
    if not some:  # areas without candidates
        return Markup()
    taken = [best] if best and best["value"] else []
    low, high = _time_limits([r["seconds_relative"] for r in some + taken])
    decades = _decades([s for r in some + taken if (s := r["conditions_changed_share"] or 0.0)])
    powers = range(decades[0], decades[1] + 1)
    ticks = [(_drawn(0.0, decades), "0"), *((10.0**k, _percent(k)) for k in powers)]
    axes = Axes(
        Axis(low, high, _time_ticks(low, high), "processor time relative to your configuration", log=True, grid=True),
        Axis(10.0 ** (decades[0] - 1), 10.0 ** decades[1], ticks, "share of the conditions changed", log=True, grid=True),
        width=_WIDE_PX, height=_HIGH_PX, left=_LEFT_PX, right=24.0, top=18.0, bottom=64.0,
    )  # fmt: skip

    def place(row: Row) -> tuple[float, float]:
        share = _drawn(row["conditions_changed_share"] or 0.0, decades)
        x, y = axes.at([row["seconds_relative"]], [share])
        return float(x[0]), float(y[0])

    keys = "seconds_relative", "conditions_changed_share"
    unbeaten = front([r for r in some if _differs(r)], keys[0], keys[1])
    x, y = ([r[key] for r in unbeaten] for key in keys)
    line = axes.line(x, [_drawn(share, decades) for share in y], "front")
    named = [r for r in some if not r["knob"]] + taken + [r for r in unbeaten if r["knob"]]
    names = _names([(_name(r), place(r)) for r in named], [place(r) for r in some + taken])
    marks = [_mark(row, place(row)) for row in sorted(some, key=lambda r: not r["knob"]) + taken]
    return axes.draw(
        Markup().join([line, *names, *marks]), "changed conditions over time", css="pareto"
    )


_MARKS = {"": ("own", 7.0, "your configuration"), "together": ("taken", 7.0, "to take")}
"""Class, radius in units of the chart, and name of the marks that are no alternative, by their ``knob``."""


def _mark(row: Row, at: tuple[float, float]) -> Markup:
    css, radius, _ = _MARKS.get(row["knob"], ("whole", _MARK_PX, ""))
    told = f"{_name(row)}: {times(row['seconds_relative'])}, {changed_share(row)}"
    form = "<circle class='{}' cx='{:.1f}' cy='{:.1f}' r='{:g}'><title>{}</title></circle>"
    return Markup(form).format(css, *at, radius, told)


_WIDE_PX, _HIGH_PX, _LEFT_PX = 820.0, 460.0, 92.0
"""Width and height of the chart of all approximations and what is left of its axis, units of the chart."""

_LETTER_PX, _LINE_PX, _MARK_PX = 6.8, 14.0, 4.0
"""Greatest mean width of a letter of a name, its height, and the radius of a mark, in units of the chart."""

_BESIDE_PX = 10.0
"""From the middle of a mark to its name."""

_PLACES_PX = sorted(product(range(0, 401, 20), range(-442, 443, 13)), key=lambda at: math.hypot(*at))  # fmt: skip
"""Ways from a mark, beyond `_BESIDE_PX` to its right or left, where there may be place for its name, the nearest first."""

_NAME = (
    "<g class='tier'><path class='tie' d='M{0:.1f} {1:.1f}L{2:.1f} {3:.1f}'/>"
    "<text x='{2:.1f}' y='{4:.1f}' text-anchor='{5}'>{6}</text></g>"
)


def _names(
    named: list[tuple[str, tuple[float, float]]], marks: list[tuple[float, float]]
) -> list[Markup]:
    """Names of marks, each where it covers no mark and no other name: right or left of its own, as near as possible, with a line
    from the mark. One that has no place at all is left out; pointing at its mark gives it.
    """
    taken = [(x - _MARK_PX, y - _MARK_PX, x + _MARK_PX, y + _MARK_PX) for x, y in marks]
    found = []
    for name, (x, y) in named:
        width = _LETTER_PX * len(name)
        for (right, down), side in ((at, side) for at in _PLACES_PX for side in (1.0, -1.0)):
            near = x + (_BESIDE_PX + right) * side
            far, middle = near + width * side, y + down
            box = (min(near, far), middle - 0.5 * _LINE_PX, max(near, far), middle + 0.5 * _LINE_PX)
            inside = box[0] > 0.0 < box[1] and box[2] < _WIDE_PX and box[3] < _HIGH_PX
            if inside and not any(_overlap(box, other) for other in taken):
                taken.append(box)
                anchor = "start" if side > 0.0 else "end"
                found.append(Markup(_NAME).format(x, y, near, middle, middle + 4.0, anchor, name))
                break
    return found


def _overlap(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """True if two boxes (left, top, right, bottom) share ground."""
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _differs(row: Row) -> bool:
    """False for a row whose time is not told from that of the configuration by its interval."""
    around = row["seconds_interval"]
    return not row["knob"] or around is None or not around[0] <= 1.0 <= around[1]


def _name(row: Row) -> str:
    own = _MARKS.get(row["knob"])
    return own[2] if own else f"{row['knob']}: {row['value']}"
