"""The Sun over a place, compared with labels, spherical trigonometry and a sampled disc."""

import math

import numpy as np
import pytest
from helpers.subsolar import subsolar_point
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.constants import ASTRONOMICAL_UNIT_M, MOON_RADIUS_M, SOLAR_RADIUS_RAD
from lcp_catalog.ephemeris import solar_position as sun_table
from lcp_catalog.ephemeris.limb_darkening import VISIBLE
from lcp_catalog.ephemeris.solar_position import DIRECTION_ERROR_DEG
from lcp_catalog.ephemeris.times import instant_range
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.light import solar_disc

PARALLAX_DEG = math.degrees(MOON_RADIUS_M / (0.98 * ASTRONOMICAL_UNIT_M))
longitudes, latitudes = st.floats(-180.0, 360.0), st.floats(-89.9, 89.9)
hours = st.integers(0, 24 * 365 * 60)


def at(place, time):
    """The only record, rounded."""
    return next(sun_table.sun_table(place, time).records())


def moment(hour):
    return np.array(["1990-01-01"], "M8[us]") + np.timedelta64(hour, "h")


def test_the_label_of_a_kaguya_image():
    # KAGUYA_TC1S2B0_01_06691S820E0465: SCENE_CENTER 46.482457 E, 81.988555 S; INCIDENCE_ANGLE 83.460,
    # SOLAR_AZIMUTH_ANGLE 4.187; the middle of CORRECTED_START_TIME and CORRECTED_STOP_TIME
    found = at(EnuFrame(46.482457, -81.988555), "2009-04-05T20:10:08.736")
    assert found["azimuth_deg"] == pytest.approx(4.187, abs=DIRECTION_ERROR_DEG + 0.0005)
    assert 90.0 - found["elevation_deg"] == pytest.approx(83.460, abs=DIRECTION_ERROR_DEG + 0.0005)


def test_the_geometry_of_an_isis_cube():
    # LROC NAC M143947267L: position of the Sun and rotation of its tables (DE421), cut with the
    # sphere in the middle of the image
    found = at(EnuFrame(102.60160278, 35.98004126), "2010-11-09T13:06:46.192")
    assert found["azimuth_deg"] == pytest.approx(124.98865, abs=DIRECTION_ERROR_DEG)
    assert 90.0 - found["elevation_deg"] == pytest.approx(53.19985, abs=DIRECTION_ERROR_DEG)


@given(longitudes, latitudes, hours)
def test_spherical_trigonometry_and_parallax(lon, lat, hour):
    """Zenith angle and azimuth from the triangle of place, pole and subsolar point; the parallax of
    a near Sun from the plane triangle of centre, place and Sun.
    """
    when = moment(hour)
    found = sun_table.sun_table(EnuFrame(lon, lat), when)
    sub_lon, sub_lat = subsolar_point(when[0].item())
    turn, phi, dec = np.radians([sub_lon - lon, lat, sub_lat])
    cosine = np.sin(phi) * np.sin(dec) + np.cos(phi) * np.cos(dec) * np.cos(turn)
    east, north = (
        np.cos(dec) * np.sin(turn),
        np.cos(phi) * np.sin(dec) - np.sin(phi) * np.cos(dec) * np.cos(turn),
    )
    zenith = np.arctan2(np.hypot(east, north), cosine)
    ratio = MOON_RADIUS_M / ASTRONOMICAL_UNIT_M / found.distance_au[0]
    elevation = 90.0 - np.degrees(zenith + ratio * np.sin(zenith))
    assert found.elevation_deg[0] == pytest.approx(elevation, abs=1e-7)
    if np.sin(zenith) > 1e-3:
        azimuth = np.degrees(np.arctan2(east, north))
        assert (found.azimuth_deg[0] - azimuth + 180) % 360 - 180 == pytest.approx(0.0, abs=1e-7)
    assert (found.subsolar_lon[0], found.subsolar_lat[0]) == pytest.approx((sub_lon, sub_lat))


def test_height_lowers_the_sun_by_its_parallax_only():
    low, high = (at(EnuFrame(30.0, 10.0, h), "2024-01-05")["elevation_deg"] for h in (0.0, 1e6))
    assert 0.0 < low - high < PARALLAX_DEG
    under = sun_table.sun_table(EnuFrame(*subsolar_point("2024-01-05")), "2024-01-05")
    over = sun_table.sun_table(EnuFrame(*subsolar_point("2024-01-05"), 1e6), "2024-01-05")
    nearer_m = (under.distance_au[0] - over.distance_au[0]) * ASTRONOMICAL_UNIT_M
    assert nearer_m == pytest.approx(1e6, abs=1.0)
    assert under.elevation_deg[0] == pytest.approx(90.0, abs=1e-5)


