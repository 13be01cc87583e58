"""The report of a speed-accuracy measurement: HTML page, Markdown table, and recommended tiers.

Public function that measures the accuracy tiers and every other approximation on a user's own build.
"""

# ruff: noqa: E501 - sentences of the report
from __future__ import annotations

import dataclasses
import json
import math
import os
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..accuracy import TIERS
from ..atomic_files import check_folder, write_folder
from ..choices import LAWS_BY_COST
from ..dem.public import Dems
from ..errors import ConfigError
from ..geometry.bounds import turned_deg
from ..plots.numbers import number, page, typeset
from ..plots.pictures import data_uri
from ..production.config import BuildConfig
from ..production.public import planned_build
from ..stages import Progress, Steps, unseen
from .charts import Row, knobs_chart, pareto, share_text, times
from .confirmation import LIMIT_S, TIERS_SHARE, WORKERS, measure_all
from .image_errors import CONTRAST, WINDOW, ErrorPicture, ModelChanges
from .knob_rows import unseen_share
from .knob_table import (
    BEST,
    KNOBS_EXPLAINED,
    KNOBS_HEADING,
    best_said,
    knob_cells,
    knobs_markdown,
    knobs_said,
)
from .measurement import AREAS, ROUNDS, Budget, Trade, measure_trade
from .point_changes import DETECTION_CHANGE
from .proposal import require_one

SAVING = 0.1
"""Least share of time by which a tier counts as faster. Of tiers that differ by less, the most
exact one is recommended.
"""

POINTS_SHARE, CONDITIONS_SHARE = 0.02, 0.01
"""Largest shares of lost and gained points, and of changed conditions, of a nearly equal catalogue.
"""

LEAST_POINTS = 19
"""Points of reference that must be compared for another tier to be named for a catalogue: where none of so many is lost, up to
15 % of all may be (`unseen_share`).
"""

FILES = ("trade.json", "trade.html", "trade.md")

RULES = (
    f"“Equal” means that no node, no point and no condition differs from reference, and no detection probability by more than {DETECTION_CHANGE:g}; “nearly equal”, that at most "
    f"{100 * POINTS_SHARE:g} % of the points are lost or gained and at most {100 * CONDITIONS_SHARE:g} % of the conditions change. The fastest tier that "
    f"qualifies is named; it must save at least {100 * SAVING:g} % against a more exact one; for a catalogue it is reference, where it has fewer than {LEAST_POINTS} points. Time is CPU time, which equals wall time on an idle machine. "
    "All tiers have the reflectance model named at the top here. A build without a stated one takes that of its own tier, and another model changes more: state it."
)

HELD_EQUAL = (
    "Equal in every tier: the Sun is a point source, each view a bundle of parallel rays, and one Sun direction "
    "serves a group of points (but for points near the limit of dependence in high and reference). Different: shadows and occlusion, in the images and in the test of a patch's independence; and the search for places "
    "that resemble a patch, which begins at half resolution in draft and standard."
)

LAWS_HEADING = "Cost of the reflectance models"

LAWS_EXPLAINED = (
    f"All images of the areas, with shadows, under the reflectance models {', '.join(LAWS_BY_COST)}. Windows of {WINDOW} x {WINDOW} nodes that are entirely visible and "
    f"have contrast (more than {CONTRAST:g} of their mean) are correlated with the same windows under {LAWS_BY_COST[-1]}; gain and offset are free. A catalogue or a "
    "render without a stated reflectance model uses the first of these whose error is at most "
    + ", ".join(f"{100 * row.law_residual:g} % ({row.tier})" for row in TIERS.values())
    + f" of the mean signal: the rms difference from {LAWS_BY_COST[-1]} in images of random relief, gain and offset free."
)


def write_trade(trade: Trade, folder: Path, overwrite: bool = False) -> None:
    """Write ``trade.json``, ``trade.html`` and ``trade.md`` into a folder, which is created if missing, and
    ``best.toml``; that of a run before goes where this one has none.

    Raises as `atomic_files.check_folder`.
    """
    document = trade.document() | {"advice": advice(trade.tiers), "best_said": best_said(trade)}
    texts = (json.dumps(document, indent=2) + "\n", render_trade(trade), markdown(trade))
    files = dict(zip(FILES, texts, strict=True))
    if trade.best:
        comments = (
            textwrap.fill(f"# {line}", 100, subsequent_indent="#   ", break_on_hyphens=False)
            for line in best_said(trade)
        )
        files[BEST] = "\n".join((*comments, _from(folder, trade.best)))
    write_folder(folder, files, overwrite)
    if overwrite and not trade.best:
        (folder / BEST).unlink(missing_ok=True)


