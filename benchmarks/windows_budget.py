"""Causes of correlations below 0.9 in 16 x 16 windows of images and renders: one change at a time, on Apollo 15 frames.

    .venv/bin/python benchmarks/windows_budget.py [-o build/windows]        # 3 minutes of one core, 1.5 GB

The shared lunar data are needed (see `tests/conftest.py`). The output is `tables.md` and, for each frame, a picture: image, render,
map of correlations, and the histogram. All settings were chosen on the frames of `CHOSEN_ON`; the other frames were run once with
these settings.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import cv2
import numpy as np
from helpers import apollo_frames as apollo
from helpers.apollo_windows import LINEAR, Ground, photograph

from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.effective_resolution import Resolution, of_file
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.srgb import decode_srgb
from lcp_catalog.validation.orthoimage import orthorectify, terrain_nodes
from lcp_catalog.validation.point_spread import Pair, paired
from lcp_catalog.validation.window_correlation import WindowComparison, compare

CHOSEN_ON = ("AS15-M-0414", "AS15-M-0295")
KEPT_ASIDE = ("AS15-M-0299", "AS15-M-0300", "AS15-M-1134")
CELLS_M = (474.0, 948.0)
PLAIN = "lunar-lambert, no phase function"
SUN_BINS = (4, 12, 20, 30, 41, 60)
HADLEY = "images/apollo15-metric-hadley/gld100_256ppd_lat20-30_lon000-010.tif"
DEMS = {
    "GLD100 256 px/deg, Hadley": HADLEY,
    "GLD100 256 px/deg, Taurus-Littrow": "dem/gld100/gld100_256ppd_taurus-littrow_lat17-24_lon027-035.tif",
    "GLD100 256 px/deg, Giordano Bruno": "dem/gld100/gld100_256ppd_giordano-bruno_lat33-39_lon099-107.tif",
    "GLD100 64 px/deg, far side": "images/apollo15-metric-farside/gld100_064ppd_lat-28_-13_lon132-155.tif",
    "GLD100 64 px/deg, 16-2 S 1 W-20 E": "images/apollo16-metric-series/gld100_064ppd_lat-16_-02_lon-01_020.tif",
    "GLD100 16 px/deg, 20 S-20 N": "dem/gld100/gld100_016ppd_global.tif",
    "NAC DTM of 8-bit steps, 2 m": "images/nac-tranqpit1-pair/tranqpit1_dtm_2m.tif",
}


# -- one frame


def variants(ground: Ground, target_m: float) -> Iterator[tuple[str, WindowComparison]]:
    """The comparison with the default settings, the plain one, and each change alone."""
    whole = ground.radiance()
    as_it_is = ground.pair(target_m, whole)
    yield "as it is", _compared(as_it_is)
    plain = ground.radiance(PLAIN, albedo=False)
    yield (
        "plain: no film, albedo, phase, DEM",
        ground.windows(target_m, plain, LINEAR, dem_fwhm_m=0.0),
    )
    yield "film: codes taken as brightness", ground.windows(target_m, whole, LINEAR)
    bare = ground.radiance(albedo=False)
    yield "albedo: no map", ground.windows(target_m, bare)
    yield "film and albedo: neither", ground.windows(target_m, bare, LINEAR)
    yield "phase: no phase function", ground.windows(target_m, ground.radiance(PLAIN))
    yield "law: lommel-seeliger", ground.windows(target_m, ground.radiance("lommel-seeliger"))
    yield "law: hapke", ground.windows(target_m, ground.radiance("hapke"))
    dark = ground.radiance(shadows=False)
    yield "shadows: none cast", ground.windows(target_m, dark)
    yield "DEM: image not smoothed to it", ground.windows(target_m, whole, dem_fwhm_m=0.0)
    wide = 2.0 * ground.resolution.point_spread_m
    yield "DEM: image smoothed twice as far", ground.windows(target_m, whole, dem_fwhm_m=wide)
    yield "cells: half the point spread", ground.windows(target_m, whole, cell_fwhm=1.0)
    yield "camera turned by half a cell", _compared(as_it_is, shift=0.5)
    yield "pointing: one shift removed", _compared(as_it_is, offset="removed")
    yield "pointing: own best place *", _best(as_it_is)
    yield "film: any rising response *", _matched(as_it_is)


def _compared(pair: Pair, shift: float = 0.0, offset: str = "kept") -> WindowComparison:
    image = pair.image
    if shift:
        moved = np.float64([[1, 0, shift], [0, 1, shift]])
        image = cv2.warpAffine(np.nan_to_num(image), moved, image.shape[::-1])
    return compare(image, pair.render, pair.weight, gsd_m=pair.gsd_m, offset=offset)


def _best(pair: Pair) -> WindowComparison:
    found = compare(pair.image, pair.render, pair.weight, gsd_m=pair.gsd_m, search_px=2)
    found.correlation[:] = np.maximum(found.correlation, found.peak)
    return found


def _matched(pair: Pair) -> WindowComparison:
    """The render after the monotonic map of grey values that gives it the image's histogram over the whole frame."""
    there = (pair.weight > 0.9) & np.isfinite(pair.image) & np.isfinite(pair.render)
    render = pair.render.copy()
    ranks = np.argsort(np.argsort(render[there]))
    render[there] = np.sort(pair.image[there])[ranks]
    return compare(pair.image, render, pair.weight, gsd_m=pair.gsd_m)


