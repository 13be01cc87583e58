"""What the decisions of a scene plan cost: the share of the time that each takes, and what switches it."""

from __future__ import annotations

from collections.abc import Mapping

WITHIN = {
    "curvature": "in the heights, which relief counts",
    "float width": "the width of all numbers",
    "perspective": "in the rays of occlusion and the directions of reflectance",
    "other sources": "in cast shadows and reflectance, which count all sources",
    "motion of the Sun": "in all others, each for several directions",
    "Sun over sky": "one factor of the light",
}
"""Where the time of effects without work of their own is counted."""


def priced(
    decision: Mapping[str, object],
    costs: Mapping[str, float] | None,
    switches: Mapping[str, str | None],
    within: Mapping[str, str],
) -> dict[str, object]:
    """A decision (`decisions.Decision` as a dictionary) with its ``switch`` and its ``cost``, the share of the time, which is
    None only with a ``cost_reason``. ``costs``: `stages.shares_of_time`, None: not measured; ``switches``: the parameter or
    field by effect; ``within``: where the time of an effect without any of its own is counted, by effect.
    """
    effect = str(decision["effect"])
    told = {**decision, "switch": switches.get(effect)}
    if costs is None:
        return told | {"cost": None, "cost_reason": "not measured: no image was computed"}
    if effect in costs or not decision["modelled"]:
        return told | {"cost": costs.get(effect, 0.0)}
    where = within.get(effect, "in reflectance")
    return told | {"cost": None, "cost_reason": f"no time of its own: {where}"}
