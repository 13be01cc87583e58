"""The summary of a catalogue: its figures as one model, for the page, for text and for JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..accuracy import accuracy
from ..arrays import AnyArray
from ..constants import FRAME
from ..errors import CatalogError, LcpError
from ..geometry.bounds import enclosing_arc, turned_deg
from ..plots.numbers import number
from .catalogue import Catalog
from .integrity import NOT_READ
from .origins import origins
from .promise import kept_promise, promise_rows
from .schema import COVERAGE_STATUS, LEVEL_FACTORS, OLD_FILE, SCHEMA_VERSION, evaluated, usable
from .stored import StoredFile, sharded, stored_catalog
from .verification import apart, judge, judged, shard_problems


@dataclass(frozen=True, eq=False)
class Statistics:
    """Usable and evaluated conditions of a catalogue, counted block by block.

    ``usable`` and ``evaluated``: numbers of points in each condition, (view, sun_elevation,
    sun_azimuth). ``by_point``: usable share of a point's evaluated conditions, NaN if none was, (n,).
    ``points_by_elevation``: number of points at each Sun elevation, (sun_elevation, 3): evaluated,
    usable in at least one condition, usable in all evaluated ones.
    """

    usable: AnyArray
    evaluated: AnyArray
    by_point: AnyArray
    points_by_elevation: AnyArray

    @classmethod
    def of(cls, catalog: Catalog) -> Statistics:
        """The figures of a catalogue, from its flags."""
        axes = (catalog.view_off_nadir, catalog.sun_elevation, catalog.sun_azimuth)
        shape = tuple(len(axis) for axis in axes)
        works, known = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
        by_point, by_elevation = [np.zeros(0)], np.zeros((shape[1], 3), np.int64)
        for rows in catalog.blocks("condition"):
            flags = catalog.part("condition", rows)
            good, all_ = usable(flags), evaluated(flags)
            works += good.sum(axis=0)
            known += all_.sum(axis=0)
            by_point.append(_share(good.sum(axis=(1, 2, 3)), all_.sum(axis=(1, 2, 3))))
            some = all_.any(axis=(1, 3))
            every = some & (good | ~all_).all(axis=(1, 3))
            counts = (some, good.any(axis=(1, 3)), every)
            by_elevation += np.stack([which.sum(axis=0) for which in counts], axis=-1)
        return cls(works, known, np.concatenate(by_point), by_elevation)

    @cached_property
    def share(self) -> float:
        """Usable share of all points' evaluated conditions."""
        return float(_share(self.usable.sum(), self.evaluated.sum()))

    @cached_property
    def by_view(self) -> AnyArray:
        """Usable share over points and Suns, (view,)."""
        return _share(self.usable.sum(axis=(1, 2)), self.evaluated.sum(axis=(1, 2)))

    @cached_property
    def by_view_and_sun(self) -> AnyArray:
        """Usable share, (view, sun_elevation, sun_azimuth)."""
        return _share(self.usable, self.evaluated)

    @cached_property
    def by_elevation(self) -> AnyArray:
        """Usable share over points, views and azimuths, (sun_elevation,)."""
        return _share(self.usable.sum(axis=(0, 2)), self.evaluated.sum(axis=(0, 2)))

    @cached_property
    def suns(self) -> AnyArray:
        """True for Sun cells that were evaluated for at least one point, (sun_elevation,
        sun_azimuth).
        """
        return np.asarray(self.evaluated.any(axis=0))


def share_by_sun(catalog: Catalog, row: int) -> AnyArray:
    """Usable share of a point over the views, (sun_elevation, sun_azimuth)."""
    flags = catalog.part("condition", row)
    return _share(usable(flags).sum(axis=0), evaluated(flags).sum(axis=0))


def _share(good: AnyArray, all_: AnyArray) -> AnyArray:
    """Usable as a share of evaluated conditions; NaN if none was evaluated."""
    return np.asarray(np.where(all_ > 0, good / np.maximum(all_, 1), np.nan))


