"""The scene plan of a render on the plain sphere that was asked for (`--surface sphere`).

What relief would do is left out, and without heights nothing but the Moon's own extremes bounds it.
"""

from __future__ import annotations

import math

from ..constants import HIGHEST_M, LOWEST_M
from ..light.solar_disc import SHARE_RMS
from ..light.sources import Lighting
from ..photometry.law_choice import Choice
from . import decisions
from .decisions import Decision
from .plan import ScenePlan


def sphere_plan(
    light: Lighting, choice: Choice, shift_px: float, half_m: float, albedo: Decision | None
) -> ScenePlan:
    """``shift_px``: by how many pixels the Moon's highest ground would be shifted; ``half_m``: from
    the middle of what is drawn to its farthest point.
    """
    return ScenePlan(
        cast_shadows=_cast_shadows(),
        occlusion=_occlusion(),
        perspective=Decision(
            decisions.PERSPECTIVE, True, "a direction a point", 0.0, decisions.PERSPECTIVE_UNIT
        ),
        solar_disc=_solar_disc(light),
        relief=_relief(shift_px),
        float_width=Decision("float width", True, "float64 throughout", 0.0, "rad of a normal"),
        reflectance=decisions.reflectance(choice),
        others=(_curvature(), *decisions.always(half_m)[1:], albedo or decisions.albedo()),
    )


def _curvature() -> Decision:
    return Decision("curvature", True, "the surface is the sphere itself", 0.0, "m")


def _cast_shadows() -> Decision:
    reason = "the plain sphere: its own night side is dark, and relief casts no shadow"
    return Decision("cast shadows", False, reason, None, "share of nodes")


def _occlusion() -> Decision:
    reason = "the plain sphere: what lies behind its limb is hidden, exactly; relief hides nothing"
    return Decision("occlusion", False, reason, None, "share of nodes")


def _solar_disc(light: Lighting) -> Decision:
    effect, unit = "solar disc", "share of the disc"
    if light.first.disc is None:
        return Decision(effect, False, "a point Sun", 1.0, unit)
    reason = "its share above each point's level horizon, and that part's cosine of incidence: closed forms"
    return Decision(effect, True, reason, SHARE_RMS["reference"], unit)


def _relief(shift_px: float) -> Decision:
    reason = (
        f"the plain sphere, as asked; the Moon's ground lies {LOWEST_M / 1e3:g} to "
        f"{HIGHEST_M / 1e3:g} km off it"
    )
    if not math.isfinite(shift_px):
        return Decision("relief", False, reason, None, "pixels")
    reason += f", which shifts it by up to {shift_px:.2g} pixels"
    return Decision("relief", False, reason, shift_px, "pixels")