def sampled_share(elevation_rad, radius_rad):
    """Share from rings of the disc: the arc of each above the plane by the cosine rule, weighted by
    brightness.
    """
    rho = radius_rad * np.sqrt((np.arange(20000) + 0.5) / 20000)  # of equal area, nearly
    mu = np.sqrt(1.0 - (np.sin(rho) / np.sin(radius_rad)) ** 2)
    light = (VISIBLE.a + VISIBLE.b * mu + VISIBLE.c * mu**2) * np.sin(rho) / rho
    # sin(elevation of a point) = sin(e) cos(rho) + cos(e) sin(rho) cos(turn)
    edge = -np.tan(elevation_rad) / np.tan(rho)
    up = np.arccos(np.clip(edge, -1.0, 1.0)) / np.pi
    return float((light * up).sum() / light.sum())


@given(st.floats(-1.3, 1.3), st.floats(0.0045, 0.0048))
def test_the_share_of_the_disc_against_rings(elevation_radii, radius):
    elevation = elevation_radii * radius
    share = sun_table.share_above_plane(np.array([elevation]), np.array([radius]))[0]
    assert share == pytest.approx(sampled_share(elevation, radius), abs=5e-5)


def test_the_share_is_all_half_or_nothing():
    elevation = np.radians([-90.0, -5.8, -0.2667, 0.0, 0.2667, 5.8, 90.0])
    share = sun_table.share_above_plane(elevation, np.full(7, SOLAR_RADIUS_RAD))
    assert share.tolist() == pytest.approx([0, 0, 0, 0.5, 1, 1, 1], abs=1e-12)
    grid = np.linspace(-0.3, 0.3, 1001)
    rising = sun_table.share_above_plane(np.radians(grid), np.full(1001, SOLAR_RADIUS_RAD))
    assert (np.diff(rising) >= 0).all()
    assert ((rising >= 0) & (rising <= 1)).all()


def test_the_discs_radius():
    table = sun_table.sun_table(EnuFrame(0, 0), instant_range("2024-01-01", "2024-12-31", 86400))
    # Astronomical Almanac: semidiameter at 1 au 959.63 arcsec; the solar radius here is rounded
    assert table.disc_radius_deg * table.distance_au * 3600 == pytest.approx(959.63, abs=0.3)
    other = [solar_disc.radius_at(au * ASTRONOMICAL_UNIT_M) for au in table.distance_au]
    assert np.radians(table.disc_radius_deg) == pytest.approx(np.array(other), rel=1e-12)


@pytest.mark.parametrize("lon", [0.0, 77.0, -120.0, 359.5])
def test_azimuth_at_the_poles(lon):
    """Azimuth increases clockwise seen from above: against the longitudes at the north pole, with
    them at the south pole. It is 0 at the meridian that the table gives.
    """
    time = "2022-09-10T00:00"
    sub_lon, sub_lat = subsolar_point(time)
    for lat, way in ((90.0, -1.0), (-90.0, 1.0)):
        place = EnuFrame(lon, lat)
        zero = sun_table.azimuth_zero_lon(place)
        found = sun_table.sun_table(place, time)
        expected = way * (sub_lon - zero) % 360.0
        assert found.azimuth_deg[0] == pytest.approx(expected, abs=1e-6)
        assert found.elevation_deg[0] == pytest.approx(
            math.copysign(1, lat) * sub_lat, abs=PARALLAX_DEG
        )
        close = sun_table.sun_table(EnuFrame(lon, lat * (1 - 1e-9)), time)
        assert close.azimuth_deg[0] == pytest.approx(found.azimuth_deg[0], abs=1e-5)
        assert any(f"meridian {zero:.10g} deg" in line for line in found.remarks())
        assert sun_table.azimuth_zero_lon(EnuFrame(lon, lat * (1 - 1e-9))) is None


def test_longitudes_that_are_the_same():
    one, two = (at(EnuFrame(lon, 12.0), "2024-03-03T03:03:03") for lon in (359.75, -0.25))
    assert one == two


def test_chunks_do_not_show(monkeypatch):
    when = instant_range("2024-01-01", "2024-01-03", 3600.0)
    whole = sun_table.sun_table(EnuFrame(5.0, -80.0), when)
    monkeypatch.setattr(sun_table, "_CHUNK", 7)
    parts = sun_table.sun_table(EnuFrame(5.0, -80.0), when)
    for name in whole.figures:
        assert np.array_equal(getattr(whole, name), getattr(parts, name))
        assert getattr(whole, name).shape == (49,)


def test_records_are_rounded_within_the_circle():
    place = EnuFrame(5.0, -80.0)
    when = instant_range("2024-01-01", "2024-01-01T01:00", 3600.0)
    n = len(when)
    columns = [np.full(n, value) for value in (359.99999999, -1e-9, 1.0, 360.0, -1e-12, 1.0, 0.3)]
    records = list(sun_table.SunTable(place, when, *columns).records())
    assert len(records) == n
    assert (records[0]["azimuth_deg"], records[0]["subsolar_lon"]) == (0.0, 0.0)
    assert str(records[0]["elevation_deg"]) == str(records[0]["subsolar_lat"]) == "0.0"


def test_remark_for_years_without_a_stated_error():
    for time, said in (("1989-12-31", True), ("1990-01-01", False), ("2051-01-01", True)):
        lines = sun_table.sun_table(EnuFrame(0, 0), time).remarks()
        assert any("outside 1990-2050" in line for line in lines) == said
        assert lines[0].startswith("frame MOON_ME, approximated by the IAU series")
