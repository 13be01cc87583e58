"""Check of the stated Sun for a surface with another reflectance law than that of the search:
neither is mistaken for the other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import small_world
from helpers.catalogs import ALBEDO_MAP
from helpers.small_world import HADLEY, World, overhead

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.geometry.frames import EnuFrame, azimuth_elevation, direction_enu, mcmf_to_lonlat
from lcp_catalog.images.image import Image
from lcp_catalog.matching import sun_check
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.point_search import Criteria, SearchImage
from lcp_catalog.matching.sun_check import MatchedPoints, check_sun, with_sun
from lcp_catalog.matching.sun_verdict import FAR_TURNS_DEG, SunCheck
from lcp_catalog.photometry.laws import reflectance_model

SEARCHED = reflectance_model("lommel-seeliger")
SUN = (100.0, 30.0)
AWAY_M, PIXEL_M = 900e3, 400.0


def oblique(azimuth_deg: float, off_nadir_deg: float) -> Camera:
    """A narrow camera that looks at the middle of the synthetic terrain from a direction."""
    there = direction_enu(azimuth_deg, 90.0 - off_nadir_deg)
    right = np.cross(-there, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-there, right), -there]) @ HADLEY.rotation
    size, middle = (200, 200), (99.5, 99.5)
    return Camera(HADLEY.to_mcmf(AWAY_M * there), rotation, AWAY_M / PIXEL_M, middle, size)


@pytest.fixture(scope="module")
def world() -> World:
    return small_world.world()


@pytest.fixture(scope="module")
def points(world):
    return world.catalog()


@pytest.fixture(scope="module", params=[40.0, pytest.param(190.0, marks=pytest.mark.slow)])
def rough(world, request) -> Image:
    """An image taken 45 deg off the vertical, of a surface after Hapke."""
    return world.photo(oblique(request.param, 45.0), SUN, law=reflectance_model("hapke"))


def checked(points, photo: Image, turn_deg: float = 0.0, raise_deg: float = 0.0) -> SunCheck:
    rows = points_in_view(points, photo.sensor)
    stated = with_sun(photo, points.position_mcmf[rows], turn_deg, raise_deg)
    matched = MatchedPoints(
        points, SearchImage.of(stated), SEARCHED, rows, np.zeros((len(rows), 2)), Criteria()
    )
    return matched.check()


@pytest.mark.slow
def test_a_law_is_not_taken_for_a_sun(points, rough: Image, monkeypatch) -> None:
    """Under Lommel-Seeliger alone a Sun turned by 20 deg correlates much better; under the image's
    own law none does.
    """
    found = checked(points, rough)
    assert (found.law, found.fits) == ("hapke", True)
    assert found.correlation > max(found.correlations)
    monkeypatch.setattr(sun_check, "LAWS", ())
    alone = checked(points, rough)
    assert not alone.fits
    assert alone.turns_deg[alone.preferred][0] != 0.0
    assert found.least_doubt_px == found.doubt_px == alone.doubt_px


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [-20.0, 20.0])
def test_a_sun_is_not_taken_for_a_law(points, rough: Image, turn_deg: float) -> None:
    found = checked(points, rough, turn_deg)
    assert not found.fits
    assert f"{-turn_deg:+.0f} deg" in found.complaint


@pytest.mark.slow
def test_the_searchs_own_law_stays_where_it_is_right(points, world) -> None:
    photo = world.photo(overhead(), SUN, law=SEARCHED)
    assert (checked(points, photo).law, checked(points, photo).fits) == ("", True)
    assert not checked(points, photo, 20.0).fits


@pytest.mark.parametrize(
    ("elevation_deg", "power"),
    [
        (15.0, 1 / 2.2),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in ((50.0, 2.2), (15.0, 2.2), (50.0, 1 / 2.2), (30.0, 1 / 2.2), (30.0, 2.2))
        ),
    ],
)
def test_a_bent_brightness_is_not_taken_for_an_elevation(
    points, world, elevation_deg: float, power: float, monkeypatch
) -> None:
    """Brightness to the power of 1 / 2.2 and 2.2, as of a linear image taken for sRGB and the reverse."""
    monkeypatch.setattr(sun_check, "LAWS", ())
    plain = world.photo(overhead(), (100.0, elevation_deg), law=SEARCHED)
    bent = replace(plain, signal=np.maximum(plain.signal, 0.0) ** np.float32(power))
    known, right = checked(points, plain), checked(points, bent)
    assert known.elevation_fits
    assert right.elevation_fits
    assert right.best_raise_deg == pytest.approx(known.best_raise_deg, abs=0.1)
    assert not checked(points, bent, 0.0, -10.0).elevation_fits
    assert not checked(points, bent, 0.0, 10.0).elevation_fits


def test_without_its_power_the_brightness_moves_the_best_elevation(
    points, world, monkeypatch
) -> None:
    monkeypatch.setattr(sun_check, "LAWS", ())
    monkeypatch.setattr(sun_check._Tried, "bent", lambda tried, law, rows: tried)
    plain = world.photo(overhead(), SUN, law=SEARCHED)
    low, high = (
        checked(points, replace(plain, signal=np.maximum(plain.signal, 0.0) ** np.float32(power)))
        for power in (1 / 2.2, 2.2)
    )
    assert high.best_raise_deg - low.best_raise_deg > 4.0


@pytest.mark.parametrize(
    ("elevation_deg", "hapke_deg", "scatter", "power", "fits"),
    [
        (50.0, 2.0, 0.0, 0.0, True),
        (50.0, 5.0, 0.0, 0.0, False),  # nor does it fit under the other law
        (35.0, 2.0, 0.0, 0.0, False),  # below, no law is asked
        (60.0, -20.0, 1.5, 0.0, False),  # the sigma alone would allow it
        (50.0, 8.0, 0.0, 0.9, True),
        (50.0, 8.0, 0.0, 1.1, True),
        (50.0, 8.0, 0.0, 1.2, False),  # as far no map is wrong
        (35.0, 8.0, 0.0, 0.9, False),
    ],
)
def test_a_high_suns_elevation_may_fit_under_the_law_of_a_rough_surface_or_with_another_map(
    points,
    world,
    monkeypatch,
    elevation_deg: float,
    hapke_deg: float,
    scatter: float,
    power: float,
    fits: bool,
) -> None:
    """Points that correlate best under a Sun 8 deg higher, with Hapke under one that is higher by ``hapke_deg``, with the map's
    brightness to a power (0: none) by 2 deg; each loses with the square of the distance, in log tan.
    """
    monkeypatch.setattr(sun_check, "LAWS", ())
    photo = world.photo(overhead(), (100.0, elevation_deg), law=SEARCHED)
    rows = points_in_view(points, photo.sensor)[:20]
    if power:
        bright = np.full(points.dem.shape, 2.0, np.float32)
        points = replace(points, albedo=bright, albedo_map=ALBEDO_MAP)
    middle = points.position_mcmf[rows].mean(axis=0)
    here = EnuFrame(*(float(v) for v in mcmf_to_lonlat(middle)[:2]))
    stated = float(azimuth_elevation(here.direction_from_mcmf(photo.sun_directions(middle)))[1])
    noise = np.linspace(-scatter, scatter, len(rows))

    def search_for(which: np.ndarray, catalog: Catalog | None):
        assert catalog is None or len(catalog) == len(rows)
        used = 1.0 if catalog is None else float(np.log2(catalog.albedo[0, 0, 0]))

        def search(moved: Image, law, some: np.ndarray, _power: float):
            sun = here.direction_from_mcmf(moved.sun_directions(middle))
            azimuth, up = (float(v) for v in azimuth_elevation(sun))
            best = stated + (hapke_deg if law.name == "hapke" else 8.0)
            best = stated + 2.0 if power and abs(used - power) < 1e-3 else best
            off = np.log(np.tan(np.radians(up)) / np.tan(np.radians(best)))
            off = off - noise[some] * (law.name == "hapke")
            return np.tanh(1.0 - off**2 - 1e-4 * (azimuth - 100.0) ** 2), np.zeros((len(some), 2))

        return search

    check = check_sun(search_for, points, rows, photo, SEARCHED)
    assert check.best_raise_deg == pytest.approx(8.0, abs=0.01)
    assert check.elevation_fits == fits
    assert check.fits


def test_far_suns_have_their_own_rule_where_they_are_searched(world, points, monkeypatch) -> None:
    """Six of ten points correlate a little better under every other Sun: too few for a near one, enough for a far one."""
    monkeypatch.setattr(sun_check, "LAWS", ())
    photo = world.photo(overhead(), (100.0, 30.0), law=SEARCHED)
    rows = points_in_view(points, photo.sensor)[:10]

    def search_for(*_: object):
        def search(moved: Image, _law, some: np.ndarray, _power: float):
            other = moved is not photo
            better = np.where(some % 5 < 3, 0.01, -0.01) * other
            return 0.8 + better, np.full((len(some), 2), 0.5 * other)

        return search

    assert check_sun(search_for, points, rows, photo, SEARCHED).fits
    assert not check_sun(search_for, points, rows, photo, SEARCHED, turns_deg=FAR_TURNS_DEG).fits
