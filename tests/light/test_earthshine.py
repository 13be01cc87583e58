"""The Earth as a light source: comparison with NASA's tables, Meeus' textbook and published
magnitudes.
"""

import datetime as dt
import math

import numpy as np
import pytest
from helpers import twins_earth
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.approximations import APPROXIMATIONS
from lcp_catalog.constants import ASTRONOMICAL_UNIT_M, MOON_RADIUS_M
from lcp_catalog.ephemeris.times import instants
from lcp_catalog.errors import SunError
from lcp_catalog.geometry.frames import EnuFrame, central_angle_deg, lonlat_to_mcmf, mcmf_to_lonlat
from lcp_catalog.light.sources import (
    EARTH_ALBEDO,
    EARTH_RADIUS_M,
    LAST_PHASE_DEG,
    MEAN_DISTANCE_M,
    Earth,
    earth_at,
    earth_over_sun,
    mean_earth,
    phase_function,
)

NASA = [
    # time, sub-Earth longitude and latitude (deg), distance (km), lit share of the Moon (%): NASA SVS, "Moon Phase
    # and Libration, 2024" (mooninfo_2024), DE421
    ("2024-01-01T00:00", 0.041, -4.685, 404634, 78.03),
]
MEEUS_53A = (2448724.5, -1.23, 4.20)  # example 53.a, 1992 April 12, 0h TD: total librations


def sub_earth(earth):
    """Longitude and latitude of the place with the Earth in the zenith, degrees."""
    return mcmf_to_lonlat(earth.position_mcmf_m)[:2]


@pytest.mark.parametrize(("time", "lon", "lat", "distance_km", "_lit"), NASA)
def test_the_sub_earth_point_of_nasas_tables(time, lon, lat, distance_km, _lit):
    earth = earth_at(time)
    assert central_angle_deg(*sub_earth(earth), lon, lat) < 0.01
    found_km = np.linalg.norm(earth.position_mcmf_m) / 1e3
    assert found_km == pytest.approx(distance_km, abs=100.0)  # moon98: 20 km rms, and light time


@pytest.mark.parametrize(("time", "_lon", "_lat", "distance_km", "lit"), NASA)
def test_the_earths_phase_completes_the_moons(time, _lon, _lat, distance_km, lit):
    """The angles of the triangle Sun, Earth, Moon sum to 180 deg; the lit share is (1 + cos i) / 2."""
    moons = math.degrees(math.acos(2 * lit / 100 - 1))
    earth = earth_at(time)
    at_the_sun = math.degrees(
        math.asin(math.sin(math.radians(moons)) * distance_km * 1e3 / ASTRONOMICAL_UNIT_M)
    )
    assert math.degrees(earth.phase_rad()) == pytest.approx(180 - moons - at_the_sun, abs=0.02)


def test_the_textbook_example_of_the_twin():
    """As printed, for the principal axes; the mean-Earth frame differs by a constant rotation."""
    jde, lon, lat = MEEUS_53A
    assert twins_earth.sub_earth(jde, principal=True)[:2] == pytest.approx((lon, lat), abs=0.005)


@settings(max_examples=60)
@given(st.datetimes(dt.datetime(1990, 1, 1), dt.datetime(2050, 1, 1)))
def test_the_plain_theory_agrees(moment):
    jd1, jd2 = instants(moment).terrestrial()
    lon, lat, distance_km = twins_earth.sub_earth(float(jd1[0] + jd2[0]))
    earth = earth_at(moment)
    assert central_angle_deg(*sub_earth(earth), lon, lat) < 0.02
    assert np.linalg.norm(earth.position_mcmf_m) / 1e3 == pytest.approx(distance_km, abs=150.0)


@pytest.mark.parametrize(
    ("r_au", "d_au", "phase_deg", "magnitude"),
    [
        # Mallama and Hilton 2018, test data of the paper's programs, as Skyfield's tests quote them
        (0.983331936476, 1.41317594650699, 8.7897, -3.269),
        (0.983356079811, 0.26526856764726, 4.1369, -6.909),
        # the third of them, 1.122 at 175.69 deg, is beyond the data, where the phase function is extrapolated
    ],
)
def test_published_magnitudes_of_the_earth(r_au, d_au, phase_deg, magnitude):
    """The Earth's irradiance relative to the Sun's at the Earth is 10^(-0.4 (V - V_sun(r))), with
    V_sun = -26.75 of the paper.
    """
    ratio = earth_over_sun(math.radians(phase_deg), d_au * ASTRONOMICAL_UNIT_M)
    sun_at_earth = -26.75 + 5 * math.log10(r_au)
    assert -2.5 * math.log10(ratio) + sun_at_earth == pytest.approx(magnitude, abs=0.006)


def test_the_phase_function_at_published_points():
    """1.568 mag fainter at half phase: -1.060e-3 90 + 2.054e-4 8100."""
    assert phase_function(0.0) == 1.0
    assert -2.5 * math.log10(phase_function(math.pi / 2)) == pytest.approx(1.56834, abs=1e-9)
    angles = np.radians(np.linspace(6.0, 180.0, 200))
    assert (np.diff([phase_function(a) for a in angles]) < 0).all()


def test_the_phase_function_goes_on_smoothly():
    edge, step = math.radians(LAST_PHASE_DEG), 1e-7
    before, here, after = (math.log(phase_function(edge + k * step)) for k in (-1, 0, 1))
    assert after - here == pytest.approx(here - before, rel=1e-4)


