"""The small build, planned and built once."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.small_build import CONFIG, DEM

from lcp_catalog.production.run import Build, BuildRun


@pytest.fixture(scope="session")
def plan() -> Build:
    return Build.plan((DEM,), CONFIG)


@pytest.fixture(scope="session")
def built(plan: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("build") / "small.h5"
    BuildRun(plan, output).whole()
    return output
