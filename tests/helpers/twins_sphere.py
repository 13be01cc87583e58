"""Judges of the sphere tier: rays in 60 digits, a limb by brute force, shading in plain loops.

Nothing here knows the kernels' forms: the quadratic is solved as it stands.
"""

from __future__ import annotations

import mpmath
import numpy as np

from lcp_catalog.constants import MOON_RADIUS_M

DIGITS = 60


def exact_range(position, direction, radius=MOON_RADIUS_M):
    """Distance along a ray to the sphere as an mpf, None for sky: the least root that is ahead of
    the start; both roots of |p + t d|^2 = R^2 as school has them.
    """
    with mpmath.workdps(DIGITS):
        p, d = ([mpmath.mpf(float(x)) for x in v] for v in (position, direction))
        a, b = sum(x * x for x in d), 2 * sum(x * y for x, y in zip(p, d, strict=True))
        c = sum(x * x for x in p) - mpmath.mpf(float(radius)) ** 2
        under_root = b * b - 4 * a * c
        if under_root < 0:
            return None
        roots = sorted((-b + sign * mpmath.sqrt(under_root)) / (2 * a) for sign in (-1, 1))
        if c == 0:  # on the sphere: it is met here by what goes in
            roots = [mpmath.mpf(0)] if b < 0 else []
        ahead = [t for t in roots if t >= 0]
        return ahead[0] * mpmath.sqrt(a) if ahead else None


def exact_miss(position, direction, radius=MOON_RADIUS_M):
    """By how much of the radius a ray's line passes outside (above 0) or inside the sphere."""
    with mpmath.workdps(DIGITS):
        p, d = ([mpmath.mpf(float(x)) for x in v] for v in (position, direction))
        cross = [
            p[(i + 1) % 3] * d[(i + 2) % 3] - p[(i + 2) % 3] * d[(i + 1) % 3] for i in range(3)
        ]
        nearest = mpmath.sqrt(sum(x * x for x in cross) / sum(x * x for x in d))
        return nearest / mpmath.mpf(float(radius)) - 1


def sampled_coverage(camera, column, row, samples, radius=MOON_RADIUS_M):
    """Share of a pixel's area on the sphere, by samples x samples rays."""
    step = (np.arange(samples) + 0.5) / samples - 0.5
    u, v = np.meshgrid(column + step, row + step)
    d = camera.rays(np.stack([u, v], -1))
    p = camera.position_mcmf_m
    along = d @ p
    miss = np.linalg.norm(p - along[..., None] * d, axis=-1)
    return float(np.mean((miss <= radius) & (along < 0)))


def naive_ranges(position, directions, radius=MOON_RADIUS_M):
    """The paper's formula in float64, whose discriminant cancels."""
    b = 2.0 * directions @ position
    delta = b * b - 4.0 * (position @ position - radius * radius)
    t = (-b - np.sqrt(np.maximum(delta, 0.0))) / 2.0
    return np.where((delta >= 0) & (t > 0), t, np.nan)


def angle_between(a, b):
    """Degrees, by half the angle (Kahan): no arc cosine."""
    a, b = (np.asarray(v, dtype=float) / np.linalg.norm(v) for v in (a, b))
    return float(np.degrees(2.0 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b))))
