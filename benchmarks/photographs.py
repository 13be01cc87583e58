"""Renders compared with images of the Moon: every reflectance model, with and without an albedo map, by Sun and phase.

    .venv/bin/python benchmarks/photographs.py [-o build/photographs] [--frames 54]

needs the shared lunar data (`tests/conftest.py` has their folder) and writes `tables.md` (the tables of
docs/measurements/photographs.md), `frames.csv` (one line for each frame) and pictures. The library makes every render and every
albedo factor. Nothing is fitted to an image except the one shift of the series.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import cv2
import numpy as np
import rasterio
from helpers import apollo_frames as apollo
from photograph_pairs import measured_shift, repeatability

from lcp_catalog.errors import ConfigError
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.laws import reflectance_model

MODELS = (
    "lambert",
    "lommel-seeliger",
    "lommel-seeliger:rolo",
    "lunar-lambert",
    "minnaert",
    "hapke",
    "hapke:wac-643-mare",
    "hapke:wac-643-highland",
)
DRAWN = "lunar-lambert"
LISTED = ("lommel-seeliger", "lommel-seeliger:rolo", "lunar-lambert", "hapke")  # in frames.csv
NO_MAP = "-"
ALONE = "map alone"
SEARCH_PX = 8
FOUND_PX = 1.0
SUN_BINS = (4, 8, 12, 16, 20, 25, 30, 35, 41, 46, 50, 55, 60)
PHASE_BINS = (0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 120)
CENTRE_PHASE_BINS = (30, 40, 50, 60, 70, 80, 90)
SHOWN = ("AS16-M-0447", "AS16-M-1268", "AS16-M-2805")

PANELS = [("lommel-seeliger", NO_MAP), (DRAWN, NO_MAP), (DRAWN, "linear")]

Maps = dict[str, AlbedoMap]
Variant = tuple[str, str]
"""Reflectance model, and use of the albedo map."""


@dataclass
class Window:
    """One window of a frame, with its result for each variant."""

    sun_deg: float
    phase_deg: float
    correlation: dict[Variant, float] = field(default_factory=dict)
    found: dict[Variant, bool] = field(default_factory=dict)


@dataclass
class Row:
    """One frame."""

    name: str
    sun_deg: float
    phase_deg: float
    nodes: int
    whole: dict[Variant, float] = field(default_factory=dict)
    windows: list[Window] = field(default_factory=list)

    def median(self, variant: Variant) -> float:
        """Of the windows' correlations."""
        return median([window.correlation[variant] for window in self.windows])


def median(values: list[float]) -> float:
    return float(np.median(values)) if values else float("nan")


# -- maps


def albedo_maps(source: Path, folder: Path) -> Maps:
    """The map with three encodings: as declared; as linear values although they are codes; and
    decoded twice.
    """
    with rasterio.open(source) as file:
        linear, profile = file.read(1) / 65535.0, file.profile
    codes = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    for name, values in (("codes", codes), ("twice", linear)):
        with rasterio.open(folder / f"{name}.tif", "w", **profile) as file:
            file.write(np.round(65535.0 * values).astype(np.uint16), 1)
    return {
        "linear": AlbedoMap.open(source, "linear"),
        "codes": AlbedoMap.open(folder / "codes.tif", "linear"),
        "decoded twice": AlbedoMap.open(folder / "twice.tif", "srgb"),
    }


# -- one frame


def judged(frame: apollo.Frame, models: list[str], maps: Maps) -> Row:
    """All variants of one frame."""
    phase = frame.phase_deg
    row = Row(
        frame.name,
        frame.sun_elevation_deg,
        frame.phase_at_centre_deg,
        int(frame.compared.sum()),
    )
    places = frame.windows()
    row.windows = [Window(row.sun_deg, float(phase[place].mean())) for place in places]
    for variant, render in renders(frame, models, maps):
        row.whole[variant] = frame.correlation(render)
        for window, place in zip(row.windows, places, strict=True):
            window.correlation[variant] = frame.correlation(render, place)
            found = located(frame, render, place)
            if found is not None:
                window.found[variant] = found
    return row


