"""Inputs are read for their sums once a build: parts and workers compare size, times and inode, and read what differs."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from helpers.small_build import CONFIG, DEM

from lcp_catalog import atomic_files
from lcp_catalog.atomic_files import file_facts, know_sums, known_sums
from lcp_catalog.errors import OutputExistsError
from lcp_catalog.production import run
from lcp_catalog.production.cluster import Expected
from lcp_catalog.production.run import Build, BuildPart, BuildRun


def another_process(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Forget all sums; return the list of the files that are read for theirs from now on."""
    read, digest = list[str](), atomic_files._digest_of

    def noted(path: str) -> str:
        read.append(Path(path).name)
        return digest(path)

    monkeypatch.setattr(atomic_files, "_digest_of", noted)
    monkeypatch.setattr(atomic_files, "_SUMS", {})
    atomic_files._sha256.cache_clear()
    return read


@pytest.fixture
def dem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy whose last change is long ago, by a clock that is ahead."""
    path = shutil.copy(DEM, tmp_path / DEM.name)
    with Path(path).open("ab") as file:
        file.write(bytes(8))  # beyond what GDAL reads
    now = atomic_files.time.time_ns
    monkeypatch.setattr(atomic_files.time, "time_ns", lambda: now() + 3_000_000_000)
    return Path(path)


def part(dem: Path, number: int) -> None:
    BuildRun(Build.plan((dem,), CONFIG), dem.with_name("c.h5")).part(BuildPart(number, 3))


def test_a_part_reads_nothing_that_another_has_read(
    dem: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run.BuildRun, "_compute", lambda self, jobs: {})
    read = another_process(monkeypatch)
    part(dem, 1)
    assert read == [DEM.name]
    read = another_process(monkeypatch)
    part(dem, 2)
    assert read == []
    os.utime(dem)  # the same content
    read = another_process(monkeypatch)
    part(dem, 2)
    assert read == [DEM.name]
    read = another_process(monkeypatch)
    part(dem, 3)
    assert read == []


def test_a_replaced_file_is_noticed_although_size_and_time_are_the_same(
    dem: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run.BuildRun, "_compute", lambda self, jobs: {})
    part(dem, 1)
    facts, content = os.stat(dem), bytearray(dem.read_bytes())
    content[-1] ^= 1
    dem.write_bytes(content)
    os.utime(dem, ns=(facts.st_atime_ns, facts.st_mtime_ns))
    another_process(monkeypatch)
    with pytest.raises(OutputExistsError, match="content of the files"):
        part(dem, 2)


def test_a_file_that_has_just_changed_is_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Path(shutil.copy(DEM, tmp_path))
    another_process(monkeypatch)
    file_facts([path])
    assert known_sums() == []


def test_a_worker_reads_only_what_differs(dem: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    another_process(monkeypatch)
    expected = Expected.here([dem])
    read = another_process(monkeypatch)
    assert expected.difference() is None
    assert read == []
    dem.write_bytes(dem.read_bytes()[:-1] + b"\1")
    assert "other content" in str(expected.difference())
    assert read == [DEM.name]


@pytest.mark.parametrize("found", [None, 3, "x", [1], [[1, 2, 3, "s"]], [["a"] * 5], {"a": 1}])
def test_what_is_no_table_of_sums_is_left(found: object, monkeypatch: pytest.MonkeyPatch) -> None:
    another_process(monkeypatch)
    know_sums(json.loads(json.dumps(found)))
    assert known_sums() == []
