"""Every public photograph at hand in one table and on one page: located or not, windows, claims, metres; figure 4 of the paper.

    make evidence
    .venv/bin/python benchmarks/evidence.py [-o build/evidence] [--data FOLDER] [--only NAME ...] [--suns]

The photographs are not in the repository: `--data` or the environment variable LCP_SHARED_DATA names their folder. Written are
`evidence.html` (table, pictures and histograms), `evidence.md` (the tables of docs/measurements/evidence.md) and the pictures.
Catalogues and finished photographs are kept in the folder and used again. `--suns` adds the measurement of wrong Suns
(`evidence_suns.py`). About 10 minutes of one core; as much again with `--suns`.
"""

from __future__ import annotations

import argparse
import html
import json
import os
import sys
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]
for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import cv2
import numpy as np
from claims import shared_data
from claims_photographs import ALBEDO
from evidence_cases import NEEDED, Case, cases
from markupsafe import Markup
from rasterio.errors import NotGeoreferencedWarning

from lcp_catalog.cameras.camera_file import read_sensor
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import LcpError
from lcp_catalog.images.image_file import ImageOptions, open_image
from lcp_catalog.images.pixels import image_shape
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.plots.axes import Axes, Axis, round_ticks
from lcp_catalog.plots.numbers import typeset
from lcp_catalog.plots.pictures import grey, shrunk
from lcp_catalog.validation.ground_comparison import RenderSettings, WindowChoice, against_dem
from lcp_catalog.validation.report_pictures import COLOURS, correlation_class
from lcp_catalog.validation.result import ImageVerdict, plain
from lcp_catalog.validation.run import Validation, run_validation
from lcp_catalog.validation.window_correlation import WindowComparison

LAW = "lunar-lambert"
PAPER = {"a": (0.89, 0.985), "b": (0.84, 0.985)}
"""Share of windows above 0.9 and mode, Pivovarchuk et al. (2026), figure 4: a, the image reduced to the cells of the DEM; b, image
and render on cells finer than the DEM's."""
SHARE = 0.9
BIN, LOWEST = 0.01, -0.2
PICTURE_PX = 300
STYLE = (
    "svg{background:#fff;font:13px system-ui,sans-serif;fill:#333}.grid{stroke:#ddd}.axis{fill:none;stroke:#888}"
    ".middle{text-anchor:middle}.end{text-anchor:end}.bar{fill:#8aa8cf}.high{fill:#1f5fbf}"
    ".paper{fill:none;stroke:#c05a00;stroke-width:1.5;stroke-dasharray:5 3}.note{fill:#c05a00}.own{fill:#1f5fbf}"
)


@dataclass(frozen=True, eq=False)
class Row:
    """One photograph: the figures of the table, correlations of the windows, and the picture's file."""

    name: str
    figures: dict[str, Any]
    coarse: np.ndarray  # (n,) at the DEM's resolution
    fine: np.ndarray  # (m,) on cells finer than the DEM's; empty where there are none
    picture: Path | None


# -- one photograph


def judged(case: Case, data: Path, folder: Path) -> Row:
    """The row of a case; from the folder if it is finished there."""
    stem = "_".join("".join(c for c in case.name if c not in "(),").split())
    figures, arrays = folder / f"{stem}.json", folder / f"{stem}.npz"
    picture = folder.parent / "pictures" / f"{stem}.jpg"
    if not figures.exists():
        found, coarse, fine, drawn = _validated(case, data)
        if drawn is not None:
            picture.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(picture), drawn)
        np.savez(arrays, coarse=coarse, fine=fine)
        figures.write_text(json.dumps(plain(found), indent=1), encoding="utf-8")
        print(f"{case.name}: {found['verdict']}", file=sys.stderr, flush=True)
    with np.load(arrays) as saved:
        return Row(
            case.name,
            json.loads(figures.read_text(encoding="utf-8")),
            saved["coarse"],
            saved["fine"],
            picture if picture.exists() else None,
        )


def _validated(
    case: Case, data: Path
) -> tuple[dict[str, Any], np.ndarray, np.ndarray, np.ndarray | None]:
    """Figures, correlations at and below the resolution, and the picture."""
    catalog = case.catalog()
    head = {"licence": case.licence, "truth": case.truth, "off_m": None}
    nothing = np.empty(0)
    if catalog is None:
        return head | {"verdict": "no catalogue"}, nothing, nothing, None
    albedo = AlbedoMap.open(data / ALBEDO, "linear") if case.albedo else None
    request = Validation(
        catalog,
        (case.files,),
        case.uncertainty,
        (case.dem,),
        sun=case.sun,
        model=reflectance_model(LAW),
        albedo=albedo,
        pixels=ImageOptions(encoding=case.encoding),
    )
    result = run_validation(request)
    verdict = result.verdict.images[0]
    figures = head | verdict.figures()
    if verdict.pose is not None and case.off_m is not None:
        figures["off_m"] = case.off_m(verdict.pose.pose)
    if verdict.windows is None:
        return figures, nothing, nothing, None
    w = verdict.windows.compared
    shown = result.pictures[0]
    drawn = picture(shown.ground_image, shown.ground_render, w)
    return figures, w.correlation, _fine(case, verdict, albedo), drawn


