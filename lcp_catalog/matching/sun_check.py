"""Check of the stated Sun direction: comparison with the correlations under other Suns.

A patch rendered under a wrong Sun still correlates with the image, but less, and its match may be
shifted, by the same amount for all points: the matches can agree on a wrong position. So the points
of an agreement are rendered again under Suns turned about the vertical and raised or lowered, and
searched near their matches (`MatchedPoints`), or all together (`joint_offset`).

With z = artanh(correlation) (Fisher 1921), another Sun is preferred if more than half of the points
correlate better under it, by two sigmas of the binomial distribution. A preferred Sun is not yet a
reason to refuse the stated one, for two reasons. A reflectance law other than that of the surface
looks like a wrong Sun, or hides one. So the check is repeated with other laws (`LAWS`); the law
that most points prefer, each law under its own best Sun, decides. A DEM that is smoother than the
terrain makes all points prefer a Sun that is slightly off, mostly a lower one. So the stated Sun is
refused only if the preferred one gains more than any true frame did (`LEAST_GAIN`). Below that, the
shift of the matches under a Sun that is as good is a position error common to all of them.

An azimuth that is wrong by half a turn makes two Suns fit equally, and neither is preferred. There the
vertex of a parabola through the means of z under the stated and the two turned Suns says where the
Sun is (`best_turn`): a smoother DEM lowers all three alike. A lower Sun bends the brightness of slopes, and so do film and
decoding: the vertex over the elevation is taken with the image's brightness to the power with which the points correlate best
(`_Tried.bent`). A vertex farther away than that of a right Sun (`RAISE_LIMITS_DEG`) is named, and refuses nothing.

Detail that an albedo map lacks can look like a turned Sun, by the same angle for all points (`map_detail`). Before an azimuth is
refused, its sigma is raised by the turn that one sigma of such detail causes.

Thirteen and more searches are half of the time of a frame, and mostly the stated Sun is right beyond
doubt. So a navigator first takes a glance (`MatchedPoints.glance`): `_GLANCE_POINTS` points, without a search, from the places
where they were found, under the same Suns and each of the laws. Only if that leaves a doubt under any
law the check is made. A glance never refuses a Sun.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..arrays import Array, Index
from ..catalog.catalogue import Catalog
from ..choices import DEFAULT_LAW, REFERENCE_LAW
from ..ephemeris.solar_position import direction_from_angles
from ..geometry.frames import Direction, EnuFrame, mcmf_to_lonlat
from ..images.image import Image
from ..photometry.laws import Reflectance, reflectance_model
from .map_detail import MapDetail, of_contrasts
from .point_choice import evenly
from .point_search import Criteria, FoundPlaces, SearchImage

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

AS_STATED = (0.0, 0.0)
SIDEWAYS_DEG = (AS_STATED, *TURNS_DEG[:2])

LEAST_GAIN = ((0.025, 0.25), (0.08, 0.5))
"""Gain in the median correlation, and in the median of z, above which the stated Sun is refused:
for a Sun that is turned, and for one that is raised or lowered. The first of each pair decides for
photographs (correlations of 0.7 to 0.9), the second for simulated frames (above 0.95).
"""

LAWS = (REFERENCE_LAW, DEFAULT_LAW)
"""Reflectance laws tried beside that of the search: one of a rough and one of a dark surface. Under
one of them, a surface that follows the other looks as if the Sun were elsewhere.
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
_OTHERWISE_DEG = 42.0
_CONTRASTS = (0.9, 1.1)
"""Elevation above which an elevation must not fit under the law of a rough surface or another contrast of the albedo map, either.
The less a Sun shades, the more the best elevation depends on both. Brightness of two maps of one mosaic, in patches of 16 km, goes
with another power from square to square of 150 km, by 12 to 15 % (1 sigma).
"""
_POWER_STEP, _POWER_STEPS = 1.5, 3
"""Factor between powers of the brightness tried, and most of them: 0.3 to 3.4, for sRGB taken as linear and the reverse."""
_HIGHEST = 4.0  # log tan of 88.95 deg
_SEEN_DEG = 15.0  # a vertex farther away lies beyond the Suns that were tried
_REACH_PX = 3.0
_MOST = 100
_GLANCE = 2
"""One of so many points is searched first, under the stated and the turned Suns, to decide if
another law is tried in full: only if most of these points correlate better. This takes a third of
the time.
"""
_FEWEST = 5

