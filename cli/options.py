"""Options that several commands share, as decorators. No file is read here."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

from .build_options import field_option
from .files import CATALOG, RASTER, InputFile, OutputFile
from .groups import Decorator, collected, option_group
from .names import in_options
from .value_types import AZIMUTH, PLACE, POSITIVE, Instant, Number, Step

if TYPE_CHECKING:
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.production.model_config import ModelConfig

Map = TypeVar("Map")

product_order_option = field_option("dem.product_order")

dem_argument = click.argument("dem", nargs=-1, required=True, type=RASTER, metavar="DEM...")

dem_argument_or_none = click.argument("dem", nargs=-1, type=RASTER, metavar="[DEM...]")


def dems_option(text: str) -> Decorator:
    """``--dem``, once for each file, of a command whose DEMs are optional; ``text``: what they are for."""
    return click.option("--dem", "dems", multiple=True, type=RASTER, metavar="DEM...", help=text)


def camera_file_option(text: str, *names: str, **settings: Any) -> Decorator:
    """``--camera``, a file; ``text``: what the camera is for; ``settings``: further ones of click."""
    kind = InputFile()
    return click.option("--camera", *names, type=kind, metavar="CAMERA.json", help=text, **settings)


def range_option(text: str, metavar: str = "START STOP STEP", required: bool = False) -> Decorator:
    """``--range``, instants at equal steps, which a command gets as ``span``; ``text``: what they are."""
    kind = click.Tuple([Instant(), Instant(), Step()])
    return click.option("--range", "span", type=kind, required=required, metavar=metavar, help=text)


def altitude_option(text: str) -> Decorator:
    """``--altitude`` of a camera, which a command gets as ``altitude_km``; ``text``: which altitude it is."""
    return click.option("--altitude", "altitude_km", type=POSITIVE, metavar="KM", help=text)


def center_option(text: str, *names: str, **settings: Any) -> Decorator:
    """``--center``, a place; ``text``: which it is; ``settings``: further ones of click."""
    return click.option("--center", *names, type=PLACE, metavar="LON LAT", help=text, **settings)


def trajectory_option(text: str) -> Decorator:
    """``--trajectory``, a file; ``text``: what it is for."""
    return click.option("--trajectory", type=InputFile(), metavar="FILE", help=text)


catalog_argument = click.argument("catalog", metavar="CATALOG.h5", type=CATALOG)


area_options = option_group(
    field_option("area.center_deg", "what the camera sees, else the whole DEM"),
    field_option("area.size_km"),
    field_option("area.bounds_deg"),
    field_option("area.gsd_m", "that of the DEM"),
)
"""Area of a render."""


def sun_choice(
    sun_azimuth: float | None,
    sun_elevation: float | None,
    time_utc: str | None,
    subsolar: tuple[float, float] | None,
) -> SunChoice:
    """The Sun of the options. Usage error for several statements or half of one."""
    from lcp_catalog.errors import SunError
    from lcp_catalog.light.sun_choice import SunChoice

    try:
        return SunChoice(sun_azimuth, sun_elevation, time_utc, subsolar)
    except SunError as error:
        raise click.UsageError(in_options(str(error))) from error


sun_angle_options = collected(
    "sun",
    sun_choice,
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
        type=PLACE,
        metavar="LON LAT",
        help="Subsolar point, degrees: the place where the Sun is at the zenith.",
    ),
)
"""The Sun, which a command gets as ``sun``, a SunChoice."""


view_angle_options = option_group(
    click.option(
        "--off-nadir",
        type=Number(0, 90, max_open=True),
        metavar="DEG",
        help="Angle between the vertical and the direction to the camera at the centre, degrees; default: 0.",
    ),
    click.option(
        "--view-azimuth",
        type=AZIMUTH,
        metavar="DEG",
        help="Azimuth of the camera, seen from the centre, degrees clockwise from north; needed with --off-nadir.",
    ),
)
"""The direction to the camera, in degrees, of a command without ``--camera``."""

disc_option = click.option(
    "--sun",
    "disc",
    type=click.Choice(["point", "disc"]),
    callback=lambda context, option, value: None if value is None else value == "disc",
    help="Model of the Sun: point source or extended disc; default: point in the tiers draft and standard, disc in "
    "high and reference.",
)
"""True for a disc, False for a point, None for the tier's own."""

overwrite_option = click.option("--overwrite", is_flag=True, help="Replace existing output.")


def output_option(
    metavar: str, kind: OutputFile | None = None, required: bool = True, text: str = "Output file."
) -> Decorator:
    """Option ``-o`` for the output file, or for a folder (``DIR``)."""
    what = "Output folder." if metavar == "DIR" else text
    settings: dict[str, Any] = {"required": required, "type": kind or OutputFile(), "help": what}
    return click.option("-o", "--output", metavar=metavar, **settings)


def other_output_option(flag: str, metavar: str, text: str, name: str | None = None) -> Decorator:
    """An option for a further output file; ``name``: that of its value, if it is not the flag's."""
    names = (flag,) if name is None else (flag, name)
    return click.option(*names, type=OutputFile(), metavar=metavar, help=text)


def json_option(text: str = "Print one JSON document on stdout.") -> Decorator:
    """``--json``, which a command gets as ``as_json``."""
    return click.option("--json", "as_json", is_flag=True, help=text)


def albedo_map(
    model: ModelConfig, read: Callable[[str, str | None, float | None], Map]
) -> Map | None:
    """The albedo map of a model, opened by ``read``; None without one."""
    path = model.albedo_file
    return None if path is None else read(str(path), model.albedo_encoding, model.albedo_reference)
