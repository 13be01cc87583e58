"""Every flag that more than one command has, once: groups of options as decorators.

A group gives a command plain keyword arguments under the names that stand here; nothing is read or
computed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from .value_types import (
    AZIMUTH,
    LATITUDE,
    LAW,
    LONGITUDE,
    POSITIVE,
    REFLECTANCES,
    Instant,
    Names,
    Number,
)

Command = Callable[..., Any]

TIERS = ("draft", "standard", "high", "reference")
"""Like `REFLECTANCES`: written out, and held by a test against `lcp_catalog.accuracy`."""

REFLECTANCE_HELP = (
    f"Law of reflection: {', '.join(REFLECTANCES)}, some with :SET (hapke:wac-643-mare, minnaert:0.7; "
    "docs/reflectance.md); default: auto, the one that the scene's phases want."
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
    help="Products, families or files that come first wherever they have a height; default: the product meant for the "
    "latitude, then the finer pixel, then as given.",
)

dem_argument = click.argument("dem", nargs=-1, required=True, metavar="DEM...")

dem_argument_or_none = click.argument("dem", nargs=-1, metavar="[DEM...]")

area_options = option_group(
    click.option(
        "--center",
        nargs=2,
        type=click.Tuple([LONGITUDE, LATITUDE]),
        metavar="LON LAT",
        help="Centre of the area, degrees; with --size.",
    ),
    click.option("--size", "size_km", type=POSITIVE, metavar="KM", help="Side of the area."),
    click.option(
        "--bounds",
        nargs=4,
        type=click.Tuple([LONGITUDE, LATITUDE] * 2),
        metavar="W S E N",
        help="Area by its bounds, degrees; may cross the antimeridian.",
    ),
    click.option(
        "--gsd", "gsd_m", type=POSITIVE, metavar="M", help="Cell size; default: the DEM's own."
    ),
)

sun_angle_options = option_group(
    click.option(
        "--sun-azimuth",
        type=AZIMUTH,
        metavar="DEG",
        help="Azimuth of the Sun, clockwise from north, at the area's centre.",
    ),
    click.option(
        "--sun-elevation",
        type=Number(-90, 90),
        metavar="DEG",
        help="Elevation of the Sun above the horizontal at the area's centre.",
    ),
    click.option(
        "--time", "time_utc", type=Instant(), metavar="UTC", help="Sun of an instant, ISO 8601."
    ),
    click.option(
        "--subsolar",
        nargs=2,
        type=click.Tuple([LONGITUDE, LATITUDE]),
        metavar="LON LAT",
        help="Sun overhead at a place.",
    ),
)

sun_options = option_group(
    sun_angle_options,
    click.option(
        "--sun",
        "sun_model",
        type=click.Choice(["point", "disc"]),
        default=None,
        help="Shape of the Sun; default: a point in draft and standard, a disc in high and "
        "reference.",
    ),
)

accuracy_options = option_group(
    click.option(
        "--accuracy",
        type=click.Choice(TIERS),
        default=None,
        help="Share of nodes whose shadow may be wrong: draft 0.5 %, standard 0.02 % (the default), "
        "high none, reference none and float64 throughout.",
    ),
    click.option(
        "--tolerance",
        type=Number(0.0),
        metavar="T",
        default=None,
        help="Instead of --accuracy: the fastest tier whose errors stay within this share.",
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

ENCODINGS = ("linear", "srgb")
"""Like `REFLECTANCES`: written out, and held by a test against `lcp_catalog.build.config`."""

albedo_options = option_group(
    click.option(
        "--albedo",
        "albedo_path",
        metavar="MAP",
        help="A map of the ground's relative brightness, any raster in a lunar CRS; radiance is "
        "multiplied by its value over a reference.",
    ),
    click.option(
        "--albedo-encoding",
        type=click.Choice(ENCODINGS),
        default=None,
        help="What MAP holds: values proportional to brightness (the default), or the codes of a "
        "display image.",
    ),
    click.option(
        "--albedo-reference",
        type=POSITIVE,
        default=None,
        metavar="V",
        help="The value, decoded, whose factor is 1; default: MAP's own mean over the ground.",
    ),
)

overwrite_option = click.option(
    "--overwrite", is_flag=True, help="Replace an output that exists already."
)

depfile_option = click.option(
    "--depfile", metavar="FILE", help="Also write what was read, as a rule for make."
)


def output_option(metavar: str, required: bool = True) -> Callable[[Command], Command]:
    """``-o``, the file that a command makes."""
    return click.option("-o", "--output", required=required, metavar=metavar, help="What to write.")


def check_area(
    center: tuple[float, float] | None, size_km: float | None, bounds: tuple[float, ...] | None
) -> None:
    """Usage error for area flags that contradict each other or say half."""
    if center and bounds:
        raise click.UsageError("--center and --bounds exclude each other")
    if bool(center) != (size_km is not None):
        given, missing = ("--center", "--size") if center else ("--size", "--center")
        raise click.UsageError(f"{given} needs {missing}")
    if bounds and not bounds[1] < bounds[3]:
        raise click.UsageError("--bounds W S E N: the south must be below the north")
    if bounds and bounds[0] == bounds[2]:
        raise click.UsageError("--bounds W S E N: west and east are the same")


def check_sun(
    azimuth: float | None,
    elevation: float | None,
    time_utc: str | None,
    subsolar: tuple[float, float] | None,
) -> bool:
    """Whether flags state a Sun; usage error for more than one or half of one."""
    if (azimuth is None) != (elevation is None):
        raise click.UsageError("--sun-azimuth and --sun-elevation go together")
    stated = [azimuth is not None, time_utc is not None, subsolar is not None]
    if sum(stated) > 1:
        raise click.UsageError(
            "state the Sun once: --sun-azimuth and --sun-elevation, or --time, or --subsolar"
        )
    return any(stated)


def check_albedo(path: str | None, encoding: str | None, reference: float | None) -> None:
    """Usage error for what says how a map is read without one."""
    for flag, value in (("--albedo-encoding", encoding), ("--albedo-reference", reference)):
        if path is None and value is not None:
            raise click.UsageError(f"{flag} needs --albedo MAP")


def check_accuracy(tier: str | None, tolerance: float | None) -> None:
    """Usage error for a tier and a tolerance at once."""
    if tier is not None and tolerance is not None:
        raise click.UsageError("--accuracy and --tolerance exclude each other")
