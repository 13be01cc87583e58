"""Flags of conditions, compared with counts by hand."""

from __future__ import annotations

import numpy as np

from lcp_catalog.catalog.schema import summarise_usable, usable


def test_summary_of_usable_suns() -> None:
    condition = np.zeros((1, 1, 3, 3), dtype=np.uint8)
    condition[0, 0, :, 0] = [31, 15, 31]
    condition[0, 0, :, 1] = [15, 31, 0]
    lowest, highest = summarise_usable(condition, [10.0, 20.0, 30.0])
    np.testing.assert_array_equal(lowest, [[[10.0, 20.0, np.nan]]])
    np.testing.assert_array_equal(highest, [[[30.0, 20.0, np.nan]]])
    assert usable([31, 30, 15, 0]).tolist() == [True, False, False, False]