def describe(path: Path | str) -> dict[str, Any]:
    """Contents and integrity of a catalogue file as plain values; None for those that cannot be
    read.

    For a bad file ``intact`` is false and ``problems`` lists the reasons; CatalogError for one that is not there,
    no plain file, or not opened by the system: nothing is known of it. ``usable_share`` is the share of all
    evaluated conditions (points x views x Suns) that are usable; ``bounds`` are those of the points, with west
    above east if they cross the prime meridian.
    """
    names = ("points", "usable_share", "intact", "problems", "schema_version", "sources", "bounds")
    stored = StoredFile.of(path)
    try:
        problems, found = apart(stored, _described)
    except CatalogError as error:
        problems, found = [str(error).removeprefix(f"{path}: ")], {}
    if problems and problems[0].startswith(NOT_READ):
        raise CatalogError(f"{path}: {problems[0]}")
    if not problems and not found:
        catalog = judged(stored, None)
        problems = shard_problems(catalog)
        found = {} if problems else summary(catalog)
    return {**dict.fromkeys(names), "intact": not problems, "problems": problems, **found}


def _described(facts: Sequence[Any]) -> tuple[list[str], dict[str, Any]]:
    """Problems and figures of a file; no figures of a bad one, and of an index, whose shards are not judged."""
    stored = StoredFile.received(facts)
    problems, head = judge(stored)
    try:
        catalog = None if problems else stored_catalog(stored, head=head)
        return problems, {} if catalog is None or sharded(catalog) else summary(catalog)
    except CatalogError as error:  # the file changed in between
        return [str(error).removeprefix(f"{stored.path}: ")], {}


def summary(catalog: Catalog, statistics: Statistics | None = None) -> dict[str, Any]:
    """The figures of a catalogue as plain values, ready for JSON; ``statistics``: its own, if known."""
    statistics = statistics or Statistics.of(catalog)
    return {
        "points": len(catalog),
        "usable_share": _plain(statistics.share),
        "universal_points": int(catalog.universal.sum()),
        "min_detection": catalog.min_detection,
        **_accuracy(catalog.config),
        "schema_version": SCHEMA_VERSION,
        "frame": FRAME,
        "software": f"lcp-catalog {catalog.software_version}",
        "sources": catalog.sources,
        "albedo": _albedo(catalog),
        "bounds": bounds(catalog.longitude, catalog.latitude),
        "region": _region(catalog),
        "spacing_m": catalog.coverage.spacing_m,
        "map_levels": [1, *LEVEL_FACTORS] if catalog.overview_levels else [],
        "patch_nodes": catalog.patch_nodes,
        "gsd_m": _range(catalog.gsd),
        "levels": _levels(catalog),
        "products": dict(sorted(_products(catalog).items())),
        "elevation_sigma_m": _known(catalog.elevation_sigma),
        "dem_resolution_m": _known(catalog.dem_resolution),
        "usable_by_sun_elevation": _by_elevation(catalog, statistics),
        "suns_evaluated": int(statistics.suns.sum()),
        "sun_elevation_deg": _range(catalog.sun_elevation),
        "views": [
            one | {"usable_share": _plain(share)}
            for one, share in zip(views(catalog), statistics.by_view, strict=True)
        ],
        "localization_sigma_m": _percentiles(catalog.localization_sigma[:, 0]),
        "second_peak": _percentiles(catalog.second_peak),
        "coverage": coverage_counts(catalog),
        "promise": kept_promise(catalog),
    }


def _by_elevation(catalog: Catalog, statistics: Statistics) -> list[dict[str, Any]]:
    """Usable share and numbers of points by Sun elevation, for elevations that were evaluated."""
    columns = zip(
        catalog.sun_elevation.tolist(),
        statistics.by_elevation,
        statistics.points_by_elevation.tolist(),
        strict=True,
    )
    return [
        {
            "sun_elevation_deg": elevation,
            "usable_share": _plain(share),
            "points_evaluated": counts[0],
            "points_usable": counts[1],
            "points_always_usable": counts[2],
        }
        for elevation, share, counts in columns
        if counts[0]
    ]


def _levels(catalog: Catalog) -> list[dict[str, Any]]:
    """Cell sizes and numbers of points of each level, from fine to coarse."""
    level = np.asarray(catalog.level)
    return [
        {
            "level": number,
            "gsd_m": _range(catalog.gsd[level == number]),
            "points": int(np.count_nonzero(level == number)),
            "universal_points": int(catalog.universal[level == number].sum()),
        }
        for number in np.unique(level).tolist()
    ]


