"""Every public photograph at hand in one table: located or not, windows, claims, metres; figure 4 of the paper.

    python -m benchmarks.evidence photographs [-o FOLDER] [--data FOLDER] [--only NAME ...]

The photographs are not in the repository: `--data` or the environment variable LCP_SHARED_DATA names their folder. Written are
`evidence.md` (the tables of docs/measurements/evidence.md), `figure_4.svg` (histograms) and in `pictures` photograph, render and
correlation of the windows (yellow above 0.95, light green above 0.9, green above 0.8, dark below 0.5, white without one).
Catalogues and finished photographs are kept in the folder and used again. About 10 minutes of one core.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning

from benchmarks.evidence.cases import Case, chosen
from benchmarks.evidence.catalogues import ALBEDO, LAW
from benchmarks.evidence.scores import STYLE, arrays, bins_table, kept, scores_table, together_table
from benchmarks.markdown import table
from benchmarks.sections import evidence_parser
from lcp_catalog.arrays import Array
from lcp_catalog.cameras.camera_file import read_sensor
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import LcpError
from lcp_catalog.images.image_file import ImageOptions, open_image
from lcp_catalog.images.pixels import image_shape
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.plots.axes import Axes, Axis, round_ticks
from lcp_catalog.plots.pictures import grey, shrunk
from lcp_catalog.validation.claims import Claims
from lcp_catalog.validation.ground_comparison import (
    RenderSettings,
    WindowChoice,
    WindowComparison,
    against_dem,
)
from lcp_catalog.validation.report_pictures import COLOURS, correlation_class
from lcp_catalog.validation.result import ImageVerdict, plain
from lcp_catalog.validation.run import Validation, run_validation

PAPER = {"a": (0.89, 0.985), "b": (0.84, 0.985)}
"""Share of windows above 0.9 and mode, Pivovarchuk et al. (2026), figure 4: a, the image reduced to the cells of the DEM; b, image
and render on cells finer than the DEM's."""
SHARE = 0.9
Picture = NDArray[np.uint8]
BIN, LOWEST = 0.01, -0.2
PICTURE_PX = 300


@dataclass(frozen=True, eq=False)
class Row:
    """One photograph: the figures of the table, and correlations of the windows."""

    name: str
    figures: dict[str, Any]
    kind: str
    coarse: Array  # (n,) plain, as the paper's, at the DEM's resolution
    fine: Array  # (m,) plain, on cells finer than the DEM's; empty where there are none
    claims: Claims


# -- one photograph


def judged(case: Case, data: Path, folder: Path) -> Row:
    """The row of a case; from the folder if it is finished there."""
    stem = "_".join("".join(c for c in case.name if c not in "(),").split())
    figures, pixels = folder / f"{stem}.json", folder / f"{stem}.npz"
    picture = folder.parent / "pictures" / f"{stem}.jpg"
    if not figures.exists():
        found, coarse, fine, claims, drawn = _validated(case, data)
        if drawn is not None:
            picture.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(picture), drawn)
        np.savez(pixels, coarse=coarse, fine=fine, **arrays(claims))
        figures.write_text(json.dumps(plain(found), indent=1), encoding="utf-8")
        print(f"{case.name}: {found['verdict']}", file=sys.stderr, flush=True)
    with np.load(pixels) as saved:
        return Row(
            case.name,
            json.loads(figures.read_text(encoding="utf-8")),
            case.kind,
            saved["coarse"],
            saved["fine"],
            kept(saved),
        )


def _validated(
    case: Case, data: Path
) -> tuple[dict[str, Any], Array, Array, Claims, Picture | None]:
    """Figures, correlations of plain windows at and below the resolution, claims, and the picture."""
    catalog = case.catalog()
    head = {"licence": case.licence, "truth": case.truth, "off_m": None}
    nothing = np.empty(0)
    if catalog is None:
        return head | {"verdict": "no catalogue"}, nothing, nothing, Claims.none(), None
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
        pose_is_known=case.known,
    )
    result = run_validation(request)
    verdict = result.verdict.images[0]
    figures = head | verdict.figures()
    if verdict.pose is not None and case.off_m is not None:
        figures["off_m"] = case.off_m(verdict.pose.pose)
    shown = result.pictures[0]
    if verdict.windows is None or shown.ground_image is None or shown.ground_render is None:
        return figures, nothing, nothing, verdict.claims, None
    drawn = picture(shown.ground_image, shown.ground_render, verdict.windows.compared)
    coarse = verdict.windows.plain.correlation
    return figures, coarse, _fine(case, verdict, albedo), verdict.claims, drawn


def _fine(case: Case, verdict: ImageVerdict, albedo: AlbedoMap | None) -> Array:
    """Plain correlations on cells of half the DEM's posting, or of the image's pixel if that is larger; empty where these are not
    finer than two thirds of the cells before.
    """
    dems = DemSet.open([case.dem])
    cell_m = max(0.5 * dems.dems[0].gsd_m, verdict.facts.pixel_m)
    if not (verdict.pose and verdict.windows and cell_m < 0.66 * verdict.windows.compared.gsd_m):
        return np.empty(0)
    files = case.files
    sensor = read_sensor(files.camera, image_shape(files.image)) if files.camera else None
    image = open_image(files.image, sensor, case.sun, ImageOptions(encoding=case.encoding))
    image = image.with_sensor(verdict.pose.pose.sensor)
    settings = RenderSettings(reflectance_model(LAW), albedo=albedo)
    try:
        return against_dem(image, dems, settings, WindowChoice(gsd_m=cell_m)).plain.correlation
    except LcpError as error:
        print(f"{case.name}: {error}", file=sys.stderr)
        return np.empty(0)


# -- drawings