def test_the_error_of_the_earths_albedo_is_stated():
    """Robinson 2025 (arXiv:2507.22258), from observed phase curves: geometric albedo 0.242, spherical 0.294, phase integral 1.22.
    And what is extrapolated, beside the parabola continued.
    """
    row = next(one for one in APPROXIMATIONS if one.name == "light of the Earth")
    assert f"{100.0 * (EARTH_ALBEDO / 0.242 - 1.0):.0f} % too bright" in row.bound
    angles = np.radians(np.linspace(0.0, 180.0, 1801))
    bright = np.array([phase_function(a) for a in angles])
    integral = 2.0 * np.trapezoid(bright * np.sin(angles), angles)
    assert integral == pytest.approx(1.22, rel=0.08)
    sent = EARTH_ALBEDO * integral
    assert pytest.approx(row.error.value, abs=0.5) == 100.0 * (sent / 0.294 - 1.0)
    assert f"{sent:.2f} of the light is sent back" in row.bound
    assert f"measured: {100.0 * (sent / 0.294 - 1.0):.0f} % too much" in row.bound
    last = math.radians(LAST_PHASE_DEG)
    assert 5e-7 < earth_over_sun(last, MEAN_DISTANCE_M) < 6e-7
    parabola = 10.0 ** (-0.4 * (-1.060e-3 * 180.0 + 2.054e-4 * 180.0**2))
    assert bright[-1] == pytest.approx(parabola, rel=0.02)
    nearest, furthest = (MEAN_DISTANCE_M / (1e6 * d) for d in (356.5, 406.7))  # perigee, apogee
    assert f"{100 * (furthest**2 - 1):.0f} to {100 * (nearest**2 - 1):.0f} %" in row.bound
    for sun_deg, share in ((0.5, 0.3), (5.0, 0.03), (10.0, 0.013)):
        # the Earth opposite the Sun at any elevation; of the light, what a smaller albedo takes away
        up = np.radians(np.linspace(0.0, 180.0 - sun_deg, 500))
        light = [
            earth_over_sun(a + math.radians(sun_deg), MEAN_DISTANCE_M) * math.sin(a) for a in up
        ]
        most = 100.0 * max(light) / math.sin(math.radians(sun_deg)) * (1.0 - 0.242 / EARTH_ALBEDO)
        assert most == pytest.approx(share, rel=0.08)


def test_the_full_earth_gives_a_ten_thousandth_of_the_sun():
    """Published: about 16 lx of 128 to 137 klx; p (R / d)^2 = 0.434 (6371 / 384400)^2."""
    ratio = earth_over_sun(0.0, MEAN_DISTANCE_M)
    assert ratio == pytest.approx(0.434 * (6371 / 384400) ** 2, rel=1e-12)
    assert 14.0 < ratio * 128e3 < ratio * 137e3 < 18.0


def test_the_mean_earth_hangs_over_the_middle():
    earth = mean_earth([1.0, 0.0, 0.0])  # the Sun over the near side: a new Earth
    assert sub_earth(earth) == (0.0, 0.0)
    assert math.degrees(earth.phase_rad()) == pytest.approx(180.0)
    full = mean_earth([-1.0, 0.0, 0.0]).source(EnuFrame(0.0, 0.0))
    assert full.direction.vector == pytest.approx([0.0, 0.0, 1.0])
    distance = MEAN_DISTANCE_M - MOON_RADIUS_M
    assert full.irradiance == pytest.approx(EARTH_ALBEDO * (EARTH_RADIUS_M / distance) ** 2)


@pytest.mark.parametrize(("lon", "lat"), [(0.0, 60.0), (40.0, -10.0), (90.0, 0.0), (180.0, 0.0)])
def test_the_earth_stands_where_a_place_sees_it(lon, lat):
    """Azimuth and elevation by spherical trigonometry, including parallax."""
    earth = Earth(lonlat_to_mcmf(5.0, -3.0, 370e6 - MOON_RADIUS_M), np.array([0.0, 1.0, 0.0]))
    source = earth.source(EnuFrame(lon, lat), as_disc=True)
    away = math.radians(float(central_angle_deg(lon, lat, 5.0, -3.0)))
    distance = math.sqrt(370e6**2 + MOON_RADIUS_M**2 - 2 * 370e6 * MOON_RADIUS_M * math.cos(away))
    elevation = math.asin((370e6 * math.cos(away) - MOON_RADIUS_M) / distance)
    assert source.direction.elevation_rad == pytest.approx(elevation, abs=1e-12)
    assert source.disc.radius_rad == pytest.approx(math.asin(EARTH_RADIUS_M / distance))
    if lat == -10.0:  # the Earth is west and a little north of there
        assert source.direction.vector[0] < 0.0 < source.direction.vector[1]


def test_the_suns_distance_from_place_and_earth_counts():
    """Irradiance is relative to the Sun's at the place, which may be nearer to the Sun than the
    Earth is.
    """
    towards = np.array([1.0, 0.0, 0.0])
    position = np.array([-MEAN_DISTANCE_M, 0.0, 0.0])
    near = Earth(position, towards, ASTRONOMICAL_UNIT_M).source(EnuFrame(180.0, 0.0))
    far = Earth(position, towards).source(EnuFrame(180.0, 0.0))
    expected = (
        (ASTRONOMICAL_UNIT_M + MOON_RADIUS_M) / (ASTRONOMICAL_UNIT_M + MEAN_DISTANCE_M)
    ) ** 2
    assert near.irradiance / far.irradiance == pytest.approx(expected, rel=1e-9)


def test_invalid_times():
    with pytest.raises(SunError):
        earth_at("yesterday")
