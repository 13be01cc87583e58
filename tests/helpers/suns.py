"""Synthetic checks of the Sun."""

from __future__ import annotations

from lcp_catalog.matching.sun_verdict import FAR_TURNS_DEG, TURNS_DEG, FarSunCheck, SunCheck


def light(
    share: float,
    gain: float = 0.03,
    gain_z: float = 0.1,
    points: int = 50,
    independent: float = 25.0,
) -> SunCheck:
    """A check with one turned Sun, and one lowered Sun with the same gain in z less 0.01."""
    return SunCheck(
        points,
        independent,
        0.8,
        TURNS_DEG,
        (0.7, 0.8 + gain, 0.8, 0.7),
        (-0.2, gain_z, gain_z - 0.01, -0.2),
        (0.1, share, share, 0.1),
        (0.9, 0.4, 0.3, 0.8),
    )


def far_light(
    share: float, gain: float = 0.03, gain_z: float = 0.1, points: int = 50
) -> FarSunCheck:
    """The same by Suns turned far: the second one is that of `light`."""
    near = light(share, gain, gain_z, points)
    return FarSunCheck(**vars(near) | {"turns_deg": FAR_TURNS_DEG})
