"""What ``lcp render`` wrote, read back by rasterio alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rasterio


def read(path: Path | str) -> tuple[dict[str, np.ndarray], Any, dict[str, str]]:
    """Bands by name, the profile, the tags."""
    with rasterio.open(path) as file:
        bands = dict(zip(file.descriptions, file.read(), strict=True))
        return bands, file.profile, file.tags()
