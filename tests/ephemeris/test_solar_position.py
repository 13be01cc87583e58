"""The Sun, compared with published values and spherical geometry."""

import datetime as dt

import numpy as np
import pytest
from helpers import twins_sun
from helpers.subsolar import subsolar_point
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.constants import SUBSOLAR_LATITUDE_MAX_DEG
from lcp_catalog.ephemeris import solar_position
from lcp_catalog.ephemeris.times import instant_range, instants
from lcp_catalog.errors import SunError
from lcp_catalog.geometry.frames import (
    EnuFrame,
    azimuth_elevation,
    central_angle_deg,
)


def test_subsolar_point_of_the_facts():
    # shared facts: DE421 mean-Earth frame, 2024-01-01 00:00 UT; the series is good to 0.0042 deg
    lon, lat = subsolar_point("2024-01-01T00:00:00")
    assert lon - 360.0 == pytest.approx(-55.867, abs=0.0042)
    assert lat == pytest.approx(-1.554, abs=0.0042)


def test_subsolar_point_at_eclipses():
    """In the middle of a solar eclipse the Sun is over the far side of the Moon."""
    # NASA eclipse catalogue: total solar 2017-08-21 18:26 UT, total lunar 2018-07-27 20:22 UT.
    # The Earth's libration in longitude is at most 8 deg.
    far, _ = subsolar_point("2017-08-21T18:26:00Z")
    near, _ = subsolar_point("2018-07-27T20:22:00Z")
    assert abs(far - 180.0) < 8.0
    assert min(near, 360.0 - near) < 8.0


# Longitude and latitude of the subsolar point and the Sun's distance in au, as SPICE (LT+S) had them
# when images were prepared: the Sun's position and the body's rotation of DOI-USGS/ale's and
# DOI-USGS/usgscsm's sensor descriptions (public domain) and of ISIS cubes, multiplied. UTC from their
# ephemeris time. Mean-Earth frame, DE421 (the last: DE403/DE405; it is line AS15-M-0299 of the table of Sun
# positions of NASA's PhotometryTK, to all its digits). They carry 1e-7 deg; the IAU series decides.
MEAN_EARTH = [
    ("1971-08-01T14:58:03.282", 59.63296, 0.20637, 1.0160495),  # Apollo 15 Metric AS15-M-1450
    ("2009-07-30T12:21:05.169", 77.78431, -0.20330, 1.0159842),  # LROC NAC M103595705L, ISIS
    ("2009-07-30T12:20:38.184", 77.78812, -0.20329, 1.0159841),  # the same, its first line
    ("2009-09-11T11:56:51.205", 273.10866, -1.19379, 1.0069467),  # LROC NAC, usgscsm
    ("2009-09-15T07:27:49.251", 226.54372, -1.24970, 1.0039697),  # LROC WAC 0000a1c4
    ("2010-02-04T11:44:41.512", 296.10447, 0.69445, 0.9866133),  # LROC WAC, usgscsm
    ("2010-11-09T13:06:46.192", 143.60716, -1.12406, 0.9886558),  # LROC NAC M143947267L, ISIS
    ("1971-07-31T01:25:52.175", 78.73110, 0.24096, 1.0154763),  # Apollo 15 Metric AS15-M-0299
]
# The same with IAU_MOON, the frame whose series is used here.
IAU_MOON = [
    ("2009-04-05T20:09:53.639", 50.64684, 1.44738, 1.0022842),  # Kaguya TC
    ("2025-11-09T11:08:35.886", 311.69082, -1.36415, 0.9919092),  # Chandrayaan-2 OHRC
    ("2025-12-20T09:22:07.160", 173.73382, -1.50846, 0.9812098),  # Chandrayaan-2 TMC-2
]
# NASA's Scientific Visualization Studio, Moon Phase and Libration 2020, 2021, 2022, 2024 (DE421,
# mean-Earth): Slon, Slat at hours UT.
SVS = [
    ("2020-01-01T00:00", 114.557, -0.045),
    ("2020-01-03T12:00", 84.148, -0.096),
    ("2020-01-06T12:00", 47.707, -0.167),
    ("2020-12-28T12:00", 15.392, -0.465),
    ("2020-12-30T00:00", -2.801, -0.508),
    ("2021-01-01T00:00", -27.058, -0.567),
    ("2021-04-19T00:00", 98.070, -1.101),
    ("2021-04-20T12:00", 79.768, -1.070),
    ("2021-04-24T00:00", 37.116, -0.987),
    ("2022-09-10T00:00", 9.592, 1.306),
    ("2022-09-12T12:00", -20.837, 1.267),
    ("2022-09-15T00:00", -51.284, 1.230),
    ("2022-12-28T12:00", 116.055, -1.263),
    ("2022-12-30T00:00", 97.808, -1.299),
    ("2022-12-31T23:00", 74.007, -1.347),
    ("2024-01-01T00:00", -55.867, -1.554),
]


