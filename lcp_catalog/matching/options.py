"""How `locate` searches."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ..cameras.sensor import Uncertainty
from .point_search import Criteria


@dataclass(frozen=True)
class Options:
    """Settings of the search. Pixels are those of the searched image, which may be a reduced one
    (`point_choice.working_image`).
    """

    criteria: Criteria = field(default_factory=Criteria)
    tolerance_px: float = 1.0  # of a match, in addition to 3 sigma of its own
    sigmas: float = 3.0  # reach of the search in the stated uncertainty
    least_reach_px: float = 16.0  # least reach, so that a wrong image can fail to agree
    most_reach_px: float = 64.0  # beyond, a coarse offset of the whole image is found first
    common_px: float = 0.0  # 1 sigma of an error common to all matches
    most_first: int = 400  # points of the first search; if these do not agree, all are searched
    second_reach_px: float = 6.0  # with the corrected sensor
    passes: int = 4
    most_sigmas: float = 4.0  # largest correction of the given sensor
    check_sun: bool = True
    whole_sun_check: bool = False  # also where a glance leaves no doubt (`MatchedPoints.glance`)
    sun_reach_px: float = 3.0


OPTIONS = Options()
"""How `locate` searches by default."""

FAINT = Options(tolerance_px=1.5, criteria=Criteria(max_back_px=3.0, max_false_match=1.0))
"""For low-contrast terrain: accept weak matches and rely on their mutual agreement, whose number of
false alarms does not depend on the quality of single matches.
"""

USUAL = Uncertainty(position_m=1000.0, attitude_rad=math.radians(0.1))
"""Uncertainty of a camera of which none is stated."""
