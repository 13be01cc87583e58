"""Small random heightfields and Suns on and off the axes: what the tests of the heightfield share."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from lcp_catalog.terrain.heightfield import Heightfield

GSD, X0, Y0 = 4.0, 10.0, 20.0
ROUNDING_M = 1e-9
"""Margins smaller than this are ties, which float64 may decide either way."""

AXES = [
    (1, 0, 0),
    (0, 1, 0),
    (-1, 0, 0),
    (0, -1, 0),
    (1, 1, 0),
    (1, -1, 0),
    (-1, 1, 0),
    (-1, -1, 0),
]
SPECIAL_AZIMUTHS = [0, 45, 90, 135, 180, 225, 270, 315]
SPECIAL_ELEVATIONS = [0, 1e-6, 0.1, 5, 45, 89.9, 90, -5, -40, -90]
quick = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


def sun(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """Unit ENU vector; exactly on an axis or a diagonal where the azimuth is, so that the judge
    means the same ray.
    """
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    east, north = math.sin(a), math.cos(a)
    if azimuth_deg % 45 == 0:
        east, north = (
            float(np.sign(round(c, 9))) * (1 if azimuth_deg % 90 == 0 else math.sqrt(0.5))
            for c in (east, north)
        )
    level = 0.0 if abs(elevation_deg) == 90 else math.cos(e)
    return np.array([east * level, north * level, math.sin(e)])


@st.composite
def terrains(draw, holes=None) -> np.ndarray:
    """Small terrains: ties of whole numbers, noise, spikes and pits, cliffs, float32 of all sizes;
    some with nodata.
    """
    rows, cols = draw(st.integers(2, 14)), draw(st.integers(2, 14))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from(["whole", "noise", "spikes", "cliff", "mixed"]))
    if kind == "whole":
        z = rng.integers(-3, 4, (rows, cols)).astype(float)
    elif kind == "noise":
        z = rng.normal(size=(rows, cols)) * 5
    elif kind == "spikes":
        z = np.zeros((rows, cols))
        z.flat[rng.integers(0, z.size, 3)] = rng.choice([-50, 50, 7], 3)
    elif kind == "cliff":
        z = np.where(np.arange(cols) > cols // 2, 20.0, 0.0) + rng.normal(size=(rows, cols))
    else:
        z = rng.normal(size=(rows, cols)) * 10.0 ** rng.integers(-6, 4, (rows, cols))
    share = draw(st.sampled_from([0.0, 0.0, 0.1, 0.3, 0.6])) if holes is None else holes
    z[rng.random(z.shape) < share] = np.nan
    return z.astype(np.float32)


suns = st.builds(
    sun,
    st.one_of(st.sampled_from(SPECIAL_AZIMUTHS), st.floats(0, 360).map(lambda a: round(a, 6))),
    st.one_of(st.sampled_from(SPECIAL_ELEVATIONS), st.floats(0, 90).map(lambda e: round(e, 6))),
)


def field(z: np.ndarray) -> Heightfield:
    return Heightfield(z, GSD, X0, Y0)


def agrees(answer: np.ndarray, margins: np.ndarray) -> bool:
    """Whether answers are those of the judge wherever the judge is sure, and False at nodata."""
    sure = np.isfinite(margins) & (np.abs(margins) > ROUNDING_M) | np.isinf(margins)
    return bool((answer[sure] == (margins[sure] > 0)).all() and not answer[np.isnan(margins)].any())


def places(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    i, j = np.mgrid[: z.shape[0], : z.shape[1]]
    return X0 + j * GSD, Y0 - i * GSD