def off_deg(time, lon, lat):
    """Angle between the subsolar point of the library and a given one."""
    return float(central_angle_deg(*subsolar_point(time), lon, lat))


def test_the_mean_earth_sun_of_spice():
    for time, lon, lat, distance_au in MEAN_EARTH:
        assert off_deg(time, lon, lat) < solar_position.DIRECTION_ERROR_DEG, time
        assert solar_position.apparent_sun(time)[1][0] == pytest.approx(distance_au, abs=2e-7), time


def test_the_iau_sun_of_spice_to_its_last_digit():
    """Aberration is 0.0057 deg, light time 0.0000015 deg: only the apparent Sun of SPICE agrees."""
    for time, lon, lat, distance_au in IAU_MOON:
        assert off_deg(time, lon, lat) < 1.5e-5, time  # five decimals are given
        assert solar_position.apparent_sun(time)[1][0] == pytest.approx(distance_au, abs=2e-7), time


def test_the_hours_of_nasas_tables():
    for row in SVS:
        assert off_deg(*row) < solar_position.DIRECTION_ERROR_DEG, row


def test_the_textbook_example_of_the_twin():
    # Meeus, example 53.a: 1992 April 12, 0h TD: the subsolar point is 67.89, 1.46
    lon, lat, _ = twins_sun.subsolar(2448724.5, principal=True)
    assert (round(lon, 2), round(lat, 2)) == (67.89, 1.46)
    time = "1992-04-11T23:59:01.816"  # TD - UTC was 58.184 s
    mean_earth = twins_sun.subsolar(
        2448724.5
    )  # its printed figures are those of the principal axes
    assert subsolar_point(time) == pytest.approx(mean_earth[:2], abs=0.005)


@given(st.datetimes(dt.datetime(1960, 1, 1), dt.datetime(2090, 1, 1)))
def test_the_plain_theory_agrees(moment):
    when = instants(moment)
    lon, lat, distance_au = twins_sun.subsolar(float(np.sum(when.terrestrial())))
    directions, ours_au = solar_position.apparent_sun(when)
    assert off_deg(moment, lon, lat) < 0.0125
    assert ours_au[0] == pytest.approx(distance_au, abs=1e-4)
    assert np.linalg.norm(directions[0]) == pytest.approx(1.0, abs=1e-14)


def test_perihelion_and_aphelion():
    # Astronomical Almanac 2024: perihelion January 3, 0.9833 au; aphelion July 5, 1.0167 au. The
    # Moon is within 0.00271 au of the Earth; at new moon (December 30, 2024, 22:27; 0.9834 au) nearer.
    year = solar_position.apparent_sun(instant_range("2024-01-01", "2024-12-31", 21600.0))[1]
    assert 0.9833 - 0.00272 < year.min() < 0.9833
    assert 1.0167 < year.max() < 1.0167 + 0.00272
    new_moon = solar_position.apparent_sun("2024-12-30T22:27")[1][0]
    assert new_moon == pytest.approx(0.98336 - 0.00257, abs=2e-4)


