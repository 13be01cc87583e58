"""The report: a catalogue for people, as a page that needs nothing but itself."""

# ruff: noqa: E501 - lines of markup and style

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import AnyArray
from ..atomic_files import check_output, write_bytes
from ..geometry.frames import EnuFrame, lonlat_to_mcmf
from ..plots.html_page import facts, header, page, tiles
from ..plots.svg import (
    STEPS,
    Map,
    Mark,
    SunDisc,
    data_uri,
    hillshade,
    histogram,
    number,
    shade_class,
    symbol,
)
from .hdf5 import Catalog, open_catalog
from .schema import COVERAGE_STATUS
from .summary import (
    Statistics,
    coverage_counts,
    latitude_name,
    percent,
    summary,
    summary_rows,
    view_name,
)

CARDS_MAX = 60
"""Patches that a page shows; of more points a third are the best, a third the worst, a third a
sample between.
"""

HOLES = {
    "featureless": ("ring", "hole", "nothing that localises"),
    "ambiguous": (
        "cross",
        "hole",
        "localises, but looks like other ground within the search radius",
    ),
    "dependent": ("triangle", "hole", "unique, but shadowed or hidden by relief outside the patch"),
    "nodata": ("square", "hole", "no heights in the elevation model"),
}
"""Symbol, class and meaning of a spacing cell without a point."""


def write_report(catalog_path: Path | str, output: Path | str, overwrite: bool = False) -> None:
    """Draw a catalogue as one page. Raises CatalogError for a catalogue that cannot be read, and
    as `files.check_output` does.
    """
    check_output(output, overwrite)
    page = render_report(open_catalog(catalog_path), Path(catalog_path).name)
    write_bytes(output, page.encode("utf-8"), overwrite)


def render_report(catalog: Catalog, name: str, cards_max: int = CARDS_MAX) -> str:
    """The page as HTML that refers to nothing outside itself; equal catalogues give equal text."""
    statistics, found = Statistics(catalog), summary(catalog)
    disc = SunDisc(catalog.sun_elevation, catalog.sun_azimuth)
    body = [
        header(catalog.title, name),
        _facts(found),
        _map_section(catalog, statistics),
        _validity_section(statistics, found, disc),
        _figures_section(catalog),
        _cards_section(catalog, statistics, disc, cards_max),
        _provenance(catalog),
    ]
    return page(f"{catalog.title}: {name}", body, _STYLE, _SCRIPT, disc.definitions())


def _facts(found: dict[str, Any]) -> str:
    sigma, coverage = found["localization_sigma_m"], found["coverage"]
    ground = sum(coverage.values()) - coverage["nodata"]
    figures = [
        (str(found["points"]), "control points"),
        (percent(found["usable_share"]), "of the evaluated conditions are usable"),
        (
            "–" if sigma is None else f"{number(sigma['median'])} m",
            "median localisation, 1 sigma, worst usable condition",
        ),
        (
            percent(coverage["point"] / ground if ground else None),
            "of the spacing cells with ground have a point near",
        ),
    ]
    rows = [
        (name.strip(), text)
        for name, text in summary_rows(found)
        if not name.startswith(" ") and name != "points"
    ]
    return f"<section>{tiles(figures)}{facts(rows)}</section>"


def _map_section(catalog: Catalog, statistics: Statistics) -> str:
    view = catalog.overview
    chart = Map(view.height, view.x, view.y, EnuFrame(view.center_lon, view.center_lat))
    drawn = chart.draw(
        [*_hole_marks(catalog, chart), *_point_marks(catalog, statistics, chart)],
        "map of the control points",
    )
    return (
        "<section><h2>Where the points are</h2>"
        f"<figure>{drawn}<figcaption>{_ramp('usable share of a point’s evaluated conditions')}{_hole_legend(catalog)}"
        "<p>Relief lit from the north-west, 45° high; north is up at the centre (orthographic).</p></figcaption></figure></section>"
    )


