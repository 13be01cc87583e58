"""A slow, simple twin of the Sun over the Moon: Meeus, Astronomical Algorithms, 2nd edition,
chapters 25 (Sun), 47 (Moon, its larger terms) and 53 (optical and physical librations).

Independent theories of low precision: no series, rotation model or code is shared with
`lcp_catalog.ephemeris.solar_position`. Degrees; accurate to about 0.01 deg.
"""

from __future__ import annotations

import math

AU_KM = 149_597_870.7


def sin(deg: float) -> float:
    return math.sin(math.radians(deg))


def cos(deg: float) -> float:
    return math.cos(math.radians(deg))


def polynomial(t: float, *coefficients: float) -> float:
    return sum(c * t**power for power, c in enumerate(coefficients))


def sun(t: float) -> tuple[float, float]:
    """Longitude of the mean equinox of date (aberration included) and distance in au; chapter 25."""
    longitude = polynomial(t, 280.46646, 36000.76983, 0.0003032)
    anomaly = polynomial(t, 357.52911, 35999.05029, -0.0001537)
    e = polynomial(t, 0.016708634, -0.000042037, -0.0000001267)
    centre = (
        polynomial(t, 1.914602, -0.004817, -0.000014) * sin(anomaly)
        + polynomial(t, 0.019993, -0.000101) * sin(2 * anomaly)
        + 0.000289 * sin(3 * anomaly)
    )
    distance = 1.000001018 * (1 - e * e) / (1 + e * cos(anomaly + centre))
    return longitude + centre - 0.00569, distance


def arguments(t: float) -> tuple[float, float, float, float, float, float]:
    """L', D, M, M', F and the node of the Moon's orbit; chapter 47."""
    return (
        polynomial(t, 218.3164477, 481267.88123421, -0.0015786, 1 / 538841, -1 / 65194000),
        polynomial(t, 297.8501921, 445267.1114034, -0.0018819, 1 / 545868, -1 / 113065000),
        polynomial(t, 357.5291092, 35999.0502909, -0.0001536, 1 / 24490000),
        polynomial(t, 134.9633964, 477198.8675055, 0.0087414, 1 / 69699, -1 / 14712000),
        polynomial(t, 93.2720950, 483202.0175233, -0.0036539, -1 / 3526000, 1 / 863310000),
        polynomial(t, 125.0445479, -1934.1362891, 0.0020754, 1 / 467441, -1 / 60616000),
    )


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


def physical(t: float, principal: bool) -> tuple[float, float, float]:
    """Librations tau, rho and sigma; chapter 53. As printed they refer to the principal axes: the
    pair -0.02245 sin F, +0.02244 cos F is the constant turn by 0.0224 deg about y (79 arcsec in
    DE421's frame kernel) that the mean-Earth frame does not have.
    """
    pair = 1.0 if principal else 0.0
    _, d, m, m1, f, node = arguments(t)
    k1, k2 = 119.75 + 131.849 * t, 72.56 + 20.186 * t
    e = polynomial(t, 1.0, -0.002516, -0.0000074)
    rho = (
        -0.02752 * cos(m1)
        - pair * 0.02245 * sin(f)
        + 0.00684 * cos(m1 - 2 * f)
        - 0.00293 * cos(2 * f)
        - 0.00085 * cos(2 * f - 2 * d)
        - 0.00054 * cos(m1 - 2 * d)
    )
    sigma = (
        -0.02816 * sin(m1)
        + pair * 0.02244 * cos(f)
        - 0.00682 * sin(m1 - 2 * f)
        - 0.00279 * sin(2 * f)
        - 0.00083 * sin(2 * f - 2 * d)
        + 0.00069 * sin(m1 - 2 * d)
        + 0.00040 * cos(m1 + f)
    )
    tau = (
        0.02520 * e * sin(m)
        + 0.00473 * sin(2 * m1 - 2 * f)
        - 0.00467 * sin(m1)
        + 0.00396 * sin(k1)
        + 0.00276 * sin(2 * m1 - 2 * d)
        + 0.00196 * sin(node)
        - 0.00183 * cos(m1 - f)
        + 0.00115 * sin(m1 - 2 * d)
        - 0.00096 * sin(m1 - d)
        + 0.00046 * sin(2 * f - 2 * d)
        + 0.00023 * sin(k2)
    )
    return tau, rho, sigma


def subsolar(jde: float, principal: bool = False) -> tuple[float, float, float]:
    """Selenographic longitude (0..360) and latitude of the Sun, and the Moon's distance from it in
    au, at a Julian ephemeris day.
    """
    t = (jde - 2451545.0) / 36525.0
    sun_longitude, sun_au = sun(t)
    moon_longitude, moon_latitude, moon_km = moon(t)
    ratio = moon_km / (sun_au * AU_KM)
    elongation = sun_longitude - moon_longitude
    longitude = sun_longitude + 180 + math.degrees(ratio * cos(moon_latitude) * sin(elongation))
    latitude = ratio * moon_latitude
    *_, f, node = arguments(t)
    w, tilt = longitude - node, 1.54242
    a = math.degrees(
        math.atan2(
            sin(w) * cos(latitude) * cos(tilt) - sin(latitude) * sin(tilt),
            cos(w) * cos(latitude),
        )
    )
    b = math.degrees(math.asin(-sin(w) * cos(latitude) * sin(tilt) - sin(latitude) * cos(tilt)))
    tau, rho, sigma = physical(t, principal)
    lon = a - f - tau + (rho * cos(a) + sigma * sin(a)) * math.tan(math.radians(b))
    distance = sun_au * (1 - ratio * cos(moon_latitude) * cos(elongation))
    return lon % 360.0, b + sigma * cos(a) - rho * sin(a), distance