def test_many_instants_are_each_as_alone():
    when = instant_range("1971-01-01", "2071-01-01", 86400.0 * 731.3)
    directions, distances = solar_position.apparent_sun(when)
    assert len(directions) == len(when) > 40
    for k, label in enumerate(when.labels()):
        alone, distance = solar_position.apparent_sun(label)
        assert np.array_equal(alone[0], directions[k])
        assert distance[0] == distances[k]
        assert np.array_equal(solar_position.sun_direction_at(label), directions[k])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("time", ["1900-01-01", "1955-05-05", "2099-12-31T23:59:59"])
def test_all_years_of_the_series_are_quiet(time):
    assert np.linalg.norm(solar_position.sun_direction_at(time)) == pytest.approx(1.0)


@pytest.mark.parametrize("time", ["1899-12-31", "2100-01-01", "0001-01-01T00:00:00+14:00"])
def test_no_series_no_sun(time):
    with pytest.raises(SunError, match="1900-2099"):
        subsolar_point(time)


def test_a_leap_second_moves_the_sun_by_a_second():
    lons = [
        subsolar_point(time)[0]
        for time in ("2016-12-31T23:59:59", "2016-12-31T23:59:60", "2017-01-01")
    ]
    second_deg = 360.0 / 29.530589 / 86400.0
    assert np.diff(lons) == pytest.approx([-second_deg] * 2, rel=0.02)


@pytest.mark.slow
def test_a_lunation_and_the_latitude_bound():
    start = dt.datetime(1995, 3, 1)
    points = [subsolar_point(start + dt.timedelta(days=11.3 * k)) for k in range(1500)]
    lats = np.array([lat for _, lat in points])
    assert np.abs(lats).max() < SUBSOLAR_LATITUDE_MAX_DEG
    assert np.abs(lats).max() > SUBSOLAR_LATITUDE_MAX_DEG - 0.05
    turned = np.unwrap(np.radians([lon for lon, _ in points]))
    days_per_turn = 2 * np.pi * 11.3 * 1499 / (turned[0] - turned[-1])
    assert days_per_turn == pytest.approx(29.5306, abs=0.003)  # mean synodic month


def test_zones_are_respected():
    east = subsolar_point("2024-01-01T03:00:00+03:00")
    assert east == subsolar_point("2024-01-01") == subsolar_point(dt.datetime(2024, 1, 1))


@pytest.mark.parametrize("time", ["yesterday", "2024-13-01", ""])
def test_invalid_times(time):
    with pytest.raises(SunError, match="invalid time"):
        subsolar_point(time)


def test_rotation_is_one_and_right_handed():
    rotation = solar_position.lunar_rotation(1234.5)
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert np.array_equal(solar_position.lunar_rotation([1.0, 1234.5])[1], rotation)


@pytest.mark.parametrize(("lon", "lat"), [(0, 0), (120, -1.5), (300, 1.5)])
def test_three_ways_to_the_same_direction(lon, lat):
    frame = EnuFrame(lon + 40.0, 33.0)
    subsolar = solar_position.direction_from_subsolar(lon, lat)
    far = solar_position.direction_from_position(frame, subsolar * 1e15)
    azimuth, elevation = azimuth_elevation(frame.direction_from_mcmf(subsolar))
    angles = solar_position.direction_from_angles(frame, float(azimuth), float(elevation))
    assert np.allclose(far, subsolar, atol=3e-9)
    assert np.allclose(angles, subsolar, atol=1e-15)


def test_elevation_and_azimuth_at_the_equator():
    frame = EnuFrame(10.0, 0.0)
    east = frame.direction_from_mcmf(solar_position.direction_from_subsolar(70.0, 0.0))
    assert azimuth_elevation(east)[0] == pytest.approx(90.0)
    assert azimuth_elevation(east)[1] == pytest.approx(30.0)


@pytest.mark.parametrize(
    "call",
    [
        lambda: solar_position.direction_from_subsolar(0.0, 91.0),
        lambda: solar_position.direction_from_subsolar(float("nan"), 0.0),
        lambda: solar_position.direction_from_angles(EnuFrame(0, 0), 10.0, 95.0),
        lambda: solar_position.direction_from_position(EnuFrame(0, 0), [1.0, 2.0, 3.0]),
    ],
)
def test_refused_suns(call):
    with pytest.raises(SunError):
        call()
