"""Check of the stated Sun direction: comparison with the correlations under other Suns.

A patch rendered under a wrong Sun still correlates with the image, but less, and its match may be
shifted, by the same amount for all points: the matches can agree on a wrong position. So the points
of an agreement are rendered again under Suns turned about the vertical and raised or lowered, and
searched near their matches (`MatchedPoints`), or all together (`joint_offset`). `sun_verdict` says what follows.

A reflectance law other than that of the surface looks like a wrong Sun, or hides one. So the check is repeated with other
laws (`LAWS`); the law that most points prefer, each law under its own best Sun, decides.

A lower Sun bends the brightness of slopes, and so do film and decoding: the vertex over the elevation is taken with the
image's brightness to the power with which the points correlate best (`_Tried.bent`).

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
from .sun_verdict import (
    FAR_TURNS_DEG,
    LEAST_ELEVATION_DEG,
    LOWERED,
    RAISED,
    SEEN_DEG,
    TURNS_DEG,
    FarSunCheck,
    SunCheck,
    majority,
)

AS_STATED = (0.0, 0.0)
SIDEWAYS_DEG = (AS_STATED, *TURNS_DEG[:2])

LAWS = (REFERENCE_LAW, DEFAULT_LAW)
"""Reflectance laws tried beside that of the search: one of a rough and one of a dark surface. Under
one of them, a surface that follows the other looks as if the Sun were elsewhere.
"""

_OTHERWISE_DEG = 42.0
_CONTRASTS = (0.9, 1.1)
"""Elevation above which an elevation must not fit under the law of a rough surface or another contrast of the albedo map, either.
The less a Sun shades, the more the best elevation depends on both. Brightness of two maps of one mosaic, in patches of 16 km, goes
with another power from square to square of 150 km, by 12 to 15 % (1 sigma).
"""
_POWER_STEP, _POWER_STEPS = 1.5, 3
"""Factor between powers of the brightness tried, and most of them: 0.3 to 3.4, for sRGB taken as linear and the reverse."""
_HIGHEST = 4.0  # log tan of 88.95 deg
_REACH_PX = 3.0
_MOST = 100
_GLANCE = 2
"""One of so many points is searched first, under the stated and the turned Suns, to decide if
another law is tried in full: only if most of these points correlate better. This takes a third of
the time.
"""
_GLANCE_POINTS = 24

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
        if _most_gain(z - own_z, majority(own.independent)) and gain > most:
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
        if other.elevation_fits and abs(other.best_raise_deg) < SEEN_DEG:
            return True
    return False


def _most_gain(gain: Array, majority: float = 0.5) -> bool:
    """True if more than a share of the points (n,) gain."""
    return bool((gain > 0.0).mean() > majority)


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
        kind = FarSunCheck if self.turns_deg == FAR_TURNS_DEG else SunCheck
        check = kind(
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
