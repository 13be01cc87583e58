"""Sun directions that can occur at a latitude: compared with many directions of every cell."""

import datetime as dt
import itertools

import numpy as np
import pytest

from lcp_catalog.constants import SOLAR_RADIUS_RAD, SUBSOLAR_LATITUDE_MAX_DEG
from lcp_catalog.ephemeris.solar_position import (
    azimuth_boxes,
    declination_range,
    elevation_boxes,
    highest_sun_deg,
    reachable_suns,
    sun_direction_at,
)
from lcp_catalog.errors import SunError
from lcp_catalog.geometry.frames import EnuFrame, azimuth_elevation, direction_enu

LIMIT_DEG = SUBSOLAR_LATITUDE_MAX_DEG + np.degrees(SOLAR_RADIUS_RAD)


def test_refused_latitudes_and_elevations():
    with pytest.raises(SunError, match="latitude"):
        reachable_suns(100.0, [0.0], [10.0])
    with pytest.raises(SunError, match="increase"):
        elevation_boxes([10.0, 5.0])


def test_boxes_are_half_steps():
    first, last = azimuth_boxes([0, 90, 180, 270])
    assert first.tolist() == [-45, 45, 135, 225]
    assert last.tolist() == [45, 135, 225, 315]
    first, last = azimuth_boxes([100, 80, 90])  # a partial range, unsorted
    assert first.tolist() == [95, 75, 85]
    assert last.tolist() == [105, 85, 95]
    assert [float(edge[0]) for edge in azimuth_boxes([7])] == [7, 7]
    low, high = elevation_boxes([2, 5, 10, 88])
    assert low.tolist() == [0.5, 3.5, 7.5, 49]
    assert high.tolist() == [3.5, 7.5, 49, 90]
    assert [float(edge[0]) for edge in elevation_boxes([7])] == [7, 7]


def brute_force(lat, azimuths, elevations, n=61):
    """Mask of boxes with a reachable declination among many directions of each box, by rotation of
    vectors.
    """
    frame = EnuFrame(0.0, lat)
    az_boxes = list(zip(*azimuth_boxes(azimuths), strict=True))
    el_boxes = list(zip(*elevation_boxes(elevations), strict=True))
    answer = np.zeros((len(el_boxes), len(az_boxes)), bool)
    for (i, el), (j, az) in itertools.product(enumerate(el_boxes), enumerate(az_boxes)):
        a, e = np.meshgrid(np.linspace(*az, n), np.linspace(*el, n))
        dec = np.degrees(np.arcsin(frame.direction_to_mcmf(direction_enu(a, e))[..., 2]))
        answer[i, j] = (np.abs(dec) <= LIMIT_DEG).any() or (dec.min() < 0 < dec.max())
    return answer


@pytest.mark.parametrize(
    ("azimuths", "elevations"),
    [
        (np.arange(0, 360, 30.0), [2.0, 10.0, 30.0, 60.0, 85.0]),
        (np.arange(5, 360, 10.0), [0.5, 1.0, 1.5, 2.0, 5.0]),
        (np.arange(80, 110, 3.0), [60.0, 62.0, 64.0]),
    ],
)
def test_reachable_against_brute_force(azimuths, elevations):
    for lat in (0.0, 1.0, -26.0, 26.0, 60.0, -85.0, 89.0, 90.0, -90.0):
        exact = reachable_suns(lat, azimuths, elevations)
        sampled = brute_force(lat, azimuths, elevations)
        assert exact.shape == (len(elevations), len(azimuths))
        assert not (sampled & ~exact).any(), lat
        # sampling misses only directions between the samples
        assert (exact & ~sampled).mean() <= 0.02, lat


@pytest.mark.parametrize("lat", [0.0, 30.0, -30.0, 60.0, 90.0])
def test_declinations_of_wide_boxes_against_dense_samples(lat):
    """Boxes of 120 x 40 deg, so that extremes fall on edges and inside; samples 0.25 deg apart."""
    for first in (0.0, 37.0, 90.0, 180.0):
        azimuths, elevations = (first + np.array([0, 120, 240])) % 360, np.array([10.0, 50.0, 80.0])
        lowest, highest = declination_range(lat, azimuths, elevations)
        az_from, az_to = azimuth_boxes(azimuths)
        el_from, el_to = elevation_boxes(elevations)
        for i, j in itertools.product(range(3), range(3)):
            a = np.linspace(az_from[j], az_to[j], 481)
            e = np.linspace(el_from[i], el_to[i], 161)[:, None]
            sine = EnuFrame(0.0, lat).direction_to_mcmf(direction_enu(a, e))[..., 2]
            assert sine.min() - 2e-5 <= lowest[i, j] <= sine.min() + 1e-12
            assert sine.max() - 1e-12 <= highest[i, j] <= sine.max() + 2e-5


def test_an_extreme_inside_a_box_counts():
    lat = 88.0  # noon elevation 2 deg +- 1.86: only boxes that begin below 3.86 deg
    suns = reachable_suns(lat, [150.0, 180.0, 210.0], [3.0, 7.0, 11.0])
    assert suns[:, 1].tolist() == [True, False, False]
    north_crest = reachable_suns(0.0, [-10.0, 0.0, 10.0], [70.0, 80.0, 90.0])
    assert north_crest[2].all()
    assert not north_crest[:2].any()


def test_the_sun_only_comes_to_reachable_cells():
    azimuths, elevations = np.arange(0, 360, 15.0), np.array([2.0, 6, 15, 30, 50, 70, 85])
    first_el, last_el = elevation_boxes(elevations)
    times = [dt.datetime(2000, 1, 1) + dt.timedelta(hours=31.7 * k) for k in range(400)]
    directions = np.array([sun_direction_at(time) for time in times])
    for lat in (0.0, -43.0, 80.0, -89.5):
        frame = EnuFrame(77.0, lat)
        reachable = reachable_suns(lat, azimuths, elevations)
        azimuth, elevation = azimuth_elevation(frame.direction_from_mcmf(directions))
        column = np.round(azimuth / 15.0).astype(int) % 24
        for row in range(len(elevations)):
            here = (first_el[row] <= elevation) & (elevation <= last_el[row])
            assert reachable[row, column[here]].all()
    tropics = reachable_suns(0.0, azimuths, elevations)
    assert not tropics.all()  # at the equator the Sun is never in the north or south


@pytest.mark.parametrize("lat", [-90.0, -88.0, -83.0, 0.0, 85.0, 90.0])
def test_the_highest_sun_is_that_of_a_subsolar_point_on_the_same_meridian(lat):
    """The angle between the zenith and the disc's upper edge, by vectors."""
    subsolar = np.radians(np.linspace(-LIMIT_DEG, LIMIT_DEG, 1001))
    zenith = np.array([np.cos(np.radians(lat)), np.sin(np.radians(lat))])
    sines = np.cos(subsolar) * zenith[0] + np.sin(subsolar) * zenith[1]
    assert highest_sun_deg(lat) == pytest.approx(np.degrees(np.arcsin(sines.max())), abs=2e-3)
