"""False matches and errors of the match in simulation: renders of real relief, noise of known statistics, exhaustive search.

A case is a place of a render (random, at least 30 % lit) under one Sun, a patch around it, and noise of one kind and level. Its
patch is searched in so many draws of render and noise with OpenCV's correlation at every place; then shift, gain and offset are
fitted by least squares. Search and fit use nothing of the library; the renders and the predictions are its own.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from claims_scores import HEAD, Reliability, as_json, bins_table, diagram, reliability, row_of
from helpers.twins_detection import (
    NEAR_NODES,
    Surroundings,
    correlation,
    noise_field,
    plain_probability,
    refined_probability,
    shift_covariance,
    sixth_order_slopes,
)
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from lcp_catalog import Area, Request, SunChoice, render
from lcp_catalog.landmarks.detection import detection_probability, least_rival, top_probability
from lcp_catalog.landmarks.error_model import ErrorModel, PatchErrors
from lcp_catalog.landmarks.localization import registration
from lcp_catalog.landmarks.uniqueness import RING, other_places
from lcp_catalog.photometry.laws import reflectance_model

HADLEY = "images/apollo15-metric-hadley/gld100_256ppd_lat20-30_lon000-010.tif"
CELLS_M = {474: None, 118: 100.0}
"""Cell size, and the side of the area in kilometres (None: the whole DEM)."""
SUN_ELEVATIONS = (6.0, 12.0, 20.0, 30.0, 45.0, 60.0)
SUN_AZIMUTHS = (20.0, 95.0, 170.0, 240.0, 310.0)
PLACES = 33  # x 30 Suns = 990 cases
DRAWS = 25
PATCHES = {33: 64, 25: 64, 17: 24}
"""Nodes along a patch's side, and the search in nodes each way."""
LENGTHS = (0.0, 1.5, 4.0)
LEVELS = (0.03, 0.075, 0.15, 0.3, 0.6)
SURE = 0.9
_LEAST_LIT, _LEAST_CONTRAST = 0.3, 0.005

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Case:
    """One place under one Sun and one noise, and what came of its draws."""

    cell_m: int
    nodes: int
    sun: tuple[float, float]  # azimuth, elevation
    place: tuple[int, int]
    length: float  # nodes
    level: float  # 1 sigma of the noise, of the mean lit level
    contrast: float
    predicted: dict[str, float]  # by method
    sigma_major: float  # stated, nodes
    near: int  # draws whose highest correlation lies within `NEAR_NODES` of the true place
    squared: dict[
        str, list[float]
    ]  # error^2 / covariance / 2 of the draws that were found, by method


def work(folder: Path, data: Path, places: int, draws: int) -> list[Case]:
    """All cases, those of finished Suns from the folder's files."""
    folder.mkdir(parents=True, exist_ok=True)
    cases: list[Case] = []
    for cell_m in CELLS_M:
        for sun in [(a, e) for e in SUN_ELEVATIONS for a in SUN_AZIMUTHS]:
            path = folder / f"{cell_m}-{sun[0]:g}-{sun[1]:g}-{places}x{draws}.json"
            if not path.exists():
                rows = [asdict(case) for case in _under_a_sun(data, cell_m, sun, places, draws)]
                beside = path.with_suffix(".part")
                beside.write_text(json.dumps(rows), encoding="utf-8")
                beside.rename(path)
                print(path.name, len(rows), flush=True)
            cases += [Case(**row) for row in json.loads(path.read_text(encoding="utf-8"))]
    return cases


