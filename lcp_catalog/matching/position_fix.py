"""Position from which an image was taken, by a catalogue's points: search, agreement, solution,
second search; and the decision whether to accept it.

A pose is given only with the decision `LOCATED`. It requires, in this order: an image with
contents; enough points that can be searched for; a significant agreement among those found, without
a rival (`consensus`), or a significant offset of all points together (`joint_offset`); a correction
that the stated uncertainty allows; a stated Sun that fits (`sun_check`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..arrays import Array, Index, Mask
from ..cameras.public import SensorOrPath
from ..cameras.sensor import Sensor, Uncertainty
from ..catalog.catalogue import Catalog
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..errors import not_a
from ..images.image import Image
from ..images.image_file import open_image
from ..landmarks.ground_votes import independent_share
from ..landmarks.located import SIGNIFICANT, log10_false_alarms
from ..photometry.law_choice import law_of
from ..photometry.laws import DEFAULT_MODEL, Reflectance
from .common_errors import SharedTerrain, map_sigma_m, shadow_shift_px
from .consensus import SHARE_IF_HERE, Consensus, agree, agreeing
from .fix import CANNOT_SAY, LOCATED, NOT_HERE, Fix
from .fix_advice import advised
from .joint_offset import JointOffset, find_joint_offset
from .matches import CODE, SEARCHED, Matches, joined
from .options import OPTIONS, USUAL, Options
from .point_choice import (
    NO_CLAIM,
    likeliest,
    patch_width_px,
    points_in_view,
    reductions,
    searched_in,
    shows_points,
    working_image,
)
from .point_search import SearchImage, find_points, nothing_in
from .pose import Pose, solve
from .search_area import SearchArea, narrowed, none_in_view, perhaps_in_view
from .sun_check import MatchedPoints
from .sun_verdict import FAR_TURNS_DEG, TURNS_DEG, SunCheck, near_or_far

LEAST_USABLE = 6
"""Least number of points that agree, without those that are known not to be usable, from which a pose
is solved with them alone: twice as many as determine it.
"""

_FEW = 0.5
"""Share of the searched points below which those that agree are also held against Suns that are far from the stated one."""

_SETTLED = 0.2
"""Change of the correction by a search, in sigmas, up to which no other search follows: in photographs and made frames that
would have changed it by 0.06 sigmas at most.
"""
_ROUNDS = 10
_MOST_NEEDED = 1000  # points that a reason asks for
_NOBODY = np.zeros(0, dtype=np.int64)


def locate(
    catalog: CatalogOrPath,
    image: Image | Path | str,
    uncertainty: Uncertainty | None = None,
    model: Reflectance | str = DEFAULT_MODEL,
    options: Options = OPTIONS,
    *,
    camera: SensorOrPath | None = None,
) -> Fix:
    """Find the position from which an image was taken: search for a catalogue's points in an image
    whose sensor is known within an uncertainty, and solve for the sensor.

    Parameters
    ----------
    catalog:
        A catalogue, or its file.
    image:
        An image with its sensor and Sun (`open_image`), or its file.
    uncertainty:
        1 sigma of the sensor's position and attitude; None: 1 km and 0.1 deg.
    model:
        Reflectance law of the renders, or its name.
    options:
        Settings of the search; `matching.options.FAINT` for low-contrast terrain.
    camera:
        For the file of an image: its camera, or camera file; None: a map projection.

    Returns
    -------
    Fix
        ``verdict`` and ``reason``; ``pose`` (None unless located) corrects the sensor:
        ``pose.position_mcmf_m`` (3,) and ``pose.position_covariance_m2`` (3, 3); ``matches`` in pixels
        of the full-resolution image.

    Raises
    ------
    CatalogError, ImageError, CameraError, SunError
        For files that cannot be read.

    Examples
    --------
    >>> fix = lcp.locate(catalog, folder / "AS15-M-0414.png", camera=camera)
    >>> fix.verdict in ("located", "not this place", "cannot say"), len(fix.matches) > 0
    (True, True)
    """
    catalog, law = opened_catalog(catalog), law_of(model) or DEFAULT_MODEL
    uncertainty = uncertainty or USUAL
    if isinstance(image, Path | str):
        image = open_image(image, camera, sees=shows_points(catalog))
    if not isinstance(image, Image):
        raise not_a(
            image, "image", "an Image (of a simulated frame `image`) or the path of its file"
        )
    area = perhaps_in_view(catalog, image.sensor, uncertainty, options.sigmas)
    area = area.only(np.isin(area.points, searched_in(catalog, area.points, image)))
    fix = fix_in_area(catalog, image, uncertainty, law, options, area)
    return advised(fix, catalog, image.sensor, uncertainty, options.sigmas)


def fix_in_area(
    catalog: Catalog,
    image: Image,
    uncertainty: Uncertainty,
    law: Reflectance,
    options: Options,
    area: SearchArea,
) -> Fix:
    """As `locate`, by the points of an area, which are of one scale of the image (`point_choice.searched_in`)."""
    working = working_image(catalog, image, area.points)
    levels = frozenset(np.asarray(catalog.level)[area.points].tolist())
    search = _FixSearch(catalog, image, working, uncertainty, law, options, levels)
    if not len(area):
        return Fix(CANNOT_SAY, none_in_view(catalog, image.sensor), search.unmatched())
    if not working.signal.size:
        few = f"the image is smaller than a pixel of the search, {working.sensor.factor} of its own wide"
        unused = search.unmatched(area.points)
        return Fix(CANNOT_SAY, f"{few}: use a catalogue with finer cells", unused)
    if (missing := nothing_in(image)) is not None:
        return Fix(CANNOT_SAY, missing, search.unmatched(area.points))
    return search.located(area.at_least(options.least_reach_px * search.factor))


@dataclass(frozen=True, eq=False)
class _FixSearch:
    catalog: Catalog
    image: Image  # at full resolution
    working: Image  # as it is searched
    uncertainty: Uncertainty
    model: Reflectance
    options: Options
    levels: frozenset[int]  # of the first search

    @property
    def factor(self) -> int:
        """Pixels of the full-resolution image along the side of a searched one."""
        return self.working.sensor.factor

    @property
    def tolerance_px(self) -> float:
        return self.options.tolerance_px * self.factor

    def tolerances_px(self, rows: Index) -> Array:
        """Tolerances (n,) of matches by `near`."""
        return self.options.tolerance_px * self.factors(rows).astype(float)

    def unmatched(self, rows: Index = _NOBODY) -> Matches:
        """Points without a match."""
        count = len(rows)
        nothing = np.full((count, 2), np.nan)
        return Matches(
            point=rows,
            predicted_px=self.image.sensor.project(self.catalog.position_mcmf[rows]),
            found_px=nothing,
            covariance_px2=np.full((count, 2, 2), np.nan),
            correlation=nothing[:, 0],
            second=nothing[:, 0],
            back_px=nothing[:, 0],
            code=np.full(count, CODE["not searched"], dtype=np.uint8),
        )

    def located(self, area: SearchArea) -> Fix:
        """The whole search over an area, and the decision."""
        options, far, coarse = self.options, float(np.median(area.reach_px)), None
        if far > options.most_reach_px * self.factor:
            least = options.least_reach_px * self.factor
            area, chance, slack = narrowed(
                area,
                self.catalog,
                self.working,
                self.image.sensor,
                self.uncertainty,
                self.model,
                options.sigmas,
                least,
            )
            if slack > self.width_px(area.points):
                reason = (
                    f"the stated uncertainty turns and scales the image by {slack:.0f} px, "
                    "too much for the search; state a smaller one"
                )
                return Fix(CANNOT_SAY, reason, self.unmatched(area.points))
            if chance > SIGNIFICANT:
                reason = (
                    f"no shift of the {len(area)} points in view within {far:.0f} px is significant"
                )
                return Fix(NOT_HERE, reason, self.unmatched(area.points))
            if math.isfinite(chance):
                coarse = JointOffset(len(area), chance, 0.0, reason="only at a coarse scale")
        matches, score, area = self.first_search(area)
        if not score.significant or score.pose is None:
            return self.refused(matches, area, score, coarse)
        matches, pose = self.settled(matches, score.pose)
        return self.judged(matches, pose, score)

    def first_search(self, area: SearchArea) -> tuple[Matches, Consensus, SearchArea]:
        """Matches and agreement of the likeliest points of an area (`point_choice.likeliest`) and
        their area; of all points if those do not agree.
        """
        suns = self.working.sun_directions(self.catalog.position_mcmf[area.points])
        best = likeliest(
            self.catalog, area.points, self.working.sensor, suns, self.options.most_first
        )
        some = area.only(best)
        matches = self.sought(self.searched, some)
        score = self.agreement(matches, some)
        if len(some) == len(area) or (score.significant and score.pose is not None):
            return matches, score, some
        # a second attempt doubles the number of solutions that chance can offer
        area = replace(area, log10_places=area.log10_places + math.log10(2.0))
        matches = self.sought(self.searched, area)
        return matches, self.agreement(matches, area), area

    @cached_property
    def searched(self) -> SearchImage:
        return SearchImage.of(self.working)

    def sought(self, image: SearchImage, area: SearchArea) -> Matches:
        """Matches near where an image's sensor projects the points; the predictions are those of
        the given sensor.
        """
        found = find_points(
            self.catalog,
            image,
            self.model,
            area.reach_px,
            points=area.points,
            offset_px=area.offset_px,
            criteria=self.options.criteria,
        )
        given = self.image.sensor.project(self.catalog.position_mcmf[area.points])
        return replace(found, predicted_px=given)

    def places(self, matches: Matches) -> tuple[Array, Array, Array]:
        """Positions, pixels and covariances of matches; NaN pixels for points that were not found."""
        found = np.where(matches.found[:, None], matches.found_px, np.nan)
        return self.catalog.position_mcmf[matches.point], found, matches.covariance_px2

    def width_px(self, rows: Index) -> float:
        """Side of a patch in the image, the median of some points."""
        return patch_width_px(self.catalog, self.image.sensor, rows)

    def agreement(self, matches: Matches, area: SearchArea) -> Consensus:
        found = agree(
            self.image.sensor,
            *self.places(matches),
            self.uncertainty,
            area.reach_px,
            tolerance_px=self.tolerance_px,
            width_px=self.width_px(matches.point),
        )
        return replace(found, log10_false_alarms=found.log10_false_alarms + area.log10_places)

    def settled(self, matches: Matches, pose: Pose) -> tuple[Matches, Pose]:
        """Search repeated with the corrected sensor, near its projections, until the correction is
        stable: first with that of the given matches which agree with a pose, by their own covariances.
        """
        pose, _ = self.solved(matches, pose)
        for _ in range(self.options.passes):
            before = pose
            pose, matches = self.solved(self.near(pose), pose)
            if (np.abs(pose.correction - before.correction) <= _SETTLED * pose.sigma).all():
                break
        return matches, pose

    def near(self, pose: Pose) -> Matches:
        """Matches near the projections of the corrected sensor, of each level at its own scale."""
        rows = points_in_view(self.catalog, pose.sensor)
        factors = self.factors(rows)
        parts = [self.unmatched()]
        for factor in np.unique(factors).tolist():
            some = rows[factors == factor]
            reach = np.full(len(some), self.options.second_reach_px * factor)
            area = SearchArea(some, np.zeros((len(some), 2)), reach)
            image = self.searched
            if factor != self.factor:
                image = SearchImage.of(self.image.reduced(factor))
            image = replace(image, source=corrected(image.source, pose))
            parts.append(self.sought(image, area))
        return joined(parts)

    def factors(self, rows: Index) -> Index:
        """`reductions` (n,) of points (rows (n,))."""
        return reductions(self.catalog, self.image.sensor, rows, self.levels, self.factor)

    def solved(self, matches: Matches, pose: Pose) -> tuple[Pose, Matches]:
        """The pose solved from the matches that agree with a pose, repeated until they stay the
        same; the others become inconsistent.
        """
        ground, found, covariance = self.places(matches)

        def who(sensor: Sensor) -> Mask:
            return agreeing(sensor, ground, found, covariance, tolerance)

        tolerance = self.tolerances_px(matches.point)
        agrees = who(pose.sensor)
        for _ in range(_ROUNDS):
            pose = self.solution(matches, agrees)
            before, agrees = agrees, who(pose.sensor)
            if (agrees == before).all():
                break
        return pose, matches.agreeing(agrees)

    def solution(self, matches: Matches, agrees: Mask, doubt_px: float = 0.0) -> Pose:
        """The pose by the agreeing matches, without those that the catalogue knows and does not call
        usable if `LEAST_USABLE` others agree: their errors are larger than stated. ``doubt_px``:
        an additional error common to all of them.
        """
        ground, found, covariance = self.places(matches)
        trusted = agrees & (matches.usable | ~np.isfinite(matches.prior))
        if trusted.sum() >= LEAST_USABLE:
            agrees = trusted
        suns = self.image.sun_directions(ground)
        shared = SharedTerrain.of(
            self.catalog, matches.point, ground, self.catalog.rotation_mcmf_to_enu[matches.point]
        )
        return solve(
            self.image.sensor,
            ground,
            found,
            covariance,
            self.uncertainty,
            agrees,
            shared=shared,
            common_px=math.hypot(self.options.common_px * self.factor, doubt_px),
            shift_px=shadow_shift_px(self.catalog, matches.point, self.image.sensor, suns),
            map_m=map_sigma_m(self.catalog, matches.point[agrees]),
        )

    def refused(
        self, matches: Matches, area: SearchArea, score: Consensus, coarse: JointOffset | None
    ) -> Fix:
        """The result without an agreement of single points: by all points together, now or at the
        coarse scale (``coarse``), else the reason why there is none.
        """
        searched = np.isin(matches.code, SEARCHED)
        undecided = score.log10_false_alarms < SIGNIFICANT
        whole = None if undecided else self.whole(area.only(searched), self.width_px(area.points))
        for said in (whole, coarse):
            if said is not None and said.shows:
                return self.by_all_points(matches, said)
        reach, expected = area.reach_px[searched], self.expected(matches, searched)
        if self.if_here(reach, expected) > SIGNIFICANT:
            count = int(searched.sum())
            reason = (
                f"too few points can be searched for: {count}, and at least "
                f"{self.fewest(area, count)} are needed; of {len(matches)} that may be in view "
                f"{matches.counted}"
            )
            if self.if_here(reach, math.inf) <= SIGNIFICANT:
                reason = (
                    f"{matches.found.sum()} of {count} points searched for were found, but they agree on no place; "
                    f"that says little, because only {expected:.3g} are expected to be found in this "
                    "light, view and scale"
                )
            return Fix.scored(CANNOT_SAY, reason, matches, score)
        if undecided:
            reason = "the points found agree about equally well on two places"
            return Fix.scored(CANNOT_SAY, reason, matches, score)
        reason = (
            f"{matches.found.sum()} of {searched.sum()} points searched for were found, "
            "but they agree on no place"
        )
        return Fix.scored(NOT_HERE, reason, matches, score)

    def whole(self, area: SearchArea, width_px: float) -> JointOffset | None:
        """The joint offset of the points of an area with patches of a width."""
        return find_joint_offset(
            self.catalog,
            self.working,
            self.image.sensor,
            self.uncertainty,
            self.model,
            area,
            width_px,
            common_px=self.options.common_px * self.factor,
            check_sun=self.options.check_sun,
        )

    def by_all_points(self, matches: Matches, whole: JointOffset) -> Fix:
        """The result by a significant joint offset. Marked found are the points that agree with its
        place by themselves.
        """
        shows = (
            f"all {whole.points} points together show this place; "
            f"the number of false alarms is 10^{whole.log10_false_alarms:.0f}"
        )
        lacking = whole.reason if whole.pose is None else self.too_far(whole.pose)
        if whole.pose is None or lacking:
            reason = f"single points agree on no place; {shows}, but {lacking}"
            return Fix.scored(CANNOT_SAY, reason, matches, whole, sun=whole.sun)
        matches = self.near(whole.pose)
        ground, found, covariance = self.places(matches)
        tolerance = self.tolerances_px(matches.point)
        used = agreeing(whole.pose.sensor, ground, found, covariance, tolerance)
        pose = replace(whole.pose, used=used)
        reason = f"{shows}; {used.sum()} of {len(matches)} points agree with it by themselves"
        return Fix.scored(LOCATED, reason, matches.agreeing(used), whole, pose, whole.sun)

    def fewest(self, area: SearchArea, too_few: int) -> int:
        """Number of points of an area's median reach, more than ``too_few``, from which an image of
        another place is refuted.
        """
        reach = float(np.median(area.reach_px))
        more = range(too_few + 1, _MOST_NEEDED)
        enough = (n for n in more if self.if_here(np.full(n, reach), math.inf) <= SIGNIFICANT)
        return next(enough, _MOST_NEEDED)

    def expected(self, matches: Matches, searched: Mask) -> float:
        """Number of the searched points that are expected to be found: by the catalogue's claims, half
        of those about which it claims nothing.
        """
        return float(np.nan_to_num(matches.prior[searched], nan=NO_CLAIM).sum())

    def if_here(self, reach_px: Array, expected: float) -> float:
        """log10 of the false alarms if `SHARE_IF_HERE` of points searched within ``reach_px`` (n,)
        agreed, or half of those ``expected`` to be found if these are fewer.
        """
        gate = math.pi * self.tolerance_px**2
        chance = np.minimum(1.0, gate / (2.0 * reach_px + 1.0) ** 2)
        least = -(-len(self.image.sensor.corrections) // 2)
        agrees = np.arange(len(chance)) < min(SHARE_IF_HERE * len(chance), 0.5 * expected)
        if agrees.sum() <= least:
            return 0.0
        return log10_false_alarms(np.sort(chance)[::-1], agrees, least)

    def judged(self, matches: Matches, pose: Pose, score: Consensus) -> Fix:
        """The decision on a significant pose."""
        if far := self.too_far(pose):
            return Fix.scored(CANNOT_SAY, f"the points agree, but {far}", matches, score)
        sun = self.sun(matches, pose) if self.options.check_sun else None
        if sun is not None and not sun.fits:
            return Fix.scored(CANNOT_SAY, sun.complaint, matches, score, sun=sun)
        if sun is not None and sun.doubt_px > 0.0:
            pose = self.solution(matches, pose.used, sun.doubt_px)
        reason = (
            f"{matches.found.sum()} of {len(matches)} points agree; "
            f"the number of false alarms is 10^{score.log10_false_alarms:.0f}"
        )
        return Fix.scored(LOCATED, reason, matches, score, pose, sun)

    def too_far(self, pose: Pose) -> str:
        """The objection to a correction larger than the stated uncertainty allows; empty if there
        is none.
        """
        sigmas = self.uncertainty.sigmas(self.image.sensor)
        off = float(np.abs(pose.correction[pose.solved] / sigmas[pose.solved]).max(initial=0.0))
        if off <= self.options.most_sigmas:
            return ""
        return f"the position is {off:.1f} stated sigmas away; state a larger uncertainty if that is possible"

    def sun(self, matches: Matches, pose: Pose) -> SunCheck:
        """The check by the points of the levels of the first search, where few agree under far Suns, too."""
        own = np.isin(np.asarray(self.catalog.level)[matches.point], [*self.levels])
        # more than determine the pose: under high Suns few points are called usable
        used = matches.found & own
        rows = matches.point[used]
        offset = matches.found_px[used] - pose.sensor.project(self.catalog.position_mcmf[rows])
        places, width = matches.found_px[used], self.width_px(matches.point[own])

        def share(some: Index) -> float:
            return independent_share(places[some], width)

        searched = replace(self.searched, source=corrected(self.working, pose))
        own_points = MatchedPoints(
            self.catalog, searched, self.model, rows, offset, self.options.criteria
        )

        def checked(reach_px: float, turns_deg: tuple[tuple[float, float], ...]) -> SunCheck:
            whole = share(np.arange(len(rows)))
            return own_points.check(whole, reach_px * self.factor, turns_deg)

        near = None if self.options.whole_sun_check else own_points.glance(share)
        if near is None:
            near = checked(self.options.sun_reach_px, TURNS_DEG)
        if matches.found.sum() > _FEW * np.isin(matches.code, SEARCHED).sum():
            return near
        return near_or_far(near, lambda: checked(self.options.second_reach_px, FAR_TURNS_DEG))


def corrected(image: Image, pose: Pose) -> Image:
    """A searched image with the corrected sensor."""
    return image.with_sensor(image.sensor.moved(pose.correction))