def _point_marks(catalog: Catalog, statistics: Statistics, chart: Map) -> list[Mark]:
    places = chart.frame.from_mcmf(catalog.position_mcmf)
    order = np.argsort(statistics.by_point, kind="stable")
    return [
        Mark(
            float(places[i, 0]),
            float(places[i, 1]),
            "dot",
            shade_class(float(np.nan_to_num(statistics.by_point[i]))),
            f"{catalog.point_id[i]}: {percent(statistics.by_point[i])} usable",
        )
        for i in order
    ]


def _hole_marks(catalog: Catalog, chart: Map) -> list[Mark]:
    cells = catalog.coverage
    places = chart.frame.from_mcmf(lonlat_to_mcmf(cells.longitude, cells.latitude))
    return [
        Mark(float(x), float(y), *HOLES[COVERAGE_STATUS[int(code)]][:2], COVERAGE_STATUS[int(code)])
        for (x, y, _), code in zip(places, cells.status, strict=True)
        if COVERAGE_STATUS[int(code)] in HOLES
    ]


def _hole_legend(catalog: Catalog) -> str:
    counts = coverage_counts(catalog)
    entries = "".join(
        f"<li>{symbol(shape, css)} <b>{name}</b> {counts[name]}: {meaning}</li>"
        for name, (shape, css, meaning) in HOLES.items()
        if counts[name]
    )
    return (
        f"<p>Cells without a point near:</p><ul class='holes'>{entries}</ul>"
        if entries
        else "<p>No holes.</p>"
    )


def _ramp(text: str) -> str:
    boxes = "".join(f"<i class='b{k}'></i>" for k in range(STEPS))
    return (
        f"<p class='ramp'><span>{text}:</span> <span class='scale-of'>0 % {boxes} 100 %</span></p>"
    )


def _validity_section(statistics: Statistics, found: dict[str, Any], disc: SunDisc) -> str:
    figures = "".join(
        f"<figure>{disc.draw(share, f'usable share by Sun, view {k}', large=True)}"
        f"<figcaption><b>{escape(view_name(view)).capitalize()}</b><br>{percent(view['usable_share'])} usable</figcaption></figure>"
        for k, (share, view) in enumerate(
            zip(statistics.by_view_and_sun, found["views"], strict=True)
        )
    )
    return (
        "<section><h2>Under which Suns they serve</h2><p>The Sun’s sky over a point: the outer circle is the horizon, the centre the zenith, "
        "azimuth clockwise from north. Coloured cells were evaluated; elsewhere the Sun never comes.</p>"
        f"{_ramp('share of the points that are usable')}<div class='discs'>{figures}</div></section>"
    )


def _figures_section(catalog: Catalog) -> str:
    charts = [
        ("Localisation, 1 sigma, major axis (m)", catalog.localization_sigma[:, 0], "m"),
        ("Second peak of correlation", catalog.second_peak, ""),
        ("Cell size of the patches (m)", catalog.gsd, "m"),
        ("Coarsest useful image resolution (m)", catalog.gsd_max, "m"),
    ]
    figures = "".join(
        f"<figure><h3>{title}</h3>{histogram(values, unit, title)}</figure>"
        for title, values, unit in charts
    )
    return (
        "<section><h2>How well they work</h2><p>Localisation and second peak are those of each point’s worst usable condition.</p>"
        f"<div class='histograms'>{figures}</div></section>"
    )


def _chosen(statistics: Statistics, most: int) -> tuple[AnyArray, str]:
    """Which points get a card, best first, and the sentence that says so."""
    order = np.argsort(-np.nan_to_num(statistics.by_point), kind="stable")
    if len(order) <= most:
        return order, f"All {len(order)} points, the most widely usable first."
    third = most // 3
    between = order[third:-third]
    sample = between[np.linspace(0, len(between) - 1, most - 2 * third).astype(int)]
    text = f"{most} of {len(order)} points: the {third} most widely usable, the {third} least, and an even sample between."
    return np.concatenate([order[:third], sample, order[-third:]]), text


