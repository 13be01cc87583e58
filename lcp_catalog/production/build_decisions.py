"""Decisions of a scene plan that only a build has, with what they were measured to change in a catalogue."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..rendering.decisions import Decision


def scattered_of_matches(node: Decision) -> Decision:
    """The decision about scattered light for matches of patches, from that for single nodes: what it was measured to change."""
    if node.modelled:
        return node
    return replace(
        node,
        reason=f"{node.reason}; that is the bound of one node: on the sample it changes 0.3 to 1.0 % of the usable "
        "conditions, matches by 0.0003 cells (median), in 18 to 36 times the time (measured)",
    )


TURNED_DEG = 0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 12.0, 15.0, 20.0
TURNED = 0.047, 0.041, 0.041, 0.028, 0.023, 0.0085, 0.0061, 0.0042, 0.0007, 0.0
"""Elevations of the Sun, and the share of the `unshadowed` flags there that are others than under the points' own Suns, for a
tolerance of 0.5 deg (cells of 474 m, the greater of the sample's and, up to 4 deg, of that at 84 N; c167345, ede1714; up to 2
deg 2b1335ac, 2026-11-27; 3 and 15 deg c987a91f, 2026-11-29).
The share is nearly proportional to the tolerance."""

TURNED_MOST = 0.005
"""Share up to which a direction for a whole area needs no remedy."""


def _measured(sun_deg: float) -> str:
    """Whether `TURNED` was measured under such a Sun."""
    lowest = TURNED_DEG[0]
    return "measured" if sun_deg >= lowest else f"extrapolated from {lowest:g} deg"


def turned_flags(
    tolerance_deg: float, own_sun_deg: float, suns_deg: Sequence[float]
) -> tuple[float, float]:
    """The lowest Sun of a grid, degrees, under which an area has one direction, and the share of its
    `unshadowed` flags that changes (`TURNED`).
    """
    lowest_deg = min((deg for deg in suns_deg if deg > own_sun_deg), default=90.0)
    return lowest_deg, float(np.interp(lowest_deg, TURNED_DEG, TURNED)) * tolerance_deg / 0.5


def turned_text(tolerance_deg: float, own_sun_deg: float, suns_deg: Sequence[float]) -> str:
    """`turned_flags` in words; empty for a share that rounds to nothing."""
    others_deg, share = turned_flags(tolerance_deg, own_sun_deg, suns_deg)
    if share <= 0.0005:
        return ""
    return (
        f"about {100.0 * share:.1f} % of the unshadowed flags at {others_deg:g} deg of Sun are others than under the points' "
        f"own Suns ({_measured(others_deg)})"
    )


def of_a_build(
    direction_tolerance_deg: float, own_sun_deg: float, suns_deg: Sequence[float]
) -> tuple[Decision, ...]:
    """Decisions that only a build has; ``suns_deg``: the elevations of its grid."""
    turned = (
        "Sun and view are those of the area's centre, turned to the point's own north in steps of "
        "twice the tolerance"
    )
    if own_sun_deg:
        turned += (
            f"; up to {own_sun_deg:g} deg points near the limit of dependence have their own Sun: there no "
            "unshadowed flag is another than under it (measured)"
        )
    tolerance_deg = direction_tolerance_deg
    _, share = turned_flags(tolerance_deg, own_sun_deg, suns_deg)
    if text := turned_text(tolerance_deg, own_sun_deg, suns_deg):
        turned += f"; {text}"
    if share > TURNED_MOST:
        most = TURNED_MOST * 0.5 / tolerance_deg
        enough = math.ceil(np.interp(most, TURNED[::-1], TURNED_DEG[::-1]))
        turned += (
            f"; at most {100.0 * TURNED_MOST:.1f} % with own Suns up to {enough} deg (`model.own_sun_deg`), in 1.01 (sample) "
            "to 1.5 times (84 N) the time"
        )
    return (
        Decision(
            "dependence", True, "exact rays: patch alone, and in terrain", 0.0, "share of nodes"
        ),
        Decision("one direction per area", True, turned, tolerance_deg, "deg"),
    )
