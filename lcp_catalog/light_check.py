"""Does the Sun that was stated explain an image better than other Suns would?

A patch rendered under a wrong Sun still correlates with the image, but shifted, and shifted alike everywhere: matches agree with each
other on a place that is wrong. So the points that agree are rendered again under Suns turned about the vertical and raised or
lowered, and correlated near where they were found. docs/pose.md measures what a wrong Sun does, and what this finds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .contents import Catalog
from .match import Criteria, match
from .photo import Photo
from .reflectance import Reflectance

Array = NDArray[np.float64]
Index = NDArray[np.int64]

TURNS_DEG = ((0.0, 0.0), (-20.0, 0.0), (20.0, 0.0), (0.0, -10.0), (0.0, 10.0))
"""Suns that are tried: by how much the azimuth is turned and the elevation raised; the stated one first."""

CLEARLY = 0.02
"""A median correlation that is higher by this says that a Sun fits better; docs/pose.md."""

_REACH_PX = 3.0
_MOST = 100


@dataclass(frozen=True)
class LightCheck:
    """Median correlation under each of `TURNS_DEG`; NaN where too few points could be compared."""

    turns_deg: tuple[tuple[float, float], ...]
    correlation: tuple[float, ...]

    @property
    def best(self) -> int:
        """Which Sun fits best; 0, the stated one, unless another is clearly better."""
        gain = np.nan_to_num(np.array(self.correlation) - self.correlation[0], nan=-np.inf)
        top = int(np.argmax(gain))
        return top if gain[top] > CLEARLY else 0

    @property
    def fits(self) -> bool:
        """Whether no other Sun fits clearly better."""
        return self.best == 0

    @property
    def complaint(self) -> str:
        """One line on a Sun that does not fit."""
        turn, up = self.turns_deg[self.best]
        how = f"turned by {turn:+.0f} deg" if turn else f"raised by {up:+.0f} deg"
        return (
            f"the stated Sun does not fit the image: one {how} gives a median correlation of "
            f"{self.correlation[self.best]:.2f}, not {self.correlation[0]:.2f}"
        )


def check_light(
    catalog: Catalog,
    photo: Photo,
    model: Reflectance,
    points: Index,
    offset_px: Array,
    criteria: Criteria,
    reach_px: float = _REACH_PX,
) -> LightCheck:
    """Points (rows (n,) of the catalogue) that were found ``offset_px`` (n, 2) from where the photograph's sensor has them, looked for
    again within ``reach_px`` of there under each Sun.
    """
    some = np.unique(np.linspace(0, len(points) - 1, min(len(points), _MOST)).round().astype(int))
    rows = points[some]
    tried = []
    for turn_deg, raise_deg in TURNS_DEG:
        lit = with_sun(catalog, photo, rows, turn_deg, raise_deg)
        found = match(
            catalog, lit, model, reach_px, points=rows, offset_px=offset_px[some], criteria=criteria
        )
        tried.append(found.correlation)
    table = np.array(tried)  # (Suns, points)
    return LightCheck(TURNS_DEG, tuple(_medians(table)))


def _medians(table: Array) -> list[float]:
    """Median over the points that were compared under the stated Sun; what a Sun leaves in the dark correlates 0."""
    known = table[:, np.isfinite(table[0])]
    if known.shape[1] < 3:
        return [float("nan")] * len(table)
    return [float(v) for v in np.median(np.nan_to_num(known), axis=1)]


def with_sun(
    catalog: Catalog, photo: Photo, points: Index, turn_deg: float, raise_deg: float
) -> Photo:
    """The photograph as if its Sun stood elsewhere: turned clockwise about the vertical at the middle of the points, and raised."""
    middle = catalog.position_mcmf[points].mean(axis=0)
    up = middle / np.linalg.norm(middle)
    sun = photo.sun_directions(middle)
    height = np.arcsin(np.clip(sun @ up, -1.0, 1.0))
    level = sun - (sun @ up) * up
    level /= np.linalg.norm(level)
    turn = np.radians(turn_deg)
    level = np.cos(turn) * level - np.sin(turn) * np.cross(up, level)
    height = np.clip(height + np.radians(raise_deg), np.radians(1.0), np.radians(89.0))
    direction = np.cos(height) * level + np.sin(height) * up
    return replace(photo, sun_position_mcmf_m=None, sun_direction_mcmf=direction)