def _from(folder: Path, config: BuildConfig) -> str:
    """The configuration as TOML, with names of files as seen from a folder."""
    here = Path(os.path.relpath(Path.cwd(), folder))
    model, dem = config.model.beside(here), config.dem.beside(here)
    return dataclasses.replace(config, model=model, dem=dem).to_toml()


# -- recommended tiers


def advice(rows: list[Row]) -> list[str]:
    """Sentences that recommend a tier for each purpose, by `RULES`."""
    exact = rows[-1]
    judged = rows if exact["points"] >= LEAST_POINTS else [exact]
    same = _pick(judged, "cpu_seconds", _same)
    near = _pick(judged, "cpu_seconds", _nearly_same)
    quick = _pick(rows, "cpu_seconds", lambda row: True)
    image = _pick(rows, "render_seconds", lambda row: row["sunlit_error_share"] == 0.0)
    glance = _pick(rows, "render_seconds", lambda row: True)
    return [
        f"For a catalogue equal to that of reference: {same['accuracy']}, {_cost(same, exact)}.",
        f"For a nearly equal catalogue: {near['accuracy']}, {_cost(near, exact)}{'' if near is exact else '; ' + _effect(near)}.",
        f"For a first overview of a region: {quick['accuracy']}, {_cost(quick, exact)}; {_effect(quick)}.",
        f"For images without a wrong node: {image['accuracy']}, in {times(image['render_relative'])} of the time of the reference images.",
        f"For fast images: {glance['accuracy']}, in {times(glance['render_relative'])} of that time, with "
        f"{share_text(glance['sunlit_error_share'])} of the nodes wrong.",
        f"Points of reference compared: {exact['points']}. Where none of them is lost, up to {share_text(unseen_share(exact['points']))} "
        "of all may be (95 % limit): more areas tell more.",
    ]


def _pick(rows: list[Row], cost: str, fits: Callable[[Row], bool]) -> Row:
    """The most exact qualifying row whose cost is within `SAVING` of the lowest; reference always
    qualifies.
    """
    fitting = [row for row in rows if fits(row)]
    limit = min(row[cost] for row in fitting) / (1.0 - SAVING)
    return [row for row in fitting if row[cost] <= limit][-1]


def _same(row: Row) -> bool:
    wrong = ("sunlit_error_share", "visible_error_share", "points_lost", "points_gained", "conditions_changed_share", "detection_changed_share")  # fmt: skip
    return not any(row[name] for name in wrong)


def _nearly_same(row: Row) -> bool:
    points = row["points"] + row["points_lost"] - row["points_gained"]
    changed = row["points_lost"] + row["points_gained"]
    return (
        changed <= POINTS_SHARE * points
        and (row["conditions_changed_share"] or 0.0) <= CONDITIONS_SHARE
    )


def _cost(row: Row, exact: Row) -> str:
    if row is exact and row["points"] < LEAST_POINTS:
        return f"because so few points ({row['points']}) do not tell what another tier loses: measure more areas"
    if row is exact:
        return f"because no other tier that qualifies saves {100 * SAVING:g} %"
    return f"in {times(row['cpu_relative'])} of the time of reference"


def _effect(row: Row) -> str:
    """Points and conditions that differ from reference."""
    before = row["points"] + row["points_lost"] - row["points_gained"]
    changed = share_text(row["conditions_changed_share"])
    return (
        f"{row['points_lost']} of {before} points lost, {row['points_gained']} gained, "
        f"{changed} of the conditions changed"
    )


# -- the table


def _change(change: dict[str, float | None], factor: float = 1.0) -> str:
    parts = ("–" if v is None else number(factor * v, 2) for v in change.values())
    return typeset(" / ".join(parts))


def _memory(row: Row) -> str:
    if row["memory_mb"] is None:
        return "–"
    return f"{row['memory_mb']:.0f} ({row['memory_base_mb']:.0f})"


def _around(low: str, high: str) -> str:
    """The range of several runs or areas in brackets; nothing of one."""
    return f" ({low}..{high})" if low != high else ""


