"""A NAC orthoimage of 0.5 m a pixel compared with renders of the NAC DTM of the same area: the pit in Mare Tranquillitatis.

    .venv/bin/python benchmarks/nac_pair.py [-o build/nac_pair]

The shared lunar data are needed (see `tests/conftest.py`). The output is `tables.md`, the smoothed DTM as `dtm.tif`, and pictures.
The DTM is quantised in 256 steps of 0.467 m; its surface here is the smoothest one that rounds to these steps
(`benchmarks/dequantise.py`). Nothing is fitted to the image.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import cv2
import numpy as np
import rasterio
from dequantise import bending, smooth_terraces
from helpers.pit_pair import (
    GSD_M,
    PAIR,
    STEP_M,
    Ground,
    at_scale,
    build_catalog,
    dtm,
    far_from_hole,
    offset_of,
    on_ground,
    orthoimage,
    pit_sun,
    window_scores,
    write_dem,
)

from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.hdf5 import open_catalog
from lcp_catalog.images.image import Image
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.matching.position_fix import FAINT, Options, locate
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.pipeline import HeightfieldScene
from lcp_catalog.validation.window_correlation import WindowComparison, compare

OVERLAP = 4.0
"""The distance between windows is half a side, so that they cover every node; they are not independent."""

BANDS_M = ((4, 8), (8, 16), (16, 32), (32, 64), (64, 128))
STARTS = ((0.0, 0.0), (8.0, 0.0), (0.0, 8.0), (6.0, -5.0), (-7.0, 4.0))
MODELS = ("lunar-lambert", "hapke", "lommel-seeliger")


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a, b)[0, 1])


# -- registration


def offset_and_sigma(scores: np.ndarray, draws: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """The offset and its standard deviation over resampled windows (bootstrap)."""
    rng = np.random.default_rng(0)
    again = [offset_of(scores[rng.integers(0, len(scores), len(scores))]) for _ in range(draws)]
    return offset_of(scores), np.nanstd(again, axis=0) * np.sqrt(OVERLAP)


def hole_offset(folder: Path) -> tuple[np.ndarray, np.ndarray, float]:
    """Least and greatest shift (east, north) in metres of the orthoimage at which its pit covers the DTM's pit
    best, and the overlap there (intersection over union).
    """
    with rasterio.open(folder / "tranqpit1_dtm_2m.tif") as file:
        coarse, corner = file.read(1) == file.nodata, (file.transform.c, file.transform.f)
    with rasterio.open(folder / "tranqpit1_ortho_M152662021_0p5m.tif") as file:
        fine, fine_corner = file.read(1) == 0, (file.transform.c, file.transform.f)
    fine = np.kron(fine, np.ones((2, 2), bool))
    coarse = np.kron(coarse, np.ones((8, 8), bool))
    right, down = (fine_corner[0] - corner[0]) / 0.25, (corner[1] - fine_corner[1]) / 0.25
    padded = np.zeros((coarse.shape[0] + 64, coarse.shape[1] + 64), bool)
    padded[32:-32, 32:-32] = coarse
    best: dict[tuple[float, float], float] = {}
    for north in range(-16, 17):
        for east in range(-16, 17):
            row, col = 32 + round(down) - north, 32 + round(right) + east
            under = padded[row : row + fine.shape[0], col : col + fine.shape[1]]
            shared = float((under & fine).sum())
            best[0.25 * east, 0.25 * north] = shared / (coarse.sum() + fine.sum() - shared)
    top = max(best.values())
    places = np.array([place for place, value in best.items() if value > top - 1e-6])
    return places.min(axis=0), places.max(axis=0), top


# -- what limits it


def passed(values: np.ndarray, band: tuple[float, float] | None) -> np.ndarray:
    """The part of an array between two wavelengths in metres (difference of two Gaussians); NaN is filled by the mean."""
    filled = np.where(np.isfinite(values), values, np.nanmean(values))
    if band is None:
        return filled
    fine, coarse = (cv2.GaussianBlur(filled, (0, 0), wave / (2 * np.pi) / GSD_M) for wave in band)
    return fine - coarse


def windows(image: np.ndarray, ground: Ground, there: np.ndarray, factor: int) -> WindowComparison:
    return compare(
        at_scale(image, there, factor),
        at_scale(ground.radiance, there, factor),
        gsd_m=GSD_M * factor,
    )


def histogram_row(name: str, found: WindowComparison) -> str:
    textured = found.textured
    return (
        f"| {name} | {found.gsd_m:g} | {found.count} | {found.share_above(0.9):.2f} | {found.share_above(0.7):.2f} "
        f"| {found.share_above(0.5):.2f} | {found.median:.2f} | {textured.median:.2f} | {found.correlation.max():.2f} |"
    )


# -- the tables


def picture(path: Path, *values: np.ndarray) -> None:
    grey = []
    for one in values:
        low, high = np.nanpercentile(one, [1, 99])
        grey.append(np.nan_to_num(np.clip((one - low) / (high - low), 0, 1) * 255).astype(np.uint8))
    cv2.imwrite(
        str(path), cv2.resize(np.hstack(grey), None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST)
    )


def located(photo: Image, dem: Path, out: Path) -> list[str]:
    """Build a catalogue of the smoothed DTM and locate the orthoimage from a start that is shifted on purpose."""
    catalog = open_catalog(build_catalog(dem, out / "pit.h5"))
    lines = [
        f"## `locate`, {len(catalog)} points", "",
        "| law | criteria | map moved by, m | verdict | by | points agreeing | east, m | north, m | log10 of false alarms |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]  # fmt: skip
    kinds = (("as they are", Options()), ("for faint ground", FAINT))
    for (name, options), law, start in itertools.product(kinds, MODELS, STARTS):
        moved = photo.with_sensor(photo.sensor.moved(start))
        found = locate(catalog, moved, Uncertainty(5.0), reflectance_model(law), options)
        place = "| | "
        if found.pose is not None:
            at, sigma = found.pose.correction + np.array(start), found.pose.sigma
            place = "| ".join(f"{a:+.2f} +- {b:.2f} " for a, b in zip(at, sigma, strict=True))
        lines.append(
            f"| {law} | {name} | {start[0]:+g}, {start[1]:+g} | {found.verdict} | {found.by} | {found.matches.found.sum()} "
            f"| {place}| {found.log10_false_alarms:.1f} |"
        )
    return [*lines, ""]


def beside() -> Path:
    """The folder of the shared data in the checkout or beside it."""
    places = [ROOT / "shared" / "data", ROOT.parent / "shared" / "data"]
    return next((place for place in places if place.is_dir()), places[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "build" / "nac_pair")
    parser.add_argument("--data", type=Path, default=os.environ.get("LCP_SHARED_DATA", beside()))
    given = parser.parse_args()
    folder, out = given.data / PAIR, given.out
    out.mkdir(parents=True, exist_ok=True)
    sun = pit_sun(folder)
    heights, *like = dtm(folder)
    smoothed = smooth_terraces(heights, STEP_M)
    files = {
        "steps as they came": write_dem(out / "dtm_steps.tif", heights, like),
        "steps smoothed": write_dem(out / "dtm.tif", smoothed.heights_m, like),
    }
    photo = orthoimage(folder, sun)
    grounds = {name: Ground.of(path, sun) for name, path in files.items()}
    lines = ["## Smoothing", ""]
    lines += [
        f"{smoothed.rounds} rounds; bending {bending(heights):.0f} m2 -> {bending(smoothed.heights_m):.0f} m2; "
        f"moved at most {np.nanmax(np.abs(smoothed.heights_m - heights)):.4f} m, rms "
        f"{np.sqrt(np.nanmean((smoothed.heights_m - heights) ** 2)):.3f} m",
        "",
    ]
    lines += registration(folder, photo, grounds)
    lines += suns(photo, files["steps smoothed"], grounds["steps smoothed"].scene)
    lines += window_tables(photo, grounds, out)
    lines += located(photo, files["steps smoothed"], out)
    lines += limits(photo, grounds, out, like)
    (out / "tables.md").write_text("\n".join(lines) + "\n")
    sys.stdout.write("\n".join(lines) + "\n")


def registration(folder: Path, photo: Image, grounds: dict[str, Ground]) -> list[str]:
    lines = [
        "## Registration", "",
        "| surface | windows, m | count | waves, m | east, m | north, m | mean correlation there |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]  # fmt: skip
    for name, ground in grounds.items():
        image, weight = on_ground(photo, ground.nodes)
        keep = far_from_hole(ground, weight)
        for side, band in ((16, None), (32, None), (48, None), (32, (8, 64))):
            filtered = replace(ground, radiance=passed(ground.radiance, band))
            scores = window_scores(passed(image, band), filtered, keep, side)
            at, sigma = offset_and_sigma(scores)
            lines.append(
                f"| {name} | {side * GSD_M:g} | {len(scores)} | {band_name(band)} | {at[0]:+.2f} +- {sigma[0]:.2f} "
                f"| {at[1]:+.2f} +- {sigma[1]:.2f} | {scores.mean(axis=0).max():.2f} |"
            )
    low, high, shared = hole_offset(folder)
    lines.append(
        f"| the hole's outline | | | | {low[0]:+.2f} to {high[0]:+.2f} | {low[1]:+.2f} to {high[1]:+.2f} | ({shared:.3f} shared) |"
    )
    return [*lines, ""]


def band_name(band: tuple[float, float] | None) -> str:
    return "all" if band is None else f"{band[0]}-{band[1]}"


def suns(photo: Image, dem: Path, scene: HeightfieldScene) -> list[str]:
    """Mean correlation of windows of 64 m under Suns of the same elevation and other azimuths; it drops if shading prevails."""
    azimuth, elevation = scene.sun.azimuth_deg, scene.sun.elevation_deg
    lines = [
        f"## The Sun's azimuth (true: {azimuth:.1f} deg, {elevation:.1f} deg high)",
        "",
        "| turned by, deg | mean correlation of windows of 64 m |",
        "| --- | --- |",
    ]
    for turn in (0, 20, -20, 45, -45, 90, -90, 180):
        ground = Ground.of(
            dem, SunChoice(azimuth_deg=(azimuth + turn) % 360.0, elevation_deg=elevation)
        )
        image, weight = on_ground(photo, ground.nodes)
        scores = window_scores(image, ground, far_from_hole(ground, weight), 32)
        middle = scores.shape[1] // 2
        lines.append(f"| {turn:+d} | {scores[:, middle, middle].mean():.3f} |")
    return [*lines, ""]


def window_tables(photo: Image, grounds: dict[str, Ground], out: Path) -> list[str]:
    lines = [
        "## Windows", "",
        "| surface | cell, m | windows | above 0.9 | above 0.7 | above 0.5 | median | median, textured half | best |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]  # fmt: skip
    for name, ground in grounds.items():
        image, weight = on_ground(photo, ground.nodes)
        there = np.isfinite(ground.radiance) & (weight > 0.5)
        lines += [
            histogram_row(name, windows(image, ground, there, factor)) for factor in (1, 2, 4)
        ]
        picture(out / f"{name.replace(' ', '_')}.png", image, ground.radiance)
    for model in MODELS[1:]:
        path = out / "dtm.tif"
        ground = Ground.of(path, grounds["steps smoothed"].scene.request.sun, model)
        image, weight = on_ground(photo, ground.nodes)
        there = np.isfinite(ground.radiance) & (weight > 0.5)
        lines.append(histogram_row(f"steps smoothed, {model}", windows(image, ground, there, 1)))
    return [*lines, ""]


def limits(photo: Image, grounds: dict[str, Ground], out: Path, like: list[object]) -> list[str]:
    ground = grounds["steps smoothed"]
    image, weight = on_ground(photo, ground.nodes)
    keep = far_from_hole(ground, weight)
    lines = [
        "## By wavelength, away from the hole",
        "",
        "| waves, m | image's contrast | render's contrast | correlation, steps | correlation, smoothed | steps' own loss |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    true = ground.radiance
    again = ground_of_requantised(ground, out, like)
    for band in (*BANDS_M, None):
        values = {name: passed(g.radiance, band)[keep] for name, g in grounds.items()}
        seen, rendered = passed(image, band)[keep], passed(true, band)[keep]
        lines.append(
            f"| {band_name(band)} | {seen.std() / image[keep].mean():.3f} "
            f"| {values['steps smoothed'].std() / true[keep].mean():.3f} | {correlation(seen, values['steps as they came']):.2f} "
            f"| {correlation(seen, values['steps smoothed']):.2f} | {1 - correlation(passed(again, band)[keep], rendered):.3f} |"
        )
    return [*lines, ""]


def ground_of_requantised(ground: Ground, out: Path, like: list[object]) -> np.ndarray:
    """The cost of quantisation: the smoothed surface as truth, rounded to steps shifted by a quarter of one, smoothed
    again and rendered.
    """
    with rasterio.open(out / "dtm.tif") as file:
        heights = file.read(1).astype(np.float64)
    stepped = STEP_M * (np.round(heights / STEP_M + 0.25) - 0.25)
    path = write_dem(out / "dtm_again.tif", smooth_terraces(stepped, STEP_M).heights_m, like)
    return Ground.of(path, ground.scene.request.sun).radiance


if __name__ == "__main__":
    main()
