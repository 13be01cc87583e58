"""Claims in the file: packed, read back, and checked against the flags."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray
from helpers import catalogs
from helpers.verified import verify

from lcp_catalog.catalog import catalogue, schema, summary
from lcp_catalog.catalog.layout import packing, sigma_step_m
from lcp_catalog.catalog.maps import usable_nearby
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CatalogError
from lcp_catalog.landmarks.selection import Places

NAMES = ("detection_probability", "sigma_major", "sigma_minor", "sigma_angle")
DIMS = ("point", "image_scale", "view", "sun_elevation", "sun_azimuth")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("claims") / "claims.h5"
    write_catalog(catalogs.catalog(12), path)
    return path


@pytest.fixture
def copy(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(written, tmp_path / "copy.h5"))


def test_what_was_written_is_read(written: Path) -> None:
    before, after = catalogs.catalog(12), open_catalog(written)
    for name in (*NAMES, "image_scale", "universal", "level"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name), err_msg=name)
    assert after.errors == catalogs.ERRORS
    assert after.min_detection == 0.9


def test_packing_loses_half_a_step_at_most(written: Path) -> None:
    given, after = catalogs.arrays(12), open_catalog(written)
    step = float(np.float32(catalogs.GSD_M / 1000))
    for name, half in zip(NAMES, (0.002, step / 2, step / 2, 0.5), strict=True):
        found = getattr(after, name)
        assert found.dtype == np.float32
        np.testing.assert_array_equal(np.isnan(found), np.isnan(given[name]))
        away = np.abs(found - given[name])
        if name == "sigma_angle":
            away = np.minimum(away, 180.0 - away)  # an axis of 180 degrees is one of 0
        assert np.nanmax(away) <= half * (1.0 + 1e-4), name


@pytest.mark.slow
def test_xarray_unpacks_it_by_name(written: Path) -> None:
    after = open_catalog(written)
    with xarray.open_dataset(written, engine="h5netcdf") as found:
        for name in NAMES:
            assert found[name].dims == DIMS, name
            assert found[name].encoding["_FillValue"] == (65535 if "or" in name else 255)
            np.testing.assert_allclose(found[name], getattr(after, name), rtol=2e-7, atol=1e-6)
        assert found["image_scale"].values.tolist() == [1.0, 2.0, 4.0]
        assert found["universal"].values.tolist() == after.universal.tolist()
        assert found["level"].values.tolist() == [0] * 12
        assert "level" in found["harris_response"].coords
        assert json.loads(found.attrs["errors"]) == catalogs.ERRORS
    with xarray.open_dataset(written, engine="h5netcdf", group="coverage") as found:
        assert found["usable"].dims == ("cell", "view", "sun_elevation", "sun_azimuth")


def test_a_sigma_beyond_the_steps_is_the_largest(tmp_path: Path) -> None:
    given = catalogs.arrays(2)
    known = ~np.isnan(given["detection_probability"][0, 0, 0])
    given["sigma_major"][0, 0, 0][known] = np.inf
    found = catalogs.Catalog(**given)
    step = sigma_step_m(np.array([catalogs.GSD_M]))
    assert (found.sigma_major[0, 0, 0][known] == np.float32(65534 * step)).all()
    write_catalog(found, tmp_path / "c.h5")
    assert verify(tmp_path / "c.h5") == []


@pytest.mark.parametrize("name", NAMES)
def test_packed_numbers_stay_as_they_are(name: str) -> None:
    rule = packing(name, 0.118)
    numbers = np.arange(rule.missing + 1, dtype=rule.dtype)
    numbers = numbers[(numbers <= rule.largest) | (numbers == rule.missing)]
    np.testing.assert_array_equal(rule.packed(rule.unpacked(numbers)), numbers)


def test_points_that_work_in_coarser_images_only_are_allowed() -> None:
    found = catalogs.catalog(
        2, gsd_min=np.full(2, 2 * catalogs.GSD_M), gsd_max=np.full(2, 8 * catalogs.GSD_M)
    )
    assert (found.gsd_min > found.gsd).all()
    with pytest.raises(CatalogError, match="gsd_max: below gsd_min"):
        catalogs.catalog(2, gsd_min=np.full(2, 9.0), gsd_max=np.full(2, 8.0))


def test_universal_points_are_usable_in_95_percent_of_what_was_evaluated() -> None:
    condition = np.zeros((4, 1, 5, 8), np.uint8)
    condition[:3] = 31
    condition[0, 0, 0, :2] = 30 - 1  # 38 of 40
    condition[1, 0, 0, :3] = 30 - 1  # 37 of 40
    condition[2, 0, 0, :] = 0  # 32 of 32
    condition[2, 0, 1, :1] = 15
    assert schema.universal(condition).tolist() == [True, False, True, False]


def test_coverage_by_condition_against_every_distance() -> None:
    found = catalogs.catalog(12)
    cells = found.coverage
    got = usable_nearby(
        Places(cells.longitude, cells.latitude),
        Places(found.longitude, found.latitude),
        found.condition,
        7000.0,
    )
    lon, lat = np.radians(found.longitude), np.radians(found.latitude)
    near = 0
    for k, (a, b) in enumerate(zip(np.radians(cells.longitude), np.radians(cells.latitude), strict=True)):  # fmt: skip
        half = np.sin((lat - b) / 2) ** 2 + np.cos(lat) * np.cos(b) * np.sin((lon - a) / 2) ** 2
        close = 2 * 1737400.0 * np.arcsin(np.sqrt(half)) <= 7000.0
        near += int(close.sum())
        want = (found.condition[close] == 31).any(axis=0).astype(int)
        want[~(found.condition & 1).any(axis=0)] = 255
        np.testing.assert_array_equal(got[k], want)
    assert near > 10
    assert {0, 1, 255} <= set(np.unique(got).tolist())


def test_coverage_without_points_or_cells() -> None:
    none = Places(np.zeros(0), np.zeros(0))
    empty = usable_nearby(
        Places(np.zeros(3), np.zeros(3)), none, np.zeros((0, 1, 2, 4), np.uint8), 1e3
    )
    assert empty.shape == (3, 1, 2, 4)
    assert usable_nearby(none, none, np.zeros((0, 1, 2, 4), np.uint8), 1e3).shape == (0, 1, 2, 4)


# -- what does not agree


def _changed(path: Path, name: str, index: object, value: object) -> list[str]:
    with h5py.File(path, "r+") as file:
        file[name][index] = value
    return verify(path)


def _first(condition: np.ndarray, wanted: np.ndarray) -> tuple[int, ...]:
    return tuple(int(i) for i in np.argwhere(wanted)[0])


@pytest.mark.slow
def test_flags_that_do_not_agree_with_the_probability_are_named(written: Path, tmp_path: Path) -> None:  # fmt: skip
    found = open_catalog(written)
    p = found.detection_probability[:, 0]
    free = (found.condition & 25) == 25
    for wanted, number, says in (
        (found.condition == 31, 224, "condition: usable below min_detection"),
        (free & (p < 0.9) & (found.condition != 31), 226, "condition: not usable in spite of"),
        (found.condition == 0, 10, "detection_probability: is given for a condition not evaluated"),
        (found.condition == 31, 251, "detection_probability: above 250"),
        (found.condition == 31, 255, "condition: usable below min_detection"),
    ):
        copy = Path(shutil.copy(written, tmp_path / "copy.h5"))
        n, *rest = _first(found.condition, wanted)
        problems = _changed(copy, "detection_probability", (n, 0, *rest), number)
        assert any(line.startswith(says) for line in problems), (says, problems)


def test_the_least_probability_itself_agrees_with_either_flag(written: Path, tmp_path: Path) -> None:  # fmt: skip
    """0.9 is stored for 0.8995 (not usable) and for 0.9005 (usable)."""
    found = open_catalog(written)
    free = (found.condition & 25) == 25
    for wanted in (found.condition == 31, free & (found.condition != 31)):
        copy = Path(shutil.copy(written, tmp_path / "copy.h5"))
        n, *rest = _first(found.condition, wanted)
        problems = _changed(copy, "detection_probability", (n, 0, *rest), 225)
        assert problems == [
            "detection_probability: 1 of 1 chunks are not what was written (damaged or edited)"
        ]


SPOILT: dict[str, tuple[Any, Any, str]] = {
    "universal": (0, 7, "universal: does not agree with condition"),
    "level": (0, -1, "level: below 0"),
    "image_scale": (0, 0.5, "image_scale: does not rise from 1"),
    "sigma_major": ((slice(None), 0), 65535, "sigma_major: is missing in usable conditions"),
    "sigma_minor": ((slice(None), 0), 65000, "sigma_major: below sigma_minor"),
    "sigma_angle": ((0, 0, 0), 200, "sigma_angle: above 180"),
    "coverage/usable": ((0, 0), 9, "coverage/usable: has no meaning"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SPOILT)
def test_a_spoilt_claim_is_named(copy: Path, name: str) -> None:
    index, value, says = SPOILT[name]
    with h5py.File(copy) as file:
        if name == "universal":
            value = 1 - int(file[name][0])
    problems = _changed(copy, name, index, value)
    assert any(line.startswith(says) for line in problems), problems
    assert f"{name}: 1 of 1 chunks are not what was written (damaged or edited)" in problems
    with pytest.raises(CatalogError):
        open_catalog(copy)


def test_missing_parts_are_named(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        del file["sigma_angle"]
        del file["coverage"]["usable"]
        del file.attrs["errors"]
        file["sigma_major"].attrs["scale_factor"] = np.float32(2.0)
    problems = verify(copy)
    for says in (
        "sigma_angle: the variable is missing",
        "coverage/usable: the variable is missing",
        "the attribute errors is missing",
        "sigma_major: scale_factor is 2.0",
    ):
        assert any(line.startswith(says) for line in problems), problems


def test_errors_without_the_least_probability_are_refused() -> None:
    with pytest.raises(CatalogError, match="no min_detection"):
        catalogs.catalog(2, errors={"sensor_noise": 0.1})


@pytest.mark.slow
def test_no_damage_raises_or_passes(written: Path, tmp_path: Path) -> None:
    sound = catalogue.values(open_catalog(written))
    assert catalogs.noticed_damage(written, sound, tmp_path / "turned.h5", seed=5) > 15


def test_the_summary_counts_universal_points() -> None:
    found = catalogs.catalog(12)
    says = summary.summary(found)
    assert says["schema_version"] == "3.0"
    assert says["universal_points"] == int(found.universal.sum())
    assert says["min_detection"] == 0.9