def _claims(row: Row) -> str:
    if row["detection_changed_share"] is None:
        return "–"
    return f"{share_text(row['detection_changed_share'])}; {number(row['detection_change_max'], 2)}"


COLUMNS: tuple[tuple[str, str, Callable[[Row], str]], ...] = (
    ("accuracy", "accuracy tier", lambda r: r["accuracy"]),
    ("CPU time, s", "processor time of all work of a build on the areas, one thread", lambda r: f"{r['cpu_seconds']:.2f}"),
    ("relative CPU time", "as a share of reference", lambda r: times(r["cpu_relative"])),
    ("image time, s", "processor time of all images once: shadows, occlusion, shading", lambda r: f"{r['render_seconds']:.2f}"),
    ("relative image time", "as a share of reference", lambda r: times(r["render_relative"])),
    ("memory, MB", "peak memory of the process, in brackets before its first area", _memory),
    ("wrong shadow", "share of (node, Sun) pairs with a different lit state", lambda r: share_text(r["sunlit_error_share"])),
    ("at a shadow edge", "share of these within two nodes of the edge of a shadow", lambda r: share_text(r["sunlit_error_near_edge_share"])),
    ("bound", "permitted share of wrong cast shadows of the tier", lambda r: share_text(r["bound"])),
    ("wrong occlusion", "share of (node, view) pairs with a different visibility", lambda r: share_text(r["visible_error_share"])),
    ("radiance rmse", "root mean square difference of the radiance factor over nodes visible in both, as a share of the mean", lambda r: share_text(r["radiance_rmse"])),
    ("points", "control points in the areas", lambda r: str(r["points"])),
    ("lost points", "points of reference that the tier lacks", lambda r: str(r["points_lost"])),
    ("gained points", "points of the tier that reference lacks", lambda r: str(r["points_gained"])),
    ("moved points", "lost points with a gained point within half the spacing", lambda r: str(r["points_moved"])),
    ("changed conditions", "share of the conditions of common candidates that are usable in one tier only", lambda r: share_text(r["conditions_changed_share"])),
    ("changed claims", f"share of their detection probabilities, at all image scales, that differ by more than {DETECTION_CHANGE:g}; the greatest difference", _claims),
    ("change of sigma, m", "common points, worst usable condition: median / 95th percentile", lambda r: _change(r["localization_sigma_change_m"])),
    ("change of sigma, %", "relative to sigma", lambda r: _change(r["localization_sigma_change_share"], 100.0)),
)  # fmt: skip
"""Name, meaning and text of every figure of a tier."""


def markdown(trade: Trade) -> str:
    """The report in Markdown: compared areas, table with one column per tier, recommendations."""
    names = [row["accuracy"] for row in trade.tiers]
    lines = [
        compared_line(trade.compared, trade.rows),
        "",
        f"| | {' | '.join(names)} |",
        "| --- |" + " ---: |" * len(names),
    ]
    for heading, meaning, text in COLUMNS[1:]:
        lines.append(
            f"| **{heading}**: {meaning} | {' | '.join(text(row) for row in trade.tiers)} |"
        )
    said = [f"- {sentence}" for sentence in advice(trade.tiers)]
    parts = [*lines, "", *said, "", RULES, "", *laws_markdown(trade.models), *knobs_markdown(trade)]
    return "\n".join(parts)


def areas_said(compared: dict[str, Any], rows: list[Row]) -> str:
    """How many of a build's areas were computed: for the tiers, and for the rows of alternatives where time left other ones."""
    counts = {row["areas"] for row in rows} or {compared["areas"]}
    many = " to ".join(map(str, sorted({min(counts), max(counts)})))
    if counts != {compared["areas"]}:
        many = f"tiers on {compared['areas']}, alternatives on {many}"
    return f"{many} of {compared['areas_of']} area{'s' * (compared['areas_of'] != 1)}"


