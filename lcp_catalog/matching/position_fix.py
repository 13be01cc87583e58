"""Where an image was taken, from a catalogue's points in it: sought, agreed on, solved, sought again; and whether to
believe it.

A pose is given only with the verdict `LOCATED`. What has to hold for it, in this order: an image with something in
it; enough points that can be looked for; an agreement among those found that is no chance and has no rival
(`consensus`); a correction that the stated uncertainty allows; a Sun that fits (`light_check`). docs/pose.md has the
figures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import Array, Index, Mask
from ..cameras.sensor import Sensor, Uncertainty, pixel_size_m
from ..catalog.catalogue import Catalog
from ..images.image import Image
from ..photometry.laws import DEFAULT_MODEL, Reflectance
from .consensus import (
    SIGNIFICANT,
    Consensus,
    agree,
    agreeing,
    independent_share,
    log10_false_alarms,
)
from .joint_offset import WholeGround, whole_ground
from .matches import CODE, FOUND, Matches
from .point_choice import points_in_view, working_image
from .point_search import Criteria, find_points
from .pose import Pose, residuals_px, solve
from .search_area import SearchArea, narrowed, perhaps_in_view
from .search_image import nothing_in
from .sun_check import SunCheck, check_points

LOCATED = "located"
NOT_HERE = "not this place"
CANNOT_SAY = "cannot say"

BY_POINTS = "points"
BY_GROUND = "the ground as a whole"
"""What an image was located by."""

SEARCHED = tuple(
    CODE[reason] for reason in (FOUND, "weak", "ambiguous", "not confirmed", "inconsistent")
)
"""Codes of points that could be looked for: what became of them says something about the place."""

SHARE_IF_HERE = 0.25
"""Of the points that can be looked for in an image of this very place, at least so many agree; fewer points than make
that significant refute no place.
"""

_ROUNDS = 10
_NOBODY = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Options:
    """How to look. Pixels are those of the photograph that is searched, which may be a reduced one
    (`usable.working_image`).
    """

    criteria: Criteria = field(default_factory=Criteria)
    tolerance_px: float = 1.0  # how far a match may lie off beside 3 sigma of its own
    sigmas: float = 3.0  # of the stated uncertainty that are searched
    least_reach_px: float = (
        16.0  # also where the uncertainty is less: agreement must be able to fail
    )
    most_reach_px: float = 64.0  # further than this the whole image is shifted first
    common_px: float = 0.0  # 1 sigma of what all matches may be off alike
    second_reach_px: float = 6.0  # with the corrected sensor
    passes: int = 4
    most_sigmas: float = 4.0  # that a correction may be away from the sensor as it was given
    check_sun: bool = True
    sun_reach_px: float = 3.0


FAINT = Options(tolerance_px=1.5, criteria=Criteria(max_back_px=3.0, max_false_match=1.0))
"""For ground that shades by a hundredth of its brightness: matches that are doubtful alone are let through, and what agrees
is left to the consensus, whose count of false alarms does not ask how good a match is (docs/validation.md, the NAC pair).
"""


@dataclass(frozen=True, eq=False)
class PositionFix:
    """One image's verdict. ``matches`` are of every point that may be in view; with `LOCATED` those marked found are
    the inliers. ``log10_false_alarms``: of solutions as good by chance; ``rival``: the same of the best other one.
    """

    verdict: str
    reason: str  # one line
    matches: Matches
    pose: Pose | None = None
    log10_false_alarms: float = 0.0
    rival_log10: float = 0.0
    sun: SunCheck | None = None
    by: str = BY_POINTS  # or `BY_GROUND`: of all points together, few of which may be found alone


def locate(
    catalog: Catalog,
    photo: Image,
    uncertainty: Uncertainty,
    model: Reflectance = DEFAULT_MODEL,
    options: Options = Options(),
) -> PositionFix:
    """Seek a catalogue's points in a photograph whose sensor is known within an uncertainty, and solve for the
    sensor.

    Frames: the pose corrects ``photo.sensor``; matches are in the pixels of the image as it came.
    """
    area = perhaps_in_view(catalog, photo.sensor, uncertainty, options.sigmas)
    working = working_image(catalog, photo, area.points)
    search = _Search(catalog, photo, working, uncertainty, model, options)
    if not len(area):
        reason = f"none of the catalogue's {len(catalog)} points can be in view"
        return PositionFix(CANNOT_SAY, reason, search.unmatched())
    if (missing := nothing_in(photo)) is not None:
        return PositionFix(CANNOT_SAY, missing, search.unmatched(area.points))
    return search.located(area.at_least(options.least_reach_px * search.factor))


@dataclass(frozen=True, eq=False)
class _Search:
    catalog: Catalog
    photo: Image  # as it came
    working: Image  # as it is searched
    uncertainty: Uncertainty
    model: Reflectance
    options: Options

    @property
    def factor(self) -> int:
        """Pixels of the image as it came to one that is searched."""
        return self.working.sensor.factor

    @property
    def tolerance_px(self) -> float:
        return self.options.tolerance_px * self.factor

    def unmatched(self, rows: Index = _NOBODY) -> Matches:
        """Points that show nowhere."""
        count = len(rows)
        nothing = np.full((count, 2), np.nan)
        return Matches(
            point=rows,
            predicted_px=self.photo.sensor.project(self.catalog.position_mcmf[rows]),
            found_px=nothing,
            covariance_px2=np.full((count, 2, 2), np.nan),
            correlation=nothing[:, 0],
            second=nothing[:, 0],
            back_px=nothing[:, 0],
            code=np.full(count, CODE["weak"], dtype=np.uint8),
        )

    def located(self, area: SearchArea) -> PositionFix:
        """The whole search over an area, and the verdict."""
        options, far, coarse = self.options, float(np.median(area.reach_px)), None
        if far > options.most_reach_px * self.factor:
            least = options.least_reach_px * self.factor
            area, chance, slack = narrowed(
                area,
                self.catalog,
                self.working,
                self.photo.sensor,
                self.uncertainty,
                self.model,
                options.sigmas,
                least,
            )
            if slack > self.width_px(area.points):
                reason = (
                    f"the stated uncertainty turns and scales the image by {slack:.0f} px: "
                    "too much to be searched; state a smaller one"
                )
                return PositionFix(CANNOT_SAY, reason, self.unmatched(area.points))
            if chance > SIGNIFICANT:
                reason = f"of {len(area)} points in view no shift within {far:.0f} px shows more than chance"
                return PositionFix(NOT_HERE, reason, self.unmatched(area.points))
            if math.isfinite(chance):
                coarse = WholeGround(len(area), chance, 0.0, reason="only at a coarse scale")
        matches = self.sought(self.working, area)
        score = self.agreement(matches, area)
        if not score.significant or score.pose is None:
            return self.refused(matches, area, score, coarse)
        matches, pose = self.settled(score.pose)
        return self.judged(matches, pose, score)

    def sought(self, photo: Image, area: SearchArea) -> Matches:
        """Sought about where a photograph's sensor has them; the predictions stay those of the sensor as it was
        given.
        """
        found = find_points(
            self.catalog,
            photo,
            self.model,
            area.reach_px,
            points=area.points,
            offset_px=area.offset_px,
            criteria=self.options.criteria,
        )
        given = self.photo.sensor.project(self.catalog.position_mcmf[area.points])
        return replace(found, predicted_px=given)

    def places(self, matches: Matches) -> tuple[Array, Array, Array]:
        """Ground, pixels and covariances of matches; NaN pixels for what was not found."""
        found = np.where(matches.found[:, None], matches.found_px, np.nan)
        return self.catalog.position_mcmf[matches.point], found, matches.covariance_px2

    def width_px(self, rows: Index) -> float:
        """Side of a patch in the image, the median of some points'."""
        ground = pixel_size_m(self.photo.sensor, self.catalog.position_mcmf[rows])
        return float(np.nanmedian(self.catalog.gsd[rows] * (self.catalog.patch_nodes - 1) / ground))

    def agreement(self, matches: Matches, area: SearchArea) -> Consensus:
        found = agree(
            self.photo.sensor,
            *self.places(matches),
            self.uncertainty,
            area.reach_px,
            tolerance_px=self.tolerance_px,
            width_px=self.width_px(matches.point),
        )
        return replace(found, log10_false_alarms=found.log10_false_alarms + area.log10_places)

    def settled(self, pose: Pose) -> tuple[Matches, Pose]:
        """Sought again with the corrected sensor, near where it has them, until the correction stands."""
        matches = self.unmatched()
        for _ in range(self.options.passes):
            before = pose
            pose, matches = self.solved(self.near(pose), pose)
            if (np.abs(pose.correction - before.correction) <= 0.1 * pose.sigma).all():
                break
        return matches, pose

    def near(self, pose: Pose) -> Matches:
        """Sought near where the corrected sensor has them."""
        rows = points_in_view(self.catalog, pose.sensor)
        reach = np.full(len(rows), self.options.second_reach_px * self.factor)
        return self.sought(self.corrected(pose), SearchArea(rows, np.zeros((len(rows), 2)), reach))

    def corrected(self, pose: Pose) -> Image:
        """The searched photograph with the corrected sensor."""
        return self.working.with_sensor(self.working.sensor.moved(pose.correction))

    def solved(self, matches: Matches, pose: Pose) -> tuple[Pose, Matches]:
        """Solved from those that agree with a pose, and again, until nobody changes sides; the others are
        inconsistent.
        """
        ground, found, covariance = self.places(matches)

        def who(sensor: Sensor) -> Mask:
            return agreeing(sensor, ground, found, covariance, self.tolerance_px)

        agrees = who(pose.sensor)
        for _ in range(_ROUNDS):
            pose = self.solution(matches, agrees)
            before, agrees = agrees, who(pose.sensor)
            if (agrees == before).all():
                break
        return pose, told_apart(matches, pose.used)

    def solution(self, matches: Matches, agrees: Mask, doubt_px: float = 0.0) -> Pose:
        """The pose by those who agree; ``doubt_px``: what all of them may be off alike, beside the usual."""
        ground, found, covariance = self.places(matches)
        share = independent_share(found[agrees], self.width_px(matches.point))
        return solve(
            self.photo.sensor,
            ground,
            found,
            covariance,
            self.uncertainty,
            agrees,
            overlap=1.0 / share,
            common_px=math.hypot(self.options.common_px * self.factor, doubt_px),
        )

    def refused(
        self, matches: Matches, area: SearchArea, score: Consensus, coarse: WholeGround | None
    ) -> PositionFix:
        """What all points together say where single ones give no place (``coarse``: have said); else why there is none."""
        searched = np.isin(matches.code, SEARCHED)
        undecided = score.log10_false_alarms < SIGNIFICANT
        whole = None if undecided else self.whole(area.only(searched), self.width_px(area.points))
        for said in (whole, coarse):
            if said is not None and said.shows:
                return self.by_ground(matches, said)
        figures = (None, score.log10_false_alarms, score.rival_log10)
        if self.if_here(searched, area) > SIGNIFICANT:
            reason = f"too few points can be looked for: {_counted(matches)}"
            return PositionFix(CANNOT_SAY, reason, matches, *figures)
        if undecided:
            reason = "the points found agree on two places about as well"
            return PositionFix(CANNOT_SAY, reason, matches, *figures)
        reason = (
            f"of {searched.sum()} points looked for {matches.found.sum()} were found, "
            "and they agree on no place"
        )
        return PositionFix(NOT_HERE, reason, matches, *figures)

    def whole(self, area: SearchArea, width_px: float) -> WholeGround | None:
        """What the points of an area, patches so wide, say together."""
        return whole_ground(
            self.catalog,
            self.working,
            self.photo.sensor,
            self.uncertainty,
            self.model,
            area,
            width_px,
            common_px=self.options.common_px * self.factor,
            check_sun=self.options.check_sun,
        )

    def by_ground(self, matches: Matches, whole: WholeGround) -> PositionFix:
        """The verdict where the ground as a whole shows. Found are the points that agree with its place by themselves."""
        figures = (whole.log10_false_alarms, whole.rival_log10)
        shows = (
            f"the ground as a whole ({whole.points} points together) shows; "
            f"the number of false alarms is 10^{whole.log10_false_alarms:.0f}"
        )
        lacking = whole.reason if whole.pose is None else self.too_far(whole.pose)
        if whole.pose is None or lacking:
            reason = f"single points agree on no place; {shows}; but {lacking}"
            return PositionFix(CANNOT_SAY, reason, matches, None, *figures, whole.sun, BY_GROUND)
        matches = self.near(whole.pose)
        ground, found, covariance = self.places(matches)
        used = agreeing(whole.pose.sensor, ground, found, covariance, self.tolerance_px)
        residual = residuals_px(whole.pose.sensor, ground, found)
        pose = replace(whole.pose, used=used, residual_px=residual)
        reason = f"{shows}; {used.sum()} of {len(matches)} points agree with it by themselves"
        return PositionFix(
            LOCATED, reason, told_apart(matches, used), pose, *figures, whole.sun, BY_GROUND
        )

    def if_here(self, searched: Mask, area: SearchArea) -> float:
        """log10 of the false alarms if `SHARE_IF_HERE` of the points that could be looked for agreed."""
        gate = math.pi * self.tolerance_px**2
        chance = np.minimum(1.0, gate / (2.0 * area.reach_px[searched] + 1.0) ** 2)
        least = -(-len(self.photo.sensor.corrections) // 2)
        agrees = np.arange(len(chance)) < SHARE_IF_HERE * len(chance)
        if agrees.sum() <= least:
            return 0.0
        return log10_false_alarms(np.sort(chance)[::-1], agrees, least)

    def judged(self, matches: Matches, pose: Pose, score: Consensus) -> PositionFix:
        """The verdict on a pose that is no chance."""
        figures = (score.log10_false_alarms, score.rival_log10)
        if far := self.too_far(pose):
            return PositionFix(CANNOT_SAY, f"the points agree, but {far}", matches, None, *figures)
        sun = self.sun(matches, pose) if self.options.check_sun else None
        if sun is not None and not sun.fits:
            return PositionFix(CANNOT_SAY, sun.complaint, matches, None, *figures, sun)
        if sun is not None and sun.doubt_px > 0.0:
            pose = self.solution(matches, pose.used, sun.doubt_px)
        reason = (
            f"{pose.used.sum()} of {len(matches)} points agree; "
            f"the number of false alarms is 10^{score.log10_false_alarms:.0f}"
        )
        return PositionFix(LOCATED, reason, matches, pose, *figures, sun)

    def too_far(self, pose: Pose) -> str:
        """What speaks against a correction that is larger than the stated uncertainty allows; empty where it is not."""
        sigmas = self.uncertainty.sigmas(self.photo.sensor)
        off = float(np.abs(pose.correction[pose.solved] / sigmas[pose.solved]).max(initial=0.0))
        if off <= self.options.most_sigmas:
            return ""
        return f"the place is {off:.1f} of the stated sigmas away; state a larger uncertainty if it may be there"

    def sun(self, matches: Matches, pose: Pose) -> SunCheck:
        rows = matches.point[pose.used]
        offset = matches.found_px[pose.used] - pose.sensor.project(self.catalog.position_mcmf[rows])
        return check_points(
            self.catalog,
            self.corrected(pose),
            self.model,
            rows,
            offset,
            self.options.criteria,
            1.0 / pose.overlap,
            self.options.sun_reach_px * self.factor,
        )


def told_apart(matches: Matches, agrees: Mask) -> Matches:
    """Those found that do not agree are inconsistent."""
    code = np.where(matches.found & ~agrees, CODE["inconsistent"], matches.code)
    return replace(matches, code=code.astype(np.uint8))


def _counted(matches: Matches) -> str:
    """What became of the points, as text: ``12 found, 30 not lit``."""
    return ", ".join(f"{count} {reason}" for reason, count in matches.counts().items())
