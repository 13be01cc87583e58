"""Map-projected images under a high Sun, whose points are faint.
Skipped without the shared data, which may not be distributed. `locate_maps.py` of c896266 made the
figures of docs/measurements/matching-and-pose.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import apollo_maps as maps

from lcp_catalog.matching.fix import BY_POINTS, LOCATED
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.matching.sun_check import with_sun
from lcp_catalog.photometry.laws import reflectance_model

LAW = reflectance_model("lunar-lambert")


@pytest.mark.slow
def test_maps_under_a_high_sun(shared_data: Path, tmp_path: Path) -> None:
    """Frames of the Apollo 16 series under Suns of 46 to 54 deg, whose patches are weak or ambiguous
    more often than found: their corrections agree with those of the whole series, whose control net is older and whose
    frames differ by 259 and 180 m (`apollo_maps.NET_M`).
    """
    catalog = maps.built(shared_data, tmp_path)
    for key in ("AS16-M-2806", "AS16-M-2962", "AS16-M-2958"):
        photo = maps.frame(shared_data, key)
        answer = locate(catalog, photo, maps.UNCERTAIN, LAW)
        assert answer.verdict == LOCATED
        assert answer.matches.found.sum() >= 30  # 99, 84 and 49 of some 300 when this was written
        spread = np.hypot(answer.pose.sigma, [259.0, 180.0])
        assert (np.abs(answer.pose.correction - maps.NET_M) < 3.0 * spread).all()
        for _, image in maps.not_this_place(photo, [], int(key[-4:])):
            wrong = locate(catalog, image, maps.UNCERTAIN, LAW)
            assert wrong.pose is None
            assert wrong.by == BY_POINTS
        for turn_deg in (
            120.0,
            150.0,
            -150.0,
            180.0,
        ):  # the map's brightness shows a place some cells off
            wrong = locate(
                catalog, with_sun(photo, maps.middle(photo), turn_deg, 0.0), maps.UNCERTAIN, LAW
            )
            assert wrong.pose is None
