"""The Sun: against published figures, direct spherical geometry and brute force."""

import datetime as dt
import itertools

import numpy as np
import pytest

from lcp_catalog import sun
from lcp_catalog.constants import SOLAR_RADIUS_RAD, SUBSOLAR_LATITUDE_MAX_DEG
from lcp_catalog.errors import SunError
from lcp_catalog.sphere import EnuFrame, azimuth_elevation, direction_enu

LIMIT_DEG = SUBSOLAR_LATITUDE_MAX_DEG + np.degrees(SOLAR_RADIUS_RAD)


def test_subsolar_point_of_the_facts():
    # shared facts: DE421 mean-Earth frame, 2024-01-01 00:00 UT; the series is good to 0.0042 deg
    lon, lat = sun.subsolar_point("2024-01-01T00:00:00")
    assert lon - 360.0 == pytest.approx(-55.867, abs=0.0042)
    assert lat == pytest.approx(-1.554, abs=0.0042)


def test_subsolar_point_at_eclipses():
    """In the middle of a solar eclipse the Earth's far side is behind: the Sun stands over the
    lunar far side.
    """
    # NASA eclipse catalogue: total solar 2017-08-21 18:26 UT, total lunar 2018-07-27 20:22 UT.
    # The Earth's libration in longitude is at most 8 deg.
    far, _ = sun.subsolar_point("2017-08-21T18:26:00Z")
    near, _ = sun.subsolar_point("2018-07-27T20:22:00Z")
    assert abs(far - 180.0) < 8.0
    assert min(near, 360.0 - near) < 8.0


def test_a_lunation_and_the_latitude_bound():
    start = dt.datetime(1995, 3, 1)
    points = [sun.subsolar_point(start + dt.timedelta(days=11.3 * k)) for k in range(1500)]
    lats = np.array([lat for _, lat in points])
    assert np.abs(lats).max() < SUBSOLAR_LATITUDE_MAX_DEG
    assert np.abs(lats).max() > SUBSOLAR_LATITUDE_MAX_DEG - 0.05
    turned = np.unwrap(np.radians([lon for lon, _ in points]))
    days_per_turn = 2 * np.pi * 11.3 * 1499 / (turned[0] - turned[-1])
    assert days_per_turn == pytest.approx(29.5306, abs=0.003)  # mean synodic month


def test_zones_are_respected():
    east = sun.subsolar_point("2024-01-01T03:00:00+03:00")
    assert east == sun.subsolar_point("2024-01-01") == sun.subsolar_point(dt.datetime(2024, 1, 1))


@pytest.mark.parametrize("time", ["yesterday", "2024-13-01", ""])
def test_no_such_time(time):
    with pytest.raises(SunError, match="no such time"):
        sun.subsolar_point(time)


def test_rotation_is_one_and_right_handed():
    rotation = sun.lunar_rotation(1234.5)
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(("lon", "lat"), [(0, 0), (120, -1.5), (300, 1.5)])
def test_three_ways_to_the_same_direction(lon, lat):
    frame = EnuFrame(lon + 40.0, 33.0)
    subsolar = sun.direction_from_subsolar(lon, lat)
    far = sun.direction_from_position(frame, subsolar * 1e15)
    azimuth, elevation = azimuth_elevation(frame.direction_from_mcmf(subsolar))
    angles = sun.direction_from_angles(frame, float(azimuth), float(elevation))
    assert np.allclose(far, subsolar, atol=3e-9)
    assert np.allclose(angles, subsolar, atol=1e-15)


def test_the_sun_stands_where_it_should():
    frame = EnuFrame(10.0, 0.0)
    east = frame.direction_from_mcmf(sun.direction_from_subsolar(70.0, 0.0))
    assert azimuth_elevation(east)[0] == pytest.approx(90.0)
    assert azimuth_elevation(east)[1] == pytest.approx(30.0)


@pytest.mark.parametrize(
    "call",
    [
        lambda: sun.direction_from_subsolar(0.0, 91.0),
        lambda: sun.direction_from_subsolar(float("nan"), 0.0),
        lambda: sun.direction_from_angles(EnuFrame(0, 0), 10.0, 95.0),
        lambda: sun.direction_from_position(EnuFrame(0, 0), [1.0, 2.0, 3.0]),
        lambda: sun.elevation_boxes([10.0, 5.0]),
        lambda: sun.reachable_suns(100.0, [0.0], [10.0]),
    ],
)
def test_suns_that_cannot_be(call):
    with pytest.raises(SunError):
        call()


def test_boxes_are_half_steps():
    first, last = sun.azimuth_boxes([0, 90, 180, 270])
    assert first.tolist() == [-45, 45, 135, 225]
    assert last.tolist() == [45, 135, 225, 315]
    first, last = sun.azimuth_boxes([100, 80, 90])  # a partial range, unsorted
    assert first.tolist() == [95, 75, 85]
    assert last.tolist() == [105, 85, 95]
    assert [float(edge[0]) for edge in sun.azimuth_boxes([7])] == [7, 7]
    low, high = sun.elevation_boxes([2, 5, 10, 88])
    assert low.tolist() == [0.5, 3.5, 7.5, 49]
    assert high.tolist() == [3.5, 7.5, 49, 90]
    assert [float(edge[0]) for edge in sun.elevation_boxes([7])] == [7, 7]