def renders(
    frame: apollo.Frame, models: list[str], maps: Maps
) -> Iterator[tuple[Variant, np.ndarray]]:
    """Every model without a map and with each of them; and each map alone, without relief."""
    factors = {name: albedo.at_nodes(frame.scene.terrain) for name, albedo in maps.items()}
    yield from (((ALONE, name), frame.on_grid(of)) for name, of in factors.items())
    for model in models:
        radiance = frame.radiance(model)
        yield (model, NO_MAP), frame.on_grid(radiance)
        for name, factor in factors.items():
            yield (model, name), frame.on_grid(radiance * factor)


def located(frame: apollo.Frame, render: np.ndarray, place: tuple[slice, slice]) -> bool | None:
    """True if the best correlation of a rendered window with the image, within 8 cells, is at its
    true place to one cell; None near the frame's border.
    """
    top, left = place[0].start - SEARCH_PX, place[1].start - SEARCH_PX
    bottom, right = place[0].stop + SEARCH_PX, place[1].stop + SEARCH_PX
    around = np.s_[max(top, 0) : bottom, max(left, 0) : right]
    if min(top, left) < 0 or bottom > len(render) or right > render.shape[1]:
        return None
    if frame.compared[around].mean() < 0.9:
        return None
    image, template = (part.astype(np.float32) for part in (frame.image[around], render[place]))
    if template.std() == 0.0:
        return False
    scores = cv2.matchTemplate(image, template, cv2.TM_CCOEFF_NORMED)
    row, col = np.unravel_index(int(scores.argmax()), scores.shape)
    return bool(np.hypot(row - SEARCH_PX, col - SEARCH_PX) <= FOUND_PX)


# -- tables


Figure = Callable[[Variant], float]


def table(title: str, groups: list[tuple[str, int, Figure]], models: list[str]) -> str:
    """Markdown table: a row for each group, a column for each model, each cell with the figures
    without and with the map.
    """
    lines = [f"**{title}**", "", f"| | n | {' | '.join(models)} | {ALONE} |"]
    lines.append("| --- | ---: |" + " ---: |" * (len(models) + 1))
    for label, count, figure in groups:
        if count:
            cells = [f"{figure((of, NO_MAP)):.2f} / {figure((of, 'linear')):.2f}" for of in models]
            cells.append(f"{figure((ALONE, 'linear')):.2f}")
            lines.append(f"| {label} | {count} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def binned(
    values: list[tuple[float, object]], edges: tuple[int, ...]
) -> Iterator[tuple[str, list]]:
    for low, high in pairwise(edges):
        yield f"{low}..{high}", [item for value, item in values if low <= value < high]


def whole_groups(
    rows: list[Row], edges: tuple[int, ...], key: str
) -> list[tuple[str, int, Figure]]:
    """Medians over the frames of each bin."""
    pairs = [(getattr(row, key), row) for row in rows]
    return [
        (label, len(some), lambda v, some=some: median([row.whole[v] for row in some]))
        for label, some in binned(pairs, edges)
    ]


def window_groups(
    rows: list[Row], edges: tuple[int, ...], key: str, figure: str = "correlation"
) -> list[tuple[str, int, Figure]]:
    """Medians of the windows' correlations, or shares of the windows that were found."""
    pairs = [(getattr(window, key), window) for row in rows for window in row.windows]
    if figure == "found":
        pairs = [pair for pair in pairs if pair[1].found]
    of = np.median if figure == "correlation" else np.mean
    return [
        (
            label,
            len(some),
            lambda v, some=some: float(of([getattr(window, figure)[v] for window in some])),
        )
        for label, some in binned(pairs, edges)
    ]


