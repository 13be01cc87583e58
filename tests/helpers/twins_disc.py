"""Slow reference computations of the finite Sun: the disc as thousands of directions with exact
shadows, and the share of a disc above a straight edge in mpmath. No strips, horizons or tables.
"""

from __future__ import annotations

import math

import mpmath
import numpy as np

from lcp_catalog.arrays import Array
from lcp_catalog.terrain.heightfield import Heightfield

LAW = (0.30, 0.93, -0.23)  # Allen's Astrophysical Quantities, 550 nm


def towards(azimuth_deg: float, elevation_deg: float) -> Array:
    """Unit ENU vector."""
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    return np.array([math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)])


def disc_directions(sun: Array, radius_rad: float, rings: int) -> tuple[Array, Array]:
    """Directions (n, 3) over the disc and their shares of its flux (n,): rings of equal width, with
    sectors that make the cells nearly square; spherical geometry (Rodrigues).
    """
    side = np.cross(sun, [0.0, 0.0, 1.0] if abs(sun[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    other = np.cross(sun, side)
    found, weights = [], []
    for ring in range(rings):
        rho = (ring + 0.5) / rings
        mu = math.sqrt(1.0 - rho * rho)
        sectors = max(round(2.0 * math.pi * (ring + 0.5)), 4)
        turn = 2.0 * math.pi * (np.arange(sectors) + 0.5 * (ring % 2)) / sectors
        away = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other
        found.append(math.cos(rho * radius_rad) * sun + math.sin(rho * radius_rad) * away)
        brightness = LAW[0] + LAW[1] * mu + LAW[2] * mu * mu
        weights.append(np.full(sectors, brightness * rho / sectors))
    weight = np.concatenate(weights)
    return np.concatenate(found), weight / weight.sum()


def sampled_share(
    field: Heightfield,
    sun: Array,
    radius_rad: float,
    rings: int,
    window: tuple[int, int, int, int] | None = None,
) -> Array:
    """Share of the disc visible from every node of a window (by default of the field), float64
    (rows, cols).
    """
    row0, row1, col0, col1 = window or field.whole
    out = np.zeros((row1 - row0, col1 - col0))
    for direction, weight in zip(*disc_directions(sun, radius_rad, rings), strict=True):
        out += weight * ~field.occluded_nodes(direction, window)
    return out


def cap_share(height: float) -> mpmath.mpf:
    """Flux above the chord at ``height`` (radii above the centre), as a share, from the arcs of
    rings above the chord.
    """
    a, b, c = (mpmath.mpf(v) for v in map(repr, LAW))
    h = mpmath.mpf(height)

    def ring(rho: mpmath.mpf) -> mpmath.mpf:
        mu = mpmath.sqrt(1 - rho * rho)
        arc = 2 * mpmath.acos(min(max(h / rho, -1), 1)) if rho else 0
        return (a + b * mu + c * mu * mu) * rho * arc

    places = sorted({mpmath.mpf(0), abs(h), mpmath.mpf(1)})
    return mpmath.quad(ring, places) / (mpmath.pi * (a + 2 * b / 3 + c / 2))


def ridge_share(to_crest: Array, along: Array, sun: Array, radius_rad: float) -> float:
    """Share of the disc above an infinite straight crest: ``to_crest`` is the vector to a point of
    it, ``along`` its direction. Such a crest is a great circle of the sky.
    """
    normal = np.cross(along, to_crest)
    normal *= np.sign(normal[2]) / np.linalg.norm(normal)  # upwards: the open sky
    below = math.asin(float(normal @ sun))  # of the crest, under the disc's middle
    return float(cap_share(max(min(-math.tan(below) / math.tan(radius_rad), 1.0), -1.0)))