def brute_force(lat, azimuths, elevations, n=61):
    """Declinations of many directions of each box, by rotating vectors."""
    frame = EnuFrame(0.0, lat)
    az_boxes = list(zip(*sun.azimuth_boxes(azimuths), strict=True))
    el_boxes = list(zip(*sun.elevation_boxes(elevations), strict=True))
    answer = np.zeros((len(el_boxes), len(az_boxes)), bool)
    for (i, el), (j, az) in itertools.product(enumerate(el_boxes), enumerate(az_boxes)):
        a, e = np.meshgrid(np.linspace(*az, n), np.linspace(*el, n))
        dec = np.degrees(np.arcsin(frame.direction_to_mcmf(direction_enu(a, e))[..., 2]))
        answer[i, j] = (np.abs(dec) <= LIMIT_DEG).any() or (dec.min() < 0 < dec.max())
    return answer


@pytest.mark.parametrize("lat", [0.0, 1.0, -26.0, 26.0, 60.0, -85.0, 89.0, 90.0, -90.0])
@pytest.mark.parametrize(
    ("azimuths", "elevations"),
    [
        (np.arange(0, 360, 30.0), [2.0, 10.0, 30.0, 60.0, 85.0]),
        (np.arange(5, 360, 10.0), [0.5, 1.0, 1.5, 2.0, 5.0]),
        (np.arange(80, 110, 3.0), [60.0, 62.0, 64.0]),
    ],
)
def test_reachable_against_brute_force(lat, azimuths, elevations):
    exact = sun.reachable_suns(lat, azimuths, elevations)
    sampled = brute_force(lat, azimuths, elevations)
    assert exact.shape == (len(elevations), len(azimuths))
    assert not (sampled & ~exact).any()
    # sampling misses only what a box touches between its samples
    assert (exact & ~sampled).mean() <= 0.02


@pytest.mark.parametrize("lat", [0.0, 30.0, -30.0, 60.0, 90.0])
@pytest.mark.parametrize("first", [0.0, 37.0, 90.0, 180.0])
def test_declinations_of_wide_boxes_against_dense_samples(lat, first):
    """Boxes of 120 x 40 deg, so that crests fall on edges and inside; samples 0.25 deg apart."""
    azimuths, elevations = (first + np.array([0, 120, 240])) % 360, np.array([10.0, 50.0, 80.0])
    lowest, highest = sun.declination_range(lat, azimuths, elevations)
    az_from, az_to = sun.azimuth_boxes(azimuths)
    el_from, el_to = sun.elevation_boxes(elevations)
    for i, j in itertools.product(range(3), range(3)):
        a = np.linspace(az_from[j], az_to[j], 481)
        e = np.linspace(el_from[i], el_to[i], 161)[:, None]
        sine = EnuFrame(0.0, lat).direction_to_mcmf(direction_enu(a, e))[..., 2]
        assert sine.min() - 2e-5 <= lowest[i, j] <= sine.min() + 1e-12
        assert sine.max() - 1e-12 <= highest[i, j] <= sine.max() + 2e-5


def test_an_extreme_inside_a_box_counts():
    lat = 88.0  # noon elevation 2 deg +- 1.86: only boxes that reach below 3.86 deg
    suns = sun.reachable_suns(lat, [150.0, 180.0, 210.0], [3.0, 7.0, 11.0])
    assert suns[:, 1].tolist() == [True, False, False]
    north_crest = sun.reachable_suns(0.0, [-10.0, 0.0, 10.0], [70.0, 80.0, 90.0])
    assert north_crest[2].all()
    assert not north_crest[:2].any()


def test_the_sun_only_comes_to_reachable_cells():
    azimuths, elevations = np.arange(0, 360, 15.0), np.array([2.0, 6, 15, 30, 50, 70, 85])
    first_el, last_el = sun.elevation_boxes(elevations)
    times = [dt.datetime(2000, 1, 1) + dt.timedelta(hours=31.7 * k) for k in range(400)]
    directions = np.array([sun.sun_direction_at(time) for time in times])
    for lat in (0.0, -43.0, 80.0, -89.5):
        frame = EnuFrame(77.0, lat)
        reachable = sun.reachable_suns(lat, azimuths, elevations)
        azimuth, elevation = azimuth_elevation(frame.direction_from_mcmf(directions))
        column = np.round(azimuth / 15.0).astype(int) % 24
        for row in range(len(elevations)):
            here = (first_el[row] <= elevation) & (elevation <= last_el[row])
            assert reachable[row, column[here]].all()
    tropics = sun.reachable_suns(0.0, azimuths, elevations)
    assert not tropics.all()  # the Sun never stands in the north or south at the equator
