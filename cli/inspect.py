"""``lcp inspect``: contents and integrity of a catalogue."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from lcp_catalog.choices import FLIGHT

from .files import FileCommand, require_inputs
from .messages import EXIT_NO, echo
from .options import catalog_argument, json_option

if TYPE_CHECKING:
    from lcp_catalog.catalog.promise import LocatedBySun


@click.command(cls=FileCommand, example="lcp inspect site.h5")
@catalog_argument
@json_option()
@click.option(
    "--located",
    "frames",
    metavar="N",
    type=click.IntRange(min=1),
    help="Also state how probably a frame of the promised footprint is located at single moments, of N frames for each row of "
    "Suns: by points, and with the ground as a whole.",
)
def command(catalog: str, as_json: bool, frames: int | None) -> int:
    """Show the contents of a catalogue, or of a flight file (.lcpf), and check its integrity.

    Reads every dataset and checks its checksum, shape and values. The exit code is 4 if there is a
    problem. The usable share is that of all evaluated conditions.
    """
    require_inputs(click.get_current_context())
    found = _described(catalog)
    moments: Sequence[LocatedBySun] = ()
    if frames is not None and found["intact"]:
        moments = _moments(catalog, found, frames)
        found["located_at_moments"] = [vars(row) for row in moments]
    echo(
        json.dumps(found, indent=2, allow_nan=False) if as_json else _text(catalog, found, moments)
    )
    return 0 if found["intact"] else EXIT_NO


def _described(path: str) -> dict[str, Any]:
    if path.lower().endswith(FLIGHT):
        from lcp_catalog.exports.flight import describe_flight  # takes a second and 100 MB

        return describe_flight(path)
    from lcp_catalog.catalog.summary import describe

    return describe(path)


def _moments(path: str, found: dict[str, Any], frames: int) -> list[LocatedBySun]:
    """How probably frames of the footprint are located."""
    if path.lower().endswith(FLIGHT) or not found.get("promise"):
        raise click.UsageError(f"--located: {path} states no promise of a footprint")
    from lcp_catalog.catalog.verification import open_catalog
    from lcp_catalog.navigation.located_by_sun import located_by_sun

    return located_by_sun(open_catalog(path), frames)


def _text(path: str, found: dict[str, Any], moments: Sequence[LocatedBySun]) -> str:
    from lcp_catalog.catalog.summary import headline

    lines = [f"{path}: {headline(found)}"]
    lines += [f"  {problem}" for problem in found["problems"] if problem not in lines[0]]
    if any("a TIFF image" in problem for problem in found["problems"]):
        lines.append(f"  of a DEM: lcp dem info {path}")
    if found["points"] is not None and path.lower().endswith(FLIGHT):
        from lcp_catalog.exports.flight import flight_rows

        lines += [f"{name:14} {text}" for name, text in flight_rows(found)]
    elif found["points"] is not None:
        from lcp_catalog.catalog.summary import summary_rows

        lines[0] += f", schema {found['schema_version']}, made by {found['software']}"
        rows = summary_rows(found) + [row.row for row in moments]
        lines += [f"{name:14} {text}" for name, text in rows]
        files = found["sources"] + (found["albedo"]["files"] if found["albedo"] else [])
        lines += [f"{'source':14} {s['name']}, {s['size']} bytes" for s in files]
    return "\n".join(lines)