def row(found: WindowComparison) -> list[str]:
    left = float(np.mean(1.0 - found.correlation**2))
    figures = [100.0 * found.share_above(0.9), 100.0 * found.share_above(0.7)]
    figures.append(100.0 * found.textured.share_above(0.9))
    return [
        str(found.count),
        *(f"{x:.0f}" for x in figures),
        f"{found.median:.3f}",
        f"{found.mode:.4f}",
        f"{100.0 * left:.1f}",
    ]


def frame_tables(shared: Path, key: str, out: Path) -> str:
    own = Ground.of(shared, key)
    resolution = own.resolution
    text = f"## {key}\n\n{told(resolution)}\n\n"
    for target_m in (*CELLS_M, resolution.resolution_m):
        text += f"**{key}, cells of {target_m:.0f} m**\n\n"
        text += (
            "| | windows | > 0.9, % | > 0.7, % | textured > 0.9, % | median | mode | left, % |\n"
        )
        text += "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n"
        for name, found in variants(own.rendered_for(target_m), target_m):
            text += f"| {name} | {' | '.join(row(found))} |\n"
        text += "\n"
    picture(own, CELLS_M[1], out / f"{key}.png")
    return text


def told(of: Resolution) -> str:
    span = f"{of.low_m:.0f} to {of.high_m:.0f}"
    return (
        f"resolution {of.resolution_m:.0f} m ({span}), posting {of.posting_m:.0f} m: {of.how}; "
        f"point spread {of.point_spread_m:.0f} m, exponent {of.exponent:.2f}"
    )


# -- pictures


def picture(ground: Ground, target_m: float, path: Path) -> None:
    """Image, render, correlations from 0.5 (dark) to 1 (bright), and their histogram."""
    pair = ground.pair(target_m, ground.radiance())
    found = compare(pair.image, pair.render, pair.weight, gsd_m=pair.gsd_m)
    panels = [_grey(values, pair.weight > 0.9) for values in (pair.image, pair.render)]
    drawn = np.nan_to_num((found.map(pair.image.shape) - 0.5) * 2.0, nan=0.0)
    panels.append(np.uint8(255 * np.clip(drawn, 0.0, 1.0)))
    wall = np.hstack([cv2.resize(p, None, fx=2, fy=2, interpolation=0) for p in panels])
    bars = np.full((200, wall.shape[1]), 255, np.uint8)
    counts, edges = found.histogram(0.01)
    shown = edges[:-1] >= 0.49
    wide = bars.shape[1] // int(shown.sum())
    for number, count in enumerate(counts[shown]):
        high = round(190 * count / max(1, counts.max()))
        bars[200 - high :, number * wide : (number + 1) * wide - 1] = 60
    cv2.imwrite(str(path), np.vstack([wall, bars]))


