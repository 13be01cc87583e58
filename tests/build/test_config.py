"""Configurations: invalid values raise errors, and TOML preserves all values."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.build.config import AreaConfig, BuildConfig, PointConfig, SunConfig, ViewConfig
from lcp_catalog.errors import ConfigError

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
        points=PointConfig(image_noise=noise, patch_nodes=2 * half + 1),
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
        ("[points]\npatch_nodes = 32\n", "patch_nodes"),
        ("[points]\npatch_nodes = 33.5\n", "patch_nodes"),
        ("[points]\nimage_noise = true\n", "image_noise"),
        ("[points]\nmax_second_peak = 1.5\n", "max_second_peak"),
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


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.toml"):
        BuildConfig.from_toml(tmp_path / "nowhere.toml")