def compared_line(compared: dict[str, Any], rows: list[Row]) -> str:
    """The compared areas and conditions in one paragraph."""
    region, suns = compared["region"], compared["suns"]
    low, high = min(compared["sun_elevations_deg"]), max(compared["sun_elevations_deg"])
    lat_deg = region["center_lat"]
    many = f"{suns[0]}" if len(suns) == 1 else f"{suns[0]} to {suns[-1]}"
    rounds = "1 round" if compared["rounds"] == 1 else f"{compared['rounds']} rounds"
    processes = (
        "each tier in a process of its own"
        if compared["own_process"]
        else "all tiers in the same process"
    )
    return (
        f"{', '.join(compared['dems'])}; region around {turned_deg(region['center_lon']):.4g}° E, {abs(lat_deg):.4g}° {'NS'[lat_deg < 0.0]}, "
        f"cells of {number(compared['gsd_m'], 4)} m; {areas_said(compared, rows)} "
        f"({sum(compared['area_nodes']):,} nodes for the tiers, without margins); {many} Sun direction{'s' * (suns != [1])}, elevations {low:g} to {high:g}°; "
        f"{compared['views']} view{'s' * (compared['views'] != 1)}; {compared['reflectance']}. {compared['threads']} thread, {processes}, tiers in turn, "
        f"median of {rounds} after an untimed one."
    )  # fmt: skip


# -- the reflectance models


LAW_COLUMNS = (
    "phase angle, deg",
    "reflectance model",
    "images",
    "windows",
    "correlation: median",
    "5th percentile",
    "above 0.9",
)


def laws_markdown(models: ModelChanges) -> list[str]:
    """Lines of the Markdown table of the reflectance models."""
    lines = [f"## {LAWS_HEADING}", "", LAWS_EXPLAINED, "", _law_times(models), ""]
    lines += [
        f"| {' | '.join(LAW_COLUMNS)} |",
        "| ---: | --- |" + " ---: |" * (len(LAW_COLUMNS) - 2),
    ]
    lines += [f"| {' | '.join(cells)} |" for cells in _law_rows(models)]
    return [*lines, ""]


def _law_times(models: ModelChanges) -> str:
    shares = ", ".join(
        f"{law} {share:.2f}" + _around(f"{low:.2f}", f"{high:.2f}")
        for law, (share, low, high) in models.times().items()
        if law != LAWS_BY_COST[-1]
    )
    return f"Processor time of all images, shadows and shading, as a share of that with {LAWS_BY_COST[-1]}, in brackets of single areas: {shares}."


def _law_rows(models: ModelChanges) -> list[list[str]]:
    """Cells of the table, sorted by phase angle."""
    rows = sorted(
        models.rows(), key=lambda row: (row["phase_deg"], LAWS_BY_COST.index(row["reflectance"]))
    )
    return [
        [
            "{:g} to {:g}".format(*row["phase_deg"]),
            row["reflectance"],
            str(row["images"]),
            f"{row['windows']:,}",
            f"{row['correlation_median']:.4f}",
            f"{row['correlation_p05']:.4f}",
            f"{100 * row['share_above_0_9']:.1f} %",
        ]
        for row in rows
    ]


# -- the page


def render_trade(trade: Trade) -> str:
    """The report as one self-contained HTML page."""
    compared, rows, shown = trade.compared, trade.tiers, trade.picture
    return page(
        "trade.html.j2",
        title=f"Speed and accuracy: {', '.join(compared['dems'])}",
        heading="Speed and accuracy of the approximations",
        below=compared_line(compared, trade.rows),
        advice=advice(rows),
        rules=RULES,
        pareto=pareto(rows),
        tiers=[row["accuracy"] for row in rows],
        rows=[(name, meaning, [text(row) for row in rows]) for name, meaning, text in COLUMNS[1:]],
        held_equal=HELD_EQUAL,
        picture=_picture(shown) if shown and shown.wrong_nodes else None,
        laws={
            "heading": LAWS_HEADING,
            "times": _law_times(trade.models),
            "columns": LAW_COLUMNS,
            "rows": _law_rows(trade.models),
            "explained": LAWS_EXPLAINED,
        },
        compared=json.dumps(compared, indent=1),
        knobs=None
        if not trade.rows
        else {
            "heading": KNOBS_HEADING,
            "said": knobs_said(trade),
            "table": knob_cells(trade.rows),
            "chart": knobs_chart(trade.rows, trade.best_row) if trade.rows[1:] else None,
            "explained": KNOBS_EXPLAINED if trade.rows[1:] else (),
            "left": list(trade.not_measured.items()),
        },
    )