def _fine(case: Case, verdict: ImageVerdict, albedo: AlbedoMap | None) -> np.ndarray:
    """Correlations on cells of half the DEM's posting, or of the image's pixel if that is larger; empty where these are not
    finer than two thirds of the cells before.
    """
    dems = DemSet.open([case.dem])
    cell_m = max(0.5 * dems.dems[0].gsd_m, verdict.facts.pixel_m)
    if not (verdict.pose and cell_m < 0.66 * verdict.windows.compared.gsd_m):
        return np.empty(0)
    files = case.files
    sensor = read_sensor(files.camera, image_shape(files.image)) if files.camera else None
    image = open_image(files.image, sensor, case.sun, ImageOptions(encoding=case.encoding))
    image = image.with_sensor(verdict.pose.pose.sensor)
    settings = RenderSettings(reflectance_model(LAW), albedo=albedo)
    try:
        return against_dem(image, dems, settings, WindowChoice(gsd_m=cell_m)).windows.correlation
    except LcpError as error:
        print(f"{case.name}: {error}", file=sys.stderr)
        return np.empty(0)


# -- drawings


def picture(image: np.ndarray, render: np.ndarray, windows: WindowComparison) -> np.ndarray:
    """Image, render and map of correlations beside each other, BGR; every photograph is as high."""
    scale = PICTURE_PX / image.shape[0]
    seen, model = (shrunk(values) for values in (image, render))
    panels = [_on_white(grey(a, b)) for a, b in ((seen, model), (model, seen))]
    values = windows.map(image.shape)
    colours = np.array(COLOURS, np.uint8)[correlation_class(np.nan_to_num(values))][..., ::-1]
    panels.append(np.where(np.isfinite(values)[..., None], colours, 255).astype(np.uint8))
    size = max(1, round(image.shape[1] * scale)), PICTURE_PX
    how = [cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC] * 2 + [cv2.INTER_NEAREST]
    panels = [cv2.resize(p, size, interpolation=h) for p, h in zip(panels, how, strict=True)]
    gap = np.full((PICTURE_PX, 6, 3), 255, np.uint8)
    return np.hstack([panels[0], gap, panels[1], gap, panels[2]])


def _on_white(pixels: np.ndarray) -> np.ndarray:
    """BGR of grey and opacity (rows, cols, 2)."""
    return np.repeat(np.where(pixels[..., 1:] > 0, pixels[..., :1], 255), 3, axis=-1)


def figures_of(correlation: np.ndarray) -> WindowComparison:
    """The windows' correlations alone, for share and mode."""
    none = np.zeros(len(correlation), np.int64)
    flat = np.ones(len(correlation))
    return WindowComparison(16, 16, 1.0, none, none, correlation, flat, flat, "kept")


def histogram(correlation: np.ndarray, part: str, title: str) -> Markup:
    """Figure 4 again: share of the windows over their correlation, and the paper's mode and share."""
    edges = np.arange(LOWEST, 1.0 + BIN / 2, BIN)
    counts, _ = np.histogram(np.clip(correlation, LOWEST, 1.0), edges)
    shares = 100.0 * counts / len(correlation)
    top = max(10.0, 10.0 * np.ceil(shares.max() / 10.0))
    axes = Axes(
        Axis(LOWEST, 1.0, [(v / 5, f"{v / 5:g}") for v in range(-1, 6)], "correlation"),
        Axis(0.0, top, round_ticks(0.0, top, 5), "share of the windows, %", grid=True),
        width=330.0,
        height=150.0,
        top=62.0,
    )
    bars = axes.bars(
        (low, low + BIN, share, "high" if low > SHARE - 1e-9 else "bar", f"{share:.1f} %")
        for low, share in zip(edges[:-1], shares, strict=True)
        if share
    )
    share, mode = PAPER[part]
    x = float(axes.at(mode, 0.0)[0])
    own = figures_of(correlation)
    plural = "s" * (own.count != 1)
    text = Markup(
        '<path class="paper" d="M{x:.1f} 0V{h:g}"/><text class="own" x="0" y="-28">{own:.0%} above 0.9, mode {m:.3f}, '
        '{n} window{s}</text><text class="note" x="0" y="-11">paper: {share:.0%} above 0.9, mode {mode}</text>'
        '<text x="0" y="-46">{title}</text>'
    ).format(
        x=x, h=axes.height, own=own.share_above(SHARE), m=own.mode, n=own.count, s=plural, share=share,
        mode=mode, title=title,
    )  # fmt: skip
    return axes.draw(bars + text, f"{title}: histogram of correlations", STYLE)