_GLANCE_POINTS = 24
_SURE_SHARE = 0.25
"""Points of a glance, and the largest share of them that may correlate better under another Sun. If half of all
points do so, at most 6 of 24 do in 1 of 90 glances; if 60 % do, which is the least share that refuses a Sun, in 1 of 900.
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
        """Index of the Sun that a significant majority of the points prefers, of far Suns that move them half of them, the one
        with the largest gain; None if there is none.
        """
        if self.points < _FEWEST:
            return None
        far = self.turns_deg == FAR_TURNS_DEG
        most = 0.5 if far else _majority(self.independent)
        some = [
            k
            for k, (share, shift) in enumerate(zip(self.shares, self.shifts_px, strict=True))
            if share > most and self.gains[k] > 0.0
            if not (far and 0.0 < shift < _SAME_PX)  # 0: no place is known
        ]
        return max(some, key=lambda k: self.gains[k]) if some else None

    @property
    def fits(self) -> bool:
        """True if the stated Sun may be right."""
        return not (self.outdone or self.turned)

    @property
    def outdone(self) -> bool:
        """True if the preferred Sun gains more than `LEAST_GAIN`; of far Suns, if there is one."""
        best = self.preferred
        if best is None or self.turns_deg == FAR_TURNS_DEG:
            return best is not None
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
        if math.isfinite(self.best_raise_sigma_deg) and abs(self.best_raise_deg) < _SEEN_DEG:
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


Search = Callable[[Image, Reflectance, Index, float], tuple[Array, Array]]
"""A search for n points near their known matches. Arguments: an image with its Sun, a reflectance
law, rows (k,) of the n points, and the power to which the image's brightness (negative: 0) is searched. Returns correlations
(k,) and places (k, 2) in pixels. A point that is not found has the correlation 0 and a NaN place.
"""


@dataclass(frozen=True, eq=False)
class MatchedPoints:
    """Points by which the Sun of an image is checked: rows (n,) of a catalogue, n >= 1, whose matches lie at
    ``offset_px`` (n, 2) from where the image's sensor projects them. Pixels of the full-resolution image.
    """

    catalog: Catalog
    searched: SearchImage
    model: Reflectance
    rows: Index
    offset_px: Array
    criteria: Criteria

    def check(
        self,
        independent_share: float = 1.0,
        reach_px: float = _REACH_PX,
        turns_deg: tuple[tuple[float, float], ...] = TURNS_DEG,
    ) -> SunCheck:
        """`check_sun` by points that are searched one by one, each within ``reach_px`` of its match."""

        def search_for(which: Index, catalog: Catalog | None) -> Search:
            points = replace(self, rows=self.rows[which], offset_px=self.offset_px[which])
            if catalog is not None:
                points = replace(points, catalog=catalog, rows=np.arange(len(which)))
            known: dict[tuple[bytes, float], FoundPlaces] = {}

            def search(
                moved: Image, law: Reflectance, some: Index, power: float
            ) -> tuple[Array, Array]:
                key = some.tobytes()
                if (key, 1.0) not in known:
                    known[key, 1.0] = points._found(some, reach_px)
                if (key, power) not in known:
                    known[key, power] = known[key, 1.0].to_power(power)
                return known[key, power].under(moved, law)

            return search

        image = self.searched.source
        return check_sun(
            search_for, self.catalog, self.rows, image, self.model, independent_share, turns_deg
        )

    def glance(
        self, independent_share: Callable[[Index], float] = lambda _: 1.0
    ) -> SunCheck | None:
        """A glance instead of `check`: the check by few points under the law of the search; None if it leaves a doubt under
        any law, or if the points are too few for it. ``independent_share``: of some of the points, by their places in ``rows``.
        """
        some = evenly(np.arange(len(self.rows)), _GLANCE_POINTS)
        if len(some) < _GLANCE_POINTS:
            return None
        found = self._found(some)

        def search(moved: Image, law: Reflectance, *_: object) -> tuple[Array, Array]:
            return found.under(moved, law)

        ground = self.catalog.position_mcmf[self.rows[some]]
        tried = _Tried(search, self.searched.source, ground, TURNS_DEG)
        others = [law for law in map(reflectance_model, LAWS) if law.name != self.model.name]
        checks, share = [], independent_share(some)
        for law in (self.model, *others):
            checks.append(tried.check(law, np.arange(len(some)), share)[0])
            if not checks[-1].is_sure:
                return None
        return checks[0]

    def _found(self, some: Index, reach_px: float | None = None) -> FoundPlaces:
        rows, offset_px = self.rows[some], self.offset_px[some]
        return FoundPlaces.of(self.catalog, self.searched, rows, offset_px, self.criteria, reach_px)


def check_sun(
    search_for: Callable[[Index, Catalog | None], Search],
    catalog: Catalog,
    points: Index,
    image: Image,
    model: Reflectance,
    independent_share: float = 1.0,
    turns_deg: tuple[tuple[float, float], ...] = TURNS_DEG,
) -> SunCheck:
    """Correlations of n >= 1 ``points`` (rows of a catalogue) under the stated Sun of an image
    and under Suns moved by ``turns_deg``; rendered with ``model``, or with the one of `LAWS` that
    most points prefer to it.

    ``search_for``: gives the search for some of the n points, in their own catalogue (None) or in one of these alone.
    ``independent_share``: number of points that share no terrain, as a share of n. At most 100 points, evenly chosen, are
    searched.
    """
    every = np.arange(len(points))
    tried = _Tried(search_for(every, None), image, catalog.position_mcmf[points], turns_deg)
    rows = evenly(every, _MOST)
    glance = rows[::_GLANCE]
    own, own_z = tried.check(model, rows, independent_share)
    best, most = own, 0.0
    for law in map(reflectance_model, LAWS):
        if law.name == model.name:
            continue
        if not _most_gain(
            _highest(fisher_z(tried.under(law, glance, SIDEWAYS_DEG)[0])) - own_z[::_GLANCE]
        ):
            continue
        other, z = tried.check(law, rows, independent_share)
        gain = float(np.median(z - own_z))
        if _most_gain(z - own_z, _majority(own.independent)) and gain > most:
            best, most = replace(other, law=law.name, least_doubt_px=own.doubt_px), gain
    if turns_deg != TURNS_DEG:
        return best
    bent = tried.bent(model, glance)
    raised = bent.best_raise(model, rows, best.independent)
    best = replace(best, best_raise_deg=raised[0], best_raise_sigma_deg=raised[1])
    ground = tried.ground_mcmf_m[rows]
    with_maps = (search_for(rows, one) for one in of_contrasts(catalog, points[rows], _CONTRASTS))
    otherwise = _fits_otherwise(best, bent, rows, with_maps, model)
    best = replace(best, fits_otherwise=otherwise)
    if not best.turned or best.outdone:
        return best
    if (detail := MapDetail.of(catalog, points[rows], image.sun_directions(ground))) is None:
        return best
    law, every = reflectance_model(best.law) if best.law else model, np.arange(len(rows))
    less, more = (
        _Tried(search_for(rows, detail.altered(sigmas)), image, ground, TURNS_DEG[:2]).check(
            law, every, independent_share
        )[0]
        for sigmas in (-1.0, 1.0)
    )
    sigma = math.inf  # where altered maps have no best azimuth
    if math.isfinite(less.best_turn_sigma_deg + more.best_turn_sigma_deg):
        by_map = 0.5 * (more.best_turn_deg - less.best_turn_deg)
        sigma = math.hypot(best.best_turn_sigma_deg, by_map)
    return replace(best, best_turn_sigma_deg=sigma, turned_by_map=True)


def near_or_far(near: SunCheck, far: Callable[[], SunCheck]) -> SunCheck:
    """The check by near Suns; that by `FAR_TURNS_DEG` where the near ones do not refuse the stated Sun and the far ones do."""
    return near if not near.fits or (found := far()).fits else found


def _fits_otherwise(
    check: SunCheck, own: _Tried, rows: Index, with_maps: Iterable[Search], model: Reflectance
) -> bool:
    """True if a high elevation that does not fit does so under the law of a rough surface or with another map, whose best one lies
    among the Suns tried.

    ``rows``: of the points of ``own``, which each of the searches ``with_maps`` has alone.
    """
    if check.elevation_fits or check.elevation_deg < _OTHERWISE_DEG:
        return False
    ground, every = own.ground_mcmf_m[rows], np.arange(len(rows))
    others = ((replace(own, search=one, ground_mcmf_m=ground), every) for one in with_maps)
    for (tried, some), law in product(
        ((own, rows), *others), (model, reflectance_model(REFERENCE_LAW))
    ):
        other, _ = tried.check(law, some, check.independent / len(rows))
        if other.elevation_fits and abs(other.best_raise_deg) < _SEEN_DEG:
            return True
    return False


def _most_gain(gain: Array, majority: float = 0.5) -> bool:
    """True if more than a share of the points (n,) gain."""
    return bool((gain > 0.0).mean() > majority)


def _majority(independent: float) -> float:
    """Share of the points, ``independent`` of them, that exceeds one half by `SIGMAS` of the
    binomial distribution.
    """
    return 0.5 + SIGMAS * 0.5 / math.sqrt(independent)


@dataclass(frozen=True, eq=False)
class _Tried:
    """A search repeated under other Suns and reflectance laws."""

    search: Search
    image: Image
    ground_mcmf_m: Array  # (n, 3)
    turns_deg: tuple[tuple[float, float], ...]  # (m)
    power: float = 1.0

    def under(
        self, law: Reflectance, rows: Index, turns_deg: Sequence[tuple[float, float]]
    ) -> tuple[Array, Array]:
        """Correlations (m, k) and places (m, k, 2) under m Suns."""
        ground = self.ground_mcmf_m[rows]
        found = [
            self.search(with_sun(self.image, ground, turned, raised), law, rows, self.power)
            for turned, raised in turns_deg
        ]
        return np.array([f[0] for f in found]), np.array([f[1] for f in found])

    def check(
        self, law: Reflectance, rows: Index, independent_share: float
    ) -> tuple[SunCheck, Array]:
        """The check under one law, and each point's z (k,) under the Sun with the highest median."""
        correlations, places = self.under(law, rows, (AS_STATED, *self.turns_deg))
        z, medians = fisher_z(correlations), np.median(correlations, axis=1)
        gain = z[1:] - z[0]
        independent = max(1.0, len(rows) * independent_share)
        turn, raised, stated_deg = self._vertex(gain, independent), (0.0, math.inf), math.nan
        if self.turns_deg == TURNS_DEG:
            stated_deg = _sun_over(self.image, self.ground_mcmf_m)[1].elevation_deg
            raised = self._rise(gain[[LOWERED, RAISED]], independent)
        check = SunCheck(
            points=len(rows),
            independent=independent,
            correlation=float(medians[0]),
            turns_deg=self.turns_deg,
            correlations=tuple(medians[1:].tolist()),
            gains=tuple(np.median(gain, axis=1).tolist()),
            shares=tuple((gain > 0.0).mean(axis=1).tolist()),
            shifts_px=tuple(_common_shift(moved - places[0]) for moved in places[1:]),
            best_turn_deg=turn[0],
            best_turn_sigma_deg=turn[1],
            elevation_deg=stated_deg,
            best_raise_deg=raised[0],
            best_raise_sigma_deg=raised[1],
        )
        return check, _highest(z)

    def bent(self, law: Reflectance, rows: Index) -> _Tried:
        """The same with the image's brightness to the power with which the points ``rows`` correlate best under the stated Sun:
        the vertex over the logarithm of powers `_POWER_STEP` apart.
        """
        known: dict[int, float] = {}

        def mean_z(step: int) -> float:
            if step not in known:
                bent = replace(self, power=_POWER_STEP**step)
                known[step] = float(fisher_z(bent.under(law, rows, (AS_STATED,))[0]).mean())
            return known[step]

        best = max((0, -1, 1), key=mean_z)
        on = best
        while 0 < abs(best) < _POWER_STEPS and mean_z(best + on) > mean_z(best):
            best += on
        step = 0.0
        if abs(best) < _POWER_STEPS:
            back, ahead = (np.array([mean_z(best + k) - mean_z(best)]) for k in (-1, 1))
            step = best_turn(back, ahead, 1.0, 1.0)[0]
        return replace(self, power=_POWER_STEP ** (best + step))

    def best_raise(self, law: Reflectance, rows: Index, independent: float) -> tuple[float, float]:
        """Rise of the elevation to the best one, and its 1 sigma, degrees; infinite if there is none."""
        suns = (AS_STATED, TURNS_DEG[LOWERED], TURNS_DEG[RAISED])
        z = fisher_z(self.under(law, rows, suns)[0])
        return self._rise(z[1:] - z[0], independent)

    def _rise(self, gain: Array, independent: float) -> tuple[float, float]:
        """`best_raise` of gains (2, n) under the lowered and the raised Sun: the parabola is one over log tan of the elevation,
        because slopes are bright by its cotangent.
        """
        stated = _sun_over(self.image, self.ground_mcmf_m)[1].elevation_deg
        if stated < 2.0 * LEAST_ELEVATION_DEG:  # hardly any Sun is lower
            return 0.0, math.inf
        least, most = LEAST_ELEVATION_DEG, 90.0 - LEAST_ELEVATION_DEG
        tried = stated + np.array([0.0, TURNS_DEG[LOWERED][1], TURNS_DEG[RAISED][1]])
        at, low, high = np.log(np.tan(np.radians(np.clip(tried, least, most))))
        step, sigma = best_turn(gain[0], gain[1], high - at, independent, at - low)
        if not math.isfinite(sigma):
            return 0.0, math.inf
        best = math.degrees(math.atan(math.exp(min(at + step, _HIGHEST))))
        return best - stated, sigma * math.degrees(0.5 * math.sin(2.0 * math.radians(stated)))

    def _vertex(self, gain: Array, independent: float) -> tuple[float, float]:
        """`best_turn` of gains (m, n) over the azimuth; none if those Suns were not tried."""
        pairs = [(k, turn) for k, (turn, up) in enumerate(self.turns_deg) if turn and not up]
        if len(pairs) != 2 or pairs[0][1] != -pairs[1][1]:
            return 0.0, math.inf
        (back, _), (ahead, step_deg) = pairs
        return best_turn(gain[back], gain[ahead], step_deg, independent)


