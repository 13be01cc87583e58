"""``lcp diff``: which points of two catalogues differ, and by how much."""

from __future__ import annotations

import json
from itertools import islice
from typing import TYPE_CHECKING, Any

import click

from . import options
from .files import CATALOG, FileCommand
from .messages import EXIT_NO, echo, say

if TYPE_CHECKING:
    from lcp_catalog.catalog.comparison import Comparison

_SHOWN = 10
_VALUE_LENGTH = 60


@click.command(cls=FileCommand, rule=True, example="lcp diff old.h5 new.h5 -o differences.csv")
@click.argument("first", metavar="A.h5", type=CATALOG)
@click.argument("second", metavar="B.h5", type=CATALOG)
@options.json_option()
@options.output_option(
    "OUT.csv", required=False, text="Also write all points that differ as a table."
)
@options.overwrite_option
def command(first: str, second: str, as_json: bool, output: str | None, overwrite: bool) -> int:
    """Compare two catalogues: points of B that came, went, moved or changed since A.

    Points with the same id are compared in every variable. A point without partner has moved if the nearest
    one without partner of the same level lies within the spacing. The exit code is 4 if anything differs; the
    version of the software and the order of the points do not count.
    """
    from lcp_catalog.catalog.comparison import compare

    found = compare(first, second)
    if output is not None:
        found.write_table(output, overwrite)
        say(f"{output}: written")
    if as_json:
        for piece in found.json_pieces():
            echo(piece, nl=False)
        echo("")
    else:
        echo("\n".join(_text(first, second, found)))
    return EXIT_NO if found.differs else 0


def _text(first: str, second: str, found: Comparison) -> list[str]:
    """The summary, and the largest differences of points."""
    if not found.differs:
        return [f"{first} and {second}: no difference, {found.points[0]} points"]
    summary, counts = found.summary(), found.counts()
    lines = [f"{first}: {counts['first']} points; {second}: {counts['second']} points"]
    for fact in summary["attributes"]:
        lines.append(f"{fact['name']}: {_short(fact['first'])} -> {_short(fact['second'])}")
    lines += [f"{fact['name']}: {fact['difference']}" for fact in summary["maps"]]
    if found.not_compared:
        lines.append(f"not compared: {', '.join(found.not_compared)}")
    kinds = ("matched", "came", "went", "moved", "changed")
    lines.append("points: " + ", ".join(f"{counts[kind]} {kind}" for kind in kinds))
    lines += [_variable(one) for one in summary["variables"]]
    if counts["moved"]:
        lines.append(_heading("moved", counts["moved"], "farthest"))
        lines += [
            f"  {one['former_id']} -> {one['point_id']}  {one['distance_m']:.4g} m"
            for one in islice(found.moves(), _SHOWN)
        ]
    if counts["changed"]:
        lines.append(_heading("changed", counts["changed"], "most"))
        units = {one["variable"]: one["unit"] for one in summary["variables"]}
        lines += [_changed(one, units) for one in islice(found.changes(), _SHOWN)]
    return lines


def _heading(kind: str, count: int, which: str) -> str:
    return f"{kind}:" if count <= _SHOWN else f"{kind} {which}, {_SHOWN} of {count}:"


def _variable(one: dict[str, Any]) -> str:
    text = f"  {one['variable']}: {one['points']} points"
    if one["largest"]:
        text += f", at most {_amount(one['largest'], one['unit'])} (point {one['point_id']})"
    return text + (f", {one['known_in_one']} in one only" if one["known_in_one"] else "")


def _changed(one: dict[str, Any], units: dict[str, str]) -> str:
    """A point with its differences, the flags and the heights of the patch first."""
    own = one["differences"]
    names = sorted(own, key=lambda name: (name not in ("condition", "dem"), name))
    parts = [f"{name} {_amount(own[name], units[name])}" for name in names[:4]]
    rest = f", and {len(names) - 4} more" if len(names) > 4 else ""
    return f"  {one['point_id']}  {', '.join(parts)}{rest}"


def _amount(value: float | None, unit: str) -> str:
    return "in one only" if value is None else f"{value:.4g} {unit}".rstrip()


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _VALUE_LENGTH else f"{text[: _VALUE_LENGTH - 3]}..."
