"""Options that several commands share, as decorators, and checks of their combinations.

A group passes the parsed values to the command as keyword arguments. No file is read here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from lcp_catalog.accuracy import TIERS
from lcp_catalog.choices import ENCODINGS, REFLECTANCE_MODELS

from .files import DEPFILE_HELP, Files, InputFile, OutputFile, raster_files
from .value_types import (
    AZIMUTH,
    CELL_SIZE,
    LATITUDE,
    LAW,
    LONGITUDE,
    POSITIVE,
    Instant,
    Names,
    Number,
)

Command = Callable[..., Any]

REFLECTANCE_HELP = (
    f"Reflectance model of the surface (law): {', '.join(REFLECTANCE_MODELS)}; some take a parameter set, like "
    "hapke:wac-643-mare or minnaert:0.7. Default: auto, chosen by the phase angles of the scene."
)


def option_group(*options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


product_order_option = click.option(
    "--product-order",
    type=Names(),
    metavar="NAME,NAME...",
    help="Order of precedence where DEMs overlap: product names, product families or file names. Default: products made "
    "for the latitude first, then finer pixels, then the order of the arguments.",
)

RASTER = InputFile(raster_files)
"""A DEM, an image or a map."""

dem_argument = click.argument("dem", nargs=-1, required=True, type=RASTER, metavar="DEM...")

dem_argument_or_none = click.argument("dem", nargs=-1, type=RASTER, metavar="[DEM...]")

catalog_argument = click.argument("catalog", metavar="CATALOG.h5", type=InputFile())


def _area_group(area: str, cell: str) -> Callable[[Command], Command]:
    """The options of an area. ``area``, ``cell``: its default, and that of the cell size, in words."""
    return option_group(
        click.option(
            "--center",
            nargs=2,
            type=click.Tuple([LONGITUDE, LATITUDE]),
            metavar="LON LAT",
            help=f"Centre of the area, degrees; needs --size. Default area: {area}.",
        ),
        click.option(
            "--size", "size_km", type=POSITIVE, metavar="KM", help="Side length of the square area."
        ),
        click.option(
            "--bounds",
            nargs=4,
            type=click.Tuple([LONGITUDE, LATITUDE] * 2),
            metavar="W S E N",
            help="Western, southern, eastern and northern limit of the area, degrees; may cross the antimeridian. "
            "Default: as of --center.",
        ),
        click.option(
            "--gsd",
            "gsd_m",
            type=CELL_SIZE,
            metavar="M",
            help=f"Cell size; default: {cell}.",
        ),
    )


area_options = _area_group("what the camera sees, else the whole DEM", "that of the DEM")
"""Area of a render."""

region_options = _area_group(
    "the whole DEM", "about half of what the DEM resolves, at least its own"
)
"""Area of a build."""

sun_angle_options = option_group(
    click.option(
        "--sun-azimuth",
        type=AZIMUTH,
        metavar="DEG",
        help="Azimuth of the Sun at the area's centre, clockwise from north. Default Sun: that of the camera file.",
    ),
    click.option(
        "--sun-elevation",
        type=Number(-90, 90),
        metavar="DEG",
        help="Elevation of the Sun above the horizontal at the area's centre.",
    ),
    click.option(
        "--time",
        "time_utc",
        type=Instant(),
        metavar="UTC",
        help="Time in ISO 8601; the Sun's position is computed for it.",
    ),
    click.option(
        "--subsolar",
        nargs=2,
        type=click.Tuple([LONGITUDE, LATITUDE]),
        metavar="LON LAT",
        help="Subsolar point, degrees: the place where the Sun is at the zenith.",
    ),
)

sun_options = option_group(
    sun_angle_options,
    click.option(
        "--sun",
        "sun_model",
        type=click.Choice(["point", "disc"]),
        default=None,
        help="Model of the Sun: point source or extended disc; default: point in the tiers draft and standard, disc in "
        "high and reference.",
    ),
)

accuracy_options = option_group(
    click.option(
        "--accuracy",
        type=click.Choice(list(TIERS)),
        default=None,
        help="Accuracy tier, by the permitted share of nodes with a wrong shadow: draft 0.5 %, standard 0.02 % (default), "
        "high 0, reference 0 with float64 arithmetic throughout. In high and reference a build also searches for places that "
        "resemble a point at full resolution everywhere.",
    ),
    click.option(
        "--tolerance",
        type=Number(0.0),
        metavar="T",
        default=None,
        help="Permitted share of nodes with a wrong shadow; selects the fastest sufficient tier. Replaces --accuracy. "
        "Default: that of the tier.",
    ),
)

model_options = option_group(
    click.option(
        "--reflectance",
        type=LAW,
        default=None,
        help=REFLECTANCE_HELP,
    ),
    accuracy_options,
)

albedo_options = option_group(
    click.option(
        "--albedo",
        "albedo_path",
        type=RASTER,
        metavar="MAP",
        help="Albedo map: a raster of relative surface brightness in a lunar CRS; default: none, uniform ground. "
        "Radiance is multiplied by the ratio of "
        "its value to --albedo-reference. Three bands are red, green and blue in lcp render.",
    ),
    click.option(
        "--albedo-encoding",
        type=click.Choice(ENCODINGS),
        default=None,
        help="Encoding of MAP: linear (values proportional to brightness, the default) or srgb (codes of a display "
        "image).",
    ),
    click.option(
        "--albedo-reference",
        type=POSITIVE,
        default=None,
        metavar="V",
        help="Decoded value of MAP that leaves the radiance unchanged; default: the mean of MAP, in colour of its "
        "luminance.",
    ),
)

overwrite_option = click.option("--overwrite", is_flag=True, help="Replace existing output.")

depfile_option = click.option(
    "--depfile",
    type=OutputFile(),
    metavar="FILE",
    help=DEPFILE_HELP,
)


def output_option(
    metavar: str, required: bool = True, written: Files | None = None
) -> Callable[[Command], Command]:
    """Option ``-o`` for the output file, or for a folder (``DIR``). ``written``: the files that are written,
    if they are others than the named one.
    """
    what = "Output folder." if metavar == "DIR" else "Output file."
    kind = OutputFile(written)
    return click.option("-o", "--output", required=required, type=kind, metavar=metavar, help=what)


def check_area(
    center: tuple[float, float] | None, size_km: float | None, bounds: tuple[float, ...] | None
) -> None:
    """Raise a usage error for contradictory or incomplete area options."""
    if center and bounds:
        raise click.UsageError("--center and --bounds exclude each other")
    if bool(center) != (size_km is not None):
        given, missing = ("--center", "--size") if center else ("--size", "--center")
        raise click.UsageError(f"{given} needs {missing}")
    if bounds and not bounds[1] < bounds[3]:
        raise click.UsageError("--bounds W S E N: the south must be below the north")
    if bounds and bounds[0] == bounds[2]:
        raise click.UsageError("--bounds W S E N: west and east are the same")


SUN_ANGLES = ("sun_azimuth", "sun_elevation", "time_utc", "subsolar")
"""Names of the values of `sun_angle_options`, in the order of `check_sun`."""


def check_sun(
    azimuth: float | None,
    elevation: float | None,
    time_utc: str | None,
    subsolar: tuple[float, float] | None,
) -> bool:
    """Return True if the options state a Sun. Usage error for several statements or half of one."""
    if (azimuth is None) != (elevation is None):
        raise click.UsageError("--sun-azimuth and --sun-elevation go together")
    stated = [azimuth is not None, time_utc is not None, subsolar is not None]
    if sum(stated) > 1:
        raise click.UsageError(
            "state the Sun once: --sun-azimuth and --sun-elevation, or --time, or --subsolar"
        )
    return any(stated)


def check_albedo(path: str | None, encoding: str | None, reference: float | None) -> None:
    """Raise a usage error for albedo options without ``--albedo``."""
    for flag, value in (("--albedo-encoding", encoding), ("--albedo-reference", reference)):
        if path is None and value is not None:
            raise click.UsageError(f"{flag} needs --albedo MAP")


def check_accuracy(tier: str | None, tolerance: float | None) -> None:
    """Raise a usage error if both a tier and a tolerance are given."""
    if tier is not None and tolerance is not None:
        raise click.UsageError("--accuracy and --tolerance exclude each other")
