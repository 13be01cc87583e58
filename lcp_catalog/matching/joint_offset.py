"""Offset of an image whose points cannot be found one by one, by the correlations of all points
together.

At one offset of the whole image every point's correlation is slightly higher than elsewhere, though
no single point is significant. The votes of `search_area.coarse_shift`, at the pixels of the
searched image, give that offset and the expected number of offsets as clear by chance. The place is
the maximum of the mean of z = artanh(correlation), found again with the corrected sensor until it
is stable. Its covariance is that of resampled points (bootstrap, Efron 1979), divided by the share
of them that is independent.

Brightness that the albedo map knows is significant under a wrong Sun, too, some pixels off. So the stated Sun is compared with
near and with far ones (`sun_check`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Index
from ..cameras.sensor import Sensor, Uncertainty
from ..catalog.catalogue import Catalog
from ..images.image import Image
from ..landmarks.ground_votes import (
    FARTHEST_PX,
    FEWEST,
    MOST_POINTS,
    MOST_SLACK_PX,
    independent_share,
)
from ..landmarks.located import GATE, SIGNIFICANT
from ..photometry.laws import Reflectance
from .common_errors import map_sigma_m, shadow_shift_px
from .consensus import widened
from .point_choice import likeliest
from .point_search import SearchImage
from .pose import Pose, jacobian, solve
from .search_area import CoarseShift, SearchArea, coarse_shift, correlation_maps, slack_px
from .subpixel import peaks
from .sun_check import Search, check_sun
from .sun_verdict import FAR_TURNS_DEG, TURNS_DEG, SunCheck, near_or_far

SHOWS = -3.0
"""log10 of the number of false alarms from which on an image counts as one of another place."""

_CHUNK = 64
_NEAR_PX = 6
_SUN_PX = 3
_DRAWS = 200
_AT_EDGE = 0.1
"""Largest share of the resamplings whose peak lies at the edge of the maps."""
_MOST_SIGMA_PX = 2.0
_FLOOR_PX = 0.02
_PASSES = 4
_STILL = 0.1
_LOOSEST = 0.5
"""Slack, as a share of the reach, above which a common offset has no meaning."""


@dataclass(frozen=True, eq=False)
class JointOffset:
    """Result by n points together. ``pose`` has one place, that of all of them, as its point;
    without a pose, ``reason`` says why.
    """

    points: int
    log10_false_alarms: float
    rival_log10: float
    pose: Pose | None = None
    reason: str = ""
    sun: SunCheck | None = None

    @property
    def shows(self) -> bool:
        """True if the image may be one of this place."""
        return self.log10_false_alarms < SHOWS


@dataclass(frozen=True, eq=False)
class _Place:
    """Maximum of the mean of z, from where the sensor projects the terrain, in searched pixels."""

    shift: Array  # (2,)
    covariance: Array  # (2, 2), NaN if resampled points agree on no place nearby


def find_joint_offset(
    catalog: Catalog,
    image: Image,
    given: Sensor,
    uncertainty: Uncertainty,
    model: Reflectance,
    area: SearchArea,
    width_px: float,
    *,
    common_px: float = 0.0,
    check_sun: bool = True,
) -> JointOffset | None:
    """The common offset of the points of an area in a searched image, and the sensor corrected by
    it.

    ``given``: sensor of the full-resolution image. In its pixels: ``width_px``, the side of a
    patch, and ``common_px``, 1 sigma of an error common to all points. None if a common offset has
    no meaning: fewer points than `FEWEST`, too few offsets, an uncertainty that turns and scales
    the image by more than half of the reach, or a reach of more than 64 searched pixels.
    """
    if len(area) < FEWEST:
        return None
    suns = image.sun_directions(catalog.position_mcmf[area.points])
    some = area.only(likeliest(catalog, area.points, image.sensor, suns, MOST_POINTS))
    search = _JointSearch(
        catalog, image, given, uncertainty, model, some, width_px, common_px, check_sun
    )
    return search.found()


@dataclass(frozen=True, eq=False)
class _JointSearch:
    catalog: Catalog
    image: Image
    given: Sensor
    uncertainty: Uncertainty
    model: Reflectance
    area: SearchArea
    width_px: float
    common_px: float
    check_sun: bool

    @property
    def factor(self) -> int:
        return self.image.sensor.factor

    @cached_property
    def share(self) -> float:
        """Share of the points that is independent."""
        places = self.given.project(self.catalog.position_mcmf[self.area.points])
        return independent_share(places, self.width_px)

    def found(self) -> JointOffset | None:
        slack = slack_px(self.given, self.catalog.position_mcmf[self.area.points], self.uncertainty)
        loose = slack > MOST_SLACK_PX * self.factor
        reach = max(float(np.median(self.area.reach_px)), self.width_px)
        if slack > _LOOSEST * reach or reach > FARTHEST_PX * self.factor:
            return None
        shift = self.shift(reach, slack if loose else 0.0)
        if shift is None:
            return None
        log10 = shift.log10_false_alarms + self.area.log10_places
        whole = JointOffset(shift.points, log10, shift.rival_log10)
        if log10 >= SIGNIFICANT:
            return replace(whole, reason="not significant enough for a position")
        if shift.rival_log10 <= min(SIGNIFICANT, 0.5 * log10):
            return replace(whole, reason="another place is about as significant")
        if loose:
            turned = "the stated uncertainty turns and scales the image by"
            return replace(whole, reason=f"{turned} {slack:.1f} px, too much for a position")
        return self.placed(whole, np.array(shift.offset_px))

    def shift(self, reach_px: float, slack: float) -> CoarseShift | None:
        return coarse_shift(
            self.catalog,
            self.image,
            self.model,
            reach_px,
            points=self.area.points,
            offset_px=self.area.offset_px,
            slack_px=slack,
            grid_px=FARTHEST_PX,
            share=self.share,
        )

    def placed(self, whole: JointOffset, offset_px: Array) -> JointOffset:
        """The result with the pose, if the place is certain and the Sun fits."""
        found = self.given.project(self.ground) + self.area.offset_px[self.middle] + offset_px
        shown, covariance = found, self.factor**2 * np.eye(2)
        pose = self.solved(found, covariance)
        for _ in range(_PASSES):
            before, place = pose, self.place(self.at(pose))
            covariance = self.factor**2 * place.covariance + self.unlike
            if not np.diag(covariance).max() <= (_MOST_SIGMA_PX * self.factor) ** 2:
                return replace(whole, reason="its place is uncertain by more than two pixels")
            found = pose.sensor.project(self.ground) + self.factor * place.shift
            pose = self.solved(found, covariance)
            if (np.abs(pose.correction - before.correction) <= _STILL * pose.sigma).all():
                break
        if self.is_beyond(found - shown, covariance + self.factor**2 * np.eye(2)):
            return replace(
                whole, reason="its place is uncertain: the votes of its points are for another"
            )
        off = found - pose.sensor.project(self.ground)
        if self.is_beyond(off, covariance):
            away = float(np.hypot(*off))
            return replace(
                whole,
                reason=f"it lies {away:.1f} px from the places that the stated uncertainty allows",
            )
        if not self.check_sun:
            return replace(whole, pose=pose)
        check = self.sun(self.at(pose))
        if check is None or not check.fits:
            few = "too few points remain to compare the stated Sun with others"
            return replace(whole, sun=check, reason=check.complaint if check else few)
        return replace(whole, sun=check, pose=self.solved(found, covariance, check.doubt_px))

    @cached_property
    def middle(self) -> int:
        """The point nearest to the middle of all, whose place stands for all of them."""
        places = self.catalog.position_mcmf[self.area.points]
        return int(np.linalg.norm(places - places.mean(axis=0), axis=-1).argmin())

    @property
    def ground(self) -> Array:
        """That point's position, (3,)."""
        return np.asarray(self.catalog.position_mcmf[self.area.points[self.middle]])

    @cached_property
    def unlike(self) -> Array:
        """Covariance (2, 2) of that point's shift relative to the mean of all points, by the
        uncertainty.
        """
        places = self.catalog.position_mcmf[self.area.points]
        slope = jacobian(self.given, places)
        apart = slope[self.middle] - slope.mean(axis=0)
        return np.asarray(apart @ np.diag(self.uncertainty.sigmas(self.given) ** 2) @ apart.T)

    def solved(self, found_px: Array, covariance_px2: Array, doubt_px: float = 0.0) -> Pose:
        """The sensor corrected by the one place."""
        row = self.area.points[self.middle : self.middle + 1]
        sun = self.image.sun_directions(self.ground[None])
        return solve(
            self.given,
            self.ground[None],
            found_px[None],
            covariance_px2[None],
            self.uncertainty,
            [True],
            common_px=math.hypot(self.common_px, doubt_px),
            shift_px=shadow_shift_px(self.catalog, row, self.given, sun),
            map_m=map_sigma_m(self.catalog, row),
        )

    def is_beyond(self, off_px: Array, covariance_px2: Array) -> bool:
        """True if an offset is outside its gate, which is widened by a searched pixel."""
        wide = widened(covariance_px2, float(self.factor))
        return bool(off_px @ np.linalg.solve(wide, off_px) > GATE**2)

    def at(self, pose: Pose) -> Image:
        """The searched image with a corrected sensor."""
        return self.image.with_sensor(self.image.sensor.moved(pose.correction))

    def place(self, image: Image) -> _Place:
        """The peak near where an image's sensor projects the terrain, by all points and by
        resampled ones.
        """
        z = self.z_maps(image, self.area.points, _NEAR_PX)
        z = z[_whole_middle(z)]
        nowhere = _Place(np.full(2, np.nan), np.full((2, 2), np.nan))
        if len(z) < FEWEST:
            return nowhere
        shift, _ = _summit(z)
        drawn = np.random.default_rng(0).multinomial(
            len(z), np.full(len(z), 1.0 / len(z)), size=_DRAWS
        )
        column, row, _ = peaks(np.moveaxis(_mean(z, drawn.astype(np.float64)), 0, -1))
        inside = np.isfinite(column)
        if inside.mean() < 1.0 - _AT_EDGE or not np.isfinite(shift).all():
            return nowhere
        scale = len(z) / (len(z) - 1.0) / self.share
        covariance = scale * np.cov(column[inside], row[inside]) + _FLOOR_PX**2 * np.eye(2)
        return _Place(shift, covariance)

    def z_maps(
        self, image: Image, rows: Index, reach: int, law: Reflectance | None = None
    ) -> Array:
        """artanh of the correlations (n, 2 reach + 1, 2 reach + 1) of points about where an image's
        sensor projects them.
        """
        searched = replace(self.searched, source=image)
        parts = [rows[start : start + _CHUNK] for start in range(0, len(rows), _CHUNK)]
        found = [
            correlation_maps(
                self.catalog, searched, law or self.model, part, np.zeros((len(part), 2)), reach
            )
            for part in parts
        ]
        return np.arctanh(np.clip(np.concatenate(found).astype(np.float64), -0.99, 0.99))

    @cached_property
    def searched(self) -> SearchImage:
        return SearchImage.of(self.image)

    def sun(self, image: Image) -> SunCheck | None:
        """The check of the stated Sun by the points whose map has no gap next to its middle; None
        for too few of them.
        """
        rows = self.area.points
        rows = rows[_whole_middle(self.z_maps(image, rows, _SUN_PX))]
        if len(rows) < FEWEST:
            return None

        def search_for(which: Index, catalog: Catalog | None) -> Search:
            here, known = self, rows[which]
            if catalog is not None:
                here, known = replace(self, catalog=catalog), np.arange(len(which))

            def search(
                moved: Image, law: Reflectance, some: Index, _: float
            ) -> tuple[Array, Array]:
                shift, z = _summit(here.z_maps(moved, known[some], _SUN_PX, law))
                return np.tanh(np.nan_to_num(z)), np.tile(self.factor * shift, (len(some), 1))

            return search

        checked = partial(check_sun, search_for, self.catalog, rows, image, self.model, self.share)
        return near_or_far(checked(TURNS_DEG), lambda: checked(FAR_TURNS_DEG))


def _whole_middle(z: Array) -> NDArray[np.bool_]:
    """True (n,) for maps (n, m, m) with all values next to the middle: a value that comes and goes
    at a gap would move a peak.
    """
    middle = z.shape[1] // 2
    near = np.s_[:, middle - 1 : middle + 2, middle - 1 : middle + 2]
    return np.asarray(np.isfinite(z[near]).all(axis=(1, 2)))


def _mean(z: Array, weights: Array) -> Array:
    """Means (k, m, m) of maps z (n, m, m) with weights (k, n); missing values count as 0."""
    flat = np.nan_to_num(z.reshape(len(z), -1))
    mean = weights @ flat / weights.sum(axis=1, keepdims=True)
    return np.asarray(mean.reshape(-1, *z.shape[1:]))


def _summit(z: Array) -> tuple[Array, Array]:
    """(column, row), from the middle, of the maximum of the mean of maps (n, m, m), NaN at the
    edge; and each map's value at the nearest whole offset.
    """
    mean = _mean(z, np.ones((1, len(z))))
    column, row, _ = peaks(np.moveaxis(mean, 0, -1))
    at = np.unravel_index(int(mean[0].argmax()), mean[0].shape)
    return np.array([column[0], row[0]]), z[:, at[0], at[1]]
