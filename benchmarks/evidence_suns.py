"""Suns wrong by 10 deg: does an image say so? A part of `evidence.py --suns`.

`locate` searches every photograph with the Sun as it is stated and turned by 10 deg either way, and says where the best azimuth
lies (`sun_check.best_turn`). The same quantity is measured in windows of 16 x 16 cells against the DEM, with the number of
windows that it takes; elevations are tried there, too. Simulated frames are those of `claims_frames.py`: clones of the DEM with
height errors, unmapped brightness and noise, traced by an independent renderer, searched with its law and with another one.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import claims_frames
import numpy as np
from claims_photographs import ALBEDO
from evidence_cases import Case
from helpers import located_frames
from helpers.closed_loops import Site
from helpers.embree_mesh import read_nodes

from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.hdf5 import open_catalog
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.images.image import Image
from lcp_catalog.images.image_file import ImageOptions, open_image
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.matching.sun_check import best_turn, with_sun
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.validation.ground_comparison import RenderSettings, WindowChoice, against_dem

WRONG_DEG = (0.0, 10.0, -10.0)
STEP_DEG = 20.0
CELL_M = 948.0
EVERY = 5
"""One of so many maps of the series is searched."""
FRAMES = 10
LAW = "lunar-lambert"


def report(cases: Iterable[Case], data: Path, folder: Path) -> str:
    """Tables of points in photographs and simulated frames, and of windows."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [
        "| searched | Sun, deg | points | right Sun: best turn, deg | | +10 deg | | -10 deg | |",
        "| --- | ---: | ---: |" + " ---: | --- |" * 3,
        *photographs(list(cases)),
        *simulated(data, folder),
        "",
        "| windows | count | right Sun: best turn, deg | +10 deg | -10 deg | windows needed | "
        "loss at +-10 deg | at 10 deg lower, higher |",
        "| --- |" + " ---: |" * 7,
        *windows(data),
    ]
    return "\n".join(lines) + "\n"


# -- points


def photographs(cases: list[Case]) -> Iterator[str]:
    framed = [case for case in cases if case.name in located_frames.FRAMES]
    series = [case for case in cases if case.name.startswith("AS16")]
    for case in [*framed, *series[::EVERY]]:
        path = case.catalog()
        if path is not None:
            yield row(case.name, open_catalog(path), photograph(case), case.uncertainty)


def photograph(case: Case) -> Image:
    """The image; an Apollo 15 frame with the camera that `evidence_cases` displaced."""
    camera = read_camera(case.files.camera) if case.files.camera else None
    return open_image(case.files.image, camera, case.sun, ImageOptions(encoding=case.encoding))


def simulated(data: Path, folder: Path) -> Iterator[str]:
    for name, place in claims_frames.PLACES.items():
        dem = data / place.dem
        catalog = open_catalog(claims_frames.built(folder / f"{name}.h5", dem, place))
        nodes = read_nodes(dem, *place.center_deg, claims_frames.REACH_M)
        shots = Site(name, dem, catalog).shots(FRAMES // 2, claims_frames.SEED, claims_frames.DRAW)
        for shot, camera in shots:
            photo = claims_frames.taken(catalog, nodes, place, shot, camera)
            for law in (claims_frames.LAW, LAW):
                told = f"simulated, {name} {shot.number}, {law}"
                yield row(told, catalog, photo, Uncertainty(1500.0), law)


def row(name: str, catalog: Catalog, photo: Image, uncertainty: Uncertainty, law: str = LAW) -> str:
    ground = catalog.position_mcmf
    cells, sun, points = [], math.nan, 0
    for wrong in WRONG_DEG:
        told = with_sun(photo, ground, wrong, 0.0)
        found = locate(catalog, told, uncertainty, reflectance_model(law))
        if found.sun is not None:
            points = max(points, found.sun.points)
            turn = f"{found.sun.best_turn_deg:+.1f} +- {found.sun.best_turn_sigma_deg:.1f}"
        else:
            turn = "-"
        cells.append(f"{turn} | {found.verdict}{', Sun' if 'Sun' in found.reason else ''}")
    middle = ground.mean(axis=0)
    to_sun = photo.sun_directions(middle[None]).reshape(3)
    sun = math.degrees(math.asin(to_sun @ middle / np.linalg.norm(middle)))
    line = f"| {name} | {sun:.0f} | {points} | {' | '.join(cells)} |"
    print(line, file=sys.stderr, flush=True)
    return line


# -- windows


def windows(data: Path) -> Iterator[str]:
    """One row for each Apollo 15 frame, with its known camera."""
    albedo = AlbedoMap.open(data / ALBEDO, "linear")
    for name, ground in located_frames.FRAMES.items():
        folder = data / "images" / ground.folder
        given = located_frames.frame(data, name)
        photo = open_image(
            folder / f"{name}{ground.suffix}.png",
            given.sensor,
            options=ImageOptions(encoding="srgb"),
        )
        line = _windows_row(name, photo, folder / ground.dem, albedo)
        print(line, file=sys.stderr, flush=True)
        yield line


def _windows_row(name: str, photo: Image, dem: Path, albedo: AlbedoMap) -> str:
    middle = photo.sensor.position_mcmf_m[None]
    dems = DemSet.open([dem])
    choice = WindowChoice(gsd_m=CELL_M)

    def z(turn_deg: float, raise_deg: float) -> np.ndarray:
        told = with_sun(photo, middle, turn_deg, raise_deg)
        settings = RenderSettings(reflectance_model(LAW), albedo=albedo)
        found = against_dem(told, dems, settings, choice).windows.correlation
        return np.arctanh(np.clip(found, -0.999, 0.999))

    turned = {turn: z(turn, 0.0) for turn in (-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0)}
    lower, higher = z(0.0, -10.0), z(0.0, 10.0)
    right, cells, needed = turned[0.0], [], 0.0
    for wrong in WRONG_DEG:
        stated = turned[wrong]
        back, ahead = turned[wrong - STEP_DEG] - stated, turned[wrong + STEP_DEG] - stated
        turn, sigma = best_turn(back, ahead, STEP_DEG, len(stated))
        cells.append(f"{turn:+.1f} +- {sigma:.1f}")
        needed = max(needed, (3.0 * sigma / 10.0) ** 2 * len(stated))
    loss = right.mean() - 0.5 * (turned[-10.0].mean() + turned[10.0].mean())
    up = [f"{right.mean() - other.mean():.2f}" for other in (lower, higher)]
    return f"| {name} | {len(right)} | {' | '.join(cells)} | {math.ceil(needed)} | {loss:.2f} | {', '.join(up)} |"
