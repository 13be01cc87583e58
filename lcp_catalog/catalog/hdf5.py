"""The catalogue as an HDF5 file that is also netCDF-4: `writing` writes it; `verification` opens and
checks it.
"""

from __future__ import annotations

from .catalogue import Catalog
from .model import Coverage, Overview
from .schema import SCHEMA_VERSION
from .verification import open_catalog, verify
from .writing import new_catalog, write_catalog

__all__ = [
    "SCHEMA_VERSION",
    "Catalog",
    "Coverage",
    "Overview",
    "new_catalog",
    "open_catalog",
    "verify",
    "write_catalog",
]