def _grey(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    low, high = np.percentile(values[there], [1, 99])
    scaled = np.clip((np.nan_to_num(values) - low) / (high - low), 0.0, 1.0)
    return np.uint8(255 * scaled * there)


# -- other tables


def resolutions(shared: Path) -> str:
    text = "| DEM | posting | resolution, m | 68 % | point spread, m | exponent | |\n"
    text += "| --- | ---: | ---: | ---: | ---: | ---: | --- |\n"
    for name, file in DEMS.items():
        of = of_file(Dem.open(shared / file))
        span = f"{of.low_m:.0f}-{of.high_m:.0f}"
        figures = f"{of.posting_m:.4g} | {of.resolution_m:.4g} | {span} | {of.point_spread_m:.4g}"
        text += f"| {name} | {figures} | {of.exponent:.2f} | {of.how} |\n"
    return text


def two_images(shared: Path) -> str:
    """Two frames of the same terrain, taken 21 s apart: the correlation that a render without errors could reach."""
    grounds = [Ground.of(shared, key) for key in KEPT_ASIDE[:2]]
    text = "| cells, m | windows | > 0.9, % | median | its root |\n| ---: | ---: | ---: | ---: | ---: |\n"
    nodes = grounds[0]
    place = terrain_nodes(nodes.scene.terrain)
    seen = [orthorectify(photograph(g.image, g.camera), place) for g in grounds]
    weight = np.minimum(seen[0].weight, seen[1].weight)
    for target_m in CELLS_M:
        for spread in (0.0, nodes.resolution.point_spread_m):
            how = {"gsd_m": nodes.scene.gsd_m, "target_m": max(target_m, nodes.scene.gsd_m)}
            signals = [np.where(weight > 0.0, each.signal, np.nan) for each in seen]
            one = paired(signals[0], signals[1], weight, dem_fwhm_m=spread, **how)
            two = paired(signals[1], signals[0], weight, dem_fwhm_m=spread, **how)
            found = compare(one.image, two.image, one.weight, gsd_m=target_m)
            above, median = 100.0 * found.share_above(0.9), found.median
            label = f"{target_m:.0f}{', smoothed to the DEM' if spread else ''}"
            text += (
                f"| {label} | {found.count} | {above:.0f} | {median:.3f} | {median**0.5:.3f} |\n"
            )
    return text


def series(shared: Path) -> str:
    """The Apollo 16 series: windows of 20 km by Sun elevation."""
    albedo = AlbedoMap.open(shared / "albedo" / "relative_albedo_11ppd.tif", "linear")
    cells: dict[int, list[tuple[float, float]]] = {}
    for key in apollo.series_keys(shared):
        frame = apollo.series_frame(shared, key)
        place = frame.windows()
        plain = frame.render(PLAIN)
        full = frame.render("lunar-lambert", albedo.at_nodes(frame.scene.terrain))
        linear = [frame.correlation(plain, window) for window in place]
        frame.image = decode_srgb(frame.image / 255.0)
        decoded = [frame.correlation(full, window) for window in place]
        number = int(np.searchsorted(SUN_BINS, frame.sun_elevation_deg)) - 1
        cells.setdefault(number, []).extend(zip(linear, decoded, strict=True))
    text = "| Sun, deg | windows | plain > 0.9, % | as it is > 0.9, % | plain, median | as it is, median |\n"
    text += "| --- | ---: | ---: | ---: | ---: | ---: |\n"
    for number in sorted(cells):
        plain, full = np.array(cells[number]).T
        shares = [f"{100.0 * np.mean(x > 0.9):.0f}" for x in (plain, full)]
        medians = [f"{np.median(x):.2f}" for x in (plain, full)]
        span = f"{SUN_BINS[number]}..{SUN_BINS[number + 1]}"
        text += f"| {span} | {len(plain)} | {' | '.join(shares + medians)} |\n"
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", type=Path, default=ROOT / "build" / "windows")
    out = parser.parse_args().o
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")
    shared = Path(os.environ.get("LCP_SHARED_DATA", ROOT.parent / "shared" / "data"))
    parts = ["## What DEMs resolve\n\n" + resolutions(shared)]
    parts += [frame_tables(shared, key, out) for key in (*CHOSEN_ON, *KEPT_ASIDE)]
    parts += ["## Two photographs\n\n" + two_images(shared), "## The series\n\n" + series(shared)]
    (out / "tables.md").write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
