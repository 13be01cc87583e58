"""The small build, planned and built once."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from helpers import areas_once as once
from helpers import merges
from helpers.small_build import CONFIG, DEM

from lcp_catalog.catalog import comparison
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.production import run
from lcp_catalog.production.run import Build, BuildRun


@pytest.fixture(scope="session")
def plan() -> Build:
    return Build.plan((DEM,), CONFIG)


@pytest.fixture(scope="session")
def built(plan: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Once for all workers of a parallel run, each of which has a copy."""
    output, folder = tmp_path_factory.mktemp("build") / "small.h5", tmp_path_factory.getbasetemp()
    shared = (folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "small.h5"
    if not shared.is_file():
        BuildRun(plan, output).whole()
        output.replace(shared)
    shutil.copy(shared, output)
    return output


@pytest.fixture
def areas_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Areas of the same configuration are computed once in this process."""
    monkeypatch.setattr(run, "run_area", once.run_area)


@pytest.fixture(scope="module")
def inputs() -> list[Catalog]:
    """Two catalogues to merge."""
    return merges.neighbours()


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catalogues that a test wrote are read unchecked."""
    monkeypatch.setattr(comparison, "open_catalog", lambda path, check=True: merges.read(path))
