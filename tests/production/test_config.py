"""Configurations: invalid values raise errors, and TOML preserves all values."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.errors import ConfigError, InputError
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.error_config import ErrorConfig
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.sweep import Conditions

rising = st.lists(st.floats(0.0, 89.0), min_size=1, max_size=6, unique=True).map(
    lambda v: tuple(sorted(v))
)


@given(
    elevations=rising,
    noise=st.floats(1e-6, 0.99),
    size=st.floats(0.1, 1e4),
    half=st.integers(4, 60),
)
def test_toml_keeps_every_value(
    elevations: tuple[float, ...], noise: float, size: float, half: int
) -> None:
    config = BuildConfig(
        area=AreaConfig(center_deg=(-3.25, 89.5), size_km=size),
        sun=SunConfig(elevations_deg=elevations),
        view=ViewConfig((0.0, 20.0), (0.0, 10.0), (math.inf, 100.0)),
        points=PointConfig(min_detection=noise, patch_nodes=2 * half + 1),
        errors=ErrorConfig(sensor_noise=noise, height_sigma_m=size),
    )
    import tomllib

    assert BuildConfig.from_dict(tomllib.loads(config.to_toml())) == config


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("[sunn]\n", "sunn"),
        ("[sun]\nazimuth_deg = [1]\n", "azimuth_deg"),
        ("[sun]\nelevations_deg = [5, 4]\n", "elevations_deg"),
        ("[sun]\nelevations_deg = 5\n", "elevations_deg"),
        ("[sun]\nazimuths_deg = []\n", "azimuths_deg is empty"),
        ("[points]\npatch_nodes = 32\n", "patch_nodes"),
        ("[points]\npatch_nodes = 33.5\n", "patch_nodes"),
        ("[points]\nmin_detection = true\n", "points.min_detection must be a number"),
        ("[points]\nmin_detection = 1.5\n", r"points.min_detection must lie in 0\.\.1"),
        ("[points]\nimage_noise = 0.1\n", r"\[points\] has no key image_noise"),
        ("[errors]\nsensor_noise = -0.1\n", "errors.sensor_noise must be at least 0"),
        ("[errors]\nheight_sigma_m = inf\n", "errors.height_sigma_m must be 0 or above"),
        ("[errors]\nalbedo_length_m = 0\n", "errors.albedo_length_m must be above 0"),
        ("[errors]\nalbedo_sigma = 'map'\n", "errors.albedo_sigma must be a number"),
        ("[errors]\nnoise = 0.1\n", r"\[errors\] has no key noise; there are sensor_noise, height"),
        ("[area]\ncenter_deg = [1, 2]\n", "size_km"),
        ("[area]\ncenter_deg = [1, 2]\nsize_km = 3\nbounds_deg = [1, 2, 3, 4]\n", "bounds_deg"),
        ("[view]\noff_nadir_deg = [0, 10]\n", "one length"),
        ("[model]\nreflectance = 3\n", "reflectance"),
        ("sun = 3\n", "sun"),
        ("[sun\n", "not TOML"),
    ],
)
def test_bad_files_name_the_file_and_the_key(tmp_path: Path, text: str, names: str) -> None:
    path = tmp_path / "build.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=names) as caught:
        BuildConfig.from_toml(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_errors_that_are_not_given_follow_from_the_dem() -> None:
    plain = ErrorConfig().model(12.0, 600.0)
    assert (plain.height_sigma_m, plain.height_length_m) == (12.0, 600.0)
    given = ErrorConfig(height_sigma_m=0.0, albedo_sigma=0.01, sensor_noise=0.2, spread=0.0)
    model = given.model(12.0, 600.0)
    assert (model.height_sigma_m, model.height_length_m) == (0.0, 600.0)
    assert (model.albedo_sigma, model.sensor_noise, model.spread) == (0.01, 0.2, 0.0)


def test_the_stored_configuration_holds_no_value_that_was_not_given() -> None:
    assert "height_sigma_m" not in BuildConfig().to_toml()
    known = BuildConfig(errors=ErrorConfig(height_sigma_m=3.0)).to_toml()
    assert "height_sigma_m = 3.0" in known


LOW = (0.5, 1.0, 1.5, 2.0, 3.0)


@pytest.mark.parametrize(
    ("lat_deg", "low"),
    [(0.0, ()), (-81.8, ()), (81.8, ()), (-81.9, LOW), (81.9, LOW), (-90.0, LOW), (90.0, LOW)],
)
def test_the_default_suns_follow_from_the_latitude(lat_deg: float, low: tuple[float, ...]) -> None:
    """90 - 81.86 + 1.59 + 0.27 = 10: beyond, the Sun stays below 10 deg."""
    every = (4.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 52.0, 60.0, 65.0, 70.0, 75.0)
    assert SunConfig().at(lat_deg).elevations_deg == (*low, *every)
    assert SunConfig(elevations_deg=(7.0,)).at(lat_deg).elevations_deg == (7.0,)


def test_at_a_pole_the_default_suns_go_around_the_horizon() -> None:
    """There the Sun's elevation is its declination, up to 1.59 deg and the disc's radius, 0.27: half
    steps around 0.5, 1, 1.5 and 2 deg begin below, those around 3 and more above.
    """
    for lat_deg in (-90.0, 90.0):
        found = Conditions.at(lat_deg, BuildConfig(sun=SunConfig().at(lat_deg)))
        assert found.reachable.all(axis=1).tolist() == [True] * 4 + [False] * 13
        assert not found.reachable[4:].any()


def test_no_default_sun_is_far_above_the_highest() -> None:
    """The upper edge of the Sun at noon of the solstice: 90 deg - latitude + 1.59 deg + 0.27 deg."""
    sun = SunConfig()
    nodes = np.array(sun.at(0.0).elevations_deg)
    for lat_deg in np.arange(-45.0, 45.0, 0.5):
        evaluated = Conditions.at(float(lat_deg), BuildConfig(sun=sun.at(0.0))).reachable.any(
            axis=1
        )
        highest = min(90.0, 90.0 - abs(lat_deg) + 1.86)
        over = nodes[evaluated].max() - highest
        assert over <= (2.5 if highest > 57.5 else 4.0) + 0.01, lat_deg
        assert nodes[evaluated].max() >= min(highest, 75.0) - 4.0, lat_deg


def test_at_85_deg_the_noon_sun_decides() -> None:
    """Noon in the south, 5 deg - declination high: up to 6.86 deg, in the boxes of 3.5 to 4.5 and 4.5 to 7.5
    deg, and not in that below 2.5 deg; none in the north. Mirrored at the south pole.
    """
    for lat_deg, noon in ((85.0, 180.0), (-85.0, 0.0)):
        config = BuildConfig(sun=SunConfig((0.0, 180.0)).at(lat_deg))
        day = replace(config, sun=replace(config.sun, azimuths_deg=(noon,)))
        assert Conditions.at(lat_deg, day).reachable[:, 0].tolist() == [
            *(False, False, False, False),
            *(True, True, True, *(False,) * 10),
        ]
        night = replace(config, sun=replace(config.sun, azimuths_deg=(180.0 - noon,)))
        assert not Conditions.at(lat_deg, night).reachable.any()


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.toml: there is no such file"):
        BuildConfig.from_toml(tmp_path / "nowhere.toml")


def test_spacing_and_search_by_default_and_as_given() -> None:
    """Two patches, and 64 cells; both at most 8 km, and at least half a patch."""
    fine, coarse = 118.0, 948.0
    assert [PointConfig().spacing_nodes(g) for g in (fine, 474.0, coarse)] == [64, 17, 16]
    assert [PointConfig().search_nodes(g) for g in (fine, 474.0, coarse)] == [64, 17, 16]
    given = PointConfig(spacing_m=20_000.0, search_m=300.0)
    assert (given.spacing_nodes(474.0), given.search_nodes(474.0)) == (42, 1)
    assert PointConfig(patch_nodes=9).spacing_nodes(fine) == 16


def test_a_search_within_half_a_patch_is_refused() -> None:
    """Patches of 33 nodes reach 16 nodes from their centre: 1600 m on cells of 100 m. The radius is
    rounded to nodes.
    """
    PointConfig(search_m=1560.0).check_cells(100.0)
    PointConfig(patch_nodes=9, search_m=400.0).check_cells(100.0)
    for patch_nodes, search_m, least in ((33, 1540.0, "1600 m"), (65, 1600.0, "3200 m")):
        points = PointConfig(patch_nodes=patch_nodes, search_m=search_m)
        with pytest.raises(ConfigError, match=f"at least half a patch, {least}"):
            points.check_cells(100.0)
    for gsd_m in (1.0, 474.0, 948.0, 20_000.0):
        PointConfig().check_cells(gsd_m)


def test_the_keys_that_are_not_the_default_are_one_line() -> None:
    config = BuildConfig.from_dict(
        {
            "area": {"gsd_m": 200.0},
            "sun": {"elevations_deg": [10.0, 20.0]},
            "points": {"per_view": 0},
        }
    )
    assert config.in_one_line() == (
        "area.gsd_m = 200.0; sun.elevations_deg = [10.0, 20.0]; points.per_view = 0"
    )
    assert BuildConfig().in_one_line() == ""
