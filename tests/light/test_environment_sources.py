"""Bright sources of environment maps: known lamps, an independent implementation in plain loops,
and conservation of power.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from helpers.environment_maps import OVERCAST, Lamp, cie_sky, room, uniform, with_lamps
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from lcp_catalog.errors import ImageError
from lcp_catalog.geometry.frames import azimuth_elevation, direction_enu
from lcp_catalog.light.environment_map import Panorama
from lcp_catalog.light.sources import MOST_SOURCES, SourceSearch, split_sources


def off_deg(a, b):
    return math.degrees(math.atan2(np.linalg.norm(np.cross(a, b)), a @ b))


def pixel_moments(panorama, count=8):
    """Solid angle and mean direction of each pixel of the upper half by Gauss-Legendre quadrature,
    exact to rounding because the radius test depends on them.
    """
    rows, cols = panorama.luminance.shape
    nodes, weights = np.polynomial.legendre.leggauss(count)
    part, share = (nodes + 1) / 2, weights / 2
    out = {}
    for r in range(rows // 2):
        for c in range(cols):
            azimuth = 360 * (c + part[None, :]) / cols - 180 + panorama.azimuth_deg
            towards = direction_enu(azimuth, 90 - 180 * (r + part[:, None]) / rows)
            level = np.sin(math.pi * (r + part) / rows)
            weight = (share * level)[:, None] * share * 2 * math.pi**2 / rows / cols
            out[r, c] = float(weight.sum()), (weight[..., None] * towards).sum(axis=(0, 1))
    return out


def twin(panorama, threshold, radius_deg, minimum):
    """The search in plain loops over pixels: powers and directions of the sources, and the
    remainder.
    """
    light = {
        (r, c): float(panorama.luminance[r, c])
        for r in range(panorama.rows // 2)
        for c in range(panorama.cols)
    }
    measure = pixel_moments(panorama)
    middle, segment = {}, {}
    for r, c in light:
        e, a = 90 - 180 * (r + 0.5) / panorama.rows, 360 * (c + 0.5) / panorama.cols
        middle[r, c] = direction_enu(a - 180 + panorama.azimuth_deg, e)
        segment[r, c] = (e <= 45, math.floor(a / 45))

    def mean(name):
        inside = [p for p in light if segment[p] == name]
        return sum(light[p] * measure[p][0] for p in inside) / sum(measure[p][0] for p in inside)

    closed, cut, found = set(), set(), []
    while len(found) < MOST_SOURCES:
        means = {name: mean(name) for name in set(segment.values())}
        bright = [p for p in light if p not in closed and light[p] > threshold * means[segment[p]]]
        if not bright:
            break
        peak = max(bright, key=lambda p: light[p])
        floor, centre = minimum * means[segment[peak]], middle[peak]
        for _ in range(20):
            near = [
                p
                for p in light
                if np.dot(middle[p], centre) >= math.cos(math.radians(radius_deg)) - 1e-9
            ]
            inside = [p for p in near if light[p] > floor and p not in cut]
            moment = sum((light[p] - floor) * measure[p][1] for p in inside)
            held, where = near, moment / np.linalg.norm(moment)
            power = sum((light[p] - floor) * measure[p][0] for p in inside)
            taken, moved, left = inside, off_deg(where, centre), off_deg(where, middle[peak])
            if moved < 18 / panorama.rows or left > radius_deg:
                break
            centre = where
        closed |= set(held)
        cut |= set(taken)
        light |= dict.fromkeys(taken, floor)
        found.append((power, where))
    left = panorama.luminance.copy()
    for (r, c), value in light.items():
        left[r, c] = value
    return sorted(found, key=lambda one: -one[0]), left


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from([(6.0, 5.0, 2.0), (3.0, 25.0, 1.5), (2.0, 40.0, 2.0)]),
    st.sampled_from([8, 10, 11]),
    st.floats(-180, 180),
)
def test_against_the_plain_search(seed, coefficients, rows, azimuth_deg):
    rng = np.random.default_rng(seed)
    light = rng.lognormal(0.0, rng.uniform(0.1, 1.5), (rows, 2 * rows))
    light[rng.integers(0, rows // 2, 3), rng.integers(0, 2 * rows, 3)] *= 100.0
    panorama = Panorama(light, azimuth_deg)
    expected, left = twin(panorama, *coefficients)
    found = split_sources(panorama, SourceSearch(*coefficients))
    powers = [p for p, _ in expected]
    assert [one.power for one in found.sources] == pytest.approx(powers, rel=1e-9)
    assert found.remainder.luminance == pytest.approx(left, rel=1e-9)
    for one, (_, direction) in zip(found.sources, expected, strict=True):
        assert off_deg(one.direction, direction) < 1e-6


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 40), st.floats(0.1, 3.0))
def test_power_is_kept(seed, rows, spread):
    rng = np.random.default_rng(seed)
    panorama = Panorama(rng.lognormal(0.0, spread, (rows, 2 * rows)))
    found = split_sources(panorama, SourceSearch(3.0, 20.0, 1.0))
    assert found.power == pytest.approx(panorama.power, rel=1e-12)
    assert found.power_above == pytest.approx(panorama.power_above, rel=1e-12)
    assert (found.remainder.luminance <= panorama.luminance).all()
    assert (
        found.remainder.luminance[(rows + 1) // 2 :] == panorama.luminance[(rows + 1) // 2 :]
    ).all()


@settings(max_examples=40, deadline=None)
@given(st.floats(0, 360), st.floats(4, 90), st.floats(0.5, 3.5))
def test_one_lamp_is_one_source_wherever_it_stands(azimuth, elevation, radius):
    """On borders of segments, across the image's seam, and in the zenith."""
    sky = room(90, [Lamp(azimuth, elevation, 3.0, radius)], ambient=0.01)
    found = split_sources(sky)
    assert len(found.sources) == 1
    assert (
        off_deg(found.sources[0].direction, direction_enu(azimuth, elevation)) < 1.5
    )  # pixels of 2
    assert found.sources[0].power == pytest.approx(3.0, rel=0.2)  # what is cut stays: two means


