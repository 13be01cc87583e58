"""Problems of a catalogue, as users are told them."""

from __future__ import annotations

from pathlib import Path

from lcp_catalog.catalog.summary import describe
from lcp_catalog.errors import CatalogError


def verify(path: Path | str) -> list[str]:
    """All that `lcp inspect` says of a file, one line each; empty if it is intact."""
    try:
        return list(describe(path)["problems"])
    except CatalogError as error:
        return [str(error).removeprefix(f"{path}: ")]
