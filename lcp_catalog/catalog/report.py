"""The catalogue report: one self-contained HTML page. The template is ``catalogue.html.j2``.

The part of the catalogue report in which a Sun, a view and an image scale are chosen: the claims as
compact numbers for the page's script, and the frame of the map that it draws in.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ..arrays import AnyArray, Index
from ..atomic_files import check_output, write_bytes
from ..dem.products import tie_of
from ..ephemeris.solar_position import reachable_suns
from ..plots.axes import Axes, Axis, round_ticks
from ..plots.numbers import number, page
from ..plots.pictures import data_uri
from .catalogue import Catalog
from .charts import (
    MAP_PX,
    STEPS,
    Distribution,
    Mark,
    ReliefMap,
    SunDisc,
    categories,
    distribution,
    hillshade,
    shade_class,
    symbol,
)
from .layout import packing
from .promise import LocatedBySun, promised_text, range_text, worst_text
from .schema import COVERAGE_STATUS, COVERAGE_UNKNOWN, SCHEMA_VERSION, usable
from .summary import (
    Statistics,
    coverage_counts,
    latitude_name,
    percent,
    share_by_sun,
    summary,
    summary_rows,
    view_name,
    views,
)
from .verification import open_catalog

BYTES_MAX = 12_000_000
"""Most bytes of claims on a page, before compression. A larger catalogue is shown at image scale 1
alone, and if that is still too large with an even sample of its points.
"""

CELLS_MAX = 5000
"""Most spacing cells on a page; of more an even sample."""

PATCHES_MAX = 500
"""Most points with their heights on a page; of more an even sample."""

UNKNOWN = 255
"""Code of a value that is not known."""

_SIGMA_RATIO = 1.02
"""Ratio of neighbouring codes of a sigma."""

_ELLIPSE_PX = 14.0
"""Semi-axis, in units of the map, that the median ellipse is enlarged to."""


@dataclass(frozen=True)
class Shown:
    """The points and image scales on the page."""

    rows: Index
    scales: Index

    @classmethod
    def of(cls, catalog: Catalog, suns: int, bytes_max: int) -> Shown:
        """All points and scales that fit into ``bytes_max`` with ``suns`` Sun directions."""
        views, scales = len(catalog.view_off_nadir), len(_scales(catalog))
        one = max(1, suns * views)  # bytes of a point, of each plane
        if len(catalog) * one * (4 * scales + 1) > bytes_max:
            scales = 1
        most = max(1, bytes_max // (one * (4 * scales + 1)))
        return cls(_sample(len(catalog), most), np.arange(scales))


def claim_map(catalog: Catalog, chart: ReliefMap, evaluated: AnyArray) -> dict[str, Any] | None:
    """Numbers for the script: JSON-ready, None for a catalogue without points.
    ``evaluated``: True for the Suns to show, (sun_elevation, sun_azimuth).

    All ``data`` are base64 of bytes that are compressed (RFC 1950). ``suns``: the evaluated directions
    as indices [elevation, azimuth]. ``data``, for
    the shown points n, scales s, views v and Suns k, in this order: condition (n, v, k), detection
    probability in steps of 1/250 (n, s, v, k), sigma of the major axis, minor over major axis in
    1/254, and direction of the major axis in degrees, clockwise from the point's north. A sigma is
    ``sigma_m`` * ``sigma_ratio`` ** code; code 254 stands for everything above. 255: not known.
    ``points``: identifier, longitude, latitude, map coordinates, index of the cell size in ``levels``,
    and direction of the point's north on the map. ``map_px``: width and height of the map.

    ``cells``: spacing cells with their map coordinates and width; ``data``: a row of bits (v, k) for each, filled
    up to whole bytes: 1 where a usable point is near, or the Sun never comes there; ``known`` (v, k): the condition was evaluated;
    ``of``: number of all cells. ``patches``: heights (``side``, ``side``) of the points ``of``, indices
    in ``points``; ``data``: little-endian int16 in steps of ``step_m``.
    """
    if not len(catalog):
        return None
    suns = np.argwhere(evaluated)
    shown = Shown.of(catalog, len(suns), BYTES_MAX)
    x, y, turn = _places(catalog, chart, shown.rows)
    x, y = (np.where(np.isfinite(x + y), at, -1e6) for at in (x, y))  # not on the map
    condition = catalog.part("condition", shown.rows)[:, :, suns[:, 0], suns[:, 1]]
    smallest, planes = _planes(catalog, shown, suns)
    content = b"".join(np.ascontiguousarray(plane).tobytes() for plane in (condition, *planes))
    scales, gsd = _scales(catalog)[shown.scales], catalog.gsd[shown.rows]
    levels, level = np.unique(gsd, return_inverse=True)
    return {
        "suns": suns.tolist(),
        "elevations": catalog.sun_elevation.tolist(),
        "azimuths": catalog.sun_azimuth.tolist(),
        "views": [view_name(one) for one in views(catalog)],
        "scales": scales.tolist(),
        "points": [
            [str(catalog.point_id[i]), round(float(catalog.longitude[i]), 4), round(float(catalog.latitude[i]), 4),
             round(float(px), 1), round(float(py), 1), int(k), round(float(north), 1)]
            for i, px, py, k, north in zip(shown.rows, x, y, level, turn, strict=True)
        ],
        "levels": levels.tolist(),
        "map_px": list(chart.size_px),
        "sigma_m": smallest,
        "sigma_ratio": _SIGMA_RATIO,
        "least": catalog.min_detection,
        "px_per_m": chart.scale,
        "enlarged": _enlargement(catalog, shown, chart),
        "first": _first_choice(condition),
        "of": len(catalog),
        "data": _packed(content),
        "cells": _cells(catalog, chart, suns),
        "patches": _patches(catalog, shown.rows),
    }  # fmt: skip


def _packed(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 9)).decode("ascii")


def _sample(count: int, most: int) -> Index:
    """Indices of all of ``count`` things, or of an even sample."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.int64)


