"""Brightness of the solar disc, and its flux above horizons: exact integrals of a limb-darkening law.

Lengths are in radii of the disc, whose middle is the origin; y is up. Flux is that of a disc of
radius 1 whose middle has the brightness 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array

STEPS = 4096
"""Steps of the table of a strip's flux over height; linear interpolation is accurate to 3e-6 of the
disc's flux.
"""


@dataclass(frozen=True)
class LimbDarkening:
    """Quadratic limb darkening: I(mu) / I(1) = a + b mu + c mu^2 with a + b + c = 1.

    mu is the cosine of the angle between the line of sight and the Sun's surface normal: mu^2 = 1 -
    (distance from the disc's centre)^2. The default is the visible continuum at 550 nm: Cox (ed.)
    2000, Allen's Astrophysical Quantities, 4th edition.
    """

    a: float = 0.30
    b: float = 0.93
    c: float = -0.23

    @property
    def flux(self) -> float:
        """Flux of the whole disc."""
        return math.pi * (self.a + 2.0 / 3.0 * self.b + 0.5 * self.c)

    def chord_flux(self, half: ArrayLike, start: ArrayLike, end: ArrayLike) -> Array:
        """Flux per unit width from ``start`` to ``end`` of chords of half length ``half``, on which
        mu^2 = half^2 - (position)^2; closed form.
        """
        half = np.asarray(half, dtype=np.float64)
        return self._primitive(half, end) - self._primitive(half, start)

    def _primitive(self, half: Array, place: ArrayLike) -> Array:
        y = np.clip(place, -half, half)
        turn = np.arcsin(np.divide(y, half, out=np.zeros_like(y), where=half > 0.0))
        square = half * half
        mu = np.sqrt(square - y * y)
        curved = 0.5 * self.b * (y * mu + square * turn)
        return np.asarray(self.a * y + curved + self.c * (square * y - y**3 / 3.0))

    def share_above(self, height: ArrayLike) -> Array:
        """Share of the flux above a straight horizon at ``height`` over the centre; closed form."""
        y = np.clip(np.asarray(height, dtype=np.float64), -1.0, 1.0)
        half = np.sqrt(1.0 - y * y)
        rest = np.arccos(y)
        first = rest - y * half  # the integrals of 2, pi / 2 and 4 / 3 times half^1, 2, 3 up to 1
        second = 0.5 * math.pi * (2.0 / 3.0 - y + y**3 / 3.0)
        third = 0.5 * rest - 0.5 * y * half - y * half**3 / 3.0
        return np.asarray((self.a * first + self.b * second + self.c * third) / self.flux)

    def samples(self, count: int) -> Array:
        """Points (count, 2) of equal flux: a sunflower (Vogel 1979) whose radii are quantiles of
        the flux.
        """
        radius = np.linspace(0.0, 1.0, 4097)
        square = 1.0 - radius**2
        beyond = self.a * square + 2.0 / 3.0 * self.b * square**1.5 + 0.5 * self.c * square**2
        order = np.arange(count)
        rho = np.interp((order + 0.5) / count, 1.0 - beyond / beyond[0], radius)
        turn = order * math.pi * (3.0 - math.sqrt(5.0))
        return np.stack([rho * np.cos(turn), rho * np.sin(turn)], axis=-1)


VISIBLE = LimbDarkening()


@dataclass(frozen=True, eq=False)
class Strips:
    """Strips of the disc between straight lines that meet in (0, 1 / lean), in the plane tangent to
    the sky at the disc's centre. The lines are vertical planes, which meet in the zenith.

    ``middle``: x at y = 0 of the line that represents the strip. ``low``, ``high``: lower and upper
    end of the strip, each (k,). ``flux`` (k, STEPS + 1): share of the disc's flux in the strip
    above each of equal steps from y = -1 to 1.
    """

    middle: Array
    low: Array
    high: Array
    flux: Array


@lru_cache(maxsize=32)
def strips(law: LimbDarkening, count: int, lean: float = 0.0) -> Strips:
    """``count`` strips of equal width at y = 0. ``lean``: below 0.5 in size; 0 gives parallel
    strips.
    """
    edges = np.linspace(-1.0, 1.0, count + 1)
    left, right = edges[:-1, None], edges[1:, None]
    inner = np.where(left * right < 0.0, 0.0, np.minimum(abs(left), abs(right)))[:, 0]
    high = np.sqrt(1.0 - (inner * (1.0 - abs(lean))) ** 2)
    middle = _centroids(law, left, right)
    edges[[0, -1]] = -4.0, 4.0  # leaning lines may miss the limb: include all of the disc
    node, weight = np.polynomial.legendre.leggauss(2)
    y = (-1.0 + (np.arange(STEPS)[:, None] + 0.5 + 0.5 * node) * (2.0 / STEPS)).ravel()
    narrower = 1.0 - lean * y
    half = np.sqrt(1.0 - y * y)
    flux = np.zeros((count, STEPS + 1))
    beside = law._primitive(half, edges[0] * narrower)
    for k, edge in enumerate(edges[1:]):  # one strip at a time fits the cache
        before, beside = beside, law._primitive(half, edge * narrower)
        layers = (beside - before).reshape(STEPS, node.size)
        step = (layers * weight).sum(axis=-1) / (STEPS * law.flux)
        flux[k, :-1] = np.cumsum(step[::-1])[::-1]
    return Strips(middle, -high, high, flux)


def _centroids(law: LimbDarkening, left: Array, right: Array) -> Array:
    node, weight = np.polynomial.legendre.leggauss(32)
    first, last = np.arcsin(left), np.arcsin(right)
    turn = (
        0.5 * (first + last) + 0.5 * (last - first) * node
    )  # x = sin(turn) avoids the square root at the limb
    half = np.cos(turn)
    flux = law.chord_flux(half, -half, half) * half * weight
    return np.asarray((flux * np.sin(turn)).sum(axis=1) / flux.sum(axis=1))