def _cards_section(catalog: Catalog, statistics: Statistics, disc: SunDisc, most: int) -> str:
    chosen, text = _chosen(statistics, most)
    if not len(chosen):
        return "<section><h2>The patches</h2><p>The catalogue has no points.</p></section>"
    orders = (
        ("usable", "share usable"),
        ("sigma", "sigma"),
        ("peak", "second peak"),
        ("id", "identifier"),
    )
    options = "".join(f"<option value='{value}'>{name}</option>" for value, name in orders)
    cards = "".join(_card(catalog, statistics, disc, int(i)) for i in chosen)
    views = len(catalog.view_off_nadir)
    discs = "share of the views" if views > 1 else "usable or not"
    return (
        f"<section><h2>The patches</h2><p>{text} Relief lit from the north-west; the disc is the Sun’s sky over the point ({discs}).</p>"
        f"<p class='sort'><label>Order by <select id='order'>{options}</select></label></p><div class='cards' id='cards'>{cards}</div></section>"
    )


def _card(catalog: Catalog, statistics: Statistics, disc: SunDisc, i: int) -> str:
    picture = data_uri(hillshade(catalog.dem[i], float(catalog.gsd[i])))
    share, sigma = float(statistics.by_point[i]), catalog.localization_sigma[i]
    size_km = (catalog.patch_nodes - 1) * float(catalog.gsd[i]) / 1e3
    rows = (
        (
            "place",
            f"{catalog.longitude[i]:.4f}° E, {latitude_name(catalog.latitude[i])}",
        ),
        ("elevation", f"{catalog.elevation[i]:.0f} m"),
        ("usable", percent(share)),
        ("sigma", f"{number(float(sigma[0]))} x {number(float(sigma[1]))} m"),
        ("second peak", number(float(catalog.second_peak[i]))),
        ("false match", number(float(catalog.false_match_probability[i]), 2)),
        (
            "image",
            f"{number(float(catalog.gsd_min[i]))} to {number(float(catalog.gsd_max[i]))} m/px",
        ),
    )
    facts = "".join(f"<dt>{name}</dt><dd>{text}</dd>" for name, text in rows)
    keys = {
        "usable": -share,
        "sigma": float(sigma[0]),
        "peak": float(catalog.second_peak[i]),
        "id": int(catalog.point_id[i]),
    }
    data = " ".join(
        f'data-{name}="{json.dumps(value) if np.isfinite(value) else 1e300}"'
        for name, value in keys.items()
    )
    small = disc.draw(
        statistics.by_point_and_sun[i], f"Suns under which point {catalog.point_id[i]} is usable"
    )
    return (
        f'<article {data}><h3>{catalog.point_id[i]}</h3><div class="pair"><img src="{picture}" alt="relief of the patch, {number(size_km)} km wide"'
        f">{small}</div><dl>{facts}</dl></article>"
    )


def _provenance(catalog: Catalog) -> str:
    sources = "".join(
        f"<li><b>{escape(str(s.get('name', '')))}</b>, {escape(str(s.get('size', '')))} bytes<br><code>sha256 {escape(str(s.get('sha256', '')))}</code></li>"
        for s in [*catalog.sources, *(catalog.albedo_map or {}).get("files", [])]
    )
    plan = json.dumps(catalog.scene_plan, indent=1, sort_keys=True, ensure_ascii=False)
    return (
        "<section><h2>Where it comes from</h2>"
        f"<p>Made by lcp-catalog {escape(catalog.software_version)}, schema {escape(catalog.schema_version)}, from:</p><ul class='sources'>{sources}</ul>"
        f"<details><summary>Configuration</summary><pre>{escape(catalog.config)}</pre></details>"
        f"<details><summary>What was modelled, and why</summary><pre>{escape(plan)}</pre></details></section>"
    )