# -- tables


HEAD = (
    "| photograph | Sun, deg | pixel, m | result | points found | off, m (stated) | windows | > 0.9 | > 0.7 | mode | "
    "usable points found | Brier (of the mean) |\n"
    + "| --- |"
    + " ---: |" * 2
    + " --- |"
    + " ---: |" * 8
)


def cells(row: Row) -> list[str]:
    """One line of the table."""
    f = row.figures
    if "windows" not in f:
        return [row.name, "", "", f["verdict"], *[""] * 8]
    by = " jointly" if f["located_by"] == "the ground as a whole" else ""
    off = (
        "" if f["off_m"] is None else f"{f['off_m']:.2g}" if f["off_m"] < 1 else f"{f['off_m']:.0f}"
    )
    sigma = f["pose"]["position_sigma_m"] if f["pose"] else None
    stated = "" if sigma is None else f" ({sigma:.2g})" if sigma < 1 else f" ({sigma:.0f})"
    w, claims = f["windows"], f["claims"]
    scored = bool(claims["count"])
    return [
        row.name,
        _or_none(f["sun"]["elevation_deg"], ".0f"),
        _or_none(f["pixel_m"], ".0f" if (f["pixel_m"] or 0.0) >= 100.0 else ".3g"),
        f["verdict"] + by,
        f"{f['points_found']} of {f['points_in_view']}",
        off + stated,
        str(w["count"]),
        _or_none(w["share_above_0_9"], ".0%"),
        _or_none(w["share_above_0_7"], ".0%"),
        f"{figures_of(row.coarse).mode:.3f}" if len(row.coarse) else "-",
        f"{_or_none(claims['found_of_usable'], '.2f')} of {claims['usable']}" if scored else "",
        f"{claims['brier']:.3f} ({claims['brier_of_the_mean']:.3f})" if scored else "",
    ]


