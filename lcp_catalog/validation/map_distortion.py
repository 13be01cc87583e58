"""A smooth pattern in the residuals of a map that only a shift corrects: a map that is distorted, of another scale, or turned.

The residuals of the matches are fitted, by their sigmas, by a shift and by quadratic polynomials of the place in the map, both
axes alike. The F-test (Fisher 1925) of the ten further coefficients says how likely chance leaves such a pattern; matches that
share ground count as the independent ones among them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from ..arrays import Array
from ..cameras.sensor import ON_MAP
from ..catalog.catalogue import Catalog
from ..images.image import Image
from ..landmarks.ground_votes import independent_share
from ..matching.fix import Fix
from ..matching.point_choice import patch_width_px

LEAST_PX = 0.25
"""Root mean square of a pattern that is named, in pixels of the map."""
LOG10_CHANCE = -3.0
"""Chance below which a pattern is named. Maps of Apollo 16 as they are leave patterns of 0.07 to 0.34 px; none fulfils both."""

_FLOOR_PX = 0.05  # a match is not better than this, whatever its covariance says
_SHIFT, _TERMS = 1, 6  # coefficients of an axis: of the correction, and of the polynomial


@dataclass(frozen=True)
class Pattern:
    """``rms_px``: of the pattern over the matches; ``log10_chance``: that errors without a pattern leave one as strong; 0 where
    the matches are too few."""

    rms_px: float
    log10_chance: float

    @property
    def is_named(self) -> bool:
        """True for a pattern that is not by chance and large enough to matter."""
        return self.rms_px > LEAST_PX and self.log10_chance < LOG10_CHANCE


def smooth_pattern(
    place_px: Array, residual_px: Array, sigma_px: Array, independent: float
) -> Pattern:
    """Quadratic pattern in residuals (n, 2) of matches at places (n, 2) of a map, of 1 sigma (n,), pixels; ``independent``:
    number of matches that share no ground.
    """
    free = 2.0 * (independent - _TERMS)
    if free < 1.0:
        return Pattern(0.0, 0.0)
    middle, half = place_px.mean(axis=0), np.ptp(place_px, axis=0).max() / 2.0
    x, y = ((place_px - middle) / half).T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    weight = 1.0 / np.hypot(sigma_px, _FLOOR_PX)[:, None]
    fitted, left = [], []
    for columns in (_SHIFT, _TERMS):
        used = terms[:, :columns]
        found = np.linalg.lstsq(used * weight, residual_px * weight, rcond=None)[0]
        fitted.append(used @ found)
        left.append(float((((residual_px - fitted[-1]) * weight) ** 2).sum()))
    more = 2.0 * (_TERMS - _SHIFT)
    ratio = max(left[0] - left[1], 0.0) / more / max(left[1] / free, 1e-12)
    rms = math.sqrt(float(((fitted[1] - fitted[0]) ** 2).sum(axis=1).mean()))
    with np.errstate(divide="ignore"):  # fdtrc: the survival function of Fisher's F
        return Pattern(rms, float(np.log10(fdtrc(more, free, ratio))))


def distortion_advice(located: Fix, catalog: Catalog, image: Image) -> str:
    """One line about a located map whose matches leave a smooth pattern; empty for others."""
    pose, matches = located.pose, located.matches
    if pose is None or image.sensor.corrections != ON_MAP:
        return ""
    rows = matches.point[matches.found]
    place = matches.found_px[matches.found]
    residual = place - pose.sensor.project(catalog.position_mcmf[rows])
    sigma = np.sqrt(np.trace(matches.covariance_px2[matches.found], axis1=1, axis2=2) / 2.0)
    share = independent_share(place, patch_width_px(catalog, image.sensor, rows))
    found = smooth_pattern(place, residual, sigma, len(rows) * share)
    if not found.is_named:
        return ""
    return (
        f"the matches leave a smooth pattern of {found.rms_px:.2g} px rms over the map (chance 10^{found.log10_chance:.0f}) that "
        "no shift explains: the map may be distorted, turned, or of another scale; check its projection and how it was rectified"
    )
