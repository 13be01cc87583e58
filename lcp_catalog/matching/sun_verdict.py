"""What the correlations of an image's points under other Suns say about the stated one (`sun_check` makes them).

With z = artanh(correlation) (Fisher 1921), another Sun is preferred if more than half of the points correlate better under it,
by two sigmas of the binomial distribution. A DEM that is smoother than the terrain makes all points prefer a Sun that is
slightly off, mostly a lower one. So the stated Sun is refused only if the preferred one gains more than any true frame did
(`LEAST_GAIN`). Below that, the shift of the matches under a Sun that is as good is a position error common to all of them.
Suns that are turned far (`FarSunCheck`) have a rule of their own.

An azimuth that is wrong by half a turn makes two Suns fit equally, and neither is preferred. There the vertex of a parabola
through the means of z under the stated and the two turned Suns says where the Sun is (`best_turn`): a smoother DEM lowers all
three alike. A vertex over the elevation that is farther away than that of a right Sun (`RAISE_LIMITS_DEG`) is named, and
refuses nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

TURNS_DEG = ((-20.0, 0.0), (20.0, 0.0), (0.0, -10.0), (0.0, 10.0))
"""Suns that are tried: change of azimuth (clockwise) and of elevation."""

FAR_TURNS_DEG = ((90.0, 0.0), (-90.0, 0.0), (180.0, 0.0))
"""Suns that are tried where few of the searched points agree, and for the ground as a whole: brightness that the map knows is alike
under every Sun, and a part of the points agree on a place some cells off under one that is turned by 120 to 180 deg. Half of the
points must correlate better under the stated Sun than under each. Under right Suns above 44 deg at most 0.40 of the points
preferred a far one (6 maps, 32 simulated frames); under Suns turned by 90 to 180 deg at least 0.70 where the ground as a
whole showed a place (78 searches of 23 maps above 30 deg), at least 0.5 of points that agreed one by one (37 searches).
"""

_SAME_PX = 0.1
"""A far Sun under which the matches lie as near refuses nothing: the position is the same. Chosen on one right Sun outdone so
(54 % of 24 points, 0.05 px). Wrong ones moved matches of maps by 0.3 px and more; in frames one passed so, its position right.
"""

LEAST_ELEVATION_DEG = 1.0
"""A Sun that is lowered or raised ends so far from the horizon and from the zenith."""

LEAST_GAIN = ((0.025, 0.25), (0.08, 0.5))
"""Gain in the median correlation, and in the median of z, above which the stated Sun is refused:
for a Sun that is turned, and for one that is raised or lowered. The first of each pair decides for
photographs (correlations of 0.7 to 0.9), the second for simulated frames (above 0.95).
"""

SIGMAS = 2.0

LEAST_TURN_DEG = 6.0
"""Distance of the best azimuth from the stated one, by 3 of its sigmas from 0, that is refused."""

_TURN_SIGMAS = 3.0

LOWERED, RAISED = TURNS_DEG.index((0.0, -10.0)), TURNS_DEG.index((0.0, 10.0))
RAISE_LIMITS_DEG = (-6.0, 3.5)
"""Distance of the best elevation from the stated one, downwards and upwards, that is named: chosen on one half of 58 photographs
(right Suns: -9.6 +- 4.6 to 3.2 deg, lowered by 10 deg: from 3.1 on below 45 deg, raised: up to -7.0), judged on the other.
Downwards the sigma is subtracted: a DEM that lacks relief lowers the best elevation.
"""
_NEARLY_ALL = 0.88
"""Share of the points that correlate better under the lowered Sun, which is named: at most 0.85 did under the right Sun."""
SEEN_DEG = 15.0  # a vertex farther away lies beyond the Suns that were tried
_FEWEST = 5
_SURE_SHARE = 0.25
"""Largest share of the points of a glance that may correlate better under another Sun. If half of all points do so, at most 6
of 24 do in 1 of 90 glances; if 60 % do, which is the least share that refuses a Sun, in 1 of 900.
"""


@dataclass(frozen=True)
class SunCheck:
    """Correlations of the points under the stated Sun and under m others."""

    points: int
    independent: float  # number of points that share no terrain
    correlation: float  # median, under the stated Sun
    turns_deg: tuple[tuple[float, float], ...]  # (m) azimuth, elevation
    correlations: tuple[float, ...]  # (m) medians
    gains: tuple[float, ...]  # (m) median of the differences of z from the stated Sun
    shares: tuple[float, ...]  # (m) of the points that correlate better
    shifts_px: tuple[float, ...]  # (m) length of the matches' median shift
    law: str = ""  # of the renders, if not the law of the search
    least_doubt_px: float = 0.0  # doubt under the law of the search, if another decides
    best_turn_deg: float = 0.0  # turn from the stated azimuth to the best one, `best_turn`
    best_turn_sigma_deg: float = math.inf  # with that of the map's detail where it decides
    turned_by_map: bool = False  # the map's detail was looked at: the points alone refuse the Sun
    elevation_deg: float = math.nan  # of the stated Sun; NaN if others were tried than `TURNS_DEG`
    best_raise_deg: float = 0.0  # from the stated elevation to the best one, `best_turn`
    best_raise_sigma_deg: float = math.inf
    fits_otherwise: bool = False  # the elevation, under another law or contrast of the map

    @property
    def preferred(self) -> int | None:
        """Index of the Sun that a significant majority of the points prefers, the one with the largest gain; None if there is
        none.
        """
        return self._most_gained([share > majority(self.independent) for share in self.shares])

    def _most_gained(self, preferred: list[bool]) -> int | None:
        """Index of the Sun with the largest gain among those that are preferred; None for fewer than `_FEWEST` points."""
        some = [k for k, gain in enumerate(self.gains) if preferred[k] and gain > 0.0]
        return max(some, key=lambda k: self.gains[k]) if some and self.points >= _FEWEST else None

    @property
    def fits(self) -> bool:
        """True if the stated Sun may be right."""
        return not (self.outdone or self.turned)

    @property
    def outdone(self) -> bool:
        """True if the preferred Sun gains more than `LEAST_GAIN`."""
        best = self.preferred
        if best is None:
            return False
        gain, gain_z = LEAST_GAIN[0 if self.turns_deg[best][0] else 1]
        return self.correlations[best] - self.correlation > gain or self.gains[best] > gain_z

    @property
    def turned(self) -> bool:
        """True if the best azimuth is not the stated one; False for fewer than `_FEWEST` independent points, whose
        spread says too little about its sigma.
        """
        least = max(LEAST_TURN_DEG, _TURN_SIGMAS * self.best_turn_sigma_deg)
        return self.independent >= _FEWEST and abs(self.best_turn_deg) > least

    @property
    def azimuth_advice(self) -> str:
        """One line about an azimuth that only detail beyond the albedo map explains; empty for others."""
        if not self.turned_by_map or not self.fits:
            return ""
        return (
            f"the Sun's azimuth may be wrong: {self.points} points correlate best under one turned by "
            f"{self.best_turn_deg:+.0f} deg; brightness that the albedo map lacks can look so, too: check the Sun and the time"
        )

    @property
    def elevation_fits(self) -> bool:
        """False if the stated elevation is probably wrong: nearly all points prefer a Sun lowered by 10 deg, or the best
        elevation is farther from the stated one than `RAISE_LIMITS_DEG`; above `_OTHERWISE_DEG` also with
        other laws and maps. Nothing is judged for fewer than `_FEWEST` independent points.
        """
        if math.isnan(self.elevation_deg) or self.independent < _FEWEST or self.fits_otherwise:
            return True
        if self.shares[LOWERED] > _NEARLY_ALL:
            return False
        if not math.isfinite(self.best_raise_sigma_deg):  # better still beyond the Suns tried
            return max(self.shares[LOWERED], self.shares[RAISED]) <= 0.5
        low, high = RAISE_LIMITS_DEG
        return low - self.best_raise_sigma_deg <= self.best_raise_deg <= high

    @property
    def elevation_advice(self) -> str:
        """One line about an elevation that does not fit (`elevation_fits`); empty for one that may be right."""
        if self.elevation_fits:
            return ""
        best = LOWERED if self.shares[LOWERED] > self.shares[RAISED] else RAISED
        other = max(self.elevation_deg + self.turns_deg[best][1], LEAST_ELEVATION_DEG)
        low, high = RAISE_LIMITS_DEG
        seen = f"{'below' if best == LOWERED else 'above'} {other:.0f} deg"
        if math.isfinite(self.best_raise_sigma_deg) and abs(self.best_raise_deg) < SEEN_DEG:
            vertex = self.elevation_deg + self.best_raise_deg
            seen = f"at {vertex:.0f} deg +- {self.best_raise_sigma_deg:.1f}"
        return (
            f"the Sun's elevation, {self.elevation_deg:.0f} deg, may be wrong: {self.points} points correlate best {seen}, "
            f"under a right Sun between {max(self.elevation_deg + low, 0.0):.0f} and {self.elevation_deg + high:.0f} deg; "
            f"{100.0 * self.shares[best]:.0f} % correlate better at {other:.0f} deg: "
            "check the Sun and the time"
        )

    @property
    def is_sure(self) -> bool:
        """True if no other Sun is as good: few of the points prefer one, and the best azimuth lies within
        `LEAST_TURN_DEG` of the stated one by 3 of its sigmas; and the elevation fits.
        """
        turn = abs(self.best_turn_deg) + _TURN_SIGMAS * self.best_turn_sigma_deg
        few = max(self.shares) <= _SURE_SHARE
        return few and turn <= LEAST_TURN_DEG and self.elevation_fits

    @property
    def doubt_px(self) -> float:
        """1 sigma of a shift common to all matches, because another Sun may be the right one: the
        largest shift under a Sun that at least half of the points correlate better with; 0 if there
        is none.
        """
        shifts = zip(self.shifts_px, self.shares, strict=True)
        return max(self.least_doubt_px, *(shift for shift, share in shifts if share >= 0.5), 0.0)

    @property
    def complaint(self) -> str:
        """One line about a Sun that does not fit; empty for one that may be right."""
        law = f" ({self.law})" if self.law else ""
        best = self.preferred
        if self.turned and not self.outdone:
            return (
                f"the stated Sun does not fit the image: {self.points} points correlate best under one turned by "
                f"{self.best_turn_deg:+.0f} deg +- {self.best_turn_sigma_deg:.1f}{law}"
            )
        if best is None or not self.outdone:
            return ""
        turn, up = self.turns_deg[best]
        risen = f"{'lowered' if up < 0.0 else 'raised'} by {abs(up):.0f} deg"
        how = f"turned by {turn:+.0f} deg" if turn else risen
        return (
            f"the stated Sun does not fit the image: {100.0 * self.shares[best]:.0f} % of {self.points} points "
            f"correlate better under one {how}{law}"
        )


@dataclass(frozen=True)
class FarSunCheck(SunCheck):
    """Correlations under `FAR_TURNS_DEG`: one that half of the points prefer, and that moves them, refuses the stated Sun."""

    @property
    def preferred(self) -> int | None:
        """Index of the Sun with the largest gain that half of the points prefer and that moves them; None if there is none."""
        moves = [not 0.0 < shift < _SAME_PX for shift in self.shifts_px]  # 0: no place is known
        return self._most_gained(
            [share > 0.5 and moved for share, moved in zip(self.shares, moves, strict=True)]
        )

    @property
    def outdone(self) -> bool:
        """True if there is a preferred Sun."""
        return self.preferred is not None


def near_or_far(near: SunCheck, far: Callable[[], SunCheck]) -> SunCheck:
    """The check by near Suns; that by `FAR_TURNS_DEG` where the near ones do not refuse the stated Sun and the far ones do."""
    return near if not near.fits or (found := far()).fits else found


def majority(independent: float) -> float:
    """Share of the points, ``independent`` of them, that exceeds one half by `SIGMAS` of the
    binomial distribution.
    """
    return 0.5 + SIGMAS * 0.5 / math.sqrt(independent)
