"""Flags of conditions, compared with counts by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from lcp_catalog.catalog.schema import (
    PROMISE,
    SCHEMA_VERSION,
    VARIABLES,
    summarise_usable,
    usable,
)


def test_files_of_a_schema_stay_readable() -> None:
    """A file is read only with the texts of its schema, which commit a3164fb3 wrote (2026-11-29): another text is another
    schema, and has its own entry."""
    told = json.loads(Path(__file__).with_name("schemas.json").read_text(encoding="utf-8"))
    own = {
        group: {
            name: [list(one.dims), one.dtype, one.units, one.long_name]
            for name, one in some.items()
        }
        for group, some in (("variables", VARIABLES), ("promise", PROMISE))
    }
    assert own == told[SCHEMA_VERSION]


def test_summary_of_usable_suns() -> None:
    condition = np.zeros((1, 1, 3, 3), dtype=np.uint8)
    condition[0, 0, :, 0] = [31, 15, 31]
    condition[0, 0, :, 1] = [15, 31, 0]
    lowest, highest = summarise_usable(condition, [10.0, 20.0, 30.0])
    np.testing.assert_array_equal(lowest, [[[10.0, 20.0, np.nan]]])
    np.testing.assert_array_equal(highest, [[[30.0, 20.0, np.nan]]])
    assert usable([31, 30, 15, 0]).tolist() == [True, False, False, False]
