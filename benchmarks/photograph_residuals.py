"""Residual differences between renders and images of the Moon: the gain of a free response, fall-off or phase function.

    .venv/bin/python benchmarks/photograph_residuals.py [LAW ...]

A supplement to `photographs.py`: here terms are fitted to each image, one at a time, to measure their contribution. The
results are not in the tables of docs/measurements. Prints Markdown; needs the shared lunar data.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
import rasterio
from helpers import apollo_frames as apollo

from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.hapke_parameters import DEFAULT_SET, hapke_set
from lcp_catalog.photometry.laws import Reflectance, radiance_factor

LAWS = ("hapke", "lunar-lambert")
SUN_BINS = ((4, 8), (8, 16), (16, 25), (25, 35), (35, 41), (46, 60))
BINS = 60
COLUMNS = (
    "as it is",
    "times cos^4 of the field angle",
    "ranks",
    "any rising response",
    "any even fall-off",
    "any phase function",
    "fall-off and phase",
    "fall-off, phase, response",
)


def asides(frame: apollo.Frame, law: str, factor: np.ndarray) -> list[float]:
    """Correlation of a frame with its render, in the order of `COLUMNS`."""
    valid = frame.compared
    image, render = frame.image[valid], frame.render(law, factor)[valid]
    tan2 = frame.off_axis[valid] ** 2
    radial = [render * tan2, render * tan2**2]
    phase = [render * (frame.phase_deg[valid] / 60.0) ** power for power in (1, 2, 3)]
    every = _fitted(image, [render, *radial, *phase])
    return [
        apollo.correlation(image, render),
        apollo.correlation(image, render / (1.0 + tan2) ** 2),
        apollo.correlation(_ranks(image), _ranks(render)),
        apollo.correlation(image, rising(render, image)),
        apollo.correlation(image, _fitted(image, [render, *radial])),
        apollo.correlation(image, _fitted(image, [render, *phase])),
        apollo.correlation(image, every),
        apollo.correlation(image, rising(every, image)),
    ]


def _fitted(image: np.ndarray, terms: list[np.ndarray]) -> np.ndarray:
    """Best linear combination of the terms with an offset."""
    columns = np.column_stack([np.ones_like(image), *terms])
    return columns @ np.linalg.lstsq(columns, image, rcond=None)[0]


def _ranks(values: np.ndarray) -> np.ndarray:
    return np.argsort(np.argsort(values)).astype(np.float64)


def rising(render: np.ndarray, image: np.ndarray) -> np.ndarray:
    """The render through the best nondecreasing curve: means of 60 equal shares, pooled where they
    decrease (Ayer et al. 1955), linear in between.
    """
    shares = np.array_split(np.argsort(render), BINS)
    at = [float(render[share].mean()) for share in shares]
    pools: list[tuple[float, int]] = []
    for share in shares:
        pools.append((float(image[share].mean()), 1))
        while len(pools) > 1 and pools[-2][0] > pools[-1][0]:
            (a, n), (b, m) = pools[-2:]
            pools[-2:] = [((a * n + b * m) / (n + m), n + m)]
    level = [value for value, count in pools for _ in range(count)]
    return np.interp(render, at, level)


def as_scattering_albedo(data: Path, albedo: AlbedoMap) -> None:
    """AS15-M-1134 under Hapke's law: the map as a factor, and turned into each node's own single-scattering
    albedo, so that it is the ratio of radiance factors in a geometry (incidence, emission, phase).
    """
    frame = apollo.framed(data, "AS15-M-1134")
    factor, shot = albedo.at_nodes(frame.scene.terrain), frame.shot
    print(f"\nfactor: {frame.correlation(frame.render('hapke', factor)):.4f}")
    bands = (shot.incidence_deg, shot.emission_deg, shot.phase_deg)
    angles = [np.radians(np.nan_to_num(band.astype(np.float64), nan=90.0)) for band in bands]
    mean = hapke_set(DEFAULT_SET)
    steps = [replace(mean, w=float(w)) for w in np.linspace(0.05, 0.95, 46)]
    laws = [Reflectance.of_hapke(step) for step in steps]
    images = np.stack([radiance_factor(law, *angles) for law in laws])
    for geometry in ((60.0, 0.0, 60.0), (30.0, 0.0, 30.0), (0.0, 0.0, 0.0)):
        there = np.radians(geometry)
        bright = np.array([float(radiance_factor(law, *there)) for law in laws])
        bright /= float(radiance_factor(Reflectance.of_hapke(mean), *there))
        at = np.clip(np.interp(factor, bright, np.arange(len(laws))), 0.0, len(laws) - 1.001)
        below = at.astype(int)
        low, high = (np.take_along_axis(images, (below + k)[None], 0)[0] for k in (0, 1))
        radiance = (low + (at - below) * (high - low)) * shot.sunlit
        print(f"ratio at {geometry}: {frame.correlation(frame.on_grid(radiance)):.4f}")


def frames(data: Path) -> Iterator[apollo.Frame]:
    for key in apollo.series_keys(data):
        yield apollo.series_frame(data, key)
    for key in apollo.FRAMED:
        yield apollo.framed(data, key)


def main() -> None:
    warnings.filterwarnings("ignore", category=rasterio.errors.NotGeoreferencedWarning)
    data = Path(os.environ.get("LCP_SHARED_DATA", ROOT.parent / "shared" / "data"))
    albedo = AlbedoMap.open(data / "albedo" / "relative_albedo_11ppd.tif", "linear")
    laws = sys.argv[1:] or LAWS
    found: dict[str, list[tuple[str, float, list[float]]]] = {law: [] for law in laws}
    for frame in frames(data):
        factor = albedo.at_nodes(frame.scene.terrain)
        for law in laws:
            line = (frame.name, frame.sun_elevation_deg, asides(frame, law, factor))
            found[law].append(line)
    for law in laws:
        print(f"\n**{law}, with the map**\n\n| | n | {' | '.join(COLUMNS)} |")
        print("| --- | ---: |" + " ---: |" * len(COLUMNS))
        series = [line for line in found[law] if line[0].startswith("AS16")]
        for low, high in SUN_BINS:
            some = [figures for _, sun, figures in series if low <= sun < high]
            _line(f"Sun {low}..{high}", len(some), np.median(some, axis=0))
        for name, _, figures in found[law][len(series) :]:
            _line(name, 1, figures)
    as_scattering_albedo(data, albedo)


def _line(label: str, count: int, figures: list[float] | np.ndarray) -> None:
    print(f"| {label} | {count} | {' | '.join(f'{figure:.2f}' for figure in figures)} |")


if __name__ == "__main__":
    main()
