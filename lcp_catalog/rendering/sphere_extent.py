"""The part of the plain sphere that is rendered: a rectangle of the tangent plane."""

from __future__ import annotations

from dataclasses import dataclass

from ..constants import MOON_RADIUS_M
from ..errors import AreaError
from ..geometry.angles import turned_deg
from ..geometry.frames import EnuFrame

Extent = tuple[float, float, float, float]
"""Least x, greatest x, least y, greatest y in the plane of a frame, metres."""

SIZE_MAX_KM = 4 * MOON_RADIUS_M / 1e3
"""Greatest side of an area: twice the diameter of the Moon."""


@dataclass(frozen=True)
class SphereArea:
    """A rectangle of the tangent plane at a place, up to wider than the Moon; the counterpart of `Area`.
    ``size_km``: east-west, north-south.
    """

    lon_deg: float
    lat_deg: float
    size_km: tuple[float, float]

    def __post_init__(self) -> None:
        if not all(0.0 < side <= SIZE_MAX_KM for side in self.size_km):
            raise AreaError(
                f"a size of {self.size_km[0]:g} x {self.size_km[1]:g} km is not above 0 and at most "
                f"{SIZE_MAX_KM:.0f} km"
            )

    @property
    def frame(self) -> EnuFrame:
        """The frame at its centre, on the sphere."""
        return EnuFrame(turned_deg(self.lon_deg), self.lat_deg)

    @property
    def extent_m(self) -> Extent:
        """Least x, greatest x, least y, greatest y in its frame."""
        east, north = (500.0 * side for side in self.size_km)
        return -east, east, -north, north
