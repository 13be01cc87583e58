"""``lcp dem``: content of DEM files from labels and pixels, and the coverage of a set of them."""

from __future__ import annotations

import dataclasses
import json
from typing import TYPE_CHECKING, Any

import click

from . import dem_check
from .files import FileCommand, OutputFile
from .messages import echo, say
from .options import dem_argument, overwrite_option, product_order_option
from .value_types import LATITUDE, LONGITUDE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lcp_catalog.dem.consistency import Disagreement
    from lcp_catalog.dem.coverage import Band, SetCoverage
    from lcp_catalog.dem.dem import Dem
    from lcp_catalog.dem.mosaic import DemSet
    from lcp_catalog.dem.pixel_statistics import HeightStatistics
    from lcp_catalog.dem.regions import Region


@click.group()
def command() -> None:
    """Inspect DEM files."""


command.add_command(dem_check.command)


@command.command(
    cls=FileCommand, rule=True, example="lcp dem info LDEM_*.LBL --at 0 -89.5 --map used.png"
)
@dem_argument
@click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON list, one object for each file."
)
@click.option(
    "--at",
    "places",
    nargs=2,
    multiple=True,
    type=click.Tuple([LONGITUDE, LATITUDE]),
    metavar="LON LAT",
    help="Also print the height at a place, degrees; may be repeated.",
)
@click.option(
    "--set",
    "only_set",
    is_flag=True,
    help="Print only the coverage of all files together; with --json one object instead of the list.",
)
@click.option(
    "--quick", is_flag=True, help="Read no pixels: print no heights and no missing pixels."
)
@click.option(
    "--map",
    "map_path",
    type=OutputFile(),
    metavar="OUT.png",
    help="Also write a map of the product used at each place, over shaded relief (not with --quick).",
)
@product_order_option
@overwrite_option
def info(
    dem: tuple[str, ...],
    as_json: bool,
    places: tuple[tuple[float, float], ...],
    only_set: bool,
    quick: bool,
    map_path: str | None,
    product_order: tuple[str, ...] | None,
    overwrite: bool,
) -> None:
    """Show projection, bounds, cell size, heights and missing pixels of DEM files (GeoTIFF, or PDS
    by image or label), and the coverage of all files together: areas by latitude and product,
    overlaps, gaps, missing pixels.
    """
    if places and (quick or only_set):
        raise click.UsageError("--at cannot be combined with --quick or --set")
    if overwrite and not map_path:
        raise click.UsageError("--overwrite needs --map OUT.png")

    from lcp_catalog.atomic_files import check_output
    from lcp_catalog.dem.coverage import set_coverage, set_disagreements
    from lcp_catalog.dem.mosaic import DemSet  # rasterio and numba: only when the command runs
    from lcp_catalog.dem.pixel_statistics import height_statistics

    from . import dem_text

    if map_path:
        check_output(map_path, overwrite)
    dems = DemSet.open(dem, product_order)  # fails before any pixel is read
    covered = set_coverage(dems)
    surveys = None if quick else [height_statistics(one) for one in dems.dems]
    differing = None if quick else set_disagreements(dems, covered)
    whole = _describe_set(dem, dems, covered, surveys, differing)
    files = (
        []
        if only_set
        else [
            _describe(path, dems.dems[number], number, covered, surveys, places)
            for number, path in enumerate(dem)
        ]
    )
    if map_path:
        _write_map(dems, surveys, map_path, overwrite)
    if as_json and not only_set:  # the list has no field for it
        for one in differing or []:
            say(f"lcp: warning: {one}")
    if as_json:
        click.echo(json.dumps(whole if only_set else files, indent=2))
    else:
        echo("\n\n".join([*map(dem_text.file_text, files), dem_text.set_text(whole)]))


def _write_map(
    dems: DemSet, surveys: Sequence[HeightStatistics] | None, path: str, overwrite: bool
) -> None:
    from lcp_catalog.atomic_files import write_bytes
    from lcp_catalog.dem.coverage_map import set_map

    write_bytes(path, set_map(dems, surveys), overwrite)


