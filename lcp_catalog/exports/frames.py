"""Moon-fixed frames of exported files: mean Earth, in which catalogues are, and principal axes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..choices import FRAMES
from ..constants import FRAME, MOON_RADIUS_M
from ..errors import ConfigError
from ..geometry.rotations import by_vector

_ARCSECOND = math.radians(1.0 / 3600.0)
_ANGLES = (0.2785, 78.6944, 67.8526)
"""Angles about x, y and z, arcseconds (Park et al. 2021, AJ 161, 105, section 4.8): a position in the
mean-Earth frame of DE421 is Rx(-0.2785") Ry(-78.6944") Rz(-67.8526") times that in the principal
axes of DE440, R being the rotation of the axes, as in SPICE (frame kernel
moon_de440_250416.tf).
"""


@dataclass(frozen=True, eq=False)
class LunarFrame:
    """A Moon-fixed frame. ``from_me`` (3, 3) turns positions in MOON_ME into it; ``meaning`` is one
    line for people; ``spice_name`` and ``spice_id`` are those of NAIF's frame kernels.
    """

    name: str
    meaning: str
    spice_name: str
    spice_id: int
    from_me: Array

    @property
    def crs(self) -> str:
        """CRS of longitude and latitude on the sphere: the code of the IAU, which stands for mean-Earth
        coordinates, or else WKT.
        """
        return "IAU_2015:30100" if self.name == FRAME else _PRINCIPAL_WKT


_PRINCIPAL_WKT = (
    'GEOGCRS["Moon principal axes (DE440) - Sphere / Ocentric",'
    'DATUM["Moon principal axes (DE440) - Sphere",'
    f'ELLIPSOID["Moon (2015) - Sphere",{MOON_RADIUS_M:.0f},0,LENGTHUNIT["metre",1]]],'
    'PRIMEM["Reference Meridian",0,ANGLEUNIT["degree",0.0174532925199433]],'
    "CS[ellipsoidal,2],"
    'AXIS["geodetic latitude (Lat)",north,ORDER[1],ANGLEUNIT["degree",0.0174532925199433]],'
    'AXIS["geodetic longitude (Lon)",east,ORDER[2],ANGLEUNIT["degree",0.0174532925199433]]]'
)


def _turns() -> Array:
    """Rotation of positions from the mean-Earth frame to the principal axes, (3, 3)."""
    about_x, about_y, about_z = (
        by_vector(-angle * _ARCSECOND * axis)
        for angle, axis in zip(_ANGLES, np.eye(3), strict=True)
    )
    return about_z @ about_y @ about_x


def frame_named(name: str) -> LunarFrame:
    """The frame of a name of `choices.FRAMES`; ConfigError for another."""
    if name == FRAME:
        meaning = "Moon-fixed, mean Earth and rotation axis (DE421)"
        return LunarFrame(name, meaning, "MOON_ME_DE421", 31007, np.eye(3))
    if name in FRAMES:
        meaning = "Moon-fixed, principal axes (DE440)"
        return LunarFrame(name, meaning, "MOON_PA_DE440", 31008, _turns())
    raise ConfigError(f"frame {name!r} is not known; choose {' or '.join(FRAMES)}")