def _cells(catalog: Catalog, chart: ReliefMap, suns: Index) -> dict[str, Any]:
    """The spacing cells and, by condition, whether a usable point is near; none if that is not known."""
    cells = catalog.coverage
    count = 0 if cells.usable is None else len(cells.status)
    rows = _sample(count, CELLS_MAX)
    x, y = chart.pixel(*chart.plane.at(cells.longitude[rows], cells.latitude[rows]))
    x, y = (np.where(np.isfinite(x + y), at, -1e6) for at in (x, y))  # not on the map
    near = np.zeros((0, len(catalog.view_off_nadir), len(suns)), np.uint8)
    if cells.usable is not None:
        near = np.asarray(cells.usable)[rows][:, :, suns[:, 0], suns[:, 1]]
    lit = _possible(cells.latitude[rows], catalog, suns)[:, None]
    bits = np.packbits(
        ((near == 1) | ~lit).reshape(len(near), near.shape[1] * near.shape[2]), axis=1
    )
    return {
        "x": np.round(x, 1).tolist(),
        "y": np.round(y, 1).tolist(),
        "known": (near != COVERAGE_UNKNOWN).any(axis=0).tolist(),
        "of": count,
        "spacing_km": round(cells.spacing_m / 1e3, 2),
        "side_px": round(max(cells.spacing_m, cells.step_m or 0.0) * chart.scale, 2),
        "data": _packed(bits.tobytes()),
    }


def _possible(lat_deg: AnyArray, catalog: Catalog, suns: Index) -> AnyArray:
    """True for the Suns (k) that can occur at latitudes (n), to 0.1 deg, (n, k)."""
    found, of = np.unique(np.round(lat_deg, 1), return_inverse=True)
    azimuth, elevation = catalog.sun_azimuth, catalog.sun_elevation
    every = [
        reachable_suns(float(lat), azimuth, elevation)[suns[:, 0], suns[:, 1]] for lat in found
    ]
    return np.reshape(every, (len(found), len(suns))).astype(np.bool_)[of]


def _patches(catalog: Catalog, rows: Index) -> dict[str, Any]:
    """Heights of an even sample of the shown points (``rows``)."""
    some = _sample(len(rows), PATCHES_MAX)
    z = np.nan_to_num(np.asarray(catalog.part("dem", rows[some]), dtype=np.float64))
    step_m = max(float(np.abs(z).max(initial=0.0)) / 32767.0, 1e-6)
    return {
        "side": catalog.patch_nodes,
        "of": some.tolist(),
        "step_m": step_m,
        "data": _packed(np.rint(z / step_m).astype("<i2").tobytes()),
    }


def _scales(catalog: Catalog) -> AnyArray:
    return np.asarray(catalog.image_scale)