def _or_none(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def table(rows: Iterable[Row]) -> str:
    return "\n".join([HEAD, *(f"| {' | '.join(cells(row))} |" for row in rows)]) + "\n"


def figure_4(rows: Iterable[Row]) -> str:
    """Share above 0.9 and mode beside the paper's; maps are left out, whose pixels are no finer than the DEM."""
    lines = [
        "| | windows, at the DEM's resolution | > 0.9 | mode | windows, finer than the DEM | > 0.9 | mode |",
        "| --- |" + " ---: |" * 6,
        "| Pivovarchuk et al. (2026), figure 4 | - | 89 % | 0.985 | - | 84 % | 0.985 |",
    ]
    for row in rows:
        found = [figures_of(row.coarse), figures_of(row.fine)]
        if found[1].count:
            parts = [f"{w.count} | {w.share_above(SHARE):.0%} | {w.mode:.3f}" for w in found]
            lines.append(f"| {row.name} | {' | '.join(parts)} |")
    return "\n".join(lines) + "\n"


def failures(rows: Iterable[Row]) -> str:
    """What the product said of every photograph that it did not locate."""
    return "".join(
        f"- {row.name}: {row.figures['verdict']}"
        + (f": {row.figures['reason']}" if row.figures.get("reason") else "")
        + "\n"
        for row in rows
        if row.figures["verdict"] != "located"
    )


def summary(rows: list[Row]) -> str:
    located = [row for row in rows if row.figures["verdict"] == "located"]
    off = [row.figures["off_m"] for row in located if row.figures["off_m"] is not None]
    good = sum(float(np.mean(row.coarse > 0.7)) >= 0.5 for row in rows if len(row.coarse))
    return (
        f"{len(located)} of {len(rows)} are located; at least half of the windows correlate above 0.7 in {good} of "
        f"{sum(len(row.coarse) > 0 for row in rows)}; the largest error of a located one is {max(off, default=0):.0f} m.\n"
    )


# -- the page


PAGE_STYLE = """:root{color-scheme:light dark}body{font:15px system-ui;max-width:75rem;margin:1rem auto;padding:0 1rem}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:13px}td,th{padding:2px 8px;border-bottom:1px solid #8886;
text-align:right}td{white-space:nowrap}td:first-child,th:first-child{text-align:left}img{max-width:100%}svg{width:26rem;max-width:100%}"""


def page(rows: list[Row], folder: Path, more: Iterable[str]) -> str:
    """A page with the table, and picture and histograms of each photograph, those that failed first. ``more``: Markdown
    that follows (figure 4, wrong Suns).
    """
    lines = [
        "<!doctype html><html lang='en'><meta charset='utf-8'><meta name='viewport' content='width=device-width'>"
        f"<title>Photographs</title><style>{PAGE_STYLE}</style><h1>Every photograph</h1>",
        as_html(summary(rows)),
        as_html(LEGEND),
        as_html(table(rows)),
        as_html(PANELS),
    ]
    for row in sorted(rows, key=lambda row: row.figures["verdict"] == "located"):
        f = row.figures
        lines.append(f"<h2>{html.escape(row.name)}: {html.escape(f['verdict'])}</h2>")
        lines.append(as_html(f"{f.get('reason') or ''} ({f['licence']})"))
        if row.picture:
            name = row.picture.relative_to(folder).as_posix()
            lines.append(f"<img src='{name}' alt='photograph, render, correlation'>")
        lines += [str(drawing) for drawing in drawings(row).values()]
    return "\n".join([*lines, *map(as_html, more), "</html>\n"])


LEGEND = (
    "Off: distance of the solved position from the known one, in brackets its stated sigma. Windows: 16 x 16 cells at the "
    "DEM's true resolution; the share that correlates above 0.9 and 0.7 with a render, and the mode. Usable points found: of "
    "the points claimed usable. Brier: score of the claimed probabilities, in brackets that of their mean."
)
PANELS = (
    "Below: photograph, render of the DEM, correlation of the windows (yellow above 0.95, light green above 0.9, green above "
    "0.8, dark below 0.5, white without one). The photographs that are not located come first."
)


def as_html(markdown: str) -> str:
    """Paragraphs and tables of Markdown, powers of ten raised."""
    parts = []
    for block in markdown.strip().split("\n\n"):
        lines = html.escape(typeset(block)).splitlines()
        if not lines[0].startswith("|"):
            parts.append(f"<p>{' '.join(lines)}</p>")
            continue
        cells = [line.strip("|").split("|") for line in lines if not line.startswith("| ---")]
        body = ["".join(f"<td>{cell.strip()}</td>" for cell in row) for row in cells]
        body[0] = body[0].replace("td>", "th>")
        parts.append(f"<div class='wide'><table><tr>{'<tr>'.join(body)}</table></div>")
    return "\n".join(parts)


def sheet(rows: list[Row]) -> str:
    """SVG of the histograms of several photographs, one row each."""
    pairs = [list(drawings(row).values()) for row in rows]
    wide, high = 430, 280
    parts = [
        str(drawing).replace(
            "<svg", f'<svg x="{wide * column}" y="{high * line}" width="{wide}" height="{high}"', 1
        )
        for line, pair in enumerate(pairs)
        for column, drawing in enumerate(pair)
    ]
    box = f'viewBox="0 0 {2 * wide} {high * len(pairs)}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {box} role="img">{"".join(parts)}</svg>\n'


def drawings(row: Row) -> dict[str, Markup]:
    titles = {"a": "at the DEM's resolution", "b": "finer than the DEM"}
    values = {"a": row.coarse, "b": row.fine}
    return {
        part: histogram(values[part], part, f"{row.name}, {title}")
        for part, title in titles.items()
        if len(values[part])
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build" / "evidence")
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--only", nargs="*", default=[""], help="names that begin so")
    parser.add_argument("--suns", action="store_true", help="measure wrong Suns, too")
    asked = parser.parse_args()
    missing = [name for name in NEEDED if not (asked.data / name).exists()]
    if missing:
        sys.exit(
            f"evidence: {asked.data}: has no {', '.join(missing)}: give the folder of the lunar data by --data or LCP_SHARED_DATA"
        )
    warnings.filterwarnings("ignore", category=NotGeoreferencedWarning)
    folder = asked.output / "rows"
    folder.mkdir(parents=True, exist_ok=True)
    chosen = [
        case
        for case in cases(asked.data, asked.output / "catalogues")
        if case.name.startswith(tuple(asked.only))
    ]
    rows = [judged(case, asked.data, folder) for case in chosen]
    both = [row for row in rows if len(row.fine)]
    (asked.output / "figure_4.svg").write_text(sheet(both), encoding="utf-8")
    parts = [summary(rows), table(rows), "Not located:\n", failures(rows)]
    more = ["Figure 4 of the paper, and the same of these photographs:\n", figure_4(both)]
    _write(asked.output, rows, parts, more)
    if asked.suns:
        from evidence_suns import report

        more += ["Suns wrong by 10 deg:\n", report(chosen, asked.data, asked.output / "suns")]
        _write(asked.output, rows, parts, more)
    print("\n".join([*parts, *more]))


def _write(folder: Path, rows: list[Row], parts: list[str], more: list[str]) -> None:
    """The tables as Markdown, and the page."""
    (folder / "evidence.md").write_text("\n".join([*parts, *more]), encoding="utf-8")
    (folder / "evidence.html").write_text(page(rows, folder, more), encoding="utf-8")


if __name__ == "__main__":
    main()
