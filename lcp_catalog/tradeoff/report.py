"""A measured trade for people: the page, the table to paste, and which tier to use when, by rules that are stated."""

# ruff: noqa: E501 - lines of markup and style

from __future__ import annotations

import json
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..atomic_files import check_folder, write_bytes
from ..catalog.summary import latitude_name
from ..plots.html_page import header, page
from ..plots.svg import data_uri, number
from .law_report import models_markdown, models_section
from .measurement import Picture, Trade
from .pareto_plot import pareto

Row = dict[str, Any]

SAVING = 0.1
"""A tier that takes at least this share less time counts as faster; of tiers nearer together the more exact one is named."""

POINTS_SHARE, CONDITIONS_SHARE = 0.02, 0.01
"""Lost and gained points, and changed conditions, up to which a catalogue counts as the same for most uses."""

FILES = ("trade.json", "trade.html", "trade.md")

RULES = (
    "“The same” means: no node, no point and no condition differs from reference; “nearly the same”: at most "
    f"{100 * POINTS_SHARE:g} % of the points lost or gained and at most {100 * CONDITIONS_SHARE:g} % of the conditions changed. Of the tiers that "
    f"qualify the fastest is named; against a more exact one it must save at least {100 * SAVING:g} %. Time is CPU time, which on an idle machine is wall time."
)

HELD_EQUAL = (
    "Held equal in every tier: the Sun is a point, each view a bundle of parallel rays, one Sun direction serves a group of points, and "
    "independence (the patch alone against all terrain) is judged by exact rays. Only shadows and occlusion in the images differ."
)


def check_trade_folder(folder: Path, overwrite: bool) -> None:
    """Say early what would fail late. Raises as `files.check_folder`."""
    check_folder(folder, FILES, overwrite)


def write_trade(trade: Trade, folder: Path, overwrite: bool = False) -> None:
    """Write ``trade.json``, ``trade.html`` and ``trade.md`` into a folder, which is made where it is missing. Raises as `files.check_folder`."""
    check_trade_folder(folder, overwrite)
    document = trade.document() | {"advice": advice(trade.rows)}
    folder.mkdir(exist_ok=True)
    texts = (json.dumps(document, indent=2) + "\n", render_trade(trade), markdown(trade))
    for name, text in zip(FILES, texts, strict=True):
        write_bytes(folder / name, text.encode("utf-8"), overwrite)


# -- which tier when


def advice(rows: list[Row]) -> list[str]:
    """Sentences on which tier to use when, from the rows by `RULES`."""
    exact = rows[-1]
    same = _pick(rows, "cpu_seconds", _same)
    near = _pick(rows, "cpu_seconds", _nearly_same)
    quick = _pick(rows, "cpu_seconds", lambda row: True)
    image = _pick(rows, "render_seconds", lambda row: row["sunlit_error_share"] == 0.0)
    glance = _pick(rows, "render_seconds", lambda row: True)
    return [
        f"For a catalogue that must be the same as reference’s: {same['accuracy']}, {_cost(same, exact)}.",
        f"For a catalogue that is nearly the same: {near['accuracy']}, {_cost(near, exact)}; {_felt(near)}.",
        f"For a first look at a region: {quick['accuracy']}, {_cost(quick, exact)}; {_felt(quick)}.",
        f"For images without one wrong node: {image['accuracy']}, {_times(image['render_relative'])} of the time of reference’s images.",
        f"For images at a glance: {glance['accuracy']}, {_times(glance['render_relative'])} of that time, with "
        f"{_share(glance['sunlit_error_share'])} of the nodes wrong.",
    ]


def _pick(rows: list[Row], cost: str, fits: Callable[[Row], bool]) -> Row:
    """The most exact of the fitting rows whose cost is within `SAVING` of the cheapest; the reference always fits."""
    fitting = [row for row in rows if fits(row)]
    limit = min(row[cost] for row in fitting) / (1.0 - SAVING)
    return [row for row in fitting if row[cost] <= limit][-1]