def _under_a_sun(
    data: Path, cell_m: int, sun: tuple[float, float], places: int, draws: int
) -> Iterator[Case]:
    image = _rendered(data, cell_m, sun)
    for nodes, search in PATCHES.items():
        dice = np.random.default_rng(zlib.crc32(f"{cell_m} {sun} {nodes}".encode()))
        for number, place in enumerate(_places(image, nodes // 2, search, places, dice)):
            around = Surroundings.of(image, *place, nodes // 2, search)
            for kind, length in enumerate(LENGTHS):
                level = LEVELS[(number + kind) % len(LEVELS)]
                yield _tried(around, (cell_m, nodes, sun, place), length, level, draws, dice)


def _rendered(data: Path, cell_m: int, sun: tuple[float, float]) -> Image:
    size = CELLS_M[cell_m]
    request = Request(
        [data / HADLEY],
        area=None if size is None else Area(5.0, 25.0, size),
        gsd_m=float(cell_m),
        sun=SunChoice(*sun),
        model=reflectance_model("lunar-lambert"),
        disc=False,
    )
    return np.nan_to_num(render(request).radiance).astype(np.float32)


def _places(
    image: Image, half: int, search: int, count: int, dice: np.random.Generator
) -> Iterator[tuple[int, int]]:
    """Random nodes away from the border whose patch is lit and has contrast, as the matcher requires."""
    found = 0
    while found < count:
        row, col = (int(dice.integers(half + search, n - half - search)) for n in image.shape)
        patch = image[row - half : row + half + 1, col - half : col + half + 1]
        lit = patch > 0.0
        if lit.mean() >= _LEAST_LIT and patch.std() > _LEAST_CONTRAST * patch.mean():
            found += 1
            yield row, col


def _tried(
    around: Surroundings,
    about: tuple[int, int, tuple[float, float], tuple[int, int]],
    length: float,
    level: float,
    draws: int,
    dice: np.random.Generator,
) -> Case:
    predicted, covariances = _predictions(around, level, length)
    surface = spline_filter(around.image, order=3)
    near, squared = 0, {name: [] for name in covariances}
    for _ in range(draws):
        noisy = around.image + level * noise_field(dice, len(around.image), length)
        score = correlation(noisy, around.patch)
        at = np.array(np.unravel_index(np.argmax(score), score.shape)) - around.search
        if np.hypot(*at) > NEAR_NODES:
            continue
        near += 1
        if max(predicted.values()) >= SURE:
            shift = fitted_shift(surface, noisy, len(around.patch), at)
            for name, covariance in covariances.items():
                squared[name].append(float(shift @ np.linalg.solve(covariance, shift) / 2.0))
    sigma = float(np.sqrt(np.linalg.eigvalsh(covariances["library"])[1]))
    contrast = float(around.patch.std())
    return Case(*about, length, level, contrast, predicted, sigma, near, squared)


def _predictions(
    around: Surroundings, level: float, length: float
) -> tuple[dict[str, float], dict[str, NDArray[np.float64]]]:
    """Probabilities and covariances (column, row) by method."""
    probability, covariance = by_library(around, level, length)
    predicted = {
        "plain": plain_probability(around, level, length),
        "refined": refined_probability(around, level, length),
        "library": probability,
    }
    plain = shift_covariance(around.patch, level, length)
    sharp = shift_covariance(around.patch, level, length, sixth_order_slopes(around.patch))
    return predicted, {"three nodes": plain, "seven nodes": sharp, "library": covariance}


def by_library(
    around: Surroundings, level: float, length: float, cell_m: float = 100.0
) -> tuple[float, NDArray[np.float64]]:
    """Probability and covariance (column, row) as a build computes them, for the true place on a whole node.

    Correlated noise is stated as unmapped brightness of a uniform ground. The library averages that over a pixel, which widens
    l^2 by 1/6 pixel^2 and takes (l / wider)^2 of the variance; both are undone here.
    """
    nodes, reach = len(around.patch), len(around.image) // 2
    patches = around.patch[None].astype(np.float32)
    ground = np.ones_like(patches)
    inner = math.sqrt(max(length**2 - 1.0 / 6.0, 1e-6))
    noise = ErrorModel(
        sensor_noise=level if length == 0.0 else 0.0,
        height_sigma_m=0.0,
        albedo_sigma=0.0 if length == 0.0 else level * (length / inner),
        albedo_length_m=inner * cell_m,
    )
    match = registration(patches, PatchErrors(ground, 0 * ground, 0 * ground), noise, cell_m)
    middle = np.array([reach])
    image = around.image.astype(np.float32)
    whole = replace(match, shift_loss=np.zeros(1))
    least = least_rival(whole)
    others = other_places(image[None], patches, middle, middle, around.search, least=least)
    found = detection_probability(
        whole, others.correlation, others.contrast, least_correlation=-1.0
    )
    on_top = top_probability(whole, RING, others.near, others.near_contrast)
    assert match.nodes == nodes**2
    return float(found[0][0] * on_top[0]), np.asarray(match.covariance_px2[0])


def fitted_shift(
    surface: NDArray[np.float64], noisy: NDArray[np.float64], nodes: int, start: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Error (column, row), nodes, of the place at which shift, gain and offset of the patch fit a noisy image best, by Gauss and
    Newton's steps from whole nodes (row, column). ``surface``: coefficients of the cubic spline through the image without noise.
    """
    low = (len(noisy) - nodes) // 2
    grid = np.indices((nodes, nodes)) + low
    window = noisy[grid[0] + start[0], grid[1] + start[1]].ravel()

    def drawn(by: NDArray[np.float64]) -> NDArray[np.float64]:
        return map_coordinates(surface, grid + by[:, None, None], order=3, prefilter=False)

    off = np.zeros(2)  # the window is the image without noise at the grid, moved by -off
    for _ in range(20):
        model = drawn(-off)
        step = 1e-3
        slopes = [
            (drawn(-off - step * e) - drawn(-off + step * e)).ravel() / (2.0 * step)
            for e in np.eye(2)
        ]
        basis = np.stack([*slopes, np.ones(nodes**2), model.ravel()], axis=1)
        answer = np.linalg.lstsq(basis, window, rcond=None)[0]
        move = answer[:2] / answer[3]
        off = off + np.clip(move, -1.0, 1.0)
        if np.hypot(*move) < 1e-4:
            break
    return (start + off)[::-1]


# Tables


def report(cases: list[Case], draws: int, pictures: Path) -> tuple[str, dict[str, object]]:
    """Markdown, and figures for the JSON."""
    methods = list(cases[0].predicted)
    lines, figures = [], {}
    for method in methods:
        scored: dict[str, Reliability] = {}
        for length in LENGTHS:
            for cell_m in (None, *CELLS_M):
                some = [c for c in cases if c.length == length and cell_m in (None, c.cell_m)]
                scored[f"{_noise(length)}, {'all' if cell_m is None else f'{cell_m} m'}"] = _of(
                    some, method, draws
                )
        whole = {name: of for name, of in scored.items() if name.endswith("all")}
        diagram(pictures / f"simulated-{method}.png", f"Simulated search, {method}", whole)
        lines += [f"**Probability of detection, {method}**", "", HEAD]
        lines += [row_of(name, of) for name, of in scored.items()]
        lines += ["", bins_table(whole), ""]
        figures[method] = {name: as_json(of) for name, of in scored.items()}
    lines += [_by_level(cases, methods[-1], draws), "", _squared(cases, figures)]
    return "\n".join(lines) + "\n", figures


def _noise(length: float) -> str:
    return "white" if length == 0.0 else f"{length:g} cells"


def _of(cases: list[Case], method: str, draws: int) -> Reliability:
    return reliability([c.predicted[method] for c in cases], [c.near / draws for c in cases], draws)


def _by_level(cases: list[Case], method: str, draws: int) -> str:
    lines = [f"**By level of the noise and size of the patch, {method}**", "", HEAD]
    for level in LEVELS:
        some = [c for c in cases if c.level == level]
        if some:
            lines.append(row_of(f"noise {level:g}", _of(some, method, draws)))
    for nodes in PATCHES:
        some = [c for c in cases if c.nodes == nodes]
        lines.append(row_of(f"{nodes} x {nodes}", _of(some, method, draws)))
    return "\n".join(lines)


def _squared(cases: list[Case], figures: dict[str, object]) -> str:
    """Measured over stated variance of the shift where the match is sure."""
    lines = [f"**Measured over stated variance of the match, probability at least {SURE:g}**", ""]
    lines += ["| noise | cells | method | matches | mean | median of cases | 10..90 % of cases |"]
    lines += ["| --- | --- | --- | ---: | ---: | ---: | --- |"]
    rows = []
    for length in LENGTHS:
        for cell_m in (None, *CELLS_M):
            for method in cases[0].squared:
                some = [
                    c.squared[method]
                    for c in cases
                    if c.length == length
                    and cell_m in (None, c.cell_m)
                    and c.squared[method]
                    and min(c.predicted.values()) >= SURE
                ]
                if not some:
                    continue
                means = np.array([np.mean(v) for v in some])
                low, middle, high = np.percentile(means, [10, 50, 90])
                count, mean = sum(map(len, some)), float(np.mean(np.concatenate(some)))
                cells = "all" if cell_m is None else f"{cell_m} m"
                lines.append(
                    f"| {_noise(length)} | {cells} | {method} | {count} | {mean:.3f} | {middle:.2f} | {low:.2f}..{high:.2f} |"
                )
                rows.append(
                    {
                        "noise": length,
                        "cells": cells,
                        "method": method,
                        "count": count,
                        "mean": mean,
                    }
                )
    figures["squared"] = rows
    return "\n".join(lines)
