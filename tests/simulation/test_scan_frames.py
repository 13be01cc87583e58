"""Simulated images of line scanners and push-frame cameras."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.products import cylinder
from helpers.scan_files import scan
from scipy import ndimage
from simulation.test_frame import APART, CELL_M, LAW, PLACE, patches, rolling

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.camera_file import read_sensor
from lcp_catalog.cameras.frame_camera import Camera, fields_of_plane
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import AreaError, CameraError
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.simulation.detector import Detector
from lcp_catalog.simulation.frame import DemSurface, frame
from lcp_catalog.simulation.patch_surface import PatchSurface

WHERE = {"place": (PLACE.lon_deg, PLACE.lat_deg), "subsolar": (230.0, -10.0)}


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rolling hills, 1.5 degrees wide, at 64 pixels a degree."""
    made = tmp_path_factory.mktemp("dem") / "hills.tif"
    return cylinder(made, 199.65, -29.85, (96, 96), 64, rolling)


def seen(dem: Path, sensor, margin_px: int = 0) -> DemSurface:
    how = {"accuracy": TIERS["reference"], "disc": False, "model": LAW}
    return DemSurface.seen(Request(DemSet.open([dem]), view=ViewChoice(sensor), **how), margin_px)


def scanner(folder: Path, kind: str = "LINE_SCANNER", **changes):
    how = {"pixel_m": CELL_M, "altitude_m": 80e3, "shape": (36, 40), "lasts_s": 10.0}
    return read_sensor(scan(folder / f"{kind}.json", kind, **(WHERE | how | changes)))


def test_a_line_is_seen_during_its_whole_time(dem, tmp_path):
    """A pixel is the mean of the rays of its parts, each at its own time, by the scanner's own rays."""
    lines = scanner(tmp_path)
    ground = seen(dem, lines)
    found = frame(ground, lines, Detector(), 3).radiance
    column, row = np.meshgrid(np.arange(120), np.arange(108))
    origins, rays = lines.looks(np.stack([(column + 0.5) / 3 - 0.5, (row + 0.5) / 3 - 0.5], -1))
    fine = lines.part((0, 36, 0, 40), 3)
    at, towards = fine.looks(np.stack([column, row], -1))
    assert np.abs(at - origins).max() < 1e-6
    assert np.abs(towards - rays).max() < 1e-12
    light = ground.radiance(fine).reshape(36, 3, 40, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(found, light, rtol=1e-5)
    centres = ground.radiance(lines)
    assert np.abs(centres - light).mean() > 0.005 * light.mean()
    np.testing.assert_allclose(frame(ground, lines, Detector(), 1).radiance, centres, rtol=1e-6)


def test_framelets_are_frames_of_their_own(dem, tmp_path):
    """Each as a frame camera at its time takes it, with blur: its light is not mixed with that of the
    framelets beside it.
    """
    frames, detector = scanner(tmp_path, "PUSH_FRAME"), Detector(blur_px=1.2)
    ground = seen(dem, frames, detector.margin_px)
    found = frame(ground, frames, detector, 2).radiance
    assert found.shape == (36, 40)
    assert np.isfinite(found).all()
    for k, one in enumerate(frames.exposures):
        now = np.full(3, one.middle_s)
        camera = Camera(
            **fields_of_plane(one.plane),
            position_mcmf_m=one.trajectory.positions(now)[0],
            rotation_mcmf_to_camera=one.trajectory.to_mcmf(now, np.eye(3)),
            image_size_px=(40, 12),
        )
        alone = frame(ground, camera, detector, 2).radiance
        np.testing.assert_allclose(found[12 * k : 12 * k + 12], alone, rtol=1e-4)


@pytest.mark.parametrize("blur_px", [0.0, 1.5])
def test_blur_reaches_into_a_scan_from_outside(dem, tmp_path, blur_px):
    lines = scanner(tmp_path, shape=(30, 30))
    ground = seen(dem, lines, 12)
    found = frame(ground, lines, Detector(blur_px=blur_px), 4).radiance
    wide = frame(ground, lines.around(12), Detector(), 4).radiance.astype(float)
    judged = ndimage.gaussian_filter(wide, blur_px, truncate=6.0) if blur_px else wide
    assert np.abs(found - judged[12:-12, 12:-12]).max() / found.mean() < 1e-3


@pytest.mark.slow
def test_patches_under_a_scanner_are_islands_of_the_dem(dem, tmp_path):
    for kind in ("LINE_SCANNER", "PUSH_FRAME"):
        how = {"shape": (120, 120), "subsolar": (210.0, -20.0)}
        lines = scanner(tmp_path, kind, **how)
        islands = PatchSurface(
            patches(dem, APART), Path("x.h5"), lines.sun_position_mcmf_m, LAW, disc=False
        )
        whole, alone = (
            frame(ground, lines, Detector(), 2).radiance for ground in (seen(dem, lines), islands)
        )
        known = np.isfinite(alone)
        assert ndimage.label(known)[1] >= 2
        inner = ndimage.binary_erosion(known, iterations=2)
        assert inner.sum() > 300
        off = np.abs(alone - whole)[inner] / np.nanmean(whole)
        assert off.max() < 0.03


def test_a_scanner_that_sees_nothing_is_refused(dem, tmp_path):
    with pytest.raises(AreaError, match="covers"):
        seen(dem, scanner(tmp_path, place=(20.0, 30.0)))
    lines = scanner(tmp_path)
    away = scanner(tmp_path, "PUSH_FRAME", place=(210.0, -30.0))
    with pytest.raises(CameraError, match="sees nothing"):
        frame(seen(dem, lines), replace(away, name="away"), Detector(), 1)
