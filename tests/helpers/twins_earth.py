"""Independent computation of the Earth's position over the Moon: Meeus, Astronomical Algorithms,
2nd edition, chapters 47 (the Moon's position by its larger terms) and 53 (librations). Degrees;
accurate to about 0.01 deg.
"""

from __future__ import annotations

import math

from .twins_sun import arguments, cos, physical, polynomial, sin

# Multiples of D, M, M', F and coefficients of longitude's sine (1e-6 deg) and distance's cosine (m).
# fmt: off
LONGITUDE = [
    (0, 0, 1, 0, 6288774, -20905355), (2, 0, -1, 0, 1274027, -3699111), (2, 0, 0, 0, 658314, -2955968),
    (0, 0, 2, 0, 213618, -569925), (0, 1, 0, 0, -185116, 48888), (0, 0, 0, 2, -114332, -3149),
    (2, 0, -2, 0, 58793, 246158), (2, -1, -1, 0, 57066, -152138), (2, 0, 1, 0, 53322, -170733),
    (2, -1, 0, 0, 45758, -204586), (0, 1, -1, 0, -40923, -129620), (1, 0, 0, 0, -34720, 108743),
    (0, 1, 1, 0, -30383, 104755), (2, 0, 0, -2, 15327, 10321), (0, 0, 1, 2, -12528, 0),
    (0, 0, 1, -2, 10980, 79661), (4, 0, -1, 0, 10675, -34782), (0, 0, 3, 0, 10034, -23210),
    (4, 0, -2, 0, 8548, -21636), (2, 1, -1, 0, -7888, 24208), (2, 1, 0, 0, -6766, 30824),
    (1, 0, -1, 0, -5163, -8379), (1, 1, 0, 0, 4987, -16675), (2, -1, 1, 0, 4036, -12831),
    (2, 0, 2, 0, 3994, -10445), (4, 0, 0, 0, 3861, -11650), (2, 0, -3, 0, 3665, 14403),
    (0, 1, -2, 0, -2689, -7003), (2, 0, -1, 2, -2602, 0), (2, -1, -2, 0, 2390, 10056),
    (1, 0, 1, 0, -2348, 6322), (2, -2, 0, 0, 2236, -9884),
]
LATITUDE = [
    (0, 0, 0, 1, 5128122), (0, 0, 1, 1, 280602), (0, 0, 1, -1, 277693), (2, 0, 0, -1, 173237),
    (2, 0, -1, 1, 55413), (2, 0, -1, -1, 46271), (2, 0, 0, 1, 32573), (0, 0, 2, 1, 17198),
    (2, 0, 1, -1, 9266), (0, 0, 2, -1, 8822), (2, -1, 0, -1, 8216), (2, 0, -2, -1, 4324),
    (2, 0, 1, 1, 4200), (2, 1, 0, -1, -3359), (2, -1, -1, 1, 2463), (2, -1, 0, 1, 2211),
    (2, -1, -1, -1, 2065), (0, 1, -1, -1, -1870), (4, 0, -1, -1, 1828), (0, 1, 0, 1, -1794),
]
# fmt: on


def moon(t: float) -> tuple[float, float, float]:
    """Longitude and latitude of the mean equinox of date, distance in km."""
    mean, d, m, m1, f, _ = arguments(t)
    e = polynomial(t, 1.0, -0.002516, -0.0000074)
    longitude = latitude = distance = 0.0
    for i, j, k, n, sine, cosine in LONGITUDE:
        angle, shrink = i * d + j * m + k * m1 + n * f, e ** abs(j)
        longitude += shrink * sine * sin(angle)
        distance += shrink * cosine * cos(angle)
    for i, j, k, n, sine in LATITUDE:
        latitude += e ** abs(j) * sine * sin(i * d + j * m + k * m1 + n * f)
    return mean + 1e-6 * longitude, 1e-6 * latitude, 385000.56 + 1e-3 * distance


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
