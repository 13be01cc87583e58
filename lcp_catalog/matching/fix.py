"""What `position_fix.locate` answers about an image: the verdict, its reason, the matches and the pose."""

from __future__ import annotations

from dataclasses import dataclass

from .consensus import Consensus
from .joint_offset import JointOffset
from .matches import Matches
from .pose import Pose
from .sun_verdict import SunCheck

LOCATED = "located"
NOT_HERE = "not this place"
CANNOT_SAY = "cannot say"

BY_POINTS = "points"
BY_ALL_POINTS = "the ground as a whole"
"""Basis of a position: single points, or all points together."""


@dataclass(frozen=True, eq=False)
class Fix:
    """Result for one image. ``matches`` are of every point that may be in view; with `LOCATED`
    those marked found are the inliers. ``log10_false_alarms``: of the expected number of solutions
    as good by chance; ``rival_log10``: the same for the best other one.

    Examples
    --------
    >>> fix = lcp.locate(catalog, folder / "AS15-M-0414.png", camera=camera)
    >>> (fix.pose is None) == (fix.verdict != "located")
    True
    """

    verdict: str
    reason: str  # one line
    matches: Matches
    pose: Pose | None = None
    log10_false_alarms: float = 0.0
    rival_log10: float = 0.0
    sun: SunCheck | None = None
    by: str = BY_POINTS  # or `BY_ALL_POINTS`; few points may then be found alone

    def __repr__(self) -> str:
        """The result in short: an image has hundreds of matches."""
        count = f"{self.matches.found.sum()} of {len(self.matches.point)} points found"
        sigma = "" if self.pose is None else f", 1 sigma {self.pose.position_sigma_m:.4g} m"
        doubt = "; its Sun may be wrong (`advice`)" if self.advice else ""
        return f"<Fix: {self.verdict}, {count}{sigma}{doubt}>"

    @property
    def advice(self) -> tuple[str, ...]:
        """A line for each angle of the Sun that may be wrong although the position is given."""
        if self.pose is None or self.sun is None:
            return ()
        return tuple(filter(None, (self.sun.azimuth_advice, self.sun.elevation_advice)))

    @classmethod
    def scored(
        cls,
        verdict: str,
        reason: str,
        matches: Matches,
        score: Consensus | JointOffset,
        pose: Pose | None = None,
        sun: SunCheck | None = None,
    ) -> Fix:
        """The result by an agreement of single points, or by the offset of all of them together."""
        by = BY_ALL_POINTS if isinstance(score, JointOffset) else BY_POINTS
        rarity = score.log10_false_alarms
        return cls(verdict, reason, matches, pose, rarity, score.rival_log10, sun, by)
