"""A build from a DEM and an albedo map on a server: the same points, size and ETag as their source, and no mixture of two."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers.range_server import range_server
from helpers.small_commands import BUILD
from lcp_cli.main import run

import lcp_catalog as lcp
from lcp_catalog.errors import AreaFailedError, DemError
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.production.run import Build
from lcp_catalog.remote_files import first_state

SAMPLE = Path(lcp.__file__).parent.parent / "sample_data"
DEM, MAP = "hadley_gld100_256ppd.tif", "hadley_albedo_643nm_11ppd.tif"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    for name in (DEM, MAP):
        (tmp_path / name).write_bytes((SAMPLE / name).read_bytes())
    return tmp_path


def change(file: Path) -> None:
    """Another content of the same size."""
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)


@pytest.mark.slow
def test_a_build_from_a_server(folder: Path) -> None:
    config, makes = folder / "build.toml", []
    with range_server(folder) as served:
        for place in (str(folder), served.url):
            model = f'albedo = "{place}/{MAP}", accuracy'
            config.write_text(BUILD.replace("accuracy", model, 1))
            makes.append(folder / f"{len(makes)}.h5")
            words = ["build-catalog", f"{place}/{DEM}", "--config", str(config), "--jobs", "2"]
            assert run([*words, "-o", str(makes[-1])]) == 0
    here, there = (lcp.open_catalog(path) for path in makes)
    assert len(there) > 0
    with h5py.File(makes[0]) as one, h5py.File(makes[1]) as other:
        for name in ("point_id", "dem", "detection_probability", "condition"):
            np.testing.assert_array_equal(one[name][:], other[name][:])
    (source,), (of_map,) = there.sources, (there.albedo_map or {})["files"]
    assert source.keys() == of_map.keys() == {"name", "size", "etag"}
    assert source["size"] == here.sources[0]["size"]
    assert lcp.inspect(makes[1])["intact"]
    assert run(["report", str(makes[1]), "-o", str(folder / "r.html")]) == 0
    assert "ETag" in (folder / "r.html").read_text()


@pytest.mark.slow
def test_a_file_that_changes_on_the_server_is_noticed(folder: Path) -> None:
    config = folder / "build.toml"
    config.write_text(BUILD.replace("accuracy", f'albedo = "{MAP}", accuracy', 1))
    with range_server(folder) as served:
        plan = Build.plan((Path(f"{served.url}/{DEM}"),), BuildConfig.from_toml(config))
        facts = plan.facts()
        plan.inputs.require_unchanged()
        change(folder / DEM)
        with pytest.raises(AreaFailedError, match="was changed"):
            plan.inputs.require_unchanged()
        with pytest.raises(DemError, match="has changed since this process first read it"):
            Build.plan((Path(f"{served.url}/{DEM}"),), BuildConfig.from_toml(config))
        first_state.cache_clear()  # as another process
        later = Build.plan((Path(f"{served.url}/{DEM}"),), BuildConfig.from_toml(config))
        assert later.facts() != facts  # parts, a resumed build and a merge compare these
