"""``lcp dem``: what is in a DEM product, as read from its label and its pixels."""

from __future__ import annotations

import json
from typing import Any

import click

from .options import dem_argument


@click.group()
def command() -> None:
    """Look at DEM products."""


@command.command()
@dem_argument
@click.option("--json", "as_json", is_flag=True, help="One JSON list on stdout, one object a file.")
@click.option(
    "--at",
    "places",
    nargs=2,
    multiple=True,
    type=click.Tuple([click.FloatRange(-180, 360), click.FloatRange(-90, 90)]),
    metavar="LON LAT",
    help="Also the height at a place, degrees; may be repeated.",
)
def info(dem: tuple[str, ...], as_json: bool, places: tuple[tuple[float, float], ...]) -> None:
    """Projection, bounds, cell, heights and missing share of DEM files (GeoTIFF, or PDS3 by image
    or label).
    """
    from lcp_catalog.dem import Dem  # rasterio and numba: only when the command runs

    opened = [
        Dem.open(path) for path in dem
    ]  # a file that is none is said before the others are read
    described = [
        _describe(path, product, places) for path, product in zip(dem, opened, strict=True)
    ]
    click.echo(
        json.dumps(described, indent=2) if as_json else "\n\n".join(_text(one) for one in described)
    )


def _describe(path: str, dem: Any, places: tuple[tuple[float, float], ...]) -> dict[str, Any]:
    from lcp_catalog.demset import height_at

    found = dem.statistics()
    span = dem.abs_latitude_use
    return {
        "path": path,
        "product": dem.product,
        "projection": dem.grid.projection,
        "width": dem.grid.width,
        "height": dem.grid.height,
        "gsd_m": dem.gsd_m,
        "bounds": dem.grid.bounds._asdict(),
        "radius_m": dem.radius_m,
        "min_m": found.min_m,
        "max_m": found.max_m,
        "nodata_share": found.nodata_share,
        "abs_latitude_use": None if span is None else list(span),
        "samples": [
            {"lon": lon, "lat": lat, "height_m": height_at(dem, lon, lat)} for lon, lat in places
        ],
    }


def _text(one: dict[str, Any]) -> str:
    box, span = one["bounds"], one["abs_latitude_use"]
    rows = [
        ("product", one["product"]),
        (
            "projection",
            f"{one['projection']}, {one['width']} x {one['height']} pixels of "
            f"{one['gsd_m']:.10g} m",
        ),
        (
            "bounds",
            f"longitude {box['west']:.6g} .. {box['east']:.6g}, latitude "
            f"{box['south']:.6g} .. {box['north']:.6g}",
        ),
        ("heights", _range(one)),
        ("no data", f"{one['nodata_share']:.4%} of the pixels"),
        (
            "use",
            "any latitude"
            if span is None
            else f"latitudes {span[0]:g} .. {span[1]:g} north and south",
        ),
    ]
    rows += [(f"at {s['lon']:g} {s['lat']:g}", _metres(s["height_m"])) for s in one["samples"]]
    width = max(len(name) for name, _ in rows)
    return "\n".join([one["path"], *(f"  {name:<{width}}  {value}" for name, value in rows)])


def _range(one: dict[str, Any]) -> str:
    if one["min_m"] is None:
        return "none"
    return f"{one['min_m']:.2f} .. {one['max_m']:.2f} m above the sphere of {one['radius_m']:.0f} m"


def _metres(height_m: float | None) -> str:
    return "no data" if height_m is None else f"{height_m:.2f} m"
