"""The part of a large catalogue that a validation reads for an image."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import many_points
from helpers.twins_match import looking_at

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.model import StoredArray, held
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.images.image import Image
from lcp_catalog.matching.options import Options
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.validation.run import _perhaps_seen


def taken(camera: Camera) -> Image:
    """A blank image, with the Sun above its camera."""
    blank = np.ones(camera.shape, np.float32)
    up = camera.position_mcmf_m / np.linalg.norm(camera.position_mcmf_m)
    return Image("blank", blank, blank, camera, sun_direction_mcmf=up)


def test_points_far_from_the_image_stay_in_the_file(tmp_path: Path) -> None:
    write_catalog(many_points.catalog(4000), tmp_path / "c.h5")
    whole = open_catalog(tmp_path / "c.h5")
    camera = looking_at(EnuFrame(10.0, 5.0), 300e3, 0.0, 0.0, 0.0, 500.0, (256, 256))
    request = SimpleNamespace(uncertainty=Uncertainty(position_m=2000.0, attitude_rad=0.01))
    part = _perhaps_seen(request, whole, taken(camera), Options())
    seen = whole.point_id[points_in_view(whole, camera)]
    assert len(seen) > 0
    assert set(seen) <= set(part.point_id)
    assert len(part) < 100
    np.testing.assert_array_equal(part.dem, whole.part("dem", part.point_id))
    for name in ("dem", "condition", "sigma_major"):
        assert isinstance(held(whole, name), StoredArray)


@pytest.mark.slow
def test_of_several_levels_those_that_suit_the_pixel_are_read(tmp_path: Path) -> None:
    """Pixels of 600 m: the finest level is too fine, and the coarsest too coarse."""
    made = many_points.catalog(4000)
    level = (np.arange(len(made)) % 3).astype(np.int32)
    cell_m = np.array([100.0, 500.0, 1000.0])[level]
    cells = {"level": level, "gsd": cell_m, "gsd_min": cell_m, "gsd_max": 2.0 * cell_m}
    write_catalog(replace(made, **cells), tmp_path / "c.h5")
    whole = open_catalog(tmp_path / "c.h5")
    camera = looking_at(EnuFrame(10.0, 5.0), 300e3, 0.0, 0.0, 0.0, 500.0, (256, 256))
    request = SimpleNamespace(uncertainty=Uncertainty(position_m=2000.0, attitude_rad=0.01))
    part = _perhaps_seen(request, whole, taken(camera), Options())
    assert len(part) > 0
    assert set(part.level) == {1}


def test_a_catalogue_without_points_in_view_stays_as_it_is(tmp_path: Path) -> None:
    write_catalog(many_points.catalog(50), tmp_path / "c.h5")
    whole = open_catalog(tmp_path / "c.h5")
    camera = looking_at(EnuFrame(0.0, 89.0), 100e3, 0.0, 0.0, 0.0, 500.0, (256, 256))
    request = SimpleNamespace(uncertainty=Uncertainty(position_m=2000.0, attitude_rad=0.01))
    assert _perhaps_seen(request, whole, taken(camera), Options()) is whole