def _same(row: Row) -> bool:
    wrong = ("sunlit_error_share", "visible_error_share", "points_lost", "points_gained", "conditions_changed_share")  # fmt: skip
    return not any(row[name] for name in wrong)


def _nearly_same(row: Row) -> bool:
    points = row["points"] + row["points_lost"] - row["points_gained"]
    changed = row["points_lost"] + row["points_gained"]
    return (
        changed <= POINTS_SHARE * points
        and (row["conditions_changed_share"] or 0.0) <= CONDITIONS_SHARE
    )


def _cost(row: Row, exact: Row) -> str:
    if row is exact:
        return f"as no other tier that qualifies saves {100 * SAVING:g} %"
    return f"at {_times(row['cpu_relative'])} of reference’s time"


def _felt(row: Row) -> str:
    before = row["points"] + row["points_lost"] - row["points_gained"]
    changed = _share(row["conditions_changed_share"])
    return (
        f"{row['points_lost']} of {before} points lost, {row['points_gained']} gained, "
        f"{changed} of the conditions changed"
    )


def _times(ratio: float) -> str:
    return f"{ratio:.2f}" if ratio >= 0.095 else f"{ratio:.3f}"


def _share(share: float | None) -> str:
    """A share in per cent, with a nought only for none at all."""
    if share is None:
        return "–"
    return f"{np.format_float_positional(100.0 * share, precision=2, fractional=False, trim='-')} %"


# -- the table


def _change(change: dict[str, float | None], factor: float = 1.0) -> str:
    return " / ".join("–" if v is None else number(factor * v, 2) for v in change.values())


def _memory(row: Row) -> str:
    if row["memory_mb"] is None:
        return "–"
    return f"{row['memory_mb']:.0f} ({row['memory_base_mb']:.0f})"


def _relative(row: Row) -> str:
    low, high = row["seconds_relative_range"]
    return f"{_times(row['seconds_relative'])} ({_times(low)}..{_times(high)})"


COLUMNS: tuple[tuple[str, str, Callable[[Row], str]], ...] = (
    ("accuracy", "the tier", lambda r: r["accuracy"]),
    ("seconds", "wall time of the areas, all of a build’s work, one thread", lambda r: f"{r['seconds']:.2f}"),
    ("of reference", "the same as a share of reference’s, lowest and highest round in brackets", _relative),
    ("CPU seconds", "the process’s own time of the same; on a machine that does other work trust this one", lambda r: f"{r['cpu_seconds']:.2f}"),
    ("of reference", "the same as a share of reference’s", lambda r: _times(r["cpu_relative"])),
    ("images, s", "all images once: shadows, occlusion, light", lambda r: f"{r['render_seconds']:.2f}"),
    ("of reference", "the same as a share of reference’s", lambda r: _times(r["render_relative"])),
    ("MB", "peak memory of the process, in brackets what it held before its first area", _memory),
    ("sunlit wrong", "share of (node, Sun) pairs whose lit state differs", lambda r: _share(r["sunlit_error_share"])),
    ("at an edge", "share of these within two nodes of a shadow’s edge", lambda r: _share(r["sunlit_error_near_edge_share"])),
    ("bound", "what the tier promises for cast shadows", lambda r: _share(r["bound"])),
    ("occlusion wrong", "share of (node, view) pairs whose visibility differs", lambda r: _share(r["visible_error_share"])),
    ("radiance rmse", "root mean square difference of the radiance factor over nodes seen in both, as a share of the mean", lambda r: _share(r["radiance_rmse"])),
    ("points", "control points of these areas", lambda r: str(r["points"])),
    ("lost", "points of reference that this tier has not", lambda r: str(r["points_lost"])),
    ("gained", "points of this tier that reference has not", lambda r: str(r["points_gained"])),
    ("moved", "lost points with a gained one within half a spacing", lambda r: str(r["points_moved"])),
    ("conditions changed", "share of conditions, of candidates in both, that are usable in one only", lambda r: _share(r["conditions_changed_share"])),
    ("sigma change, m", "of points in both, worst usable condition: median / 95th percentile", lambda r: _change(r["localization_sigma_change_m"])),
    ("%", "the same relative to sigma", lambda r: _change(r["localization_sigma_change_share"], 100.0)),
)  # fmt: skip
"""Heading, meaning and text of every column of the table."""