@pytest.mark.parametrize("azimuth", [45.0, 180.0, 0.0, 315.0])
@pytest.mark.parametrize("elevation", [45.0, 30.0, 88.0])
def test_a_glow_over_a_border_is_found_once(azimuth, elevation):
    """The glow of a lamp exceeds the threshold of the adjacent, dark segment, too."""
    dark = room(180, [Lamp(azimuth + 0.5, elevation, 1.0, 1.0)], ambient=1e-6).luminance
    away = np.degrees(np.arccos(np.clip(_looking(180) @ direction_enu(azimuth, elevation), -1, 1)))
    sky = Panorama(dark + np.where(away < 4.0, 0.05 * dark.max() * np.exp(-away), 0.0))
    assert len(split_sources(sky).sources) == 1


def _looking(rows):
    from helpers.environment_maps import directions

    return directions(rows)


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_several_lamps_in_one_segment(data):
    """Lamps down to a hundredth of the strongest, at least 12 deg apart, in one segment of 45 x 45 deg.

    A lamp a thousand times weaker can lose 6 % of its power to the remainder: its outer pixels are
    below twice the segment's mean, which the strong lamps decide.
    """
    places = data.draw(
        st.lists(st.tuples(st.integers(3, 42), st.integers(5, 40)), min_size=2, max_size=3)
    )
    lamps = [
        Lamp(azimuth, elevation, 10.0**-k, 1.0) for k, (azimuth, elevation) in enumerate(places)
    ]
    for k, one in enumerate(lamps):
        assume(all(off_deg(one.direction, other.direction) > 12.0 for other in lamps[:k]))
    found = split_sources(room(120, lamps, ambient=1e-4)).sources
    assert len(found) == len(lamps)
    for one, lamp in zip(found, lamps, strict=True):
        assert off_deg(one.direction, lamp.direction) < 1.1  # pixels of 1.5
        assert one.power == pytest.approx(lamp.power, rel=0.05)


@pytest.mark.parametrize("elevation", [1.0, 5.0, 20.0, 45.0, 70.0, 90.0])
def test_a_sky_without_a_sun_has_no_source(elevation):
    for sky in (cie_sky(128, 77.0, elevation), cie_sky(128, 77.0, elevation, OVERCAST)):
        assert split_sources(sky).sources == ()
    assert split_sources(uniform(32)).sources == ()


