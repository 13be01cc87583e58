"""Inputs are read for their sums once a build: parts and workers compare size, times and inode, and read what differs."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path

import pytest
from helpers.small_build import CONFIG, DEM

import lcp_catalog as lcp
from lcp_catalog import atomic_files
from lcp_catalog.atomic_files import (
    are_as_noted,
    file_facts,
    know_sums,
    known_sums,
    unread_facts,
)
from lcp_catalog.errors import OutputExistsError
from lcp_catalog.production import run
from lcp_catalog.production.cluster import Expected
from lcp_catalog.production.run import Build, BuildPart, BuildRun

pytestmark = pytest.mark.usefixtures("areas_once")


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


def compute_nothing(monkeypatch: pytest.MonkeyPatch, reads: bool) -> None:
    """``reads``: a part spends as much time as allows to read its inputs."""
    spent_s = 1e9 if reads else 0.0
    monkeypatch.setattr(BuildRun, "_compute", lambda self, jobs: self._read_inputs(spent_s) or {})


@pytest.mark.slow
def test_a_part_reads_nothing_that_another_has_read(
    dem: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compute_nothing(monkeypatch, reads=True)
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


@pytest.mark.slow
def test_short_parts_read_no_input_for_its_sum(dem: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They know it by its state. The merge reads it, for the catalogue's `sources`."""
    monkeypatch.setattr(run, "_READ_SHARE", 0.0)
    for number in (1, 2, 3):
        read = another_process(monkeypatch)
        part(dem, number)
        assert read == []
    BuildRun(Build.plan((dem,), CONFIG), output := dem.with_name("c.h5")).merge()
    assert read == [DEM.name]
    sums = [one["sha256"] for one in lcp.open_catalog(output).sources]
    assert sums == [hashlib.sha256(dem.read_bytes()).hexdigest()]


@pytest.mark.slow
@pytest.mark.parametrize("whole", [False, True])
def test_a_file_that_is_written_before_its_content_was_noted_is_another(
    whole: bool, dem: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with monkeypatch.context() as patch:
        compute_nothing(patch, reads=False)
        part(dem, 1)
    os.utime(dem)
    another_process(monkeypatch)
    later = BuildRun(Build.plan((dem,), CONFIG), dem.with_name("c.h5"), resume=True)
    with pytest.raises(OutputExistsError, match="content of the files"):
        later.whole() if whole else later.merge()
    assert f"{dem}: was written or touched before its content was noted" in caplog.text


@pytest.mark.slow
def test_a_whole_build_goes_on_with_parts_that_did_not_read(
    dem: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "_READ_SHARE", 0.0)
    part(dem, 1)
    another_process(monkeypatch)
    counts = list[int]()
    build = Build.plan((dem,), CONFIG)
    output = dem.with_name("c.h5")
    BuildRun(build, output, resume=True, progress=lambda done, total: counts.append(done)).whole()
    assert counts[0] == len(build.jobs[::3])


@pytest.mark.slow
@pytest.mark.parametrize("first_reads", [False, True])
def test_parts_that_start_together_agree_whether_they_have_read_or_not(
    first_reads: bool, dem: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second has looked into the folder before the first one has noted its files."""
    compute_nothing(monkeypatch, reads=False)
    build = Build.plan((dem,), CONFIG)
    first, second = (BuildRun(build, dem.with_name("c.h5")) for _ in range(2))
    looked, read = (second, first) if first_reads else (first, second)
    assert looked.checkpoints.files[0].keys() == {"name", "state"}
    build.inputs.digest()
    assert read.checkpoints.files[0].keys() == {"name", "size", "sha256"}
    first.part(BuildPart(1, 3))
    second.part(BuildPart(2, 3))


def test_an_input_in_another_file_system_than_the_output_is_read(
    dem: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other machines may have copies, whose states differ."""
    read = another_process(monkeypatch)
    here = os.stat(dem)
    (known,) = unread_facts([dem], dem.parent)
    assert known["state"] == [here.st_ino, here.st_size, here.st_mtime_ns, here.st_ctime_ns]
    assert read == []
    (other,) = unread_facts([dem], Path("/proc"))
    assert other == file_facts([dem])[0]


@pytest.mark.parametrize(
    "noted", [None, {}, [], [1], [{}], [{"state": 3}], [{"name": DEM.name, "state": [[1]]}]]
)
def test_what_is_no_note_of_files_is_not_that_of_the_same(noted: object, dem: Path) -> None:
    assert not are_as_noted([dem], noted)
    assert are_as_noted([dem], unread_facts([dem], dem.parent))
    assert are_as_noted([dem], file_facts([dem]))


@pytest.mark.slow
def test_a_replaced_file_is_noticed_although_size_and_time_are_the_same(
    dem: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compute_nothing(monkeypatch, reads=True)
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