def _places(catalog: Catalog, chart: ReliefMap, rows: Index) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Map coordinates of points and the direction of their north on the map, degrees clockwise."""
    x, y = chart.pixel(*chart.plane.places(catalog.position_mcmf[rows]))
    return x, y, chart.plane.north(catalog.longitude[rows], catalog.latitude[rows])


def _planes(catalog: Catalog, shown: Shown, suns: Index) -> tuple[float, list[AnyArray]]:
    """The smallest sigma, and the bytes of probability, sigma, axis ratio and direction."""

    def cut(name: str) -> AnyArray:
        whole = catalog.part(name, shown.rows, slice(0, len(shown.scales)))
        return np.asarray(whole[..., suns[:, 0], suns[:, 1]], dtype=np.float64)

    detection, major, minor, angle = (
        cut(f"{n}") for n in ("detection_probability", "sigma_major", "sigma_minor", "sigma_angle")
    )
    known = np.isfinite(major) & (major > 0.0)
    smallest = float(major[known].min()) if known.any() else 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        code = np.rint(np.log(major / smallest) / np.log(_SIGMA_RATIO))
        share = np.rint(254.0 * minor / major)
    return smallest, [
        packing("detection_probability", 1.0).packed(detection),
        *(_codes(plane, known) for plane in (code, share, angle)),
    ]


def _codes(values: AnyArray, known: AnyArray) -> AnyArray:
    """Bytes 0..254, `UNKNOWN` where not known."""
    sound = known & np.isfinite(values)
    return np.where(sound, np.clip(np.nan_to_num(values), 0, 254), UNKNOWN).astype(np.uint8)


def _enlargement(catalog: Catalog, shown: Shown, chart: ReliefMap) -> int:
    """Round factor by which ellipses are enlarged on the map."""
    sigma = catalog.part("sigma_major", shown.rows, 0)
    sigma = sigma[usable(catalog.part("condition", shown.rows)) & (sigma > 0.0)]
    if not len(sigma):
        return 1
    ideal = _ELLIPSE_PX / (float(np.median(sigma)) * chart.scale)
    return next((n for n in (1000, 500, 200, 100, 50, 20, 10, 5, 2) if n <= ideal), 1)


def _first_choice(condition: AnyArray) -> list[int]:
    """View and Sun shown first: the pair with the median number of usable points, so that the page
    shows the catalogue neither at its best nor at its worst.
    """
    works = ((condition & 31) == 31).sum(axis=0)
    order = np.argsort(works[0], kind="stable")
    return [0, int(order[len(order) // 2])] if len(order) else [0, 0]


CARDS_MAX = 60
"""Most patches on a page. Of more points a third are the best, a third the worst, and a third a
sample of the others.
"""

HOLES_MAX = 3000
"""Most cells without a point that the map shows."""

POINTS_MAX = 5000
"""Most points on the map; of more an even sample is shown."""

HOLES = {
    "featureless": ("ring", "too little texture to localise a point"),
    "ambiguous": ("cross", "localisable, but similar to other terrain within the search radius"),
    "dependent": ("triangle", "unique, but shadowed or hidden by terrain outside the patch"),
    "nodata": ("square", "no heights in the DEM"),
}
"""Symbol and meaning of a spacing cell without a point."""


def write_report(
    catalog: Catalog | Path | str,
    output: Path | str,
    overwrite: bool = False,
    moments: Callable[[Catalog], Sequence[LocatedBySun]] | None = None,
) -> None:
    """Write the report of a catalogue, or of its file; ``moments``: says how probably frames are located. Raises CatalogError
    for a catalogue that cannot be read, and the errors of `atomic_files.check_output`.
    """
    path = catalog.path if isinstance(catalog, Catalog) else catalog
    check_output(output, overwrite, [] if path is None else [path])
    opened = catalog if isinstance(catalog, Catalog) else open_catalog(catalog)
    name = "in memory" if path is None else Path(path).name
    html = render_report(opened, name, moments=moments(opened) if moments else ())
    write_bytes(output, html.encode("utf-8"), overwrite)


def render_report(
    catalog: Catalog, name: str, cards_max: int = CARDS_MAX, moments: Sequence[LocatedBySun] = ()
) -> str:
    """The report as HTML. Equal catalogues give equal text."""
    statistics = Statistics.of(catalog)
    found = summary(catalog, statistics)
    disc = SunDisc.of(catalog.sun_elevation, catalog.sun_azimuth, statistics.suns)
    chosen, sentence = _chosen(statistics, cards_max)
    holes = _holes(catalog)
    return page(
        "catalogue.html.j2",
        title=f"{catalog.title}: {name}",
        heading=catalog.title,
        below=name,
        steps=STEPS,
        disc_cells=disc.definitions(),
        found=found,
        percent=percent,
        latitude=latitude_name,
        summary=[
            (name, text)
            for name, text in summary_rows(found)
            if not name.startswith(" ") and name != "points"
        ],
        map=_map(catalog, statistics),
        holes=holes,
        top_deg=disc.top_deg,
        hole_note=_hole_note(catalog, holes),
        plane=catalog.overview.plane,
        catalog=catalog,
        points_max=POINTS_MAX,
        elevation_chart=_elevation_chart(found),
        promise=_promise(catalog, found),
        moments=moments,
        claims=_claims(catalog, statistics, disc),
        discs=[
            disc.draw(share, f"usable share by Sun direction, view {k}", large=True)
            for k, share in enumerate(statistics.by_view_and_sun)
        ],
        view_name=view_name,
        distributions=_distributions(catalog),
        chosen=sentence,
        cards=[_card(catalog, statistics, disc, int(i)) for i in chosen],
        schema_version=SCHEMA_VERSION,
        sources=[*catalog.sources, *(catalog.albedo_map or {}).get("files", [])],
        ties=_ties(catalog),
        scene_plan=json.dumps(catalog.scene_plan, indent=1, sort_keys=True, ensure_ascii=False),
    )


def _ties(catalog: Catalog) -> dict[str, str]:
    """How well the map of each product lies in the Moon's frame, for the page."""
    products = sorted(set(catalog.dem_product.tolist()))
    known = {name: tie_of(name) for name in products}
    return {
        name: f"{tie[0]:g} m (1 sigma, each axis; {tie[1]})"
        if tie
        else "no published error: positions count none"
        for name, tie in known.items()
    }


