"""Does the Sun that was stated explain an image better than other Suns would?

A patch rendered under a wrong Sun still correlates with the image, but less, and it may be found shifted, alike
everywhere: matches can agree with each other on a place that is wrong. So the points that agree are rendered again
under Suns turned about the vertical and raised or lowered, and correlated near where they were found.

With z = artanh(correlation) (Fisher 1921), another Sun is preferred when most points say so: more than half of them
by twice the binomial's sigma. Preferred is not yet right: another law of reflection than the image's looks like a
Sun that is off, or hides that it is. So the same is asked under other laws (`LAWS`), and the law that most points
prefer, each law under its own best Sun, decides. A DEM that is smoother than the ground, too, makes all points prefer
a Sun that is a little off, most of all a lower one. So a stated Sun is refused only when the one preferred most gains
so much that no true frame did (`LEAST_GAIN`); below that, how far the preferred Sun moves the matches is a doubt that
all of them share. docs/pose.md has the figures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array, Index
from ..catalog.catalogue import Catalog
from ..choices import DEFAULT_LAW, REFERENCE_LAW
from ..images.image import Image
from ..photometry.laws import Reflectance, reflectance_model
from .point_choice import evenly
from .point_search import Criteria, find_points

TURNS_DEG = ((-20.0, 0.0), (20.0, 0.0), (0.0, -10.0), (0.0, 10.0))
"""Suns that are tried: by how much the azimuth is turned and the elevation raised."""

AS_STATED = (0.0, 0.0)
SIDEWAYS_DEG = (AS_STATED, *TURNS_DEG[:2])

LEAST_GAIN = ((0.025, 0.25), (0.08, 0.5))
"""In the median correlation, or in that of z; for a Sun that is turned, and for one that is raised or lowered. The
first of each pair is for photographs, whose correlations are 0.7 to 0.9; the second for those above 0.95, as
simulated frames have them.
"""

LAWS = (REFERENCE_LAW, DEFAULT_LAW)
"""Laws of reflection that are asked beside the search's own, a rough surface's and a dark one's: a surface after one of
them looks, under the other, as if its Sun stood elsewhere.
"""

SIGMAS = 2.0

_REACH_PX = 3.0
_MOST = 100
_GLANCE = 2
"""Of so many points one is asked first, and under fewer Suns, whether another law is worth asking: it is if most of them
correlate better. That is a third of the time.
"""
_FEWEST = 5


@dataclass(frozen=True)
class SunCheck:
    """How the points correlate under the stated Sun, and under others (m)."""

    points: int
    independent: float  # as many points that share no ground
    correlation: float  # median, under the stated Sun
    turns_deg: tuple[tuple[float, float], ...]  # (m) azimuth, elevation
    correlations: tuple[float, ...]  # (m) medians
    gains: tuple[float, ...]  # (m) median of z less z under the stated Sun
    shares: tuple[float, ...]  # (m) of the points that prefer it
    shifts_px: tuple[float, ...]  # (m) how far it moves the matches, the median of both coordinates
    law: str = ""  # that of the renders, where it is not the search's own
    least_doubt_px: float = 0.0  # what the search's own law leaves in doubt, where another decides

    @property
    def preferred(self) -> int | None:
        """Which of the others most points prefer, and by most; None: the stated Sun stands."""
        if self.points < _FEWEST:
            return None
        most = _majority(self.independent)
        some = [k for k, share in enumerate(self.shares) if share > most and self.gains[k] > 0.0]
        return max(some, key=lambda k: self.gains[k]) if some else None

    @property
    def fits(self) -> bool:
        """Whether the stated Sun may be right."""
        best = self.preferred
        if best is None:
            return True
        gain, gain_z = LEAST_GAIN[0 if self.turns_deg[best][0] else 1]
        return self.correlations[best] - self.correlation <= gain and self.gains[best] <= gain_z

    @property
    def doubt_px(self) -> float:
        """1 sigma of a shift that all matches share, because another Sun may be the right one: the largest shift under a Sun
        that the points do not reject, that is, of which no majority by two sigmas correlates worse; 0 if they reject all.
        """
        least = 1.0 - _majority(self.independent)
        shifts = zip(self.shifts_px, self.shares, strict=True)
        return max(self.least_doubt_px, *(shift for shift, share in shifts if share >= least), 0.0)

    @property
    def complaint(self) -> str:
        """One line on a Sun that does not fit; empty for one that may be right."""
        best = self.preferred
        if self.fits or best is None:
            return ""
        turn, up = self.turns_deg[best]
        how = f"turned by {turn:+.0f} deg" if turn else f"raised by {up:+.0f} deg"
        return (
            f"the stated Sun does not fit the image: {self.shares[best]:.0%} of {self.points} points "
            f"correlate better under one {how}{f' ({self.law})' if self.law else ''}"
        )


Search = Callable[[Image, Reflectance, Index], tuple[Array, Array]]
"""A search for n points that have been found before, near where they were found: correlations (k,) and places (k, 2), pixels,
of some of them (rows (k,) of the n) in an image with its Sun, under a reflectance law. A point that is not found has the
correlation 0 and a NaN place.
"""


def check_points(
    catalog: Catalog,
    photo: Image,
    model: Reflectance,
    points: Index,
    offset_px: Array,
    criteria: Criteria,
    independent_share: float = 1.0,
    reach_px: float = _REACH_PX,
) -> SunCheck:
    """`check_sun` by points that are found one by one: rows (n,) of the catalogue, at least one, each searched within
    ``reach_px`` of ``offset_px`` (n, 2) from where the image's sensor puts it. Pixels of the image as it came.
    """

    def search(moved: Image, law: Reflectance, rows: Index) -> tuple[Array, Array]:
        found = find_points(
            catalog,
            moved,
            law,
            reach_px,
            points=points[rows],
            offset_px=offset_px[rows],
            criteria=criteria,
        )
        return np.nan_to_num(found.correlation), found.found_px  # a point in the dark: NaN

    return check_sun(search, photo, catalog.position_mcmf[points], model, independent_share)


def check_sun(
    search: Search,
    photo: Image,
    ground_mcmf_m: Array,
    model: Reflectance,
    independent_share: float = 1.0,
    turns_deg: tuple[tuple[float, float], ...] = TURNS_DEG,
) -> SunCheck:
    """How n points at ``ground_mcmf_m`` (n, 3), n >= 1, correlate under the image's stated Sun and under Suns moved by
    ``turns_deg``, with ``model`` or with the one of `LAWS` that most points prefer to it.

    ``independent_share``: the number of points that share no terrain, as a share of n. At most 100 points are searched.
    """
    tried = _Tried(search, photo, ground_mcmf_m, turns_deg)
    rows = evenly(np.arange(len(ground_mcmf_m)), _MOST)
    glance = rows[::_GLANCE]
    own, own_z = tried.check(model, rows, independent_share)
    best, most = own, 0.0
    for law in map(reflectance_model, LAWS):
        if law.name == model.name:
            continue
        if not _most_gain(tried.best_z(law, glance, SIDEWAYS_DEG) - own_z[::_GLANCE]):
            continue
        other, z = tried.check(law, rows, independent_share)
        gain = float(np.median(z - own_z))
        if _most_gain(z - own_z, _majority(own.independent)) and gain > most:
            best, most = replace(other, law=law.name, least_doubt_px=own.doubt_px), gain
    return best


def _most_gain(gain: Array, majority: float = 0.5) -> bool:
    """True if more than a share of the points (n,) gain."""
    return bool((gain > 0.0).mean() > majority)


def _majority(independent: float) -> float:
    """The share of points, ``independent`` of them, that exceeds one half by `SIGMAS` of the binomial."""
    return 0.5 + SIGMAS * 0.5 / math.sqrt(independent)


@dataclass(frozen=True, eq=False)
class _Tried:
    """A search repeated under other Suns and reflectance laws."""

    search: Search
    photo: Image
    ground_mcmf_m: Array  # (n, 3)
    turns_deg: tuple[tuple[float, float], ...]  # (m)

    def under(
        self, law: Reflectance, rows: Index, turns_deg: Sequence[tuple[float, float]]
    ) -> tuple[Array, Array]:
        """Correlations (m, k) and places (m, k, 2) under Suns."""
        ground = self.ground_mcmf_m[rows]
        found = [self.search(with_sun(self.photo, ground, *t), law, rows) for t in turns_deg]
        return np.array([f[0] for f in found]), np.array([f[1] for f in found])

    def best_z(
        self, law: Reflectance, rows: Index, turns_deg: Sequence[tuple[float, float]]
    ) -> Array:
        """Each point's z (k,) under the Sun with the highest median."""
        return _highest(_z(self.under(law, rows, turns_deg)[0]))

    def check(
        self, law: Reflectance, rows: Index, independent_share: float
    ) -> tuple[SunCheck, Array]:
        """The check under one law, and each point's z (k,) under the Sun with the highest median."""
        correlations, places = self.under(law, rows, (AS_STATED, *self.turns_deg))
        z, medians = _z(correlations), np.median(correlations, axis=1)
        gain = z[1:] - z[0]
        check = SunCheck(
            points=len(rows),
            independent=max(1.0, len(rows) * independent_share),
            correlation=float(medians[0]),
            turns_deg=self.turns_deg,
            correlations=tuple(medians[1:].tolist()),
            gains=tuple(np.median(gain, axis=1).tolist()),
            shares=tuple((gain > 0.0).mean(axis=1).tolist()),
            shifts_px=tuple(_common_shift(moved - places[0]) for moved in places[1:]),
        )
        return check, _highest(z)


def _z(correlations: Array) -> Array:
    return np.arctanh(np.clip(correlations, -0.999, 0.999))


def _highest(z: Array) -> Array:
    """The row (n,) of (m, n) whose median is the highest."""
    return np.asarray(z[int(np.median(z, axis=1).argmax())])


def _common_shift(offsets_px: Array) -> float:
    """Length of the median of offsets (n, 2); NaN ones are left out, and 0 where there is no other."""
    known = offsets_px[np.isfinite(offsets_px).all(axis=-1)]
    return float(np.hypot(*np.median(known, axis=0))) if len(known) else 0.0


def with_sun(photo: Image, ground_mcmf_m: Array, turn_deg: float, raise_deg: float) -> Image:
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