def _albedo(catalog: Catalog) -> dict[str, Any] | None:
    """The albedo map with the range of its factors over the patches; None without one."""
    if catalog.albedo_map is None:
        return None
    ranges, off = [], 0
    for rows in catalog.blocks("albedo"):
        albedo = catalog.part("albedo", rows)
        ranges += _range(albedo[np.isfinite(albedo)]) or []
        off += int(np.isnan(albedo).any(axis=(1, 2)).sum())
    return catalog.albedo_map | {"range": _range(np.array(ranges)), "points_off_the_map": off}


def _accuracy(config: str) -> dict[str, Any]:
    """Names of the tiers of a catalogue's builds, and whether all of these sought similar places at full resolution everywhere,
    from its configuration; none and False where that does not say.
    """
    try:
        models = [one.config.get("model", {}) for one in origins(config)]
        tiers = [accuracy(one.get("accuracy"), one.get("tolerance")) for one in models]
    except (LcpError, AttributeError, TypeError, ValueError):
        models = tiers = []
    pairs = zip(models, tiers, strict=True)
    whole = [one.get("whole_search", tier.whole_search) for one, tier in pairs]
    names = sorted({tier.tier for tier in tiers})
    return {"accuracy": names, "whole_search": bool(whole) and all(whole)}


def _products(catalog: Catalog) -> Counter[str]:
    """Number of points by DEM product."""
    found: Counter[str] = Counter()
    for rows in catalog.blocks("dem_product"):
        found.update(catalog.part("dem_product", rows).tolist())
    return found


def bounds(lon_deg: AnyArray, lat_deg: AnyArray) -> dict[str, float] | None:
    """The narrowest box of longitudes (0..360) and latitudes around points; None without points."""
    if not len(lon_deg):
        return None
    west, east = enclosing_arc(lon_deg, lon_deg)
    return {
        "west": turned_deg(west),
        "south": float(np.min(lat_deg)),
        "east": turned_deg(east),
        "north": float(np.max(lat_deg)),
    }


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _known(values: AnyArray) -> list[float] | None:
    """Smallest and largest of the known figures; None without any."""
    return _range(values[np.isfinite(values)])


def _range(values: AnyArray) -> list[float] | None:
    return [float(values.min()), float(values.max())] if len(values) else None


def _percentiles(values: AnyArray) -> dict[str, float] | None:
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    low, middle, high = np.percentile(known, [5.0, 50.0, 95.0])
    return {"p05": float(low), "median": float(middle), "p95": float(high)}


def _region(catalog: Catalog) -> dict[str, float]:
    view = catalog.overview
    cell = abs(float(view.x[1] - view.x[0])) if len(view.x) > 1 else 0.0
    return {
        "center_lon": view.center_lon,
        "center_lat": view.center_lat,
        "width_km": len(view.x) * cell / 1e3,
        "height_km": len(view.y) * cell / 1e3,
    }


def views(catalog: Catalog) -> list[dict[str, Any]]:
    """Angles and altitude of each view; no altitude for parallel rays."""
    columns = (catalog.view_off_nadir, catalog.view_azimuth, catalog.view_altitude)
    return [
        {"off_nadir_deg": off, "azimuth_deg": azimuth, "altitude_km": _plain(high)}
        for off, azimuth, high in zip(*(one.tolist() for one in columns), strict=True)
    ]


def coverage_counts(catalog: Catalog) -> dict[str, int]:
    """Number of spacing cells of each status."""
    return {
        name: int(np.count_nonzero(catalog.coverage.status == code))
        for code, name in COVERAGE_STATUS.items()
    }


def view_name(view: dict[str, Any]) -> str:
    """Text for a viewpoint."""
    where = "straight down"
    if view["off_nadir_deg"]:
        where = f"{view['off_nadir_deg']:g}° off nadir, camera at azimuth {view['azimuth_deg']:g}°"
    high = "parallel rays" if view["altitude_km"] is None else f"{view['altitude_km']:g} km high"
    return f"{where}, {high}"


def latitude_name(lat_deg: float) -> str:
    """Text for a latitude."""
    return f"{abs(lat_deg):.4f}° {'S' if lat_deg < 0.0 else 'N'}"


def headline(found: dict[str, Any]) -> str:
    """Whether a file is intact, in words, of what `describe` found; of a file that is too old only that."""
    if found["problems"] == [OLD_FILE]:
        return OLD_FILE
    return "intact" if found["intact"] else "NOT INTACT"


