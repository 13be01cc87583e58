"""The finest useful cell: of what the DEM resolves, not of its posting."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.catalogs import HADLEY
from helpers.products import DEGREE_M, geotiff

from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import AreaError
from lcp_catalog.terrain.area import Area
from lcp_catalog.terrain.useful_cell import CELL_PER_RESOLUTION, cell_for, useful_cell


@pytest.mark.parametrize("posting_m", [5.0, 118.45, 1895.2])
@pytest.mark.parametrize("times", [1.0, 1.3, 2.0, 5.7, 8.3, 11.5, 40.0])
def test_the_cell_is_the_posting_times_a_power_of_two_below_half_the_resolution(
    posting_m: float, times: float
) -> None:
    wanted = CELL_PER_RESOLUTION * times * posting_m
    found = cell_for(posting_m, times * posting_m)
    powers = posting_m * 2.0 ** np.arange(8)
    below = powers[powers <= 1.07 * wanted]
    assert found == (below[-1] if len(below) else posting_m)


def test_gld100_has_cells_of_four_postings() -> None:
    """Its heights resolve about 1 km on a posting of 118.45 m."""
    cell = useful_cell(DemSet.open([HADLEY]), Area(3.5, 26.0, 60.0))
    assert cell.gsd_m == pytest.approx(473.8, abs=0.1)
    assert "4 times the posting of hadley_gld100_256ppd.tif" in cell.reason
    assert "by its heights" in cell.reason


def test_heights_that_cannot_tell_keep_their_posting(tmp_path: Path) -> None:
    path = geotiff(tmp_path / "mine.tif", np.zeros((20, 20), np.float32), 0.0, DEGREE_M, 500.0)
    cell = useful_cell(DemSet.open([path]), Area(0.1, 0.9, 2.0))
    assert cell.gsd_m == 500.0
    assert "too few heights" in cell.reason


def test_a_region_without_heights_has_no_cell() -> None:
    with pytest.raises(AreaError):
        useful_cell(DemSet.open([HADLEY]), Area(100.0, 0.0, 10.0))
