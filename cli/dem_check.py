"""``lcp dem check``: check DEM files against their labels."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from .files import FileCommand, require_inputs
from .messages import EXIT_NO, echo
from .options import dem_argument, json_option

if TYPE_CHECKING:
    from lcp_catalog.dem.file_check import CheckResult


@click.command("check", cls=FileCommand, example="lcp dem check LDEM_*.LBL")
@dem_argument
@json_option("Print one JSON list, one object for each file.")
def command(dem: tuple[str, ...], as_json: bool) -> int:
    """Check that DEM files are complete and agree with their labels.

    Every pixel is read once. All files are checked, also after a faulty one; the exit code is 4 if
    any is faulty.
    """
    from lcp_catalog.dem.file_check import check_dem  # rasterio: only when the command runs

    require_inputs(click.get_current_context())
    verdicts = []
    for path in dem:
        verdicts.append(check_dem(path))
        if not as_json:
            echo(_text(verdicts[-1]))
    if as_json:
        echo(json.dumps([asdict(one) | {"sound": one.sound} for one in verdicts], indent=2))
    return 0 if all(one.sound for one in verdicts) else EXIT_NO


def _text(one: CheckResult) -> str:
    verdict = "NOT SOUND" if not one.sound else "DOUBTFUL" if one.warnings else "sound"
    lines = [f"{one.path}: {verdict}{f', {one.product}' if one.product else ''}"]
    lines += [f"  {problem}" for problem in one.problems]
    lines += [f"  warning: {warning}" for warning in one.warnings]
    lines += [f"  note: {note}" for note in one.notes]
    return "\n".join(lines)
