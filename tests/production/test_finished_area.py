"""Figures of a catalogue that are summed up over conditions, counted by hand."""

from __future__ import annotations

import numpy as np

from lcp_catalog.production.finished_area import working_scales


def test_scales_at_which_a_point_works() -> None:
    """Four conditions at scales 1, 2, 4, a row each."""
    p = np.array(
        [
            [[0.95, 0.95, 0.95, 0.95], [0.95, 0.95, 0.2, 0.2], [0.95, 0.1, 0.1, 0.1]],  # 1 to 2
            [[0.95, 0.1, 0.1, 0.1], [0.95, 0.95, 0.95, 0.1], [0.95, 0.95, 0.1, 0.1]],  # 2 to 4
            [[0.95, 0.1, 0.1, 0.1], [0.1, 0.95, 0.95, 0.95], [0.1, 0.1, 0.1, 0.1]],  # shadows at 2
            [[0.1, 0.1, 0.1, 0.1], [0.1, 0.1, 0.1, 0.1], [0.1, 0.1, 0.1, 0.1]],  # never
            [[0.1, 0.1, 0.1, 0.1], [0.1, 0.1, 0.1, 0.1], [0.1, 0.1, 0.1, 0.95]],  # 4 alone
        ]
    ).reshape(5, 3, 1, 2, 2)
    condition = np.full((5, 1, 2, 2), 25, np.uint8)
    condition[2].ravel()[1:] = [1 + 16, 1 + 8, 0]
    finest, coarsest = working_scales(condition, p, np.array([1.0, 2.0, 4.0]), 0.9)
    assert finest.tolist() == [1.0, 2.0, 1.0, 1.0, 4.0]
    assert coarsest.tolist() == [2.0, 4.0, 1.0, 1.0, 4.0]
