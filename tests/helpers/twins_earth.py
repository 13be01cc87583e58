"""Independent computation of the Earth's position over the Moon: Meeus, Astronomical Algorithms,
2nd edition, chapters 47 (the Moon's position by its larger terms) and 53 (librations). Degrees;
accurate to about 0.01 deg.
"""

from __future__ import annotations

import math

from .twins_sun import arguments, cos, moon, physical, sin


def sub_earth(jde: float, principal: bool = False) -> tuple[float, float, float]:
    """Selenographic longitude and latitude of the Earth, and its distance in km, at a Julian
    ephemeris day; ``principal`` as in `twins_sun.physical`.
    """
    t = (jde - 2451545.0) / 36525.0
    longitude, latitude, distance = moon(t)
    *_, f, node = arguments(t)
    w, tilt = longitude - node, 1.54242
    y = sin(w) * cos(latitude) * cos(tilt) - sin(latitude) * sin(tilt)
    a = math.degrees(math.atan2(y, cos(w) * cos(latitude)))
    b = math.degrees(math.asin(-sin(w) * cos(latitude) * sin(tilt) - sin(latitude) * cos(tilt)))
    tau, rho, sigma = physical(t, principal)
    lon = a - f - tau + (rho * cos(a) + sigma * sin(a)) * math.tan(math.radians(b))
    return (lon + 180.0) % 360.0 - 180.0, b + sigma * cos(a) - rho * sin(a), distance
