"""Several sources, environment maps as lights, sources below the horizon, and the Sun's size."""

import dataclasses
import math

import numpy as np
import pytest
from helpers.environment_maps import Lamp, cie_sky, directions, room, uniform, with_lamps
from helpers.synthetic import cratered

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.frame_camera import camera_from_json
from lcp_catalog.cameras.view import looking_camera, oblique_view
from lcp_catalog.constants import ASTRONOMICAL_UNIT_M, MOON_RADIUS_M, SOLAR_RADIUS_RAD
from lcp_catalog.ephemeris.limb_darkening import LimbDarkening
from lcp_catalog.errors import SunError
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.light import solar_disc
from lcp_catalog.light.environment import Environment
from lcp_catalog.light.environment_map import Panorama
from lcp_catalog.light.solar_disc import SolarDisc, disc_directions, sunlit_share
from lcp_catalog.light.sources import (
    Lighting,
    LightSource,
    light_above_horizon,
    mean_earth,
    split_sources,
)
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.renderer import Method, render_camera, render_enu
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.terrain import Terrain

GSD = 20.0
EARTH = SolarDisc(math.radians(0.95), LimbDarkening(1.0, 0.0, 0.0))


def make(z, frame=None):
    z = np.asarray(z, dtype=np.float32)
    rows, cols = z.shape
    field = Heightfield(z, GSD, -(cols // 2) * GSD, (rows // 2) * GSD)
    window = NodeWindow(-(rows // 2), rows - rows // 2, -(cols // 2), cols - cols // 2)
    index = np.zeros(z.shape, np.int16)
    return Terrain(field, frame or EnuFrame(0.0, 0.0), (0, rows, 0, cols), window, index, ("made",))


@pytest.fixture(scope="module")
def craters():
    return make(cratered(64, GSD, seed=2, relief_m=2.0))


def pixel_lamp(rows, azimuth, elevation, power):
    """A lamp at the centre of the pixel nearest to a direction."""
    step = 180.0 / rows
    azimuth = (math.floor(azimuth / step) + 0.5) * step
    elevation = (math.floor(elevation / step) + 0.5) * step
    return Lamp(azimuth, elevation, power)


@pytest.mark.parametrize("frame", ["enu", "camera"])
@pytest.mark.parametrize(
    ("tier", "name"),
    [
        ("standard", "lommel-seeliger"),
        ("standard", "hapke"),
        pytest.param("high", "lambert", marks=pytest.mark.slow),
    ],
)
def test_a_panorama_of_one_small_sun_is_that_sun(craters, frame, tier, name):
    """Rms difference below 1 % of the mean."""
    lamp = pixel_lamp(180, 130.0, 20.0, 7.0)
    split = split_sources(room(180, [lamp], ambient=1e-9))
    light = Lighting.of_panorama(split)
    sun = Lighting.of_sun(lamp.direction)
    how = {"model": reflectance_model(name), "accuracy": TIERS[tier]}
    if frame == "enu":
        found, expected = (
            render_enu(craters, one, oblique_view(0.0, 0.0), Method(**how)) for one in (light, sun)
        )
    else:
        camera = looking_camera(craters.frame, direction_enu(0, 70) * 2e4, GSD, (800.0, 800.0))
        found, expected = (
            render_camera(craters, camera, one, Method(**how)) for one in (light, sun)
        )
    assert (found.visible == expected.visible).all()
    seen = np.asarray(expected.visible, bool)
    off = (found.radiance - expected.radiance)[seen]
    assert np.sqrt(np.mean(off**2)) < 1e-3 * expected.radiance[seen].mean()
    assert (found.sunlit == expected.sunlit).mean() > 0.9999
    assert found.radiance[seen].mean() == pytest.approx(expected.radiance[seen].mean(), rel=2e-3)


def test_two_lamps_are_the_sum_of_two_suns(craters):
    one, two = pixel_lamp(120, 60, 30, 2.0), pixel_lamp(120, 290, 15, 1.0)
    light = Lighting.of_panorama(split_sources(room(120, [one, two], ambient=1e-9)))
    assert [source.irradiance for source in light.sources] == pytest.approx(
        [2 / 3, 1 / 3], rel=5e-3
    )
    view, how = oblique_view(30, 200), {"accuracy": TIERS["standard"]}
    found = render_enu(craters, light, view, Method(**how)).radiance
    parts = [
        render_enu(craters, lamp.direction, view, Method(**how)).radiance for lamp in (one, two)
    ]
    expected = (2.0 * parts[0] + parts[1]) / 3.0
    off = found - expected
    assert np.sqrt(np.nanmean(off**2)) < 0.005 * np.nanmean(expected)


@pytest.mark.parametrize("tier", ["standard", "reference"])
@pytest.mark.parametrize("altitude", [None, 30e3])
def test_sources_add_up(craters, tier, altitude):
    """The sum of irradiance times the radiance under each source alone, in any order; the bands are
    those of the first source.
    """
    directions = [direction_enu(80, 12), direction_enu(200, 40), direction_enu(330, 5)]
    weights = [1.0, 0.25, 0.6]
    view, how = oblique_view(25, 100, altitude), {"accuracy": TIERS[tier]}
    light = Lighting(tuple(map(LightSource, directions, weights)))
    whole = render_enu(craters, light, view, Method(**how))
    alone = [render_enu(craters, one, view, Method(**how)) for one in directions]
    expected = sum(weight * one.radiance for weight, one in zip(weights, alone, strict=True))
    assert whole.radiance == pytest.approx(expected, rel=2e-6, abs=1e-9, nan_ok=True)
    for band in ("sunlit", "visible", "incidence_deg", "phase_deg"):
        assert getattr(whole, band) == pytest.approx(getattr(alone[0], band), nan_ok=True)
    other = render_enu(craters, Lighting(light.sources[::-1]), view, Method(**how))
    assert other.radiance == pytest.approx(whole.radiance, rel=2e-6, abs=1e-9, nan_ok=True)


def test_a_floor_in_shadow_is_seen_by_the_earth():
    """A deep pit under a low Sun: black without the Earth, a ten-thousandth of sunlight with it."""
    y, x = np.mgrid[-30:31, -30:31]
    z = -600.0 * (np.hypot(x, y) < 14)
    frame = EnuFrame(0.0, 0.0)
    terrain, to_sun = make(z, frame), direction_enu(90, 6)
    earth = mean_earth(frame.direction_to_mcmf(to_sun)).source(frame)
    assert earth.direction.elevation_rad == pytest.approx(math.pi / 2)
    model = reflectance_model("lambert")
    light = Lighting.of_sun(to_sun)
    how = {"model": model, "accuracy": TIERS["high"]}
    sun = render_enu(terrain, light, oblique_view(0.0, 0.0), Method(**how))
    both = render_enu(terrain, light.with_source(earth), oblique_view(0.0, 0.0), Method(**how))
    floor = (slice(26, 35), slice(26, 35))
    assert (sun.radiance[floor] == 0.0).all()
    assert (both.sunlit == sun.sunlit).all()
    # straight down on a level floor; 84 deg between Sun and Earth here are 96 at the Earth
    phase = 10 ** (-0.4 * (-1.060e-3 * 96 + 2.054e-4 * 96**2))
    expected = model.law[0] * 0.434 * phase * (6371e3 / (384400e3 - MOON_RADIUS_M)) ** 2
    assert both.radiance[floor] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("frame", ["enu", "camera"])
def test_a_sun_below_the_horizon_lights_no_border(frame):
    """Slopes at the border of the terrain face a Sun 20 deg below the horizon; the Earth remains."""
    _, x = np.mgrid[-20:21, -20:21] * GSD
    terrain = make(-0.5 * x)
    sun = LightSource(direction_enu(90, -20))
    earth = LightSource(direction_enu(200, 50), 1e-4, name="Earth")
    how = {"accuracy": TIERS["standard"]}
    night, only = Lighting((sun, earth)), Lighting((earth,))
    if frame == "enu":
        found, expected = (
            render_enu(terrain, one, oblique_view(0.0, 0.0), Method(**how)) for one in (night, only)
        )
    else:
        camera = looking_camera(terrain.frame, [0.0, 0.0, 1e4], GSD, (900.0, 900.0))
        found, expected = (
            render_camera(terrain, camera, one, Method(**how)) for one in (night, only)
        )
    seen = np.asarray(found.visible, bool)
    assert found.radiance[seen] == pytest.approx(expected.radiance[seen], rel=1e-6)
    assert (found.sunlit == 0).all()
    with pytest.raises(SunError, match=r"the Sun is .* deg below"):
        render_enu(terrain, Lighting((sun,)), oblique_view(0.0, 0.0), Method(**how))


def test_sources_above_the_horizon(craters):
    sources = (
        LightSource(direction_enu(0, -5)),
        LightSource(direction_enu(0, 5)),
        LightSource(direction_enu(9, 1)),
    )
    assert [one.irradiance for one in light_above_horizon(craters, Lighting(sources)).sources] == [
        0.0,
        1.0,
        1.0,
    ]
    night = Lighting(sources[:1], uniform(16))
    assert light_above_horizon(craters, night).first.irradiance == 0.0  # a sky lights on


def test_an_overcast_sky_has_a_first_source():
    light = Lighting.of_panorama(split_sources(uniform(32)))
    assert light.first.direction.vector == pytest.approx([0, 0, 1])
    assert light.first.irradiance == 0.0
    assert light.sky.power_above == pytest.approx(1.0)
    found = render_enu(
        make(np.zeros((5, 5))), light, oblique_view(0.0, 0.0), Method(accuracy=TIERS["standard"])
    )
    assert (found.sunlit == 0.0).all()
    assert (found.radiance > 0.0).all()
    assert found.incidence_deg == pytest.approx(0.0, abs=1e-5)


def test_the_unit_of_a_panorama():
    sky = room(90, [Lamp(10, 40, 3.0, 2), Lamp(100, 20, 1.0, 1)], ambient=0.2)
    light = Lighting.of_panorama(split_sources(sky))
    total = sum(source.irradiance for source in light.sources) + light.sky.power_above
    assert total == pytest.approx(1.0, rel=1e-12)
    said = light.describe()
    assert said["sky_irradiance"] == light.sky.power_above
    assert said["sources"][0]["azimuth_deg"] == pytest.approx(10.0, abs=0.2)


def test_turning_a_panorama_turns_its_sun():
    image = room(90, [Lamp(20, 40, 3.0)], ambient=1e-6).luminance
    for turn in (0.0, 90.0, -135.0):
        first = Environment.of(Panorama(image, turn)).lighting.first
        expected = direction_enu(20 + turn, 40)
        assert (
            math.degrees(math.acos(min(1.0, first.direction.vector @ expected))) < 1.5
        )  # pixels of 2 deg


def test_scaling_the_sun_darkens_the_sky_by_as_much():
    sky = room(90, [Lamp(20, 40, 3.0)], ambient=0.5)
    found, scaled = Environment.of(sky), Environment.of(sky, sun_sky_ratio=4.0)
    plain = [one.lighting for one in (found, scaled)]
    level = math.sin(plain[1].first.direction.elevation_rad) * plain[1].first.irradiance
    assert level / plain[1].sky.horizontal_irradiance == pytest.approx(4.0)
    assert plain[1].first.direction.vector == pytest.approx(plain[0].first.direction.vector)


@pytest.mark.parametrize(("elevation", "below"), [(5.0, 5.0), (-3.0, -3.0), (-40.0, 10.0)])
def test_the_lowest_visible_light(elevation, below):
    light = Lighting(
        (LightSource(direction_enu(0, elevation)), LightSource(direction_enu(0, 10.0)))
    )
    assert math.degrees(math.atan(light.lowest_tangent)) == pytest.approx(below)
    disc = Lighting.of_sun(direction_enu(0, 30), True)
    limb = 30.0 - math.degrees(SOLAR_RADIUS_RAD)
    assert math.degrees(math.atan(disc.lowest_tangent)) == pytest.approx(limb)


@pytest.mark.parametrize(("elevation", "radius_deg"), [(20.0, 0.95), (87.8, 0.95), (87.0, 1.9)])
def test_the_earths_disc_against_directions_all_over_it(elevation, radius_deg):
    """Shares of a disc 3.5 times as wide as the Sun's, and of a wider one that is not divided into
    strips; exact shadows of 2048 directions.
    """
    disc = dataclasses.replace(EARTH, radius_rad=math.radians(radius_deg))
    y, x = np.mgrid[-11:12, -11:12] * GSD
    field = Heightfield((400.0 * (x > 100) * (y < 0) + 0.02 * y).astype(np.float32), GSD)
    towards = direction_enu(97.0, elevation)
    found = sunlit_share(field, towards, TIERS["high"], disc=disc)
    free = np.zeros(field.shape)
    directions = disc_directions(towards, disc, TIERS["reference"])
    for direction in directions:
        free += ~field.occluded_nodes(direction)
    inner = (slice(2, -2), slice(2, -2))
    off = (found - free / len(directions))[inner]
    assert np.sqrt(np.mean(off**2)) < 2e-3
    assert np.abs(off).max() < 0.04  # 9 strips; 2048 rays
    spread = np.degrees(np.arccos(np.clip(directions @ towards, -1, 1)))
    assert spread.max() == pytest.approx(radius_deg, rel=0.01)
    assert np.mean(spread**2) == pytest.approx(
        radius_deg**2 / 2, rel=0.01
    )  # of one brightness all over


@pytest.mark.parametrize("radius_deg", [0.2666, 1.03, 1.9])
def test_no_strip_of_a_disc_leans_beyond_what_strips_are_made_for(radius_deg, monkeypatch):
    """`limb_darkening.strips` needs |lean| below 0.5; a wide disc near the zenith is sampled by
    directions instead.
    """
    leans = []
    made = solar_disc.strips
    monkeypatch.setattr(
        solar_disc, "strips", lambda law, n, lean=0.0: leans.append(lean) or made(law, n, lean)
    )
    field = Heightfield(np.pad(np.full((3, 3), 900.0, np.float32), 5), GSD)
    disc = dataclasses.replace(EARTH, radius_rad=math.radians(radius_deg))
    for elevation in (20.0, 70.0, 85.0, 87.9):
        sunlit_share(field, direction_enu(97.0, elevation), TIERS["high"], disc=disc)
    assert leans
    assert max(map(abs, leans)) < 0.5


def test_the_suns_size_by_its_distance():
    """Perihelion 2024-01-03 (0.98331 au) and aphelion 2024-07-05 (1.01673 au), USNO; the Moon is
    within 0.0027 au of the Earth.
    """
    frame = EnuFrame(0.0, 0.0)
    for time, au in (("2024-01-03T00:39", 0.98331), ("2024-07-05T05:06", 1.01673)):
        radius = SunChoice(time_utc=time).disc(frame, None).radius_rad
        assert radius == pytest.approx(math.asin(math.sin(SOLAR_RADIUS_RAD) / au), rel=0.003)
    assert SunChoice(10.0, 20.0).disc(frame, None).radius_rad == SOLAR_RADIUS_RAD
    assert SunChoice(subsolar_deg=(0.0, 0.0)).disc(frame, None).radius_rad == SOLAR_RADIUS_RAD


def test_a_cameras_own_sun_and_time():
    frame = EnuFrame(0.0, 0.0)
    document = {
        "position_mcmf_m": [2e6, 0, 0],
        "rotation_mcmf_to_camera": [[0, 1, 0], [0, 0, -1], [-1, 0, 0]],
        "focal_length_px": 100,
        "principal_point_px": [5, 5],
        "image_size_px": [10, 10],
    }
    near = {"sun_position_mcmf_m": [0.5 * ASTRONOMICAL_UNIT_M, 0.0, 0.0]}
    timed = {"time_utc": "2024-01-03T00:39"}
    half = SunChoice().disc(frame, camera_from_json(document | near, "c")).radius_rad
    assert math.sin(half) == pytest.approx(2 * math.sin(SOLAR_RADIUS_RAD), rel=1e-4)
    camera = camera_from_json(document | timed, "c")
    assert SunChoice().instant(camera) == timed["time_utc"]
    assert SunChoice().disc(frame, camera).radius_rad > 1.01 * SOLAR_RADIUS_RAD
    assert SunChoice(10.0, 20.0).instant(camera) is None  # angles are no instant
    assert SunChoice(10.0, 20.0).disc(frame, camera).radius_rad == SOLAR_RADIUS_RAD
    both = camera_from_json(document | near | timed, "c")
    assert SunChoice().instant(both) == timed["time_utc"]
    assert SunChoice().disc(frame, both).radius_rad == half


def test_one_sun_equals_a_bare_direction(craters):
    """A `Lighting` of one Sun and a direction alone give the same bits."""
    direction = direction_enu(77, 8)
    one = render_enu(craters, Lighting.of_sun(direction), oblique_view(0.0, 0.0))
    other = render_enu(craters, direction, oblique_view(0.0, 0.0))
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert (a is None and b is None) or np.array_equal(a, b, equal_nan=True)


def test_a_lambert_surface_is_lit_as_by_one_source_in_the_middle_of_the_light():
    """Its radiance, from pixel to pixel, is proportional to the cosine to that source."""
    sky = with_lamps(cie_sky(64, 100.0, 50.0), [Lamp(40.0, 60.0, 1.0, 2.0)])
    middle = Environment.of(sky).middle.vector
    light = sky.luminance[:32] * sky.solid_angles[:32, None]
    towards = directions(64)[:32]
    found = np.einsum("ij,ijk->k", light, towards)
    assert middle == pytest.approx(found / np.linalg.norm(found), abs=2e-4)
