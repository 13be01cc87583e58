"""A NAC orthoimage against renders of a DTM that came in steps: registered within 2 m, by windows and by a
catalogue's points. The pair is not ours to ship: without the shared data these tests are skipped.
docs/validation.md has the figures, `benchmarks/nac_pair.py` makes them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pit_pair as pit
import pytest

from lcp_catalog.catalog import Catalog, read_catalog
from lcp_catalog.locate import FAINT, LOCATED, locate
from lcp_catalog.photo import Photo
from lcp_catalog.request import SunChoice
from lcp_catalog.sensors import Uncertainty
from lcp_catalog.sphere import azimuth_elevation
from lcp_catalog.terraces import smooth_terraces
from lcp_catalog.windows import compare

WITHIN_M = 2.0
MOVED_M = (6.0, -5.0)


@pytest.fixture(scope="module")
def folder(shared_data: Path) -> Path:
    if not (shared_data / pit.PAIR).is_dir():
        pytest.skip(f"the pair is not here: {pit.PAIR}")
    return shared_data / pit.PAIR


@pytest.fixture(scope="module")
def sun(folder: Path) -> SunChoice:
    return pit.pit_sun(folder)


@pytest.fixture(scope="module")
def photo(folder: Path, sun: SunChoice) -> Photo:
    return pit.orthoimage(folder, sun)


@pytest.fixture(scope="module")
def dems(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    heights, *like = pit.dtm(folder)
    smooth = smooth_terraces(heights, pit.STEP_M).heights_m
    made = tmp_path_factory.mktemp("pit")
    return {
        name: pit.write_dem(made / f"{name}.tif", values, tuple(like))
        for name, values in (("steps", heights), ("smooth", smooth))
    }


@pytest.fixture(scope="module")
def grounds(dems: dict[str, Path], sun: SunChoice) -> dict[str, pit.Ground]:
    return {name: pit.Ground.of(path, sun) for name, path in dems.items()}


@pytest.fixture(scope="module")
def catalog(dems: dict[str, Path]) -> Catalog:
    path = dems["smooth"].with_name("pit.h5")
    return read_catalog(pit.build_catalog(dems["smooth"], path))


def scores(photo: Photo, ground: pit.Ground, side: int) -> np.ndarray:
    image, weight = pit.on_ground(photo, ground.nodes)
    return pit.window_scores(image, ground, pit.far_from_hole(ground, weight), side)


def in_place(found: np.ndarray) -> float:
    """Mean correlation of windows where the map puts them."""
    middle = found.shape[1] // 2
    return float(found[:, middle, middle].mean())


@pytest.mark.slow
@pytest.mark.parametrize("side", [16, 32])
def test_registered_by_windows(photo: Photo, grounds: dict[str, pit.Ground], side: int) -> None:
    """And a map that is moved on purpose is found to be moved so."""
    at = pit.offset_of(scores(photo, grounds["smooth"], side))
    assert np.hypot(*at) < WITHIN_M
    moved = photo.with_sensor(photo.sensor.moved(MOVED_M))
    np.testing.assert_allclose(
        pit.offset_of(scores(moved, grounds["smooth"], side)) + MOVED_M, at, atol=0.15
    )


@pytest.mark.slow
@pytest.mark.parametrize("start", [(0.0, 0.0), MOVED_M])
def test_registered_by_points(photo: Photo, catalog: Catalog, start: tuple[float, float]) -> None:
    moved = photo.with_sensor(photo.sensor.moved(start))
    found = locate(catalog, moved, Uncertainty(5.0), options=FAINT)
    assert found.verdict == LOCATED
    assert found.pose is not None
    assert np.hypot(*(found.pose.correction + start)) < WITHIN_M


@pytest.mark.slow
def test_smoothing_the_steps_pays(photo: Photo, grounds: dict[str, pit.Ground]) -> None:
    medians = {}
    for name, ground in grounds.items():
        image, weight = pit.on_ground(photo, ground.nodes)
        there = np.isfinite(ground.radiance) & (weight > 0.5)
        found = compare(
            pit.at_scale(image, there, 1), pit.at_scale(ground.radiance, there, 1), gsd_m=pit.GSD_M
        )
        medians[name] = found.textured.median
    assert medians["smooth"] > 0.35
    assert medians["smooth"] > 1.5 * medians["steps"]


@pytest.mark.slow
def test_it_is_shading_by_the_sun_where_it_stood(
    photo: Photo, dems: dict[str, Path], grounds: dict[str, pit.Ground]
) -> None:
    """Under a Sun that is turned by 90 deg nothing is left; from the other side light and dark change places."""
    azimuth, elevation = (float(v) for v in azimuth_elevation(grounds["smooth"].scene.sun))
    right = in_place(scores(photo, grounds["smooth"], 32))
    assert right > 0.25
    for turn, low, high in ((90.0, -0.1, 0.1), (180.0, -0.4, -0.25)):
        turned = SunChoice(azimuth_deg=(azimuth + turn) % 360.0, elevation_deg=elevation)
        assert low < in_place(scores(photo, pit.Ground.of(dems["smooth"], turned), 32)) < high
