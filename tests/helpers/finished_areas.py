"""Finished areas of a build with random figures."""

from __future__ import annotations

import numpy as np

from lcp_catalog.production.finished_area import TABLE, FinishedArea, checksums
from lcp_catalog.rendering.decisions import Decision
from lcp_catalog.rendering.plan import ScenePlan

KIND = np.dtype([("dem", "<f4", (3, 3)), ("condition", "u1", (5,))])


def area(seed: int, usable: tuple[int, ...]) -> FinishedArea:
    """Candidates with so many usable conditions, and random records of the usable ones."""
    rng = np.random.default_rng(seed)
    table = np.zeros(len(usable), TABLE)
    table["lon_deg"], table["worth"] = np.arange(len(usable)) + seed, usable
    records = np.zeros(np.count_nonzero(usable), KIND)
    records["dem"] = rng.normal(size=(len(records), 3, 3))
    records["condition"] = rng.integers(0, 32, (len(records), 5))
    table["checksum"][table["worth"] > 0] = checksums(records)
    decision = Decision("effect", False, f"of area {seed}", 0.1 * seed, "m")
    return FinishedArea(table, records, ScenePlan.of([decision] * 8))
