"""Options about an environment map as the light, the same in every command that has them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import click

from .files import RASTER
from .groups import collected
from .value_types import AZIMUTH, POSITIVE, SUN_SKY_RATIO

if TYPE_CHECKING:
    from lcp_catalog.light.environment import Environment, RatioChoice


@dataclass(frozen=True)
class EnvironmentOptions:
    """An environment map, and how its sources are found; no map without ``environment``."""

    environment: str | None
    environment_azimuth: float | None
    environment_sources: tuple[float, float, float] | None
    sun_sky_ratio: RatioChoice | Literal["found"]

    def __post_init__(self) -> None:
        for name in ("environment_azimuth", "environment_sources", "sun_sky_ratio"):
            if self.environment is None and getattr(self, name) is not None:
                raise click.UsageError(f"--{name.replace('_', '-')} needs --environment PANORAMA")

    def open(self) -> Environment | None:
        """The map; None without one."""
        if self.environment is None:
            return None
        from lcp_catalog.light.environment import Environment
        from lcp_catalog.light.sources import SourceSearch

        search = (
            None if self.environment_sources is None else SourceSearch(*self.environment_sources)
        )
        ratio = "auto" if self.sun_sky_ratio is None else self.sun_sky_ratio
        return Environment.open(
            self.environment,
            self.environment_azimuth or 0.0,
            search,
            None if ratio == "found" else ratio,
        )


environment_options = collected(
    "light",
    EnvironmentOptions,
    click.option(
        "--environment",
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
"""The environment map, which a command gets as ``light``."""
