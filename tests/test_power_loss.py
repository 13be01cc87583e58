"""After a loss of power at any moment an output is the old one, the new one, or absent; a command that has
ended has its output on the disk.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from helpers import catalogs
from helpers.power_loss import Recorder
from helpers.small_build import CONFIG, DEM
from lcp_cli.main import run

from lcp_catalog import atomic_files
from lcp_catalog.atomic_files import write_bytes
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.choices import EXPORTS

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="names of open files: /proc")


def files(path: Path) -> dict[str, bytes]:
    """Content of an output, a file or a folder, by path from its parent."""
    found = [path] if path.is_file() else [one for one in path.rglob("*") if one.is_file()]
    return {str(one.relative_to(path.parent)): one.read_bytes() for one in found}


def require_whole(log: Recorder, output: Path, old: dict[str, bytes]) -> None:
    """Each state after a failure is the old output or the new one, and the last one is the new."""
    new, states = files(output), list(log.after_failures(output.name))
    assert new
    assert all(state in (old, new) for state in states)
    assert states[-1] == new
    assert "." in set.union(*log.safe), "the folder is never synced"
    last = max(k for k, synced in enumerate(log.safe) if "." in synced)
    assert log.steps[last][0].keys() >= new.keys(), "the name is given after the folder was synced"


@pytest.mark.slow
@pytest.mark.parametrize("ending", EXPORTS)
def test_an_export(ending: str, tmp_path: Path) -> None:
    """One that is new, and one that replaces another."""
    write_catalog(catalogs.catalog(3), tmp_path / "c.h5")
    (tmp_path / "out").mkdir()
    output = tmp_path / "out" / f"x{ending}"
    words = ["export", str(tmp_path / "c.h5"), "-o", str(output), "--overwrite"]
    old: dict[str, bytes] = {}
    for frame in ("MOON_ME", "MOON_PA"):
        with Recorder(output.parent).recording() as log:
            assert run([*words, "--frame", frame]) == 0
        require_whole(log, output, old)
        old = files(output)


@pytest.mark.slow
def test_a_build(tmp_path: Path) -> None:
    """The catalogue, and every checkpoint of its areas."""
    (tmp_path / "b.toml").write_text(CONFIG.to_toml())
    (tmp_path / "out").mkdir()
    output = tmp_path / "out" / "x.h5"
    with Recorder(output.parent).recording() as log:
        words = ["build-catalog", str(DEM), "--config", str(tmp_path / "b.toml"), "--size", "40"]
        assert run([*words, "--accuracy", "draft", "-o", str(output)]) == 0
    require_whole(log, output, {})
    areas = {name for names, _ in log.steps for name in names if name.endswith(".area")}
    areas = {name for name in areas if "/." not in name}
    assert areas
    for area in areas:
        whole = {number: kept for _, kept in log.steps for number in kept}
        seen = [names[area] for names, _ in log.steps if area in names]
        assert seen
        assert all(number in whole for number in seen)


@pytest.mark.parametrize("kind", ["file", "folder", "parent"])
def test_a_missing_sync_is_seen(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The recorder finds a file that is not synced before its name is given, a folder's file that is not,
    and a parent that is not synced after it.
    """
    (tmp_path / "out").mkdir()
    output = tmp_path / "out" / "x"
    sync = atomic_files._sync

    def less(path: Path) -> None:
        if path == output.parent and kind == "parent":
            return
        if path != output.parent and kind != "parent" and path.is_file():
            return
        sync(path)

    monkeypatch.setattr(atomic_files, "_sync", less)
    with Recorder(output.parent).recording() as log:
        if kind == "folder":
            with atomic_files.folder_aside(output) as aside:
                (aside / "a").write_bytes(b"1")
        else:
            write_bytes(output, os.urandom(9))
    with pytest.raises(AssertionError):
        require_whole(log, output, {})
