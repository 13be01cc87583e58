"""A NAC orthoimage compared with renders of a DTM with quantised heights: registered within 2 m, by
windows and by the points of a catalogue. The pair may not be distributed: without the shared data
these tests are skipped. The figures are from `nac_pair.py` of c896266.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import pit_pair as pit
from helpers.small_world import mirrored

from benchmarks.evidence.dequantise import smooth_terraces
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.geometry.frames import azimuth_elevation
from lcp_catalog.images.image import Image
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.matching.fix import BY_POINTS, LOCATED, NOT_HERE
from lcp_catalog.matching.joint_offset import find_joint_offset
from lcp_catalog.matching.options import FAINT, Options
from lcp_catalog.matching.point_choice import working_image
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.matching.search_area import SearchArea
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.validation.ground_comparison import compare

WITHIN_M = 2.0
BY_WINDOWS_M = np.array([0.41, -1.51])
"""East and north by windows of 64 m (docs/measurements/evidence.md), to 0.34 and 0.78 m."""
PATCH_M = 64.0
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
def photo(folder: Path, sun: SunChoice) -> Image:
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
    return open_catalog(pit.build_catalog(dems["smooth"], path))


def scores(photo: Image, ground: pit.Ground, side: int) -> np.ndarray:
    image, weight = pit.on_ground(photo, ground.nodes)
    return pit.window_scores(image, ground, pit.far_from_hole(ground, weight), side)


def in_place(found: np.ndarray) -> float:
    """Mean correlation of the windows at the map's own position."""
    middle = found.shape[1] // 2
    return float(found[:, middle, middle].mean())


@pytest.mark.slow
@pytest.mark.parametrize("side", [16, 32])
def test_registered_by_windows(photo: Image, grounds: dict[str, pit.Ground], side: int) -> None:
    """A map that was shifted on purpose is found with that shift."""
    at = pit.offset_of(scores(photo, grounds["smooth"], side))
    assert np.hypot(*at) < WITHIN_M
    moved = photo.with_sensor(photo.sensor.moved(MOVED_M))
    np.testing.assert_allclose(
        pit.offset_of(scores(moved, grounds["smooth"], side)) + MOVED_M, at, atol=0.15
    )


@pytest.mark.slow
@pytest.mark.parametrize("law", ["lommel-seeliger", "lunar-lambert", "hapke"])
@pytest.mark.parametrize("start", [(0.0, 0.0), MOVED_M])
def test_registered_by_points(
    photo: Image, catalog: Catalog, start: tuple[float, float], law: str
) -> None:
    """Single points agree with each other and with the windows, for every reflectance model and map
    position.
    """
    moved = photo.with_sensor(photo.sensor.moved(start))
    found = locate(catalog, moved, Uncertainty(5.0), reflectance_model(law))
    assert found.verdict == LOCATED
    assert found.by == BY_POINTS
    assert found.log10_false_alarms < -7.0
    off = found.pose.correction + start - BY_WINDOWS_M
    assert (np.abs(off) < 3.0 * found.pose.sigma).all()
    assert (found.pose.sigma < 1.2).all()


@pytest.mark.slow
def test_registered_by_faint_points(photo: Image, catalog: Catalog) -> None:
    found = locate(catalog, photo, Uncertainty(5.0), options=FAINT)
    assert found.verdict == LOCATED
    assert found.by == BY_POINTS
    assert np.hypot(*found.pose.correction) < WITHIN_M


@pytest.mark.slow
@pytest.mark.parametrize("how", ["left-right", "up-down", "90", "180", "270"])
def test_turned_or_mirrored_it_is_no_place(photo: Image, catalog: Catalog, how: str) -> None:
    for options in (Options(), FAINT):
        found = locate(catalog, mirrored(photo, how), Uncertainty(5.0), options=options)
        assert found.verdict == NOT_HERE


@pytest.mark.slow
def test_the_hole_in_both_files_decides_nothing(photo: Image, catalog: Catalog) -> None:
    """Noise with the spectrum of terrain around the image's own hole is rejected; terrain away from
    the hole is accepted.
    """
    dice = np.random.default_rng(0)
    shape = photo.signal.shape
    waves = np.meshgrid(np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1]), indexing="ij")
    for _ in range(3):
        spectrum = np.fft.rfft2(dice.normal(size=shape)) / np.maximum(np.hypot(*waves), 0.005)
        noise = np.where(photo.valid, np.fft.irfft2(spectrum, s=shape), np.nan)
        image = replace(photo, signal=noise.astype(np.float32))
        assert locate(catalog, image, Uncertainty(5.0)).verdict == NOT_HERE
    rows = np.flatnonzero(from_hole_m(photo, catalog) > 100.0)
    area = SearchArea(rows, np.zeros((len(rows), 2)), np.full(len(rows), 64.0))
    searched = working_image(catalog, photo, rows)
    law = reflectance_model("lunar-lambert")
    found = find_joint_offset(
        catalog, searched, photo.sensor, Uncertainty(5.0), law, area, PATCH_M / 0.5
    )
    assert found.log10_false_alarms < -6.0
    assert (np.abs(found.pose.correction - BY_WINDOWS_M) < 3.0 * found.pose.sigma).all()


def from_hole_m(photo: Image, catalog: Catalog) -> np.ndarray:
    """Distance of the catalogue's points from the edge of the hole, (n,)."""
    column, row = np.round(photo.sensor.project(catalog.position_mcmf)).astype(int).T
    away = cv2.distanceTransform(photo.valid.astype(np.uint8), cv2.DIST_L2, 5)
    return 0.5 * away[row.clip(0, len(away) - 1), column.clip(0, away.shape[1] - 1)]


@pytest.mark.slow
def test_smoothing_the_steps_pays(photo: Image, grounds: dict[str, pit.Ground]) -> None:
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
    photo: Image, dems: dict[str, Path], grounds: dict[str, pit.Ground]
) -> None:
    """With the Sun turned by 90 deg there is no correlation; from the opposite side light and dark
    are exchanged.
    """
    azimuth, elevation = (float(v) for v in azimuth_elevation(grounds["smooth"].scene.sun))
    right = in_place(scores(photo, grounds["smooth"], 32))
    assert right > 0.25
    for turn, low, high in ((90.0, -0.1, 0.1), (180.0, -0.4, -0.25)):
        turned = SunChoice(azimuth_deg=(azimuth + turn) % 360.0, elevation_deg=elevation)
        assert low < in_place(scores(photo, pit.Ground.of(dems["smooth"], turned), 32)) < high
