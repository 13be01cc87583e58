"""Angles of a circle brought into one turn: longitudes, azimuths and their differences, in degrees."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from ..arrays import Array

Angle = TypeVar("Angle", float, Array)


def turned_deg(angle_deg: Angle) -> Angle:
    """Angles in 0 <= angle < 360. A tiny negative angle, of which ``% 360`` rounds to 360, gives 0.

    >>> turned_deg(-90.0), turned_deg(-1e-17)
    (270.0, 0.0)
    """
    turned = angle_deg % 360.0
    if isinstance(turned, float):
        return 0.0 if turned >= 360.0 else turned
    return np.where(turned >= 360.0, 0.0, turned)


def wrapped_deg(angle_deg: Angle) -> Angle:
    """Angles in -180 <= angle < 180, such as the difference of two longitudes the shorter way around.

    >>> wrapped_deg(190.0), wrapped_deg(180.0)
    (-170.0, -180.0)
    """
    return turned_deg(angle_deg + 180.0) - 180.0