def picture(image: Array, render: Array, windows: WindowComparison) -> Picture:
    """Image, render and map of correlations beside each other, BGR; every photograph is as high."""
    scale = PICTURE_PX / image.shape[0]
    seen, model = (shrunk(values) for values in (image, render))
    panels = [_on_white(grey(a, b)) for a, b in ((seen, model), (model, seen))]
    values = windows.map(image.shape)
    colours = np.array(COLOURS, np.uint8)[correlation_class(np.nan_to_num(values))][..., ::-1]
    panels.append(np.where(np.isfinite(values)[..., None], colours, 255).astype(np.uint8))
    size = max(1, round(image.shape[1] * scale)), PICTURE_PX
    how = [cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC] * 2 + [cv2.INTER_NEAREST]
    panels = [
        np.asarray(cv2.resize(p, size, interpolation=h), np.uint8)
        for p, h in zip(panels, how, strict=True)
    ]
    gap = np.full((PICTURE_PX, 6, 3), 255, np.uint8)
    return np.hstack([panels[0], gap, panels[1], gap, panels[2]])


def _on_white(pixels: Picture) -> Picture:
    """BGR of grey and opacity (rows, cols, 2)."""
    return np.repeat(np.where(pixels[..., 1:] > 0, pixels[..., :1], 255), 3, axis=-1)


def figures_of(correlation: Array) -> WindowComparison:
    """The windows' correlations alone, for share and mode."""
    none = np.zeros(len(correlation), np.int64)
    flat = np.ones(len(correlation))
    return WindowComparison(16, 16, 1.0, none, none, correlation, flat, flat, "kept")


def histogram(correlation: Array, part: str, title: str) -> Markup:
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
    "photograph", "Sun, deg", "pixel, m", "result", "points found", "off, m (stated)", "windows", "> 0.9", "> 0.9 plain",
    "> 0.7", "mode", "usable points found", "Brier (of the mean)",
)  # fmt: skip


def cells(row: Row) -> list[str]:
    """One line of the table."""
    f = row.figures
    if "windows" not in f:
        return [row.name, "", "", f["verdict"], *[""] * 9]
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
        _or_none(f["windows_plain"]["share_above_0_9"], ".0%"),
        _or_none(w["share_above_0_7"], ".0%"),
        _or_none(w["mode"], ".3f"),
        f"{_or_none(claims['found_of_usable'], '.2f')} of {claims['usable']}" if scored else "",
        f"{claims['brier']:.3f} ({claims['brier_of_the_mean']:.3f})" if scored else "",
    ]


def _or_none(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def figure_4(rows: Iterable[Row]) -> str:
    """Share above 0.9 and mode of plain windows beside the paper's; maps are left out, whose pixels are no finer than the DEM."""
    lines = [["Pivovarchuk et al. (2026), figure 4", "-", "89 %", "0.985", "-", "84 %", "0.985"]]
    for row in rows:
        found = [figures_of(row.coarse), figures_of(row.fine)]
        parts = [[str(w.count), f"{w.share_above(SHARE):.0%}", f"{w.mode:.3f}"] for w in found]
        lines.append([row.name, *parts[0], *parts[1]])
    head = [
        "",
        "windows, at the DEM's resolution",
        "> 0.9",
        "mode",
        "windows, finer than the DEM",
        "> 0.9",
        "mode",
    ]
    return table(head, lines) + "\n"


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
    good = [row.figures["windows"]["share_above_0_7"] >= 0.5 for row in rows if len(row.coarse)]
    return (
        f"{len(located)} of {len(rows)} are located; at least half of the windows correlate above 0.7 in {sum(good)} of "
        f"{len(good)}; the largest error of a located one is {max(off, default=0):.0f} m.\n"
    )


# -- the sheet of histograms


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
    box = f'style="width:auto" viewBox="0 0 {2 * wide} {high * len(pairs)}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {box} role="img">{"".join(parts)}</svg>\n'


def drawings(row: Row) -> dict[str, Markup]:
    titles = {"a": "at the DEM's resolution", "b": "finer than the DEM"}
    values = {"a": row.coarse, "b": row.fine}
    return {
        part: histogram(values[part], part, f"{row.name}, {title}")
        for part, title in titles.items()
        if len(values[part])
    }


def by_kind(rows: list[Row]) -> dict[str, list[Claims]]:
    """Claims of the photographs of each kind."""
    kinds = dict.fromkeys(row.kind for row in rows)
    return {kind: [row.claims for row in rows if row.kind == kind] for kind in kinds}


def main(words: Sequence[str]) -> int:
    parser = evidence_parser("photographs", __doc__)
    parser.add_argument("--only", nargs="*", default=[""], help="names that begin so")
    asked = parser.parse_args(words)
    warnings.filterwarnings("ignore", category=NotGeoreferencedWarning)
    folder = asked.output / "rows"
    folder.mkdir(parents=True, exist_ok=True)
    some = chosen(asked.data, asked.output / "catalogues", asked.only)
    rows = [judged(case, asked.data, folder) for case in some]
    both, claims = [row for row in rows if len(row.fine)], by_kind(rows)
    (asked.output / "figure_4.svg").write_text(sheet(both), encoding="utf-8")
    parts = [summary(rows), table(HEAD, map(cells, rows)), "\nNot located:\n", failures(rows)]
    parts += ["Claims by kind:\n", scores_table(claims) + "\n", bins_table(claims) + "\n"]
    parts += [together_table(claims) + "\n"]
    parts += ["Figure 4 of the paper, and the same of these photographs:\n", figure_4(both)]
    text = "\n".join(parts)
    (asked.output / "evidence.md").write_text(text, encoding="utf-8")
    print(text)
    return 0
