"""The report of a validation as one page that needs nothing but itself: docs/report-of-validation.md says what each part means."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from html import escape
from typing import Any

from ..catalog.summary import percent
from ..matching.position_fix import BY_GROUND
from ..matching.sun_check import LightCheck
from ..plots.greyscale import Pictures
from ..plots.html_page import facts, header, page, tiles
from ..plots.svg import number
from . import report_marks, window_charts
from .report_points import points_section, residuals_section, table_section
from .report_pose import pose_section
from .report_windows import windows_section
from .result import ImageVerdict, Verdict, plain


def render(verdict: Verdict, pictures: Sequence[Pictures]) -> str:
    """HTML that refers to nothing outside itself, one of ``pictures`` for each image; equal content gives equal text."""
    names = ", ".join(image.facts.name for image in verdict.images)
    catalog = str(verdict.catalog.get("name", ""))
    body = [
        header("Catalogue against images", f"{catalog}: {names}"),
        _overview(verdict),
        *(
            _image_section(k, image, shown)
            for k, (image, shown) in enumerate(zip(verdict.images, pictures, strict=True))
        ),
        _data_section(verdict),
    ]
    style = report_marks.STYLE + window_charts.STYLE + STYLE
    return page(f"Validation of {catalog}: {names}", body, style, _SCRIPT)


def _overview(verdict: Verdict) -> str:
    """A line for each of several images."""
    if len(verdict.images) < 2:
        return ""
    lines = "".join(
        f"<tr><th scope='row'><a href='#image-{k}'>{escape(image.facts.name)}</a></th><td>{_badge(image)}</td>"
        + "".join(f"<td>{escape(text)}</td>" for text in _overview_cells(image))
        + "</tr>"
        for k, image in enumerate(verdict.images)
    )
    head = "".join(
        f"<th scope='col'>{name}</th>"
        for name in ("", "verdict", "points found", "windows above 0.9", "1 sigma, m", "error, m")
    )
    return (
        f"<section><h2>All images</h2><div class='wide'><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{lines}</tbody></table></div></section>"
    )


def _overview_cells(image: ImageVerdict) -> tuple[str, ...]:
    w = image.windows.compared if image.windows else None
    pose = image.pose
    return (
        f"{int(image.matches.found.sum())} of {len(image.matches)}",
        percent(w.share_above(0.9)) if w and w.count else "–",
        number(pose.pose.position_sigma_m) if pose else "–",
        _maybe(pose.position_error_m) if pose else "–",
    )


def _badge(image: ImageVerdict) -> str:
    return f"<b class='badge {image.verdict.replace(' ', '-')}'>{escape(image.verdict)}</b>"


def _image_section(k: int, image: ImageVerdict, shown: Pictures) -> str:
    reason = f" {escape(image.reason)}" if image.reason else ""
    parts = [
        f"<h2>{escape(image.facts.name)}</h2><p class='said'>{_badge(image)}{reason}</p>",
        tiles(_tiles(image)),
        facts(_facts(image)),
        windows_section(k, image, shown),
        points_section(image, shown),
        pose_section(image.pose, residuals_section(image)),
        table_section(image),
    ]
    return f"<section class='image' id='image-{k}'>" + "\n".join(filter(None, parts)) + "</section>"


def _tiles(image: ImageVerdict) -> list[tuple[str, str]]:
    found: dict[str, Any] = plain(image.figures())
    count = f"{found['points_found']} of {found['points_in_view']}"
    what = "points in view were found" if image.pose else "points in view match, each by itself"
    shown = [(count, what) if found["points_in_view"] else ("0", "control points are in view")]
    if found["points_found"]:
        px, metres = found["offset_px"]["median"], found["offset_m"]["median"]
        shown.append(
            (f"{_maybe(px)} px", f"median offset from the given camera, {_maybe(metres)} m")
        )
    if image.pose is not None:
        error = image.pose.position_error_m
        known = "" if error is None else f"; its error is {number(error)} m"
        shown.append((f"{number(image.pose.pose.position_sigma_m)} m", f"position, 1 sigma{known}"))
    if image.windows is not None and image.windows.compared.count:
        w = image.windows.compared
        text = f"of {w.count} windows of {w.size} x {w.size} cells correlate above 0.9"
        shown.append((percent(w.share_above(0.9)), text))
    return shown


def _facts(image: ImageVerdict) -> list[tuple[str, str]]:
    f, w = image.facts, image.windows
    sun = f"azimuth {f.sun_azimuth_deg:.1f}°, elevation {f.sun_elevation_deg:.1f}°"
    origin = f" ({f.sun_from})" if f.sun_from else ""
    rows = [
        ("image", f"{f.width_px} x {f.height_px} pixels of {_maybe(f.pixel_m)} m"),
        ("taken by", f.sensor),
        ("Sun", sun + origin if math.isfinite(f.sun_elevation_deg) else ""),
        ("off nadir", f"{f.off_nadir_deg:.1f}°" if math.isfinite(f.off_nadir_deg) else ""),
        ("saturated", percent(f.saturated_share) if f.saturated_share > 0 else ""),
        ("without data", percent(f.missing_share) if f.missing_share > 0 else ""),
        ("by chance", _chance(image)),
        ("Sun, checked", _light(image.located.light)),
        ("rendered", w.against if w else ""),
        ("compared at", f"{number(w.compared.gsd_m, 4)} m: {w.resolution}" if w else ""),
        ("offset", w.offset_sentence if w else ""),
    ]
    return [(name, text) for name, text in rows if text]


def _chance(image: ImageVerdict) -> str:
    """How far the agreement of the points, or of the ground as a whole, is from chance."""
    known, rival = image.located.log10_false_alarms, image.located.rival_log10
    whole = image.located.by == BY_GROUND
    if not (whole or image.matches.found.any()) or not math.isfinite(known):
        return ""
    random = "of images of other ground" if whole else "of random matches"
    return f"{random} 10^{known:.0f} such agreements are expected; of the next best place’s 10^{rival:.0f}"


def _light(check: LightCheck | None) -> str:
    """Median correlation of the points under the stated Sun and under others."""
    if check is None:
        return ""
    others = ", ".join(
        f"{number(value)} ({_turn(*turn)})"
        for turn, value in zip(check.turns_deg, check.correlations, strict=True)
    )
    says = "fits" if check.fits else "does not fit"
    if check.law:
        says += f" (rendered with {check.law}, which the image is more like)"
    return f"{says}: median correlation {number(check.correlation)}; under other Suns {others}"


def _turn(turned_deg: float, raised_deg: float) -> str:
    parts = [(turned_deg, "turned"), (raised_deg, "raised")]
    return ", ".join(f"{how} {by:+g}°" for by, how in parts if by)


def _maybe(value: float | None) -> str:
    return number(math.nan if value is None else value)


def _data_section(verdict: Verdict) -> str:
    document = verdict.document()
    said = {name: document[name] for name in ("catalog", "options", "software")}
    text = json.dumps(said, indent=1, ensure_ascii=False)
    return (
        "<section><h2>As data</h2>"
        "<p class='file'>report.json beside this page holds these figures, the CSV files every point and window.</p>"
        f"<details><summary>Catalogue and options</summary><pre>{escape(text)}</pre></details></section>"
    )


STYLE = """
.part{font-size:1.05rem;margin:30px 0 8px}.said{font-size:1.02rem}.image{border-top:1px solid var(--line);margin-top:40px}
a{color:inherit}.image h2{margin-top:28px;overflow-wrap:anywhere}
.badge{display:inline-block;padding:1px 10px;border-radius:999px;color:#fff;background:#8a5a00;font-weight:600}
.badge.located{background:#0f6f47}.badge.not-this-place{background:#ad1f1c}
.drawn{display:grid;gap:8px 24px;align-items:start}@media (min-width:900px){.drawn{grid-template-columns:minmax(0,1.75fr) 1fr}}
.image thead th:first-child{text-align:left}.image div>dl{margin-top:14px;font-size:.92rem}
.columns{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,420px),1fr));gap:26px;align-items:start;margin-top:14px}
.look{margin-top:6px}.look>input[type=radio]{position:absolute;opacity:0}
.look>label{display:inline-block;margin:0 4px 8px 0;padding:2px 12px;border:1px solid var(--line);border-radius:999px;
background:var(--card);cursor:pointer;font-size:.9rem}
.look>input:checked+label{background:var(--ink);color:var(--bg)}.look>input:focus-visible+label{outline:2px solid #3b82f6}
.look .for-swipe,.swipe{display:none}.scripted .look .for-swipe{display:inline-block}
.scripted .to-swipe:checked~.swipe{display:block;width:100%;max-width:820px;margin:4px 0 8px}
.stack{display:grid;gap:14px;grid-template-columns:repeat(auto-fit,minmax(min(100%,300px),1fr));align-items:start}
.look>:not(.to-side):checked~.stack{grid-template-columns:minmax(0,820px)}
.look>:not(.to-side):checked~.stack .layer{grid-area:1/1;visibility:hidden}
.look>.to-image:checked~.stack .image,.look>.to-render:checked~.stack .render,.look>.to-correlation:checked~.stack .correlation,
.look>.to-blink:checked~.stack .image,.look>.to-blink:checked~.stack .render,
.look>.to-swipe:checked~.stack .image,.look>.to-swipe:checked~.stack .render{visibility:visible}
.look>.to-blink:checked~.stack .image{z-index:1;background:var(--bg);animation:blink 1.4s step-end infinite}
@keyframes blink{50%{opacity:0}}
.look>.to-swipe:checked~.stack .image{z-index:1;background:var(--bg);clip-path:inset(0 calc(100% - var(--cut,50%)) 0 0)}
.pairs{display:grid;grid-template-columns:repeat(auto-fill,minmax(130px,1fr));gap:12px;margin-top:8px}
.pairs div{display:grid;grid-template-columns:1fr 1fr;gap:2px}.pairs img{width:100%;aspect-ratio:1;background:var(--void)}
.pairs figcaption{font-size:.74rem;overflow-wrap:anywhere}.layer.image,.layer.render{border:0;margin:0}
.classes{display:flex;flex-wrap:wrap;gap:2px 18px;list-style:none;padding:0;margin:4px 0}
.classes .within1{color:var(--good)}.classes .within3{color:var(--mid)}.classes .beyond3{color:var(--bad)}
.tall{max-height:560px;overflow:auto}.sortable{font-size:.84rem;font-variant-numeric:tabular-nums}
.sortable thead th{position:sticky;top:0;background:var(--bg);padding:4px 6px}.sortable td{padding:3px 8px}
.sortable button{all:unset;font-weight:600}.scripted .sortable button{cursor:pointer}
.scripted .sortable button:focus-visible{outline:2px solid #3b82f6}
.sortable [aria-sort=ascending] button::after{content:" ▲"}.sortable [aria-sort=descending] button::after{content:" ▼"}
.not-found td{color:var(--soft)}.sortable td:last-child,.sortable th:last-child{text-align:left}
@media print{.tall{max-height:none}.look>input,.look>label,.swipe{display:none!important}
.look>input:checked~.stack{grid-template-columns:repeat(3,1fr)!important}
.look>input:checked~.stack .layer{grid-area:auto!important;visibility:visible!important;
animation:none!important;clip-path:none!important}}
"""

_SCRIPT = """
document.documentElement.classList.add('scripted');
document.querySelectorAll('.swipe').forEach(s=>s.addEventListener('input',()=>s.parentNode.style.setProperty('--cut',s.value+'%')));
document.querySelectorAll('.sortable').forEach(table=>{const body=table.tBodies[0],heads=[...table.tHead.rows[0].cells];
heads.forEach((head,k)=>head.firstChild.addEventListener('click',()=>{
const up=head.getAttribute('aria-sort')!=='ascending';heads.forEach(h=>h.removeAttribute('aria-sort'));
head.setAttribute('aria-sort',up?'ascending':'descending');
const key=row=>{const text=row.cells[k].textContent,value=parseFloat(text);return Number.isNaN(value)?(text==='–'?null:text):value};
[...body.rows].map(row=>[key(row),row]).sort((a,b)=>a[0]===null?(b[0]===null?0:1):b[0]===null?-1:
(a[0]<b[0]?-1:a[0]>b[0]?1:0)*(up?1:-1)).forEach(pair=>body.append(pair[1]))}))});
"""
