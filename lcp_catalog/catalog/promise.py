"""How a catalogue keeps what it promises (`model.Promise`), in figures for people: by cause, by Sun,
and by the number of points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import AnyArray, Index
from ..constants import MOON_RADIUS_M
from ..geometry.frames import lonlat_to_mcmf
from .catalogue import Catalog
from .model import Promise
from .schema import NO_CELL, Cause
from .sun_cells import SunCells

WORST = 5
"""Number of worst Suns that are named."""

_CURVE_STEPS = 12


@dataclass(frozen=True)
class LocatedBySun:
    """Frames of a promise's footprint at moments with one Sun each, in one row of the Sun grid; ``gsd_m``: the promise's cells;
    ``located_probability``: what is promised. Of the ``frames``: the mean probability of being located, by points and with the
    ground as a whole, and the shares of frames with at least as much as promised.
    """

    gsd_m: float
    sun_elevation_deg: tuple[float, float]
    located_probability: float
    frames: int
    by_points: float
    with_ground: float
    share_by_points: float
    share_with_ground: float

    @property
    def row(self) -> tuple[str, str]:
        """Name and line of text."""
        return (
            "  moments",
            f"Sun {range_text([*self.sun_elevation_deg])}: located with {self.by_points:.2f} by points, "
            f"{self.with_ground:.2f} with the ground; with {self.located_probability:g} in "
            f"{100.0 * self.share_by_points:.0f} and {100.0 * self.share_with_ground:.0f} % of {self.frames} frames",
        )


def merged_promise(catalogs: Sequence[Catalog], lost: Sequence[Index]) -> Promise | None:
    """The promises of catalogues whose points stand in one file, but for the rows ``lost`` of each;
    promise after promise from fine to coarse cells. None without one.

    Points of one do not count for the promises of another, and a lost point is taken from all
    conditions near it: there may be more points than stated. The curves against the number of
    points are left out.
    """
    given = [
        _without(catalog, rows, catalog.promise)
        for catalog, rows in zip(catalogs, lost, strict=True)
        if catalog.promise is not None and len(catalog)
    ]
    parts = [(told, k) for told in given for k in range(len(told.gsd))]
    if not parts:
        return None
    parts.sort(key=lambda part: float(part[0].gsd[part[1]]))

    def column(name: str) -> AnyArray:
        return np.array([getattr(told, name)[k] for told, k in parts])

    def joined(name: str) -> AnyArray:
        return np.concatenate([getattr(told, name)[told.parts()[k]] for told, k in parts])

    return Promise(
        longitude=joined("longitude"),
        latitude=joined("latitude"),
        demand=joined("demand"),
        points=joined("points"),
        cause=joined("cause"),
        size=np.zeros(0, np.int32),
        met=np.zeros(0),
        served=np.zeros(0),
        places=column("places"),
        gsd=column("gsd"),
        located_probability=column("located_probability"),
        per_view=column("per_view"),
        units=column("units"),
        located=column("located"),
        footprint=column("footprint"),
        radius=column("radius"),
        lower_bound=column("lower_bound"),
    )


def _without(catalog: Catalog, rows: Index, told: Promise) -> Promise:
    """The promise without points (rows) of the catalogue."""
    radius = np.repeat(told.radius, told.places)
    gone, units = np.zeros(len(told.longitude), np.int64), np.repeat(told.units, told.places)
    here = lonlat_to_mcmf(told.longitude, told.latitude, 0.0)
    for row in rows.tolist():
        there = lonlat_to_mcmf(catalog.longitude[row], catalog.latitude[row], 0.0)
        chord = np.linalg.norm(here - there, axis=-1)
        arc = 2.0 * MOON_RADIUS_M * np.arcsin(np.minimum(1.0, 0.5 * chord / MOON_RADIUS_M))
        gone += units * ((arc <= radius) & np.isin(catalog.gsd[row], told.gsd))
    nothing = told.cause == NO_CELL
    left = np.maximum(told.points.astype(np.int64) - gone[:, None, None, None], 0)
    points = np.where(nothing, NO_CELL, left).astype(np.uint8)
    short = (told.cause == Cause.MET) & (points < told.demand[:, None, None, None])
    cause = np.where(short, Cause.FEW, told.cause).astype(np.uint8)
    return replace(told, points=points, cause=cause)


def kept_promise(catalog: Catalog) -> dict[str, Any] | None:
    """Figures of the promise, ready for JSON; None for a catalogue without one.

    A condition is a view and a cell of the Sun grid at a place at which something is promised.
    ``kept_share``: of all conditions; ``causes``: shares of them by cause; ``located_by_sun``: by the elevation of
    the Sun the mean over places, azimuths and views of the probability, at least, that a frame of the footprint is located,
    and the share of conditions in which the promise is kept; ``worst_suns``: views and
    Suns with the smallest shares of places at which the promise is kept; ``curve``: pairs of a
    number of points and the share of the conditions with as much as the candidates allow;
    ``levels``: the figures of each of several promises, else empty.
    """
    promise = catalog.promise
    if promise is None:
        return None
    cause, points = catalog.part("promise/cause"), catalog.part("promise/points")
    bound = promise.least_points
    steps = np.unique(np.linspace(0, len(promise.size) - 1, _CURVE_STEPS).astype(np.int64))
    promises = (promise.located_probability, promise.per_view, promise.footprint)
    whole = _kept(cause, *(column.max() for column in promises))
    levels = [
        {"gsd_m": float(promise.gsd[k])} | _kept(cause[part], *(column[k] for column in promises))
        for k, part in enumerate(promise.parts())
        if len(promise.gsd) > 1
    ]
    return {
        **whole,
        "lower_bound": bound or None,
        "size_over_bound": len(catalog) / bound if bound else None,
        "located_by_sun": _located_by_sun(catalog, promise, cause, points),
        "worst_suns": _worst(catalog, cause),
        "curve": [
            [int(promise.size[k]), float(promise.met[k])] for k in steps if len(promise.size)
        ],
        "levels": levels,
    }


def _kept(cause: AnyArray, located: float, per_view: float, footprint_m: float) -> dict[str, Any]:
    """Figures of the places with these causes (place, v, e, a)."""
    counts = np.bincount(cause.ravel(), minlength=NO_CELL + 1)[: max(Cause) + 1]
    total = max(1, int(counts.sum()))
    return {
        "located_probability": float(located) or None,
        "per_view": int(per_view),
        "footprint_km": float(footprint_m) / 1e3,
        "places": len(cause),
        "conditions": int(counts.sum()),
        "kept_share": float(counts[Cause.MET] / total),
        "causes": {
            cause.name.lower(): float(counts[cause] / total)
            for cause in Cause
            if cause != Cause.MET and counts[cause]
        },
    }


def _located_by_sun(
    catalog: Catalog, promise: Promise, cause: AnyArray, points: AnyArray
) -> list[dict[str, Any]]:
    """Probability of being located by the rows of the Sun grid's cells; see `kept_promise`."""
    chance = np.zeros(points.shape)
    for k, part in enumerate(promise.parts()):
        chance[part] = np.append(promise.located[k], 0.0)[points[part]]
    there, cells = points != NO_CELL, SunCells.of(catalog.sun_elevation, catalog.sun_azimuth)
    return [
        {
            "sun_elevation_deg": _span(cells.elevation, row, int(cells.above[row])),
            "located_probability": float(chance[:, :, row][own].mean()),
            "kept_share": float((cause[:, :, row][own] == Cause.MET).mean()),
        }
        for row, own in enumerate(np.moveaxis(there, 2, 0))
        if own.any()
    ]