def markdown(trade: Trade) -> str:
    """The table for a document: what was compared, one line a column, one column a tier, and the advice."""
    names = [row["accuracy"] for row in trade.rows]
    lines = [
        compared_line(trade.compared),
        "",
        f"| | {' | '.join(names)} |",
        "| --- |" + " ---: |" * len(names),
    ]
    for heading, meaning, text in COLUMNS[1:]:
        lines.append(
            f"| **{heading}**: {meaning} | {' | '.join(text(row) for row in trade.rows)} |"
        )
    said = [f"- {sentence}" for sentence in advice(trade.rows)]
    return "\n".join([*lines, "", *said, "", RULES, "", *models_markdown(trade.models)])


def compared_line(compared: dict[str, Any]) -> str:
    """What was compared, in one paragraph."""
    region, suns = compared["region"], compared["suns"]
    low, high = min(compared["sun_elevations_deg"]), max(compared["sun_elevations_deg"])
    many = f"{suns[0]}" if len(suns) == 1 else f"{suns[0]} to {suns[-1]}"
    rounds = "1 round" if compared["rounds"] == 1 else f"{compared['rounds']} rounds"
    side_by_side = (
        "each tier in a process of its own"
        if compared["own_process"]
        else "all tiers in one process"
    )
    return (
        f"{', '.join(compared['dems'])}; region around {region['center_lon'] % 360.0:.4g}° E, {latitude_name(region['center_lat'])}, "
        f"cells of {number(compared['gsd_m'], 4)} m; {compared['areas']} of {compared['areas_of']} areas "
        f"({sum(compared['area_nodes']):,} nodes without halo); {many} Suns that can happen, elevations {low:g} to {high:g}°; "
        f"{compared['views']} views; {compared['reflectance']}. {compared['threads']} thread, {side_by_side}, tiers in turn, "
        f"median of {rounds} after one that does not count."
    )  # fmt: skip


# -- the page


def render_trade(trade: Trade) -> str:
    """The page as HTML that refers to nothing outside itself."""
    compared = trade.compared
    sentences = "".join(f"<li>{escape(sentence)}</li>" for sentence in advice(trade.rows))
    body = [
        header("Speed against accuracy", compared_line(compared)),
        f"<section><h2>Which tier when</h2><ul class='advice'>{sentences}</ul><p class='file'>{escape(RULES)}</p></section>",
        f"<section><h2>Price and error</h2><figure>{pareto(trade.rows)}<figcaption>Filled: a build’s whole work on the areas; ring: the "
        "images alone. Matching and localisation cost the same in every tier, so whole areas lie closer together than "
        "their images.</figcaption></figure></section>",
        f"<section><h2>The figures</h2>{_table(trade.rows)}<p class='file'>{escape(HELD_EQUAL)}</p></section>",
        _picture_section(trade.picture) if trade.picture else "",
        models_section(trade.models),
        "<section><h2>As data</h2><details><summary>What was compared</summary>"
        f"<pre>{escape(json.dumps(compared, indent=1))}</pre></details></section>",
    ]
    return page(f"Speed against accuracy: {', '.join(compared['dems'])}", body, _STYLE)


def _table(rows: list[Row]) -> str:
    """One row a figure, one column a tier: it stays narrow enough for a telephone."""
    head = "".join(f"<th scope='col'>{escape(row['accuracy'])}</th>" for row in rows)
    lines = "".join(
        f"<tr><th scope='row'>{escape(heading)}<span>{escape(meaning)}</span></th>"
        + "".join(f"<td>{escape(text(row))}</td>" for row in rows)
        + "</tr>"
        for heading, meaning, text in COLUMNS[1:]
    )
    return f"<div class='wide'><table><thead><tr><td></td>{head}</tr></thead><tbody>{lines}</tbody></table></div>"


