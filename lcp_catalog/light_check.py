"""Does the Sun that was stated explain an image better than other Suns would?

A patch rendered under a wrong Sun still correlates with the image, but less, and it may be found shifted, alike
everywhere: matches can agree with each other on a place that is wrong. So the points that agree are rendered again
under Suns turned about the vertical and raised or lowered, and correlated near where they were found.

With z = artanh(correlation) (Fisher 1921), another Sun fits better when most points say so, more than half of them by
twice the binomial's sigma, and it matters: the median correlation gains `LEAST_GAIN`, or z `LEAST_GAIN_Z`. An imperfect
law of reflection or a smooth DEM make all points prefer a Sun that is a little off, by less than that. docs/pose.md has
what a wrong Sun does, and what this finds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .contents import Catalog
from .match import Criteria, match
from .photo import Photo
from .reflectance import Reflectance

Array = NDArray[np.float64]
Index = NDArray[np.int64]

TURNS_DEG = ((-20.0, 0.0), (20.0, 0.0), (0.0, -10.0), (0.0, 10.0))
"""Suns that are tried: by how much the azimuth is turned and the elevation raised."""

LEAST_GAIN = 0.025
LEAST_GAIN_Z = 0.25
"""The first is for photographs, whose correlations are 0.7 to 0.9; the second for those above 0.95, as simulated
frames have them. True frames gain up to 0.003 and 0.05, under another law than the image's 0.02 and 0.2; a Sun that is
wrong by 20 deg of azimuth gave 0.03 to 0.08 in photographs, and 0.34 in z and more in simulated frames.
"""

SIGMAS = 2.0

_REACH_PX = 3.0
_MOST = 100
_FEWEST = 5


@dataclass(frozen=True)
class LightCheck:
    """How the points correlate under the stated Sun, and under others (m)."""

    points: int
    independent: float  # as many points that share no ground
    correlation: float  # median, under the stated Sun
    turns_deg: tuple[tuple[float, float], ...]  # (m) azimuth, elevation
    correlations: tuple[float, ...]  # (m) medians
    gains: tuple[float, ...]  # (m) median of z less z under the stated Sun
    shares: tuple[float, ...]  # (m) of the points that prefer it

    @property
    def better(self) -> tuple[int, ...]:
        """Which of the others fit clearly better, the best first."""
        if self.points < _FEWEST:
            return ()
        most = 0.5 + SIGMAS * 0.5 / math.sqrt(self.independent)
        clear = [
            k
            for k in range(len(self.turns_deg))
            if self.shares[k] > most
            and (
                self.correlations[k] - self.correlation > LEAST_GAIN or self.gains[k] > LEAST_GAIN_Z
            )
        ]
        return tuple(sorted(clear, key=lambda k: -self.gains[k]))

    @property
    def fits(self) -> bool:
        """Whether no other Sun fits clearly better."""
        return not self.better

    @property
    def complaint(self) -> str:
        """One line on a Sun that does not fit; empty for one that does."""
        if self.fits:
            return ""
        best = self.better[0]
        turn, up = self.turns_deg[best]
        how = f"turned by {turn:+.0f} deg" if turn else f"raised by {up:+.0f} deg"
        return (
            f"the stated Sun does not fit the image: {self.shares[best]:.0%} of {self.points} points "
            f"correlate better under one {how}"
        )


def check_light(
    catalog: Catalog,
    photo: Photo,
    model: Reflectance,
    points: Index,
    offset_px: Array,
    criteria: Criteria,
    independent_share: float = 1.0,
    reach_px: float = _REACH_PX,
) -> LightCheck:
    """Points (rows (n,) of the catalogue) that were found ``offset_px`` (n, 2) from where the photograph's sensor has
    them, looked for again within ``reach_px`` of there under each Sun; pixels of the image as it came, one point at
    least.
    """
    some = np.unique(np.linspace(0, len(points) - 1, min(len(points), _MOST)).round().astype(int))
    rows, offset = points[some], offset_px[some]

    def under(turn_deg: float, raise_deg: float) -> Array:
        lit = with_sun(photo, catalog.position_mcmf[rows], turn_deg, raise_deg)
        found = match(
            catalog, lit, model, reach_px, points=rows, offset_px=offset, criteria=criteria
        )
        # what a Sun leaves in the dark does not correlate
        return np.nan_to_num(found.correlation)

    stated = under(0.0, 0.0)
    others = np.array([under(*turn) for turn in TURNS_DEG])
    gain = np.arctanh(np.clip(others, -0.999, 0.999)) - np.arctanh(np.clip(stated, -0.999, 0.999))
    figures = (np.median(others, axis=1), np.median(gain, axis=1), (gain > 0.0).mean(axis=1))
    correlations, gains, shares = (tuple(values.tolist()) for values in figures)
    return LightCheck(
        points=len(rows),
        independent=max(1.0, len(rows) * independent_share),
        correlation=float(np.median(stated)),
        turns_deg=TURNS_DEG,
        correlations=correlations,
        gains=gains,
        shares=shares,
    )


def with_sun(photo: Photo, ground_mcmf_m: Array, turn_deg: float, raise_deg: float) -> Photo:
    """The photograph as if its Sun stood elsewhere: turned clockwise about the vertical at the middle of some ground
    (n, 3), and raised. A Sun that is not moved stays what it was; one never goes below 1 or above 89 degrees.
    """
    if not (turn_deg or raise_deg) or not len(ground_mcmf_m):
        return photo
    middle = np.asarray(ground_mcmf_m).mean(axis=0)
    up = middle / np.linalg.norm(middle)
    sun = photo.sun_directions(middle)
    height = math.asin(float(np.clip(sun @ up, -1.0, 1.0)))
    level = sun - (sun @ up) * up
    level /= np.linalg.norm(level)
    turn = math.radians(turn_deg)
    level = math.cos(turn) * level - math.sin(turn) * np.cross(up, level)
    height = min(max(height + math.radians(raise_deg), math.radians(1.0)), math.radians(89.0))
    direction = math.cos(height) * level + math.sin(height) * up
    return replace(photo, sun_position_mcmf_m=None, sun_direction_mcmf=direction)