def by_map(rows: list[Row], models: list[str], hows: list[str]) -> str:
    """Medians over all frames and over all windows, by the use of the map."""
    lines = ["**How the albedo map is taken**", ""]
    lines.append(f"| law | {' | '.join(f'{how}: frames | windows' for how in hows)} |")
    lines.append("| --- |" + " ---: |" * (2 * len(hows)))
    windows = [window for row in rows for window in row.windows]
    for model in models:
        cells = []
        for how in hows:
            variant = (model, how)
            cells.append(median([row.whole[variant] for row in rows]))
            cells.append(median([window.correlation[variant] for window in windows]))
        lines.append(f"| {model} | {' | '.join(f'{cell:.3f}' for cell in cells)} |")
    return "\n".join(lines) + "\n"


def lowest(rows: list[Row], models: list[str], below_deg: float) -> str:
    """The frame with the lowest correlation for each model below an elevation of the Sun, without
    and with the map.
    """
    some = [row for row in rows if row.sun_deg < below_deg]
    lines = [f"**The lowest of {len(some)} frames, Sun below {below_deg:.0f} deg**", ""]
    lines.append("| | correlation | frame, Sun | frames below 0.6 |")
    lines.append("| --- | ---: | --- | ---: |")
    for model in models:
        for how, label in ((NO_MAP, model), ("linear", f"{model}, with the map")):
            worst = min(some, key=lambda row, of=(model, how): row.whole[of])
            under = sum(row.whole[model, how] < 0.6 for row in some)
            at = f"{worst.name}, {worst.sun_deg:.1f} deg"
            lines.append(f"| {label} | {worst.whole[model, how]:.2f} | {at} | {under} |")
    return "\n".join(lines) + "\n"


def per_frame(rows: list[Row], variants: list[Variant]) -> Iterator[list[str]]:
    """Lines of frames.csv: whole frames, then the medians of their windows."""
    head = [model if how == NO_MAP else f"{model} + map" for model, how in variants]
    yield ["frame", "sun_deg", "phase_deg", "cells", *head, *(f"{name}, windows" for name in head)]
    for row in rows:
        figures = [row.whole[variant] for variant in variants]
        figures += [row.median(variant) for variant in variants]
        what = [row.name, f"{row.sun_deg:.1f}", f"{row.phase_deg:.1f}", str(row.nodes)]
        yield [*what, *(f"{figure:.2f}" for figure in figures)]


# -- pictures


def picture(frame: apollo.Frame, models: list[Variant], maps: Maps) -> np.ndarray:
    """Image and renders side by side, each stretched between its own 1st and 99th percentile of the
    compared cells; uint8.
    """
    panels = [frame.image]
    for model, how in models:
        factor = None if how == NO_MAP else maps[how].at_nodes(frame.scene.terrain)
        panels.append(frame.render(model, factor))
    shown = []
    for panel in panels:
        low, high = np.percentile(panel[frame.compared], [1, 99])
        grey = np.clip((panel - low) / (high - low), 0.0, 1.0)
        shown.append(np.where(frame.compared, 255.0 * grey, 0.0).astype(np.uint8))
    gap = np.full((frame.image.shape[0], 4), 255, np.uint8)
    return np.hstack([part for panel in shown for part in (panel, gap)][:-1])


# -- the whole


def known(models: tuple[str, ...]) -> list[str]:
    """The models that the library has."""
    found = []
    for model in models:
        try:
            reflectance_model(model)
        except ConfigError as error:
            print(f"left out: {error}", file=sys.stderr)
        else:
            found.append(model)
    return found