def _describe(
    path: str,
    dem: Dem,
    number: int,
    covered: SetCoverage,
    surveys: Sequence[HeightStatistics] | None,
    places: tuple[tuple[float, float], ...],
) -> dict[str, Any]:
    """One file: the fields of the contract, published facts about the product, and its area."""
    from lcp_catalog.dem.coverage import MOON_KM2
    from lcp_catalog.dem.mosaic import height_at

    found = surveys[number] if surveys else None
    span, own_km2, used_km2 = (
        dem.abs_latitude_use,
        covered.file_km2[number],
        covered.used_km2[number],
    )
    return {
        "path": path,
        "product": dem.product,
        "projection": dem.grid.projection,
        "width": dem.grid.width,
        "height": dem.grid.height,
        "gsd_m": dem.gsd_m,
        "bounds": dem.grid.bounds._asdict(),
        "radius_m": dem.radius_m,
        "min_m": found.min_m if found else None,
        "max_m": found.max_m if found else None,
        "nodata_share": found.nodata_share if found else None,
        "abs_latitude_use": None if span is None else list(span),
        "filled_beyond_deg": dem.facts.filled_beyond_deg,
        "filled_with": dem.facts.filled_with or None,
        "samples": [
            {"lon": lon, "lat": lat, "height_m": height_at(dem, lon, lat)} for lon, lat in places
        ],
        "vertical_uncertainty_m": dem.facts.sigma_m,
        "resolution_m": dem.facts.resolution_m,
        "true_resolution_m": dem.facts.resolution_m,
        **_resolution(dem, quick=found is None),
        "area_km2": own_km2,
        "used_share": _share(used_km2, own_km2),
        "moon_share": _share(used_km2, MOON_KM2),
        "holes": _holes(found, own_km2) if found else None,
    }


def _resolution(dem: Dem, quick: bool) -> dict[str, float | None]:
    """Effective resolution and its 1-sigma interval; None without pixels or with too few heights."""
    found = None if quick else dem.effective_resolution
    known = found if found is not None and found.is_measured else None
    return {
        "effective_resolution_m": known.resolution_m if known else None,
        "effective_resolution_low_m": known.low_m if known else None,
        "effective_resolution_high_m": known.high_m if known else None,
    }


def _holes(found: HeightStatistics, own_km2: float) -> dict[str, Any]:
    """Missing pixels of a file of an area, and their largest connected regions."""
    missing_km2 = found.hole_km2()
    return {
        "area_km2": missing_km2,
        "share": _share(missing_km2, own_km2),
        "largest": [_region(one) for one in found.holes()],
    }


def _share(part: float, whole: float) -> float:
    """A share without the last bits, so that a whole is 1."""
    return round(part / whole, 12) if whole else 0.0


def _region(region: Region) -> dict[str, Any]:
    return {"bounds": region.bounds._asdict(), "area_km2": region.area_km2}


def _describe_set(
    paths: Sequence[str],
    dems: DemSet,
    covered: SetCoverage,
    surveys: Sequence[HeightStatistics] | None,
    differing: Sequence[Disagreement] | None,
) -> dict[str, Any]:
    """The set as one object; files by the names that were given."""
    from lcp_catalog.dem.coverage import MOON_KM2

    holes = None
    if surveys is not None:
        found = zip(paths, surveys, covered.file_km2, strict=True)
        holes = [
            {"path": path, **_holes(one, own)} for path, one, own in found if one.missing.any()
        ]
    files = zip(paths, dems.products, covered.file_km2, covered.used_km2, strict=True)
    return {
        "files": [
            {"path": path, "product": product, "area_km2": own, "used_km2": used}
            for path, product, own, used in files
        ],
        "bounds": covered.bounds._asdict(),
        "covered_km2": covered.covered_km2,
        "moon_share": _share(covered.covered_km2, MOON_KM2),
        "box_share": _share(covered.covered_km2, covered.box_km2),
        "has_north_pole": covered.has_north_pole,
        "has_south_pole": covered.has_south_pole,
        "is_full_ring": covered.is_full_ring,
        "crosses_antimeridian": covered.crosses_antimeridian,
        "bands": [_band(band) for band in covered.bands],
        "overlaps": [
            {
                "files": [paths[one.first], paths[one.second]],
                "area_km2": one.area_km2,
                "bounds": one.bounds._asdict(),
            }
            for one in covered.overlaps
        ],
        "gaps": [{**_region(gap), "at_edge": gap.at_edge} for gap in covered.gaps],
        "holes": holes,
        "disagreements": None if differing is None else [_disagreement(one) for one in differing],
    }


def _disagreement(one: Disagreement) -> dict[str, Any]:
    return {**dataclasses.asdict(one), "message": str(one)}


def _band(band: Band) -> dict[str, Any]:
    return {
        "south": band.south_deg,
        "north": band.north_deg,
        "area_km2": band.area_km2,
        "covered_share": _share(band.covered_km2, band.area_km2),
        "overlap_share": _share(band.overlap_km2, band.area_km2),
        "gap_km2": band.gap_km2,
        "used_share": {name: _share(km2, band.area_km2) for name, km2 in band.used_km2.items()},
    }
