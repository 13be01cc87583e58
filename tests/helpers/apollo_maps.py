"""The frames of the Apollo 16 series as map-projected images, each with its own Sun, and a
catalogue of their terrain that the command builds from GLD100; shared by tests and benchmarks.
The maps use an older control net, which displaces their terrain by
about 0.8 km to the east and 0.2 km to the south.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from lcp_cli.main import run

from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import mcmf_to_lonlat
from lcp_catalog.images.image import Image
from lcp_catalog.images.image_file import open_image
from lcp_catalog.light.sun_choice import SunChoice

from .apollo_frames import SERIES, series_dem
from .located_frames import SWEEP
from .small_world import mirrored

UNCERTAIN = Uncertainty(1500.0)
NET_M = (803.0, -194.0)
"""Median displacement (east, north) of the frames that single points locate; robust spread 259 and
180 m."""

BUILD = SWEEP.format(elevations="10.0, 20.0, 35.0, 55.0", spacing="per_view = 0")
BOUNDS_DEG = (0, -13, 16, -5)


def built(shared: Path, folder: Path) -> Catalog:
    """The catalogue, built by the command unless it is in the folder already."""
    path = folder / "apollo16.h5"
    if not path.exists():
        config = folder / "apollo16.toml"
        config.write_text(BUILD)
        bounds = [str(value) for value in BOUNDS_DEG]
        options = ["-o", str(path), "--config", str(config), "--bounds", *bounds, "--jobs", "1"]
        assert run(["build-catalog", str(series_dem(shared)), *options]) == 0
    return open_catalog(path)


def frame(shared: Path, key: str) -> Image:
    """A map of the series, with the Sun of NASA's table."""
    folder = shared / "images" / SERIES
    rows = (line.split() for line in (folder / "meta" / "sunpos.txt").read_text().splitlines())
    position = next(np.array(row[1:], dtype=float) for row in rows if row and row[0] == key)
    lon, lat, _ = (float(value) for value in mcmf_to_lonlat(1e3 * position))
    path = folder / "DIM_input_1280mpp_masked" / f"{key}.tif"
    return open_image(path, None, SunChoice(subsolar_deg=(lon, lat)))


def middle(photo: Image) -> np.ndarray:
    """Place at the centre of a map, (1, 3)."""
    rows, cols = photo.signal.shape
    return MOON_RADIUS_M * photo.sensor.ground([[(cols - 1) / 2.0, (rows - 1) / 2.0]])


def cut(photo: Image, rows: int, cols: int) -> Image:
    """Upper left part of a map."""
    signal, weight = photo.signal[:rows, :cols], photo.weight[:rows, :cols]
    sensor = replace(photo.sensor, image_shape=signal.shape)
    return replace(photo, signal=signal, weight=weight, sensor=sensor)


def not_this_place(photo: Image, others: list[Image], seed: int = 0) -> Iterator[tuple[str, Image]]:
    """A map that does not show its place: turned or mirrored; with the pixels of other maps or of
    other terrain; or noise with the spectrum of terrain.
    """
    least = min(photo.signal.shape)
    for how in ("left-right", "up-down", "90", "180", "270"):
        yield how, mirrored(cut(photo, least, least), how)
    for other in others:
        shape = np.minimum(photo.signal.shape, other.signal.shape)
        same, given = cut(photo, *shape), cut(other, *shape)
        pixels = {name: np.ascontiguousarray(getattr(given, name)) for name in ("signal", "weight")}
        yield "other ground", replace(same, **pixels)
    shape = photo.signal.shape
    dice = np.random.default_rng(seed)
    for _ in range(3):
        waves = np.meshgrid(np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1]), indexing="ij")
        spectrum = np.fft.rfft2(dice.normal(size=shape)) / np.maximum(np.hypot(*waves), 0.005)
        yield (
            "noise like ground",
            replace(photo, signal=np.fft.irfft2(spectrum, s=shape).astype(np.float32)),
        )
