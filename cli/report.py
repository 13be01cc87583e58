"""``lcp report``: a catalogue, or the dossier for those who decide about it, as one HTML page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from . import options
from .files import FileCommand, InputFile
from .groups import collected
from .messages import EXIT_NO, say
from .query import FrameOptions, frame_options, known_options, query_choice

if TYPE_CHECKING:
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.navigation.expected_position import Query


@click.command(cls=FileCommand, rule=True, example="lcp report site.h5 -o site.html")
@options.catalog_argument
@options.output_option("REPORT.html")
@click.option(
    "--dossier",
    is_flag=True,
    help="Write the error budget of points and positions, the verdict of --require and the evidence instead.",
)
@frame_options
@options.sun_angle_options
@collected("query", query_choice, known_options)
@click.option(
    "--require",
    metavar="EXPR",
    help='With --dossier: conditions on every frame and every image of the evidence, like "position_sigma_m<50 and '
    'found_of_usable>=0.95". Exit code 4 if one is not met.',
)
@click.option(
    "--evidence",
    type=InputFile(),
    multiple=True,
    metavar="report.json",
    help="With --dossier: report of lcp validate; may be repeated.",
)
@options.overwrite_option
def command(
    catalog: str,
    output: str,
    dossier: bool,
    overwrite: bool,
    require: str | None,
    evidence: tuple[str, ...],
    frames: FrameOptions,
    sun: SunChoice,
    query: Query,
) -> int:
    """Write a catalogue report: map of the points, the points under a chosen Sun, their patches.

    The report is one HTML file without external references: it can be read offline. With --dossier: the page
    for those who decide whether the catalogue is good enough.
    """
    if not dossier:
        _refuse_dossier_options()
        from lcp_catalog.navigation.catalogue_page import report

        report(catalog, output, overwrite=overwrite)
        say(f"{output}: written")
        return 0

    from lcp_catalog.validation.dossier import write_dossier

    images = frames.read(sun, catalog)
    verdict = write_dossier(catalog, output, images, query, require, evidence, overwrite)
    for line in verdict.failures if verdict else ():
        say(f"lcp: --require: {line}")
    say(f"{output}: written")
    return EXIT_NO if verdict and verdict.failures else 0


def _refuse_dossier_options() -> None:
    """Usage error for an option that only a dossier uses."""
    context = click.get_current_context()
    for parameter in context.command.params:
        name = parameter.name or ""
        used = context.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT
        if used and name not in ("catalog", "output", "overwrite", "depfile"):
            raise click.UsageError(f"{parameter.opts[0]} needs --dossier")
