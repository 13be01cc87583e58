"""Every flag that more than one command has, once: groups of options as decorators.

A group gives a command plain keyword arguments under the names that stand here; nothing is read or
computed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import click

Command = Callable[..., Any]

TIERS = ("draft", "standard", "high", "reference")
"""Like `REFLECTANCES`: written out, and held by a test against `lcp_catalog.accuracy`."""

REFLECTANCES = ("lommel-seeliger", "lambert")
"""Written out, so that no flag needs the kernels to be imported; a test holds it against
`lcp_catalog.reflectance`.
"""


def option_group(*options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


class Number(click.FloatRange):
    """A number within bounds; nan and inf are none."""

    name = "number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return float(number)


class Instant(click.ParamType):
    """A time in ISO 8601; without a zone it is UTC."""

    name = "time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from lcp_catalog.errors import SunError
        from lcp_catalog.instants import instants  # erfa: only when a time is given

        try:
            instants(value)
        except SunError as error:
            self.fail(f"{error}.", param, ctx)
        return str(value)


class Step(click.ParamType):
    """A step of time like 30m, 6h, 1d, 3600s or PT6H, in seconds."""

    name = "step"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        from lcp_catalog.errors import SunError
        from lcp_catalog.instants import step_seconds

        try:
            return step_seconds(str(value))
        except SunError as error:
            self.fail(f"{error}.", param, ctx)


POSITIVE = Number(min=0.0, min_open=True)
LONGITUDE, LATITUDE = Number(-180, 360), Number(-90, 90)
AZIMUTH = Number(-360, 360)


class Names(click.ParamType):
    """Names with commas between them."""

    name = "names"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        if isinstance(value, tuple):
            return value
        names = tuple(name.strip() for name in value.split(","))
        if not all(names):
            self.fail(f"{value!r} is not NAME,NAME...", param, ctx)
        return names


product_order_option = click.option(
    "--product-order",
    type=Names(),
    metavar="NAME,NAME...",
    help="Products, families or files that come first wherever they have a height; default: the product meant for the "
    "latitude, then the finer pixel, then as given.",
)

dem_argument = click.argument("dem", nargs=-1, required=True, metavar="DEM...")

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

sun_options = option_group(
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
    click.option(
        "--sun",
        "sun_model",
        type=click.Choice(["point", "disc"]),
        default=None,
        help="Shape of the Sun; default: a point in draft and standard, a disc in high and "
        "reference.",
    ),
)

view_options = option_group(
    click.option("--camera", "camera_path", metavar="CAMERA.json", help="Camera that looks."),
    click.option(
        "--off-nadir",
        type=Number(0, 90, max_open=True),
        metavar="DEG",
        help="Angle between the vertical and the camera at the area's centre.",
    ),
    click.option(
        "--view-azimuth",
        type=AZIMUTH,
        metavar="DEG",
        help="Azimuth of the camera, seen from the area's centre.",
    ),
    click.option(
        "--altitude",
        "altitude_km",
        type=POSITIVE,
        metavar="KM",
        help="Altitude of the camera above the sphere; default: at infinity.",
    ),
    click.option(
        "--frame",
        type=click.Choice(["enu", "camera"]),
        default="enu",
        show_default=True,
        help="Render at the ground's nodes, or in the camera's plane.",
    ),
)

model_options = option_group(
    click.option(
        "--reflectance",
        type=click.Choice(REFLECTANCES),
        default=None,
        help=f"Photometric model; default: {REFLECTANCES[0]}.",
    ),
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


def check_view(
    camera_path: str | None,
    off_nadir: float | None,
    view_azimuth: float | None,
    altitude_km: float | None,
    frame: str,
) -> None:
    """Usage error for view flags that contradict each other or say half."""
    oblique = any(value is not None for value in (off_nadir, view_azimuth, altitude_km))
    if camera_path and oblique:
        raise click.UsageError(
            "--camera excludes --off-nadir, --view-azimuth and --altitude: it is the view"
        )
    if off_nadir and view_azimuth is None:
        raise click.UsageError("--off-nadir needs --view-azimuth")
    if view_azimuth is not None and off_nadir is None:
        raise click.UsageError("--view-azimuth needs --off-nadir")
    if frame == "camera" and not camera_path and altitude_km is None:
        raise click.UsageError("--frame camera needs --camera, or --altitude (with --off-nadir)")


def check_accuracy(tier: str | None, tolerance: float | None) -> None:
    """Usage error for a tier and a tolerance at once."""
    if tier is not None and tolerance is not None:
        raise click.UsageError("--accuracy and --tolerance exclude each other")