def _picture_section(picture: Picture) -> str:
    rows, cols = picture.lit.shape
    figures = [("reference: lit and dark", _lit_pixels(picture.lit, 25, 230))]
    for tier, wrong in picture.wrong.items():
        count = int(np.count_nonzero(wrong))
        figures.append((f"{tier}: {count} wrong", _wrong_pixels(picture.lit, wrong)))
    shown = "".join(
        f"<figure><img src='{data_uri(pixels)}' alt='{escape(text)}'><figcaption><b>{escape(text)}</b></figcaption></figure>"
        for text, pixels in figures
    )
    return (
        "<section><h2>Where they differ</h2>"
        f"<p>Area {escape(picture.area)}, Sun {picture.sun_elevation_deg:g}° high at azimuth {picture.sun_azimuth_deg:g}°: the lowest Sun at "
        f"which a tier is wrong, and of that area the {cols} x {rows} nodes with the most of them. Wrong nodes are drawn three nodes wide: "
        "<b class='over'>red</b> lit where reference is dark, <b class='under'>blue</b> dark where it is lit.</p>"
        f"<div class='pictures'>{shown}</div></section>"
    )


def _lit_pixels(lit: NDArray[np.int8], dark: int, light: int) -> NDArray[np.uint8]:
    """RGBA; no ground is transparent."""
    grey = np.where(lit > 0, light, dark).astype(np.uint8)
    return np.stack([grey, grey, grey, np.where(lit < 0, 0, 255).astype(np.uint8)], axis=-1)


def _wrong_pixels(lit: NDArray[np.int8], wrong: NDArray[np.int8]) -> NDArray[np.uint8]:
    pixels = _lit_pixels(lit, 120, 205)
    for sign, colour in ((1, (214, 39, 40, 255)), (-1, (31, 96, 196, 255))):
        pixels[_widened(wrong == sign)] = colour
    return pixels


def _widened(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The nodes of a mask and their eight neighbours."""
    padded = np.pad(mask, 1)
    rows, cols = mask.shape
    steps = [(i, j) for i in range(3) for j in range(3)]
    return np.any([padded[i : i + rows, j : j + cols] for i, j in steps], axis=0)


_STYLE = """
:root{--over:#c62320;--under:#1f5fc0;--dot:#2a788e}
@media (prefers-color-scheme:dark){:root{--over:#ff6b66;--under:#7eb0ff;--dot:#4bb3cd}}
main{max-width:1040px}p{max-width:80ch}.file{font-size:.9rem}
.advice{padding-left:20px;max-width:80ch}.advice li{margin:4px 0}
svg{width:100%;max-width:760px;height:auto;font-size:13px}svg .name{fill:var(--ink);font-weight:600}
.axis,.grid{fill:none;stroke:var(--line)}.axis{stroke:var(--soft)}.whole{fill:var(--dot);stroke:var(--bg)}.images{fill:var(--bg);stroke:var(--dot);stroke-width:2}
.tie{stroke:var(--dot);stroke-dasharray:3 4;stroke-opacity:.7}.front{fill:none;stroke:var(--dot);stroke-width:1.5;stroke-opacity:.55}
th[scope=row]{white-space:normal;min-width:190px}th span{display:block;font-weight:400;font-size:.8rem;color:var(--soft);line-height:1.35}
.pictures{display:grid;grid-template-columns:repeat(auto-fit,minmax(220px,1fr));gap:14px;margin-top:12px}.pictures img{width:100%;image-rendering:pixelated;border-radius:4px;border:1px solid var(--line)}
.over{color:var(--over)}.under{color:var(--under)}
"""
