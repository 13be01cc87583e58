"""Files that benchmarks read: the sample's, and the shared lunar data."""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
"""The checkout."""
SAMPLE = ROOT / "sample_data"
DEM = SAMPLE / "hadley_gld100_256ppd.tif"
CONFIG = SAMPLE / "hadley.toml"
OUTPUT = ROOT / "build" / "benchmarks"
"""Where results go unless another folder is named."""


def shared_data() -> Path:
    """The folder of photographs and DEMs that are not in the repository: ``LCP_SHARED_DATA``, else beside or
    in the checkout. It may not be there.
    """
    if "LCP_SHARED_DATA" in os.environ:
        return Path(os.environ["LCP_SHARED_DATA"])
    places = (ROOT.parent / "shared" / "data", ROOT / "shared" / "data")
    return next((place for place in places if place.is_dir()), places[0])