def best_turn(
    back: Array, ahead: Array, step_deg: float, independent: float, back_deg: float | None = None
) -> tuple[float, float]:
    """Turn of the Sun's azimuth at the vertex of the parabola through mean gains in z, and its 1 sigma, degrees.

    ``back``, ``ahead``: gains (n,) of the points under Suns turned by -``back_deg`` (None: -``step_deg``) and ``step_deg``
    from the stated one, whose gain is 0. The sigma is that of the spread of the points, as if there
    were ``independent`` ones; infinite where the parabola has no maximum.
    """
    behind = step_deg if back_deg is None else back_deg
    bend = (ahead / step_deg + back / behind) / (step_deg + behind)
    slope = ahead / step_deg - bend * step_deg
    if not bend.mean() < 0.0:
        return 0.0, math.inf
    turn = -0.5 * float(slope.mean() / bend.mean())
    rest = 0.5 * slope + turn * bend
    return turn, float(rest.std() / -bend.mean()) / math.sqrt(independent)


def fisher_z(correlations: Array) -> Array:
    """Fisher's transform of correlations, whose spread depends little on their size; they are limited to 0.999."""
    return np.arctanh(np.clip(correlations, -0.999, 0.999))


def _highest(z: Array) -> Array:
    """The row (n,) of (m, n) with the highest median."""
    return np.asarray(z[int(np.median(z, axis=1).argmax())])