def _worst(catalog: Catalog, cause: AnyArray) -> list[dict[str, Any]]:
    """The views and cells of the Sun grid with the smallest shares of places."""
    places = np.count_nonzero(cause != NO_CELL, axis=0)
    met = np.count_nonzero(cause == Cause.MET, axis=0)
    share = np.where(places > 0, met / np.maximum(places, 1), np.inf)
    cells = SunCells.of(catalog.sun_elevation, catalog.sun_azimuth)
    found = []
    for flat in np.argsort(share, axis=None, kind="stable")[:WORST]:
        view, row, column = (int(k) for k in np.unravel_index(flat, share.shape))
        if not share[view, row, column] < 1.0:
            break
        why = cause[:, view, row, column]
        counts = np.bincount(why[(why != NO_CELL) & (why != Cause.MET)], minlength=1)
        found.append(
            {
                "view": view,
                "sun_elevation_deg": _span(cells.elevation, row, int(cells.above[row])),
                "sun_azimuth_deg": _span(cells.azimuth, column, int(cells.after[column])),
                "places": int(places[view, row, column]),
                "kept_share": float(share[view, row, column]),
                "cause": Cause(int(counts.argmax())).name.lower(),
            }
        )
    return found


def _span(grid: AnyArray, first: int, last: int) -> list[float]:
    return [float(grid[first]), float(grid[last])]


def promise_rows(found: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Figures of `kept_promise` as names and lines of text."""
    if found is None:
        return []
    rows = []
    for level in found["levels"] or [found]:
        name = f"promise, {level['gsd_m']:g} m" if found["levels"] else "promise"
        text = (
            f"{promised_text(level)} in every footprint of {level['footprint_km']:.4g} km: kept in "
            f"{100.0 * level['kept_share']:.1f} % of {level['conditions']} places x the catalogue's views x Suns"
        )
        rows.append((name, text))
        if level["causes"]:
            shares = level["causes"].items()
            rows.append(
                ("  else", ", ".join(f"{why} {100.0 * share:.1f} %" for why, share in shares))
            )
    rows += [
        (
            f"  Sun {range_text(row['sun_elevation_deg'])}",
            f"located with at least {row['located_probability']:.2f} (mean of places, the region's border too), "
            f"kept in {100.0 * row['kept_share']:.1f} %",
        )
        for row in found["located_by_sun"]
    ]
    rows += [("  worst Sun", worst_text(sun)) for sun in found["worst_suns"]]
    if found["lower_bound"]:
        text = f"at least {found['lower_bound']:.1f} points keep as much, {found['size_over_bound']:.2f} times as many do"
        rows.append(("  size", text))
    return rows


def promised_text(level: dict[str, Any]) -> str:
    """What is promised in a footprint."""
    if level["located_probability"]:
        return f"located with a probability of {level['located_probability']:g}"
    return f"{level['per_view']} usable points"


def worst_text(sun: dict[str, Any]) -> str:
    """Text for one of the worst Suns."""
    return (
        f"elevation {range_text(sun['sun_elevation_deg'])}, azimuth {range_text(sun['sun_azimuth_deg'])}, view "
        f"{sun['view']}: kept at {100.0 * sun['kept_share']:.1f} % of {sun['places']} places ({sun['cause']})"
    )


def range_text(span: list[float]) -> str:
    """A range of angles."""
    return f"{' to '.join(dict.fromkeys(f'{value:g}' for value in span))}°"
