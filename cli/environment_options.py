"""Options about an environment map as the light, the same in every command that has them, and checks of
their combinations.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from .options import RASTER, option_group
from .value_types import AZIMUTH, POSITIVE, SUN_SKY_RATIO

if TYPE_CHECKING:
    from lcp_catalog.light.environment import Environment

environment_options = option_group(
    click.option(
        "--environment",
        "environment_path",
        type=RASTER,
        metavar="PANORAMA",
        help="Light the scene with an environment map instead of the Sun: an equirectangular image of all directions "
        "(.hdr, .pfm, .tif or .png), twice as wide as high, with north at its centre; default: none, the Sun.",
    ),
    click.option(
        "--environment-azimuth",
        type=AZIMUTH,
        metavar="DEG",
        help="Azimuth of the environment map's centre, degrees clockwise from north; default: 0.",
    ),
    click.option(
        "--environment-sources",
        nargs=3,
        type=click.Tuple([POSITIVE] * 3),
        metavar="T R M",
        help="Bright sources in the environment map: peak above T times the mean of its 45 x 45 deg segment, pixels "
        "within R degrees of it and above M times that mean; default: 6 5 2.",
    ),
    click.option(
        "--sun-sky-ratio",
        type=SUN_SKY_RATIO,
        metavar="RATIO|auto|found",
        help="Scale the strongest source so that its irradiance on a horizontal plane is RATIO times that of the rest "
        "of the environment map; found: not scaled; auto: 4 (CIE clear sky) for a high Sun that is weaker and whose "
        "luminance is cut off; default: auto.",
    ),
)

_HOW = ("environment_azimuth", "environment_sources", "sun_sky_ratio")


def check_environment(flags: Mapping[str, Any], sun_stated: bool) -> None:
    """Raise a usage error for an environment map beside a Sun, and for options about one without it."""
    stated = flags["environment_path"] is not None
    if stated and (sun_stated or flags.get("sun_model") is not None):
        raise click.UsageError(
            "--environment replaces the Sun: it excludes --sun-azimuth, --sun-elevation, --time, --subsolar and --sun"
        )
    for name in _HOW:
        if not stated and flags[name] is not None:
            raise click.UsageError(f"--{name.replace('_', '-')} needs --environment PANORAMA")


def environment(flags: Mapping[str, Any]) -> Environment | None:
    """The environment map of the options; None without one."""
    if flags["environment_path"] is None:
        return None
    from lcp_catalog.light.environment import Environment
    from lcp_catalog.light.environment_sources import SourceSearch

    ratio = flags["sun_sky_ratio"] or "auto"
    return Environment.open(
        flags["environment_path"],
        flags["environment_azimuth"] or 0.0,
        SourceSearch(*(flags["environment_sources"] or ())),
        None if ratio == "found" else ratio,
    )