def _chart(catalog: Catalog) -> ReliefMap:
    view = catalog.overview
    if catalog.overview_levels:
        finest_first = (view, *catalog.overview_levels)
        view = next((one for one in finest_first if max(one.height.shape) <= MAP_PX), view)
    return ReliefMap(view.height, view.x, view.y, view.plane)


def _claims(catalog: Catalog, statistics: Statistics, disc: SunDisc) -> dict[str, Any] | None:
    """The section of the claims: its numbers as JSON, its map and its disc; None without points."""
    chart = _chart(catalog)
    found = claim_map(catalog, chart, statistics.suns)
    if found is None:
        return None
    sky = disc.draw(
        np.where(statistics.suns, 0.0, np.nan),
        "choice of the Sun's direction",
        large=True,
        element="sky",
    )
    errors = ", ".join(
        f"{name} {number(value) if isinstance(value, int | float) else value}"
        for name, value in catalog.errors.items()
    )
    return {
        "json": Markup(
            json.dumps(found, separators=(",", ":"))
        ),  # numbers, and texts of this package
        "map": chart.draw([], "map of the region"),
        "sky": sky,
        "shown": len(found["points"]),
        "of": len(catalog),
        "enlarged": found["enlarged"],
        "errors": errors,
        "least": catalog.min_detection,
    }


def _elevation_chart(found: dict[str, Any]) -> Markup | None:
    """Usable share by Sun elevation; None if nothing was evaluated."""
    rows = found["usable_by_sun_elevation"]
    if not rows:
        return None
    names = [f"{row['sun_elevation_deg']:g}°" for row in rows]
    bars = [
        (
            100.0 * row["usable_share"],
            f"{name}: {percent(row['usable_share'])}, {row['points_usable']} points",
        )
        for name, row in zip(names, rows, strict=True)
    ]
    title = "usable share by Sun elevation"
    return categories(names, bars, "Sun elevation", "usable, %", title, highest=100.0)


def _promise(catalog: Catalog, found: dict[str, Any]) -> dict[str, Any] | None:
    """The section of the promise: its figures, its worst Suns, and its chart against the number of
    points; None without one.
    """
    told, stored = found["promise"], catalog.promise
    if told is None or stored is None:
        return None
    chart = None
    if len(stored.size) > 1:
        last = float(stored.size[-1])
        axes = Axes(
            Axis(0.0, last, round_ticks(0.0, last, 6), "points"),
            Axis(0.0, 100.0, round_ticks(0.0, 100.0, 4), "conditions, %", grid=True),
            height=180.0,
            top=10.0,
        )
        sizes = [0, *stored.size.tolist()]
        line = axes.line(sizes, [0.0, *(100.0 * stored.met).tolist()], "line")
        chart = axes.draw(
            line, "share of the conditions that are served, against the number of points"
        )
    worst = [worst_text(sun) for sun in told["worst_suns"]]
    texts = {"promised": promised_text, "range": range_text}
    return {**told, **texts, "chart": chart, "worst": worst}


def _map(catalog: Catalog, statistics: Statistics) -> Markup:
    chart = _chart(catalog)
    marks = [*_hole_marks(catalog, chart), *_point_marks(catalog, statistics, chart)]
    return chart.draw(marks, "map of the control points")


