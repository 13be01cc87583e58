"""Paths that tests share. The real data beside the checkout are optional: a test that needs them
says so by its fixture.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

HERE = Path(__file__).resolve().parent


@pytest.fixture(scope="session")
def data() -> Path:
    """The small files that the repository holds (see PROVENANCE.md there)."""
    return HERE / "data"


@pytest.fixture(scope="session")
def labels(data: Path) -> Path:
    """Exact texts of PDS3 labels."""
    return data / "labels"


@pytest.fixture(scope="session")
def ldem_4(data: Path) -> Path:
    """Folder of the archive's own LDEM_4: .IMG and .JP2 with their labels."""
    return data / "ldem_4"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real lunar data: ``LCP_SHARED_DATA``, or ``shared/data`` in or beside the checkout; skipped
    without.
    """
    root = HERE.parent
    places = [root / "shared" / "data", root.parent / "shared" / "data"]
    if "LCP_SHARED_DATA" in os.environ:
        places = [Path(os.environ["LCP_SHARED_DATA"])]
    for place in places:
        if place.is_dir():
            return place
    pytest.skip("the shared lunar data are not here; set LCP_SHARED_DATA to their folder")


settings.register_profile(
    "ci", derandomize=True
)  # a landing never hangs on the day's dice; people's runs explore
if os.environ.get("CI"):
    settings.load_profile("ci")