def test_no_sources_below_the_horizon():
    light = np.full((32, 64), 0.1)
    light[16:, 20] = 1e6
    found = split_sources(Panorama(light))
    assert found.sources == ()
    assert found.remainder.luminance == pytest.approx(light)


def test_the_three_coefficients():
    lamp = Lamp(90.0, 45.0, 1.0, 8.0)
    sky = room(180, [lamp], ambient=0.05)
    wide = split_sources(sky, SourceSearch(4.0, 10.0, 1.0)).sources
    assert len(wide) == 1
    assert wide[0].width_rad == pytest.approx(math.radians(8.0), rel=0.03)
    assert len(split_sources(sky, SourceSearch(4.0, 3.0, 1.0)).sources) > 1  # beyond R: others
    assert split_sources(sky, SourceSearch(200.0, 10.0, 1.0)).sources == ()
    deep, shallow = (split_sources(sky, SourceSearch(4.0, 10.0, m)) for m in (1.0, 3.0))
    assert deep.sources[0].power > shallow.sources[0].power
    assert deep.remainder.luminance.max() < shallow.remainder.luminance.max()


@pytest.mark.parametrize(
    "bad", [(0.5, 5, 0.5), (2, 5, 3), (6, 0, 2), (6, 50, 2), (math.nan, 5, 2), (6, 5, math.inf)]
)
def test_invalid_coefficients(bad):
    with pytest.raises(ImageError, match="T R M"):
        SourceSearch(*bad)


def test_the_greatest_number_of_sources(caplog):
    rng = np.random.default_rng(5)
    light = np.ones((64, 128))
    for row, col in zip(*np.mgrid[4:28:8, 4:124:8].reshape(2, -1), strict=True):
        light[row, col] = 500.0 + rng.random()
    panorama = Panorama(light)
    found = split_sources(panorama)
    assert len(found.sources) == MOST_SOURCES
    assert found.power == pytest.approx(panorama.power, rel=1e-12)
    assert "brightest" in caplog.text
    powers = [one.power for one in found.sources]
    assert all(a >= b for a, b in pairwise(powers))


def test_the_sun_over_the_sky():
    """CIE clear sky whose Sun was recorded at a fifth of the sky (1:5 in the paper), scaled to 4:1."""
    sky = cie_sky(128, 120.0, 50.0)
    weak = 0.2 * sky.horizontal_irradiance / math.sin(math.radians(50.0))
    found = split_sources(with_lamps(sky, [Lamp(120.0, 50.0, weak)]))
    assert found.sun_sky_ratio == pytest.approx(0.2, rel=0.03)
    scaled = found.with_ratio(4.0)
    sun, rest = scaled.sources[0], scaled.remainder
    assert sun.power * sun.direction[2] / rest.horizontal_irradiance == pytest.approx(4.0)
    assert (rest.luminance == found.remainder.luminance).all()  # the sky was measured well: kept
    assert scaled.power - scaled.remainder.power == pytest.approx(sun.power)


def test_other_lamps_count_as_sky_when_one_is_scaled():
    found = split_sources(room(90, [Lamp(0, 60, 2.0, 1), Lamp(180, 30, 1.0, 1)], 0.01))
    scaled = found.with_ratio(4.0)
    one, two = (source.power * source.direction[2] for source in scaled.sources)
    assert one / (two + scaled.remainder.horizontal_irradiance) == pytest.approx(4.0)
    assert scaled.sources[1].power == found.sources[1].power


def test_invalid_ratios():
    with pytest.raises(ImageError, match="no bright source"):
        split_sources(uniform(16)).with_ratio(4.0)
    with pytest.raises(ImageError, match="positive"):
        split_sources(room(16, [Lamp(0, 45, 1)], 0.1)).with_ratio(0.0)


def test_the_description_of_a_source():
    found = split_sources(room(180, [Lamp(222.0, 33.0, 1.0, 2.0)], 0.001)).sources[0]
    said = found.describe(2.0)
    azimuth, elevation = azimuth_elevation(found.direction)
    assert said["azimuth_deg"] == pytest.approx(float(azimuth))
    assert said["azimuth_deg"] == pytest.approx(222.0, abs=0.5)
    assert said["elevation_deg"] == pytest.approx(float(elevation))
    assert said["power_share"] == pytest.approx(found.power / 2)
    assert said["radius_deg"] == pytest.approx(2.0, rel=0.1)