def _point_marks(catalog: Catalog, statistics: Statistics, chart: ReliefMap) -> list[Mark]:
    rows = _sample(len(catalog), POINTS_MAX)
    places = np.stack(chart.plane.places(catalog.part("position_mcmf", rows)), axis=-1)
    shares = statistics.by_point[rows]
    return [
        Mark(
            float(places[i, 0]),
            float(places[i, 1]),
            "dot",
            shade_class(float(np.nan_to_num(shares[i]))),
            f"{catalog.point_id[rows[i]]}: {percent(shares[i])} usable",
        )
        for i in np.argsort(shares, kind="stable")
    ]


def _hole_marks(catalog: Catalog, chart: ReliefMap) -> list[Mark]:
    """Marks of the cells without a point, of at most `HOLES_MAX` of them, evenly chosen."""
    cells, names = (
        catalog.coverage,
        [COVERAGE_STATUS[int(code)] for code in catalog.coverage.status],
    )
    rows = np.array([row for row, name in enumerate(names) if name in HOLES], dtype=np.int64)
    rows = rows[:: _holes_step(len(rows))]
    x, y = chart.plane.at(cells.longitude[rows], cells.latitude[rows])
    return [
        Mark(float(x[k]), float(y[k]), HOLES[names[row]][0], "hole", names[row])
        for k, row in enumerate(rows)
    ]


def _holes_step(count: int) -> int:
    """Every how many-th of the cells without a point is drawn."""
    return max(1, -(-count // HOLES_MAX))


def _hole_note(catalog: Catalog, holes: list[dict[str, Any]]) -> str:
    """Words about the cells: their distance if they are a sample, and how many of them are drawn."""
    cells = catalog.coverage
    step = _holes_step(sum(hole["count"] for hole in holes))
    notes = []
    if cells.step_m is not None and cells.step_m > cells.spacing_m:
        notes.append(f"of cells {cells.step_m / 1e3:.3g} km apart, a sample")
    if step > 1:
        notes.append(f"one of {step} is drawn")
    return f" ({'; '.join(notes)})" if notes else ""


def _holes(catalog: Catalog) -> list[dict[str, Any]]:
    """Legend of the spacing cells without a point."""
    counts = coverage_counts(catalog)
    return [
        {"symbol": symbol(shape, "hole"), "name": name, "count": counts[name], "meaning": meaning}
        for name, (shape, meaning) in HOLES.items()
        if counts[name]
    ]


def _distributions(catalog: Catalog) -> list[Distribution]:
    return [
        distribution(
            catalog.localization_sigma[:, 0], "m", "Position uncertainty, 1 sigma, major axis"
        ),
        distribution(catalog.second_peak, "correlation", "Second peak of the correlation"),
        distribution(catalog.gsd, "m", "Cell size of the patches"),
        distribution(catalog.gsd_min, "m", "Finest usable image resolution"),
        distribution(catalog.gsd_max, "m", "Coarsest usable image resolution"),
    ]


def _chosen(statistics: Statistics, most: int) -> tuple[AnyArray, str]:
    """Indices of the points with a card, best first, and a sentence about the choice."""
    order = np.argsort(-np.nan_to_num(statistics.by_point), kind="stable")
    if len(order) <= most:
        return order, f"All {len(order)} points, sorted by usable share."
    third = most // 3
    last = len(order) - third
    between = order[third:last]
    sample = between[np.linspace(0, len(between) - 1, most - 2 * third).astype(int)]
    text = (
        f"{most} of {len(order)} points: the {third} with the largest usable share, the {third} with the "
        "smallest, and an even sample of the others."
    )
    return np.concatenate([order[:third], sample, order[last:]]), text


def _card(catalog: Catalog, statistics: Statistics, disc: SunDisc, i: int) -> dict[str, Any]:
    """One point's patch, Sun directions and figures."""
    share, sigma = float(statistics.by_point[i]), catalog.localization_sigma[i]
    sort_keys = {
        "usable": -share,
        "sigma": float(sigma[0]),
        "peak": float(catalog.second_peak[i]),
        "id": int(catalog.point_id[i]),
    }
    label = f"Sun directions for which point {catalog.point_id[i]} is usable"
    return {
        "row": i,
        "usable": share,
        "sort_keys": {k: v if np.isfinite(v) else 1e300 for k, v in sort_keys.items()},
        "relief": data_uri(hillshade(catalog.part("dem", i), float(catalog.gsd[i]))),
        "disc": disc.draw(share_by_sun(catalog, i), label),
    }
