"""What appears under its own name is whole; what fails leaves nothing behind."""

# ruff: noqa: PT012 - the block of a context manager is what is tested

import errno
import os
import shutil
import subprocess
import sys

import pytest

from lcp_catalog import atomic_files
from lcp_catalog.atomic_files import (
    check_output,
    depfile_rule,
    folder_aside,
    write_aside,
    write_bytes,
)
from lcp_catalog.errors import OutputError, OutputExistsError


def names(folder):
    return sorted(os.listdir(folder))


def test_appears_only_when_the_block_ends(tmp_path):
    with write_aside(tmp_path / "a.bin") as aside:
        aside.write_bytes(b"half")
        assert aside.parent == tmp_path
        assert not (tmp_path / "a.bin").exists()
        aside.write_bytes(b"whole")
    assert names(tmp_path) == ["a.bin"]
    assert (tmp_path / "a.bin").read_bytes() == b"whole"


def test_mode_is_that_of_a_plain_open(tmp_path):
    write_bytes(tmp_path / "a.bin", b"x")
    (tmp_path / "b.bin").write_bytes(b"x")
    assert (tmp_path / "a.bin").stat().st_mode == (tmp_path / "b.bin").stat().st_mode
    assert (tmp_path / "a.bin").stat().st_nlink == 1


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, SystemExit, MemoryError])
def test_a_failed_block_leaves_nothing_and_keeps_the_old(tmp_path, error):
    write_bytes(tmp_path / "old.bin", b"old")
    for name, overwrite in (("old.bin", True), ("new.bin", False)):
        with pytest.raises(error), write_aside(tmp_path / name, overwrite) as aside:
            aside.write_bytes(b"half")
            raise error
    assert names(tmp_path) == ["old.bin"]
    assert (tmp_path / "old.bin").read_bytes() == b"old"


def test_overwrites_only_when_told(tmp_path):
    write_bytes(tmp_path / "a.bin", b"1")
    with pytest.raises(OutputExistsError, match=r"a\.bin exists; use `overwrite`"):
        write_bytes(tmp_path / "a.bin", b"2")
    assert (tmp_path / "a.bin").read_bytes() == b"1"
    write_bytes(tmp_path / "a.bin", b"2", overwrite=True)
    assert (tmp_path / "a.bin").read_bytes() == b"2"


def test_does_not_replace_what_appeared_meanwhile(tmp_path):
    with (
        pytest.raises(OutputExistsError, match="created by another process"),
        write_aside(tmp_path / "a.bin") as aside,
    ):
        aside.write_bytes(b"mine")
        (tmp_path / "a.bin").write_bytes(b"theirs")
    assert names(tmp_path) == ["a.bin"]
    assert (tmp_path / "a.bin").read_bytes() == b"theirs"


def test_a_link_is_followed_not_replaced(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "a.bin").symlink_to(tmp_path / "real" / "b.bin")
    write_bytes(tmp_path / "a.bin", b"x")
    assert (tmp_path / "a.bin").is_symlink()
    assert (tmp_path / "real" / "b.bin").read_bytes() == b"x"


def test_places_that_cannot_hold_an_output(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="does not exist"):
        check_output(tmp_path / "no" / "a.bin")
    with pytest.raises(OutputError, match="plain file"):
        check_output(tmp_path / "folder", overwrite=True)
    with pytest.raises(OutputError, match="plain file"):
        check_output("/dev/null", overwrite=True)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_unwritable_folder(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="permission"):
        check_output(tmp_path / "a.bin")


