"""Limit of the memory in which a process keeps what it has read of DEM files: tiles of means, and GDAL's blocks."""

from __future__ import annotations

from .block_cache import LIMIT_BYTES, limit
from .raster import GDAL_CACHE_BYTES, limit_gdal_cache

CACHES_BYTES = LIMIT_BYTES + GDAL_CACHE_BYTES
"""Greatest size of the caches together, which is also the size without a limit of the caller's."""


def limit_caches(size_bytes: int) -> None:
    """Let the caches of this process take so much memory together, half each, at most `CACHES_BYTES`.
    What is read does not depend on it.
    """
    limit(size_bytes // 2)
    limit_gdal_cache(size_bytes // 2)