def percent(share: float | None) -> str:
    """Text for a share; a dash for NaN."""
    return "–" if share is None or not np.isfinite(share) else f"{100 * share:.1f} %"


def summary_rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    """A `summary` as names and lines of text."""
    region, box, gsd = found["region"], found["bounds"], found["gsd_m"]
    rows = [
        ("points", str(found["points"])),
        (
            "region",
            f"{number(region['width_km'], 4)} x {number(region['height_km'], 4)} km around {region['center_lon']:.4f}° E, "
            f"{latitude_name(region['center_lat'])}",
        ),
    ]
    if box:
        around = (box["east"] - box["west"]) % 360.0 > 270.0  # about a pole
        lon = "all around" if around else f"{box['west']:.4f} to {box['east']:.4f}° E"
        text = f"{lon}, {latitude_name(box['south'])} to {latitude_name(box['north'])}"
        rows.append(("points within", text))
    cell = "" if gsd is None else f" of {_metres(gsd, 4)}"
    rows += [
        ("patches", f"{found['patch_nodes']} x {found['patch_nodes']} nodes{cell}"),
        *_level_rows(found["levels"]),
        ("spacing", f"{number(found['spacing_m'], 4)} m"),
        ("DEM", ", ".join(f"{name} ({count})" for name, count in found["products"].items()) or "–"),
        (
            "heights",
            f"1 sigma {_metres(found['elevation_sigma_m'])}, resolving {_metres(found['dem_resolution_m'])}",
        ),
        *_albedo_rows(found["albedo"]),
        ("accuracy", ", ".join(found["accuracy"]) or "–"),
        ("frame", f"{found['frame']}, mean Earth"),
        ("Suns", _suns_line(found)),
        (
            "usable",
            f"{percent(found['usable_share'])} of the evaluated conditions (points x views x Suns)",
        ),
        ("universal", f"{found['universal_points']} points, usable in 95 % of them or more"),
    ]
    rows += [
        (f"  view {k}", f"{percent(v['usable_share'])}  {view_name(v)}")
        for k, v in enumerate(found["views"])
    ]
    for name, key, unit in (
        ("sigma", "localization_sigma_m", " m"),
        ("second peak", "second_peak", ""),
    ):
        figures = found[key]
        if figures:
            low, middle, high = (number(figures[p]) for p in ("p05", "median", "p95"))
            text = f"{middle}{unit} in the median, 5..95 %: {low} to {high}{unit}"
            if key == "second_peak" and not found["whole_search"]:
                text += "; it may be higher: similar places were sought at half resolution first"
            rows.append((name, text))
    rows.append(
        ("cells", ", ".join(f"{name} {count}" for name, count in found["coverage"].items()))
    )
    if found["map_levels"]:
        factors = ", ".join(str(factor) for factor in found["map_levels"])
        rows.append(("map levels", f"overview and coverage in cells {factors} times as wide"))
    rows += promise_rows(found["promise"])
    return rows


def _level_rows(levels: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """A row for each level; none for a single one."""
    return [
        (
            f"  level {one['level']}",
            f"cells of {_metres(one['gsd_m'], 4)}: {one['points']} points, {one['universal_points']} universal",
        )
        for one in levels
        if len(levels) > 1
    ]


def _metres(span: list[float] | None, digits: int = 3) -> str:
    if span is None:
        return "unknown"
    return f"{' to '.join(dict.fromkeys(number(value, digits) for value in span))} m"


def _albedo_rows(albedo: dict[str, Any] | None) -> list[tuple[str, str]]:
    """The rows about albedo; none without a map."""
    if albedo is None:
        return []
    text = f"{albedo['name']}, {albedo['encoding']}, over {number(albedo['reference'], 4)} ({albedo['reference_is']})"
    if albedo["range"]:
        text += f"; factors {' to '.join(number(value) for value in albedo['range'])}"
    if albedo["points_off_the_map"]:
        text += f"; {albedo['points_off_the_map']} points lie off it"
    return [("albedo", text)]


def _suns_line(found: dict[str, Any]) -> str:
    low, high = found["sun_elevation_deg"]
    return f"{found['suns_evaluated']} directions evaluated, elevations {low:g} to {high:g}°"


# -- the page
