"""A NAC orthoimage of half a metre a pixel against renders of the NAC DTM of the same ground: the pit in Mare Tranquillitatis.

    .venv/bin/python benchmarks/nac_pair.py [-o build/nac_pair]

needs the shared lunar data (`tests/conftest.py` says where they are sought) and writes `tables.md` (the tables of
docs/validation.md), the smoothed DTM as `dtm.tif`, and pictures to look at. The DTM came in 256 steps of 0.467 m: its
surface is the smoothest that rounds to them (`lcp_catalog.terraces`). Nothing is fitted to the image.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import cv2
import numpy as np
import rasterio

from lcp_catalog.exposure import Scene, expose, prepare
from lcp_catalog.ortho import orthorectify, terrain_nodes
from lcp_catalog.photo import Photo
from lcp_catalog.photo_file import open_photo
from lcp_catalog.raster_out import geotiff
from lcp_catalog.reflectance import reflectance_model
from lcp_catalog.request import Request, SunChoice
from lcp_catalog.terraces import bending, smooth_terraces
from lcp_catalog.windows import WindowComparison, compare

PAIR = Path("images") / "nac-tranqpit1-pair"
STEP_M = 119.0 / 255.0
GSD_M = 2.0
PIT_MARGIN_M = 20.0
"""Ground so near the hole is left out of the registration: both files have the same hole, which would be found and not the ground."""

REACH_M, PATCH, PATCH_STEP, PATCH_LEAST = 12.0, 32, 16, 0.5
BANDS_M = ((4, 8), (8, 16), (16, 32), (32, 64), (64, 128))
MODELS = ("lunar-lambert", "hapke", "lommel-seeliger")


@dataclass(frozen=True, eq=False)
class Ground:
    """The DTM, as it came or smoothed, rendered: radiance (rows, cols) and where its nodes lie."""

    scene: Scene
    radiance: np.ndarray
    nodes: np.ndarray

    @classmethod
    def of(cls, dem: Path, sun: SunChoice, model: str = MODELS[0]) -> Ground:
        request = Request([dem], sun=sun, gsd_m=GSD_M, model=reflectance_model(model))
        scene = prepare(request)
        return cls(scene, expose(scene).radiance, terrain_nodes(scene.terrain))


def dtm(folder: Path) -> tuple[np.ndarray, rasterio.CRS, rasterio.Affine]:
    """Heights as they came, metres, NaN in the hole."""
    with rasterio.open(folder / "tranqpit1_dtm_2m.tif") as file:
        heights = file.read(1).astype(np.float64)
        heights[heights == file.nodata] = np.nan
        return heights, file.crs, file.transform


def write_dem(path: Path, heights: np.ndarray, like: tuple[rasterio.CRS, rasterio.Affine]) -> Path:
    path.write_bytes(geotiff({"height": heights}, "float32", {}, *like))
    return path


def pit_sun(folder: Path) -> SunChoice:
    given = json.loads((folder / "sun_geometry_computed.json").read_text())
    return SunChoice(subsolar_deg=(given["subsolar_lon"], given["subsolar_lat"]))


def on_ground(photo: Photo, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The image at the nodes, and its weight."""
    found = orthorectify(photo, nodes)
    return found.signal, found.weight


def far_from_hole(ground: Ground, weight: np.ndarray) -> np.ndarray:
    """Nodes that have both, not beside the hole or the border."""
    there = (np.isfinite(ground.radiance) & (weight > 0.9)).astype(np.uint8)
    side = 2 * round(PIT_MARGIN_M / GSD_M) + 1
    return cv2.erode(there, np.ones((side, side), np.uint8), borderValue=0) > 0


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a, b)[0, 1])


# -- registration


