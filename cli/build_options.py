"""Options that describe a build, for every command that plans one, and the configuration they make."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import click

from .files import InputFile, config_files
from .options import RASTER, check_accuracy, check_albedo, check_area, option_group
from .value_types import POSITIVE, Number

NUMBERS_MAX = 3600
"""Most numbers of a list START:STOP:STEP: a tenth of a degree around the horizon."""


class NumberList(click.ParamType):
    """Comma-separated numbers, or START:STOP:STEP with both ends included."""

    name = "numbers"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        try:
            if ":" in value:
                start, stop, step = (float(part) for part in value.split(":"))
                if not step > 0 or not math.isfinite((stop - start) / step):
                    self.fail(f"{value!r}: the step must be positive", param, ctx)
                count = math.floor((stop - start) / step + 1e-9) + 1
                if count > NUMBERS_MAX:
                    self.fail(f"{value!r} is {count} numbers, at most {NUMBERS_MAX}", param, ctx)
                return tuple(start + i * step for i in range(count))
            return tuple(float(part) for part in value.split(","))
        except ValueError:
            self.fail(f"{value!r} is neither A,B,C nor START:STOP:STEP", param, ctx)


class ViewParam(click.ParamType):
    """OFF_NADIR[:AZIMUTH[:ALTITUDE_KM]]."""

    name = "view"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        try:
            parts = [float(part) for part in value.split(":")]
        except ValueError:
            parts = []
        if not 1 <= len(parts) <= 3 or (len(parts) == 1 and parts[0] != 0.0):
            self.fail(f"{value!r} is not OFF_NADIR:AZIMUTH[:ALTITUDE_KM] (or 0)", param, ctx)
        return (*parts, *(0.0, math.inf)[len(parts) - 1 :])


class Altitudes(click.ParamType):
    """KM-KM, lowest and highest altitude."""

    name = "altitudes"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        try:
            low, high = (float(part) for part in str(value).split("-"))
        except ValueError:
            low, high = math.nan, math.nan
        if not 0.0 < low <= high < math.inf:
            self.fail(f"{value!r} is not KM-KM, lowest and highest, for example 5-100", param, ctx)
        return low, high


class PartParam(click.ParamType):
    """K/N."""

    name = "part"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", str(value))
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            self.fail(f"{value!r} is not K/N with K from 1 to N, for example 3/16", param, ctx)
        return int(found[1]), int(found[2])


config_option = click.option(
    "--config",
    "config_path",
    type=InputFile(config_files),
    metavar="BUILD.toml",
    help="Configuration of the build; options of the command line replace its values. Default: every value its default.",
)

sweep_options = option_group(
    click.option(
        "--sun-azimuths",
        type=NumberList(),
        metavar="LIST",
        help="Azimuths of the Sun, degrees: A,B,C or START:STOP:STEP; default: 0:345:15.",
    ),
    click.option(
        "--sun-elevations",
        type=NumberList(),
        metavar="LIST",
        help="Elevations of the Sun, degrees: A,B,C or START:STOP:STEP; default: 4,5,10,15,20,30,45,60,75, and "
        "0.5,1,1.5,2,3 for a region that reaches beyond 81.9 degrees of latitude, where the Sun stays below 10.",
    ),
    click.option(
        "--view",
        "views",
        type=ViewParam(),
        multiple=True,
        metavar="OFF:AZ[:KM]",
        help="View: angle from the vertical at the point and azimuth, degrees, and altitude, km (default: infinity). Repeat "
        "for more views. Default: 0, and 30 degrees from four azimuths.",
    ),
)

level_options = option_group(
    click.option(
        "--levels",
        "levels_m",
        type=NumberList(),
        metavar="M,M,...",
        help="Several cell sizes in one catalogue, metres, at most a factor of 2 apart. Each has points only where a DEM "
        "resolves it; default: one cell size, --gsd.",
    ),
    click.option(
        "--altitudes",
        "altitudes_km",
        type=Altitudes(),
        metavar="KM-KM",
        help="Cell sizes for a camera at these altitudes: the size of its pixel (--ifov) on the ground, from the lowest to the "
        "highest, without those that no DEM resolves.",
    ),
    click.option(
        "--ifov",
        "ifov_rad",
        type=Number(0, 1, min_open=True),
        metavar="RAD",
        help="With --altitudes: angle of a pixel of the camera, radians.",
    ),
)

point_options = option_group(
    click.option(
        "--spacing",
        "spacing_km",
        type=POSITIVE,
        metavar="KM",
        help="Least distance between two points, which are then spread evenly (unless --per-view is given, too). "
        "Default: as --per-view asks for, at least half a patch.",
    ),
    click.option(
        "--per-view",
        type=click.IntRange(0, 200),
        metavar="N",
        help="Usable points that every camera's footprint in the region is promised under every Sun and view that can "
        "happen; the fewest points are chosen that keep it. 0: points are spread evenly. Default: 8, with --spacing 0.",
    ),
    click.option(
        "--footprint",
        "footprint_km",
        type=POSITIVE,
        metavar="KM",
        help="Diameter of the ground that a camera sees; default: 1024 cells, at most the shorter side of the region.",
    ),
    click.option(
        "--max-points",
        type=click.IntRange(min=1),
        metavar="N",
        help="Most points: the catalogue of this size that does most for the promise; default: no limit.",
    ),
    click.option(
        "--max-bytes",
        type=click.IntRange(min=1),
        metavar="N",
        help="The same by the estimated size of the file, bytes; default: no limit.",
    ),
    click.option(
        "--search",
        "search_km",
        type=POSITIVE,
        metavar="KM",
        help="Radius within which a point must be unique, at least half a patch; default: 64 cells, at most 8 km.",
    ),
    click.option(
        "--noise",
        "sensor_noise",
        type=Number(0, 1, min_open=True, max_open=True),
        metavar="SHARE",
        help="Noise of an image's pixel, 1 sigma, as a share of the mean signal; default: 0.07.",
    ),
)


error_map_options = option_group(
    click.option(
        "--dem-sigma",
        "sigma_map",
        type=RASTER,
        metavar="MAP",
        help="Map of the 1 sigma of the DEM's heights, metres: a raster in a lunar CRS (an _ERR layer). Without it, and "
        "where it has no value: the figure of the DEM's product.",
    ),
    click.option(
        "--dem-resolution",
        "resolution_map",
        type=RASTER,
        metavar="MAP",
        help="Map of the DEM's effective resolution, metres: a raster in a lunar CRS (an _EFFRES layer). Without it, and "
        "where it has no value: estimated from the heights of each DEM.",
    ),
)


def configuration(
    config_path: str | None,
    center: tuple[float, float] | None,
    size_km: float | None,
    bounds: tuple[float, ...] | None,
    gsd_m: float | None,
    sun_azimuths: tuple[float, ...] | None,
    sun_elevations: tuple[float, ...] | None,
    views: tuple[tuple[float, ...], ...],
    spacing_km: float | None,
    per_view: int | None,
    footprint_km: float | None,
    max_points: int | None,
    max_bytes: int | None,
    search_km: float | None,
    sensor_noise: float | None,
    reflectance: str | None,
    accuracy: str | None = None,
    tolerance: float | None = None,
    product_order: tuple[str, ...] | None = None,
    albedo_path: str | None = None,
    albedo_encoding: str | None = None,
    albedo_reference: float | None = None,
    sigma_map: str | None = None,
    resolution_map: str | None = None,
    levels_m: tuple[float, ...] | None = None,
    altitudes_km: tuple[float, ...] | None = None,
    ifov_rad: float | None = None,
) -> Any:
    """The ``BuildConfig`` of the file, with the values of the options. UsageError for contradictory options."""
    from lcp_catalog.production.config import BuildConfig

    check_area(center, size_km, bounds)
    _check_cells(gsd_m, levels_m, altitudes_km, ifov_rad)
    check_accuracy(accuracy, tolerance)
    config = BuildConfig.from_toml(Path(config_path)) if config_path else BuildConfig()
    check_albedo(albedo_path or config.model.albedo, albedo_encoding, albedo_reference)
    if albedo_path:  # the file's encoding and reference belong to its own map
        config = dataclasses.replace(config, model=config.model.without_albedo)
    area: dict[str, Any] = {}
    if center or bounds:
        area = {
            "center_deg": tuple(center or ()),
            "size_km": size_km,
            "bounds_deg": tuple(bounds or ()),
        }
    if gsd_m or levels_m or altitudes_km:  # they replace the file's
        area |= {
            "gsd_m": gsd_m,
            "levels_m": levels_m or (),
            "altitudes_km": altitudes_km or (),
            "ifov_rad": ifov_rad,
        }
    columns = list(zip(*views, strict=True))
    return dataclasses.replace(
        config,
        area=dataclasses.replace(config.area, **area),
        dem=_over(
            config.dem,
            product_order=product_order,
            sigma_map=sigma_map,
            resolution_map=resolution_map,
        ),
        sun=_over(config.sun, azimuths_deg=sun_azimuths, elevations_deg=sun_elevations),
        view=_over(
            config.view,
            **dict(zip(("off_nadir_deg", "azimuth_deg", "altitude_km"), columns, strict=False)),
        ),
        points=_over(
            config.points,
            spacing_m=spacing_km and spacing_km * 1e3,
            per_view=per_view,
            footprint_km=footprint_km,
            max_points=max_points,
            max_bytes=max_bytes,
            search_m=search_km and search_km * 1e3,
        ),
        errors=_over(config.errors, sensor_noise=sensor_noise),
        model=_over(
            _undecided(config.model) if accuracy or tolerance is not None else config.model,
            reflectance=reflectance,
            accuracy=accuracy,
            tolerance=tolerance,
            albedo=albedo_path,
            albedo_encoding=albedo_encoding,
            albedo_reference=albedo_reference,
        ),
    )


def _check_cells(
    gsd_m: float | None,
    levels_m: tuple[float, ...] | None,
    altitudes_km: tuple[float, ...] | None,
    ifov_rad: float | None,
) -> None:
    """UsageError for options that state the cells twice, or half."""
    given = {"--gsd": gsd_m, "--levels": levels_m, "--altitudes": altitudes_km}
    if len(names := [name for name, value in given.items() if value]) > 1:
        raise click.UsageError(f"{' and '.join(names)} exclude each other")
    if (altitudes_km is None) != (ifov_rad is None):
        raise click.UsageError("--altitudes and --ifov go together")


def _undecided(model: Any) -> Any:
    """The file's model without tier and tolerance: an option for one of them replaces both."""
    return dataclasses.replace(model, accuracy=None, tolerance=None)


def _over(section: Any, **values: Any) -> Any:
    """A section with the values that were given."""
    given = {name: value for name, value in values.items() if value is not None}
    return dataclasses.replace(section, **given) if given else section