_STYLE = """
:root{--r0:#440f54;--r1:#414487;--r2:#2a788e;--r3:#22a884;--r4:#7ad151;--r5:#f2d91c}
@media (prefers-color-scheme:dark){:root{--r0:#6b2a80;--r1:#5560ad}}
.map{width:100%;height:auto;font-size:14px}.frame{fill:none;stroke:var(--line)}
.graticule polyline{fill:none;stroke:#fff;stroke-opacity:.35;stroke-width:1}.scale path{fill:none;stroke:var(--ink);stroke-width:1.6}
.halo{fill:none;stroke:#111;stroke-width:3.2;stroke-opacity:.75}.hole{fill:none;stroke:#ffe9c9;stroke-width:1.4}
.c0{fill:var(--r0)}.c1{fill:var(--r1)}.c2{fill:var(--r2)}.c3{fill:var(--r3)}.c4{fill:var(--r4)}.c5{fill:var(--r5)}
.marks .c0,.marks .c1,.marks .c2,.marks .c3,.marks .c4,.marks .c5{stroke:#fff;stroke-width:1}
.holes{list-style:none;padding:0;margin:4px 0;display:grid;gap:2px}.key{display:inline-block;width:18px;height:18px;vertical-align:-4px;background:#77787c;border-radius:3px}
.ramp{display:flex;flex-wrap:wrap;gap:2px 10px;align-items:center}.scale-of{display:inline-flex;align-items:center;gap:2px;white-space:nowrap}
.ramp i{display:inline-block;width:26px;height:12px;border-radius:2px}.ramp i:first-of-type{margin-left:6px}.ramp i:last-of-type{margin-right:6px}
.b0{background:var(--r0)}.b1{background:var(--r1)}.b2{background:var(--r2)}.b3{background:var(--r3)}.b4{background:var(--r4)}.b5{background:var(--r5)}
.horizon{fill:var(--void);stroke:var(--soft);stroke-width:.8}.disc use{stroke:var(--bg);stroke-width:.7}
.ring{fill:none;stroke:var(--soft);stroke-width:.5;stroke-dasharray:2 3}.tick,.axis{stroke:var(--soft);fill:none}.small{font-size:9px}
.disc .names text{text-anchor:middle}
.discs{display:grid;grid-template-columns:repeat(auto-fit,minmax(240px,1fr));gap:18px;margin-top:12px}.discs .disc{width:100%;max-width:340px;margin:0 auto}
.discs figcaption{text-align:center}
.histograms{display:grid;grid-template-columns:repeat(auto-fit,minmax(230px,1fr));gap:24px;margin-top:14px}.histogram{width:100%;max-width:420px}
.bars rect{fill:var(--r2)}.ticks text{text-anchor:middle;font-size:11px}.single strong{font-size:1.3rem}
.cards{display:grid;grid-template-columns:repeat(auto-fill,minmax(250px,1fr));gap:14px;margin-top:10px}
article{background:var(--card);border:1px solid var(--line);border-radius:8px;padding:12px}article dl{font-size:.8rem;gap:0 10px;margin-top:8px}
.pair{display:grid;grid-template-columns:1fr 1fr;gap:8px;align-items:center}.pair img{width:100%;aspect-ratio:1;border-radius:4px;background:var(--void)}
.pair .disc{width:100%}.sources{padding-left:18px}
@media (max-width:520px){article dl{grid-template-columns:max-content 1fr}article dl dd{margin:0}.map{font-size:25px}}
"""

_SCRIPT = """
document.getElementById('order')?.addEventListener('change',e=>{const box=document.getElementById('cards'),key=e.target.value;
[...box.children].sort((a,b)=>a.dataset[key]-b.dataset[key]).forEach(c=>box.append(c))});
"""
