"""Public functions about DEM files: opening a set of them, and what they hold."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from .coverage import MOON_KM2, Band, SetCoverage, set_coverage, set_disagreements
from .dem import Dem
from .disagreements import Disagreement
from .mosaic import DemSet, dem_files, height_at
from .pixel_statistics import HeightStatistics, Region, height_statistics
from .plausibility import warn_of_all_heights

Dems: TypeAlias = DemSet | Path | str | Sequence[Path | str]
"""DEMs of a public function: an opened set, one file, or several."""


def dem_set(dem: Dems, product_order: Sequence[str] = ()) -> DemSet:
    """DEM files as one DEM; an opened set as it is. No pixel is read.

    Parameters
    ----------
    dem:
        A file (GeoTIFF, or PDS by image or label), several, or an opened set.
    product_order:
        Order of precedence where files overlap: product names, families or file names. Default:
        products made for the latitude first, then finer pixels.

    Raises
    ------
    DemError, LabelError
        For the first file that cannot be opened.
    KindError
        For what is no path.

    Examples
    --------
    >>> dems = lcp.dem_set(folder / "hadley_gld100_256ppd.tif")
    >>> dems.products
    ('GLD100_256',)
    """
    if isinstance(dem, DemSet):
        return dem
    return DemSet.open(dem_paths(dem), product_order)


def dem_paths(dem: Dems) -> tuple[Path, ...]:
    """The files of DEMs, without those beside them such as labels. KindError for what is no path."""
    if isinstance(dem, DemSet):
        return tuple(one.path for one in dem.dems)
    return dem_files(dem)


@dataclass(frozen=True, eq=False)
class DemInfo:
    """What a set of DEM files holds.

    Attributes
    ----------
    files:
        One object for each file, of the document of ``lcp dem info``: ``path``, ``product``,
        ``projection``, ``width``, ``height`` (pixels), ``gsd_m``, ``bounds`` (degrees), ``min_m``,
        ``max_m``, ``nodata_share``, ``samples`` (heights at the places asked for) and others.
    whole:
        The coverage of all files together: areas (km2) by latitude and product, overlaps, gaps,
        missing pixels, and products whose heights disagree.
    dems:
        The opened files.
    heights:
        Statistics of the heights of each file; None if no pixel was read.

    Examples
    --------
    >>> info = lcp.dem_info(folder / "hadley_gld100_256ppd.tif", quick=True)
    >>> info.files[0]["product"], info.heights is None
    ('GLD100_256', True)
    """

    files: list[dict[str, Any]]
    whole: dict[str, Any]
    dems: DemSet
    heights: tuple[HeightStatistics, ...] | None

    def __repr__(self) -> str:
        """The set in short: `files` and `whole` hold the figures."""
        box = ", ".join(f"{name} {value:.6g}" for name, value in self.whole["bounds"].items())
        products = ", ".join(sorted({str(one["product"]) for one in self.files})[:5])
        count = f"{len(self.files)} file{'s' * (len(self.files) != 1)}"
        return f"<DemInfo: {count} ({products}), {self.whole['covered_km2']:.6g} km2, {box}>"


def dem_info(
    dem: Dems,
    *,
    at_deg: Sequence[tuple[float, float]] = (),
    quick: bool = False,
    product_order: Sequence[str] = (),
) -> DemInfo:
    """Projection, bounds, cell size, heights and missing pixels of DEM files, and the coverage of all
    files together. Logs a warning for heights that are hardly those of the Moon in metres.

    Parameters
    ----------
    dem:
        A file, several, or an opened set.
    at_deg:
        Places (longitude, latitude), degrees, whose heights each file's ``samples`` state.
    quick:
        True: read no pixels; heights, missing pixels and resolutions are then None.
    product_order:
        Order of precedence where files overlap (`dem_set`).

    Raises
    ------
    DemError, LabelError
        For a file that cannot be opened or read.

    Examples
    --------
    >>> info = lcp.dem_info(folder / "hadley_gld100_256ppd.tif", at_deg=[(3.63, 26.13)])
    >>> one = info.files[0]
    >>> one["product"], round(one["gsd_m"], 1), one["samples"][0]["height_m"] < 0.0
    ('GLD100_256', 118.5, True)
    """
    dems = dem_set(dem, product_order)
    covered = set_coverage(dems)
    heights = None if quick else tuple(height_statistics(one) for one in dems.dems)
    for number, one in enumerate(dems.dems):
        warn_of_all_heights(one, heights[number] if heights else None)
    differing = None if quick else set_disagreements(dems, covered)
    paths = dem_paths(dem if not isinstance(dem, DemSet) else dems)
    names = [str(path) for path in paths]
    files = [
        _file(names[number], one, number, covered, heights, at_deg)
        for number, one in enumerate(dems.dems)
    ]
    return DemInfo(files, _whole(names, dems, covered, heights, differing), dems, heights)


def _file(
    path: str,
    dem: Dem,
    number: int,
    covered: SetCoverage,
    heights: Sequence[HeightStatistics] | None,
    places: Sequence[tuple[float, float]],
) -> dict[str, Any]:
    """One file: the fields of the contract, published facts about the product, and its area."""
    found = heights[number] if heights else None
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


def _whole(
    paths: Sequence[str],
    dems: DemSet,
    covered: SetCoverage,
    heights: Sequence[HeightStatistics] | None,
    differing: Sequence[Disagreement] | None,
) -> dict[str, Any]:
    """The set as one object; files by the names that were given."""
    holes = None
    if heights is not None:
        found = zip(paths, heights, covered.file_km2, strict=True)
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
        "disagreements": None
        if differing is None
        else [dataclasses.asdict(one) | {"message": str(one)} for one in differing],
    }


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
