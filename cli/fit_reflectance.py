"""``lcp fit-reflectance``: fit a reflectance model to goniometer measurements."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .files import FileCommand, InputFile
from .messages import echo, say
from .options import json_option, other_output_option, output_option, overwrite_option
from .progress import progress
from .value_types import Finite, Number

if TYPE_CHECKING:
    from lcp_catalog.photometry.facet_fit import Fit, Measurements

HEADING = "incidence   w_B  shift_B  sigma_B   w_D  shift_D  sigma_D  points  error %  (alone)"


@click.command(
    "fit-reflectance",
    cls=FileCommand,
    rule=True,
    example="lcp fit-reflectance paint.csv -o paint.toml --chart paint.svg",
)
@click.argument("goniometer", metavar="GONIOMETER.csv", type=InputFile())
@output_option("MODEL.toml")
@click.option(
    "--c",
    "weight",
    type=Number(0.0, 1e6),
    default=2.0,
    metavar="C",
    help="Weight of smooth curves over the incidence, relative to small errors; 0 fits every "
    "incidence alone.",
)
@click.option(
    "--albedo",
    type=Number(1e-6, 1.0),
    default=None,
    metavar="A",
    help="Directional-hemispherical reflectance of the surface, the same at every incidence; only for "
    "relative measurements. Default: 0.12.",
)
@click.option(
    "--refractive-index",
    nargs=2,
    type=Number(0.0),
    default=(1.5, 0.0),
    metavar="N K",
    help="Complex refractive index N + iK of a facet.",
)
@click.option(
    "--polarisation",
    nargs=2,
    type=Finite(),
    default=(0.0, 0.0),
    metavar="D XI",
    help="Polarisation of the light: degree 0..1, and angle between the electric vector and the plane "
    "of incidence, degrees.",
)
@click.option(
    "--normalize",
    type=click.Choice(["specular", "none"]),
    default="specular",
    help="Divide the intensities of each incidence by that of the specular direction, or use them "
    "unchanged.",
)
@click.option(
    "--name", metavar="TEXT", help="Name of the model. Default: the file name of MODEL.toml."
)
@other_output_option(
    "--chart",
    "CHART.svg",
    "Also write polar charts of measurements and model, one for each incidence.",
)
@json_option()
@overwrite_option
def command(
    goniometer: str,
    output: str,
    weight: float,
    albedo: float | None,
    refractive_index: tuple[float, float],
    polarisation: tuple[float, float],
    normalize: str,
    name: str | None,
    chart: str | None,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Fit the two-component facet model to goniophotometer measurements of a surface.

    GONIOMETER.csv has the columns incidence_deg, emission_deg (signed: positive on the side of the
    source, the specular direction is at -incidence), optionally azimuth_deg, and one of intensity,
    brightness, radiance_factor. Use the fitted model with `--reflectance facet:MODEL.toml`.
    """
    from lcp_catalog.atomic_files import write_files
    from lcp_catalog.photometry.facet_fit import (
        fit_chart,
        fit_reflectance,
        fit_table,
        read_measurements,
    )
    from lcp_catalog.photometry.facet_model import ALBEDO, FacetFile, Optics

    (index, extinction), (degree, angle_deg) = refractive_index, polarisation
    optics = Optics(index, extinction, degree, angle_deg)
    measurements = read_measurements(goniometer)
    if measurements.absolute and albedo is not None:
        raise click.UsageError(
            "--albedo: not with a radiance_factor column, which gives the brightness of the surface"
        )
    with progress("fit") as update:
        fit = fit_reflectance(
            measurements,
            weight=weight,
            albedo=ALBEDO if albedo is None else albedo,
            optics=optics,
            normalize=normalize == "specular",
            name=name or Path(output).stem,
            progress=update,
        )
    texts = {output: FacetFile(fit.model, fit_table(fit, measurements)).to_toml()}
    if chart is not None:
        texts[chart] = fit_chart(fit, measurements)
    write_files({path: text.encode("utf-8") for path, text in texts.items()}, overwrite)
    document = _document(fit, measurements) if as_json else None
    echo(_text(fit, measurements) if document is None else json.dumps(document, indent=2))
    say(f"{output}: use it with --reflectance facet:{output}")


def _text(fit: Fit, measurements: Measurements) -> str:
    rows = [
        f"{node.incidence_deg:9g} {node.w_b:5.3f} {node.shift_b_deg:8.2f} {node.sigma_b:8.4f} {node.w_d:5.3f} "
        f"{node.shift_d_deg:8.2f} {node.sigma_d:8.4f} {len(sample):7d} {100 * after:8.2f}  ({100 * before:.2f})"
        for node, sample, after, before in zip(
            fit.model.nodes, measurements.samples, fit.errors, fit.errors_alone, strict=True
        )
    ]
    total = f"D1 {fit.d1:+.3f}, D2 {fit.d2:+.3f}, D1 + {fit.weight:g} D2 = {fit.d:+.3f}"
    return "\n".join([HEADING, *rows, total])


def _document(fit: Fit, measurements: Measurements) -> dict[str, Any]:
    from lcp_catalog.photometry.facet_fit import fit_table
    from lcp_catalog.photometry.facet_model import nodes_table

    reflectance = fit.model.reflectance([node.incidence_deg for node in fit.model.nodes])
    return {
        "name": fit.model.name,
        "nodes": nodes_table(fit.model.nodes),
        "directional_reflectance": reflectance.tolist(),
        **fit_table(fit, measurements),
    }