def _common_shift(offsets_px: Array) -> float:
    """Length of the median of offsets (n, 2) without the NaN ones; 0 if all are NaN."""
    known = offsets_px[np.isfinite(offsets_px).all(axis=-1)]
    return float(np.hypot(*np.median(known, axis=0))) if len(known) else 0.0


def with_sun(image: Image, ground_mcmf_m: Array, turn_deg: float, raise_deg: float) -> Image:
    """The image with another Sun: turned clockwise about the vertical at the middle of ground
    points (n, 3), and raised.

    A Sun that is not moved stays as it is; the new elevation is limited to 1..89 degrees.
    """
    if not (turn_deg or raise_deg) or not len(ground_mcmf_m):
        return image
    frame, sun = _sun_over(image, ground_mcmf_m)
    least, most = LEAST_ELEVATION_DEG, 90.0 - LEAST_ELEVATION_DEG
    elevation_deg = min(max(sun.elevation_deg + raise_deg, least), most)
    direction = direction_from_angles(frame, sun.azimuth_deg + turn_deg, elevation_deg)
    return replace(image, sun_position_mcmf_m=None, sun_direction_mcmf=direction)


def _sun_over(image: Image, ground_mcmf_m: Array) -> tuple[EnuFrame, Direction]:
    """The frame at the middle of ground points (n, 3), and the Sun of an image in it."""
    middle = ground_mcmf_m.mean(axis=0)
    lon, lat, _ = mcmf_to_lonlat(middle)
    frame = EnuFrame(float(lon), float(lat))
    return frame, Direction.from_mcmf(image.sun_directions(middle), frame)