def test_unwritable_folder_as_the_system_reports_it(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(atomic_files.os, "open", refuse)
    with pytest.raises(OutputError, match=r"a\.bin: cannot be written: Permission denied"):
        write_bytes(tmp_path / "a.bin", b"x")


@pytest.mark.parametrize("when", ["write", "sync"])
def test_disk_full(tmp_path, monkeypatch, when):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    if when == "sync":
        monkeypatch.setattr(atomic_files, "_sync", full)
    with (
        pytest.raises(OutputError, match=r"a\.bin: the disk is full"),
        write_aside(tmp_path / "a.bin") as aside,
    ):
        aside.write_bytes(b"x")
        if when == "write":
            full()
    assert names(tmp_path) == []


def test_a_write_that_really_fails(tmp_path):
    """The file size limit of the process stands in for a full disk."""
    script = (
        "import resource, sys\n"
        "from lcp_catalog.atomic_files import write_bytes\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try:\n    write_bytes(sys.argv[1], b'x' * 5000)\n"
        "except OSError as error:\n    print(type(error).__name__, error)\n"
    )
    target = str(tmp_path / "a.bin")
    done = subprocess.run(
        [sys.executable, "-c", script, target], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"OutputError {target}: cannot be written: File too large\n"
    assert names(tmp_path) == []


def test_depfile_is_what_make_reads(tmp_path):
    rule = depfile_rule("out dir/a.tif", ["d em.tif", "b#1.tif", "c$.tif"])
    assert rule == b"out\\ dir/a.tif: d\\ em.tif b\\#1.tif c$$.tif\n"


NAMES = (
    "d em",
    "b#1",
    "c$",
    "a:b",
    "p%q",
    "s*",
    "q?",
    "[x]",
    "~t",
    "tab\tx",
    "back\\slash",
    "b\\ s",
    "b\\#s",
    "p|q",
    "\udcff",
)
"""Names with characters that make reads in its own way."""


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
@pytest.mark.parametrize("target", ["out", "o ut", "o#t", "o$t", "o|t"])
def test_make_finds_every_file_of_a_rule(target, tmp_path):
    """The target is up to date; a newer file makes it anew."""
    files = [tmp_path / name for name in NAMES]
    for number, file in enumerate((*files, tmp_path / target)):
        file.touch()
        os.utime(file, (1e9 + number, 1e9 + number))
    (tmp_path / "Makefile").write_bytes(depfile_rule(target, NAMES) + b"\t@echo made\n")
    make = ["make", "--no-print-directory", target]

    def said():
        return subprocess.run(make, cwd=tmp_path, capture_output=True, check=True).stdout

    assert b"made" not in said()
    for file in files:
        os.utime(file, (2e9, 2e9))
        assert said() == b"made\n", file
        os.utime(file, (1e9, 1e9))


def test_leftovers_of_killed_processes_are_removed_and_nothing_else(tmp_path):
    """A killed process cannot remove the file that it was writing."""
    code = (
        "import os, sys; from lcp_catalog.atomic_files import write_aside\n"
        "with write_aside(sys.argv[1]): os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.h5")], check=False)
    (left,) = names(tmp_path)
    for other in ("a.h5", "a.h5.part", ".a.h5.part", left.replace("a.h5", "a.h5.d"), ".mine.part"):
        (tmp_path / other).touch()
    atomic_files.remove_leftovers(tmp_path / "a.h5")
    assert left not in names(tmp_path)
    assert len(names(tmp_path)) == 5


def _files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_a_folder_appears_whole_and_replaces_only_its_own_kind(tmp_path):
    out = tmp_path / "maps"
    with folder_aside(out, [".lmk"]) as aside:
        (aside / "one.lmk").write_bytes(b"1")
        assert not out.exists()
    assert _files(tmp_path) == ["maps", "maps/one.lmk"]
    with pytest.raises(OutputExistsError, match="`overwrite`"), folder_aside(out, [".lmk"]):
        pass
    with folder_aside(out, [".lmk"], overwrite=True) as aside:
        (aside / "two.lmk").write_bytes(b"2")
    assert _files(tmp_path) == ["maps", "maps/two.lmk"]
    (out / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"holds notes\.txt"), folder_aside(out, [".lmk"], True):
        pass
    assert _files(out) == ["notes.txt", "two.lmk"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_failed_folder_leaves_nothing_and_keeps_the_old(tmp_path, error):
    out = tmp_path / "maps"
    for _ in range(2):
        with pytest.raises(error), folder_aside(out, [".lmk"], overwrite=True) as aside:
            (aside / "half.lmk").write_bytes(b"1")
            raise error
        assert _files(tmp_path) in ([], ["maps"])
        out.mkdir(exist_ok=True)
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputExistsError), folder_aside(tmp_path / "file", [".lmk"]):
        pass