def report(rows: list[Row], single: list[Row], models: list[str], maps: Maps) -> str:
    """All tables."""
    whole, window = partial(whole_groups, rows), partial(window_groups, rows)
    own = [(f"{row.name}, Sun {row.sun_deg:.0f}", row) for row in single]
    few = [model for model in models if not model.startswith("hapke:")]  # they differ by 0.02
    parts = [
        table("Whole frames by Sun elevation", whole(SUN_BINS, "sun_deg"), few),
        table("Whole frames by phase", whole(CENTRE_PHASE_BINS, "phase_deg"), few),
        table("Windows by Sun elevation", window(SUN_BINS, "sun_deg"), few),
        table("Windows by phase", window(PHASE_BINS, "phase_deg"), few),
        table("Windows found, by Sun elevation", window(SUN_BINS, "sun_deg", "found"), few),
        table("Windows found, by phase", window(PHASE_BINS, "phase_deg", "found"), few),
        lowest(rows, models, 41.0),
        by_map(rows, models, [NO_MAP, *maps]),
        table("Single frames, whole", [(at, 1, row.whole.__getitem__) for at, row in own], few),
        table(
            "Single frames, windows",
            [(at, len(row.windows), row.median) for at, row in own],
            few,
        ),
        by_map(single[:1], models, [NO_MAP, *maps]),
    ]
    return "\n".join(parts)


def repeated(shared: Path, keys: list[str], fwhm: float) -> str:
    """Correlation of two images of the same terrain, by window."""
    pairs = repeatability(shared, keys, fwhm)
    lines = [
        "**Photograph against photograph, windows**",
        "",
        "| Sun, deg | n | correlation | its root |",
    ]
    lines.append("| --- | ---: | ---: | ---: |")
    for label, some in binned([(sun, value) for sun, value in pairs], SUN_BINS):
        if some:
            lines.append(
                f"| {label} | {len(some)} | {median(some):.2f} | {median(some) ** 0.5:.2f} |"
            )
    return "\n".join(lines) + "\n"


def singles(data: Path, fwhm: float) -> Iterator[apollo.Frame]:
    """Frames with their own camera, and the frame of the Apollo 15 series, whose terrain only a DEM
    of 1.9 km contains.
    """
    for key in ("AS15-M-1134", "AS15-M-0414", "AS15-M-0295", "AS15-M-0299", "AS15-M-0300"):
        yield apollo.framed(data, key, fwhm)
    coarse = data / "dem" / "gld100" / "gld100_016ppd_global.tif"
    yield apollo.series_frame(data, "AS15-M-0073", fwhm=fwhm, dem=coarse)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("-o", "--out", type=Path, default=ROOT / "build" / "photographs")
    here = os.environ.get("LCP_SHARED_DATA", ROOT.parent / "shared" / "data")
    arguments.add_argument("--data", type=Path, default=Path(here))
    arguments.add_argument("--frames", type=int, default=999, help="so many of the series, spread")
    arguments.add_argument("--fwhm", type=float, default=apollo.FWHM, help="smoothing, in cells")
    options = arguments.parse_args()
    warnings.filterwarnings("ignore", category=rasterio.errors.NotGeoreferencedWarning)
    options.out.mkdir(parents=True, exist_ok=True)
    keys = apollo.series_keys(options.data)
    models = [*known(MODELS), *apollo.YARDSTICKS]
    with tempfile.TemporaryDirectory() as folder:
        maps = albedo_maps(options.data / "albedo" / "relative_albedo_11ppd.tif", Path(folder))
        single = [judged(frame, models, maps) for frame in singles(options.data, options.fwhm)]
        rows = []
        for key in keys[:: max(1, len(keys) // options.frames)]:
            frame = apollo.series_frame(options.data, key, fwhm=options.fwhm)
            rows.append(judged(frame, models, maps))
            print(f"{key}  Sun {rows[-1].sun_deg:.1f}", file=sys.stderr)
            if key in SHOWN:
                cv2.imwrite(str(options.out / f"{key}.png"), picture(frame, PANELS, maps))
        text = (
            report(rows, single, models, maps) + "\n" + repeated(options.data, keys, options.fwhm)
        )
    columns, lines = measured_shift(options.data, keys, DRAWN)
    text += f"\nMedian shift of the series: {columns:.2f} columns, {lines:.2f} rows.\n"
    (options.out / "tables.md").write_text(text, encoding="utf-8")
    variants = [(model, how) for model in LISTED for how in (NO_MAP, "linear")]
    with (options.out / "frames.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(per_frame(sorted(rows, key=lambda row: row.sun_deg), variants))
    print(text)


if __name__ == "__main__":
    main()