def highest(scores: np.ndarray, step_m: float) -> np.ndarray:
    """Column and row, metres from the middle, of a peak by a paraboloid through its 3 x 3; NaN at the border."""
    rows, cols = scores.shape
    i, j = np.unravel_index(int(np.argmax(scores)), scores.shape)
    if not (0 < i < rows - 1 and 0 < j < cols - 1):
        return np.full(2, np.nan)
    row, col = np.mgrid[-1:2, -1:2].reshape(2, -1).astype(float)
    design = np.stack([np.ones(9), col, row, col**2, row**2, col * row], axis=1)
    c = np.linalg.lstsq(design, scores[i - 1 : i + 2, j - 1 : j + 2].ravel(), rcond=None)[0]
    at = np.linalg.solve([[2 * c[3], c[5]], [c[5], 2 * c[4]]], -c[1:3])
    return (np.clip(at, -1, 1) + [j - cols // 2, i - rows // 2]) * step_m


def whole_offset(photo: Photo, ground: Ground, band: tuple[float, float] | None) -> tuple[np.ndarray, np.ndarray]:
    """Where the image's ground lies (east, north, metres) by the highest correlation of the whole, and all
    correlations: the map is moved, and read anew.
    """
    steps = np.arange(-REACH_M, REACH_M + 1.0, GSD_M)
    keep = far_from_hole(ground, on_ground(photo, ground.nodes)[1])
    render = passed(ground.radiance, band)
    scores = np.zeros((len(steps), len(steps)))
    for i, north in enumerate(steps):
        for j, east in enumerate(steps):
            moved = photo.with_sensor(photo.sensor.moved((east, north)))
            image, weight = on_ground(moved, ground.nodes)
            use = keep & (weight > 0.9)
            scores[i, j] = correlation(passed(image, band)[use], render[use])
    return highest(scores, GSD_M), scores


def patch_offsets(image: np.ndarray, ground: Ground, keep: np.ndarray) -> np.ndarray:
    """(n, 3): by how many metres (east, north) the image's ground lies off in patches, and the correlation there."""
    found = []
    reach = round(REACH_M / GSD_M)
    rows, cols = image.shape
    image = np.where(np.isfinite(image), image, np.nanmean(image)).astype(np.float32)
    render = np.nan_to_num(ground.radiance).astype(np.float32)
    for row in range(reach, rows - PATCH - reach, PATCH_STEP):
        for col in range(reach, cols - PATCH - reach, PATCH_STEP):
            if not keep[row : row + PATCH, col : col + PATCH].all():
                continue
            around = image[row - reach : row + PATCH + reach, col - reach : col + PATCH + reach]
            patch = render[row : row + PATCH, col : col + PATCH]
            scores = cv2.matchTemplate(around, patch, cv2.TM_CCOEFF_NORMED)
            right, down = highest(scores, GSD_M)
            found.append((-right, down, scores.max()))  # seen right of there: lies west of there
    return np.array(found)


# -- what limits it


def passed(values: np.ndarray, band: tuple[float, float] | None) -> np.ndarray:
    """Waves of a band of lengths (metres), by the difference of two Gaussians; NaN filled by the mean."""
    filled = np.where(np.isfinite(values), values, np.nanmean(values))
    if band is None:
        return filled
    fine, coarse = (cv2.GaussianBlur(filled, (0, 0), wave / (2 * np.pi) / GSD_M) for wave in band)
    return fine - coarse


def contrast(values: np.ndarray, keep: np.ndarray) -> float:
    """Standard deviation as a share of the mean."""
    return float(values[keep].std() / values[keep].mean())


def at_scale(values: np.ndarray, there: np.ndarray, factor: int) -> np.ndarray:
    """Means of blocks of factor x factor, NaN where fewer than 0.7 of one are there."""
    rows, cols = (n // factor for n in values.shape)
    cut = np.s_[: rows * factor, : cols * factor]
    blocks = (rows, factor, cols, factor)
    count = there[cut].reshape(blocks).sum(axis=(1, 3))
    total = np.where(there, np.nan_to_num(values), 0.0)[cut].reshape(blocks).sum(axis=(1, 3))
    return np.where(count >= 0.7 * factor**2, total / np.maximum(count, 1), np.nan)


def windows(image: np.ndarray, ground: Ground, there: np.ndarray, factor: int) -> WindowComparison:
    return compare(
        at_scale(image, there, factor), at_scale(ground.radiance, there, factor), gsd_m=GSD_M * factor
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
    cv2.imwrite(str(path), cv2.resize(np.hstack(grey), None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "build" / "nac_pair")
    parser.add_argument("--data", type=Path, default=ROOT / "shared" / "data")
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
    photo = open_photo(folder / "tranqpit1_ortho_M152662021_0p5m.tif", None, sun)
    grounds = {name: Ground.of(path, sun) for name, path in files.items()}
    lines = ["## Smoothing", ""]
    lines += [
        f"{smoothed.rounds} rounds; bending {bending(heights):.0f} m2 -> {bending(smoothed.heights_m):.0f} m2; "
        f"moved at most {np.nanmax(np.abs(smoothed.heights_m - heights)):.4f} m, rms "
        f"{np.sqrt(np.nanmean((smoothed.heights_m - heights) ** 2)):.3f} m",
        "",
    ]
    lines += registration(photo, grounds)
    lines += window_tables(photo, grounds, out)
    lines += limits(photo, grounds, out, like)
    (out / "tables.md").write_text("\n".join(lines) + "\n")
    sys.stdout.write("\n".join(lines) + "\n")


def registration(photo: Photo, grounds: dict[str, Ground]) -> list[str]:
    lines = ["## Registration", "", "| surface | how | east, m | north, m | spread, m | correlation |", "| --- | --- | --- | --- | --- | --- |"]
    for name, ground in grounds.items():
        image, weight = on_ground(photo, ground.nodes)
        keep = far_from_hole(ground, weight)
        for band in (None, (8, 64)):
            at, scores = whole_offset(photo, ground, band)
            how = "whole" if band is None else f"whole, waves of {band[0]}-{band[1]} m"
            lines.append(f"| {name} | {how} | {at[0]:+.2f} | {at[1]:+.2f} | | {scores.max():.2f} |")
        patches = patch_offsets(image, ground, keep)
        for least in (0.3, PATCH_LEAST, 0.6):
            good = patches[(patches[:, 2] >= least) & np.isfinite(patches[:, 0])]
            if len(good) < 3:
                continue
            middle = np.median(good[:, :2], axis=0)
            spread = 1.4826 * np.median(np.abs(good[:, :2] - middle))
            lines.append(
                f"| {name} | {len(good)} of {len(patches)} patches above {least:g} | {middle[0]:+.2f} | {middle[1]:+.2f} "
                f"| {spread:.2f} | {np.median(good[:, 2]):.2f} |"
            )
    return [*lines, ""]


def window_tables(photo: Photo, grounds: dict[str, Ground], out: Path) -> list[str]:
    lines = [
        "## Windows", "", "| surface | cell, m | windows | above 0.9 | above 0.7 | above 0.5 | median | median, textured half | best |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]  # fmt: skip
    for name, ground in grounds.items():
        image, weight = on_ground(photo, ground.nodes)
        there = np.isfinite(ground.radiance) & (weight > 0.5)
        lines += [histogram_row(name, windows(image, ground, there, factor)) for factor in (1, 2, 4)]
        picture(out / f"{name.replace(' ', '_')}.png", image, ground.radiance)
    for model in MODELS[1:]:
        path = out / "dtm.tif"
        ground = Ground.of(path, grounds["steps smoothed"].scene.request.sun, model)
        image, weight = on_ground(photo, ground.nodes)
        there = np.isfinite(ground.radiance) & (weight > 0.5)
        lines.append(histogram_row(f"steps smoothed, {model}", windows(image, ground, there, 1)))
    return [*lines, ""]


def limits(photo: Photo, grounds: dict[str, Ground], out: Path, like: list[object]) -> list[str]:
    ground = grounds["steps smoothed"]
    image, weight = on_ground(photo, ground.nodes)
    keep = far_from_hole(ground, weight)
    lines = ["## By wavelength, away from the hole", "", "| waves, m | image's contrast | render's contrast | correlation, steps | correlation, smoothed | steps' own loss |", "| --- | --- | --- | --- | --- | --- |"]
    true = ground.radiance
    again = ground_of_requantised(ground, out, like)
    for band in (*BANDS_M, None):
        values = {name: passed(g.radiance, band)[keep] for name, g in grounds.items()}
        seen = passed(image, band)[keep]
        lines.append(
            f"| {'all' if band is None else f'{band[0]}-{band[1]}'} | {seen.std() / image[keep].mean():.3f} "
            f"| {values['steps smoothed'].std() / true[keep].mean():.3f} | {correlation(seen, values['steps as they came']):.2f} "
            f"| {correlation(seen, values['steps smoothed']):.2f} | {1 - correlation(passed(again, band)[keep], passed(true, band)[keep]):.3f} |"
        )
    return [*lines, ""]


def ground_of_requantised(ground: Ground, out: Path, like: list[object]) -> np.ndarray:
    """The smoothed surface taken for the truth, made rougher as the Moon is, rounded to the same steps shifted by half of one, smoothed again and rendered: what
    rounding costs.
    """
    with rasterio.open(out / "dtm.tif") as file:
        heights = file.read(1).astype(np.float64)
    stepped = STEP_M * (np.round(heights / STEP_M + 0.25) - 0.25)
    path = write_dem(out / "dtm_again.tif", smooth_terraces(stepped, STEP_M).heights_m, like)
    return Ground.of(path, ground.scene.request.sun).radiance


if __name__ == "__main__":
    main()