def _picture(picture: ErrorPicture) -> dict[str, Any]:
    """The image with the most errors: reference, and each tier with its wrong nodes."""
    rows, cols = picture.lit.shape
    images = [("reference: lit and dark", data_uri(_lit_pixels(picture.lit, 25, 230)))]
    images += [
        (f"{tier}: {np.count_nonzero(wrong)} wrong", data_uri(_wrong_pixels(picture.lit, wrong)))
        for tier, wrong in picture.wrong.items()
    ]
    return {
        "area": picture.area,
        "sun_elevation": f"{picture.sun_elevation_deg:g}",
        "sun_azimuth": f"{picture.sun_azimuth_deg:g}",
        "rows": rows,
        "cols": cols,
        "images": images,
    }


def _lit_pixels(lit: NDArray[np.int8], dark: int, light: int) -> NDArray[np.uint8]:
    """RGBA pixels of lit (1) and dark (0) nodes; nodes without terrain (-1) are transparent."""
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
    near = [padded[i : i + rows, j : j + cols] for i, j in steps]
    return np.asarray(np.any(near, axis=0))


def trade(
    dem: Dems,
    output: Path | str | None = None,
    *,
    config: BuildConfig | Path | str | None = None,
    center: tuple[float, float] | None = None,
    size_km: float | None = None,
    bounds: tuple[float, float, float, float] | None = None,
    gsd_m: float | None = None,
    areas: int | None = AREAS,
    rounds: int = ROUNDS,
    isolated: bool = True,
    budget_s: float | None = None,
    max_error: float | None = None,
    time_limit_s: float = LIMIT_S,
    overwrite: bool = False,
    progress: Progress = unseen,
) -> Trade:
    """Measure what every approximation costs and changes on a DEM and a sweep: some areas of a build are computed in
    every tier and compared with the tier ``reference``, and with one alternative at a time (`approximations`)
    around the configuration.

    Parameters
    ----------
    dem:
        DEM files, or an opened set.
    output:
        Also write trade.json, trade.html and trade.md into this folder.
    config, center, size_km, bounds, gsd_m:
        The build, as `build_catalog`; one level of cells.
    areas:
        Number of the build's areas to compute, spread over the region; None: all, and the promise of every alternative.
    rounds:
        Timed runs of each area in each tier; the median counts.
    isolated:
        True: each tier in a process of its own; False: in this one, without memory figures.
    budget_s, max_error:
        Processor time of the whole build, or share of the conditions changed, for which a configuration is sought; it is
        written to best.toml. At most one of them.
    time_limit_s:
        Time after which no other alternative is begun, half of it for the tiers; 0: tiers alone, without a limit.
    overwrite:
        True: replace existing files of the folder.
    progress:
        Called with the number of runs done and of all that are known to come: a confirmation is known when it begins.

    Returns
    -------
    Trade
        ``rows``, one object an alternative (seconds, conditions changed, points lost and gained), ``tiers``, ``best``;
        ``document()``.

    Raises
    ------
    ConfigError
        For several levels of cells, or a number below 1.
    LcpError
        As `build_catalog`.

    Examples
    --------
    >>> measured = lcp.trade(
    ...     folder / "hadley_gld100_256ppd.tif", config=small_config, gsd_m=480,
    ...     center=(3.5, 26.0), size_km=15, areas=1, rounds=1, isolated=False, time_limit_s=0.0,
    ... )
    >>> [row["accuracy"] for row in measured.tiers]
    ['draft', 'standard', 'high', 'reference']
    """
    folder = None if output is None else Path(output)
    if folder is not None:
        check_folder(folder, (*FILES, BEST), overwrite)
    require_one(budget_s, max_error, time_limit_s)
    until, steps = time.monotonic() + time_limit_s, Steps(progress)
    build = planned_build(dem, config, center=center, size_km=size_km, bounds=bounds, gsd_m=gsd_m)
    if len(build.levels) > 1:
        raise ConfigError(
            "the configuration has several levels, but the tiers are compared on one cell size: give `area.gsd_m`"
        )
    limit_s = TIERS_SHARE * time_limit_s or math.inf
    found = measure_trade(build, areas or len(build.jobs), rounds, isolated, steps, limit_s)
    if time_limit_s > 0.0:
        budget, workers = Budget(budget_s, max_error), WORKERS if isolated else 0
        found = measure_all(found, build, areas, budget, until, workers, steps)
    if folder is not None:
        write_trade(found, folder, overwrite)
    return found
