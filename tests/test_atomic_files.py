"""What appears under its own name is whole; what fails leaves nothing behind."""

# ruff: noqa: PT012 - the block of a context manager is what is tested

import ctypes
import errno
import os
import shutil
import subprocess
import sys
import types

import pytest

from lcp_catalog import atomic_files
from lcp_catalog.atomic_files import (
    MANIFEST,
    check_output,
    depfile_rule,
    folder_aside,
    write_aside,
    write_bytes,
)
from lcp_catalog.errors import ConfigError, OutputError, OutputExistsError


def names(folder):
    return sorted(os.listdir(folder))


def test_appears_only_when_the_block_ends(tmp_path):
    with write_aside(tmp_path / "a.bin") as aside:
        aside.write_bytes(b"half")
        assert aside.parent.parent == tmp_path
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


@pytest.mark.slow
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


KILLED = (
    "import os, sys; from lcp_catalog.atomic_files import folder_aside, write_aside\n"
    "with globals()[sys.argv[1]](sys.argv[2], overwrite=True) as aside:\n"
    "    if aside.is_dir(): (aside / 'one.lmk').write_bytes(b'1')\n"
    "    else: aside.write_bytes(b'1')\n"
    "    os.kill(os.getpid(), 9)"
)


@pytest.mark.parametrize("kind", ["write_aside", "folder_aside"])
def test_leftovers_of_killed_processes_are_removed_and_nothing_else(tmp_path, kind):
    """The next run of the same output removes them, also if a run is under way, and keeps the user's files."""
    words = [sys.executable, "-c", KILLED, kind, str(tmp_path / "a.h5")]
    others = (".a.h5.part", ".a.h5.1.part", ".a.h5.d.0.part")
    for name in others:
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine").touch()
    with write_aside(tmp_path / "a.h5") as aside:  # `.0.part` is in use, `.1.part` the user's
        subprocess.run(words, check=False)
        assert names(tmp_path) == sorted([*others, ".a.h5.0.part", ".a.h5.2.part"])
        atomic_files.remove_leftovers(tmp_path / "a.h5")
        assert names(tmp_path) == sorted([*others, ".a.h5.0.part"])
        aside.write_bytes(b"2")
    subprocess.run(words, check=False)
    write_bytes(tmp_path / "a.h5", b"3", overwrite=True)
    assert names(tmp_path) == sorted([*others, "a.h5"])
    assert [names(tmp_path / name) for name in others] == [["mine"]] * 3


def test_a_process_killed_before_its_lock_leaves_nothing_either(tmp_path):
    (tmp_path / ".a.h5.0.part").mkdir()
    write_bytes(tmp_path / "a.h5", b"1")
    assert names(tmp_path) == ["a.h5"]


def test_where_there_are_no_locks_nothing_of_others_is_removed(tmp_path, monkeypatch):
    subprocess.run(
        [sys.executable, "-c", KILLED, "write_aside", str(tmp_path / "a.h5")], check=False
    )

    def none(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(atomic_files.fcntl, "flock", none)
    write_bytes(tmp_path / "a.h5", b"1")
    assert names(tmp_path) == [".a.h5.0.part", "a.h5"]


def test_long_names_of_many_bytes(tmp_path):
    name = "\N{FULL MOON SYMBOL}" * 62 + ".h5"
    write_bytes(tmp_path / name, b"1")
    assert names(tmp_path) == [name]


def _files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_a_folder_appears_whole_and_replaces_only_its_own_kind(tmp_path):
    out = tmp_path / "maps"
    with folder_aside(out) as aside:
        (aside / "one.lmk").write_bytes(b"1")
        assert not out.exists()
    assert _files(tmp_path) == ["maps", f"maps/{MANIFEST}", "maps/one.lmk"]
    with pytest.raises(OutputExistsError, match="`overwrite`"), folder_aside(out):
        pass
    with folder_aside(out, overwrite=True) as aside:
        (aside / "sub").mkdir()
        (aside / "sub" / "two.lmk").write_bytes(b"2")
    assert _files(tmp_path) == ["maps", f"maps/{MANIFEST}", "maps/sub", "maps/sub/two.lmk"]
    subprocess.run(["sha256sum", "--quiet", "--check", MANIFEST], cwd=out, check=True)


@pytest.mark.parametrize("theirs", ["notes.lmk", ".hidden", "sub/mine.csv", "other/", "MANIFEST"])
def test_a_folder_with_a_file_of_the_user_is_refused_and_nothing_moves(tmp_path, theirs):
    """Also a file that comes while the new folder is written."""
    out = tmp_path / "maps"
    with folder_aside(out) as aside:
        (aside / "sub").mkdir()
        (aside / "sub" / "one.lmk").write_bytes(b"1")
    number = out.stat().st_ino

    def plant():
        (out / theirs).mkdir() if theirs.endswith("/") else (out / theirs).write_text("mine")

    with pytest.raises(OutputError, match="no part of an export"), folder_aside(out, True) as aside:
        (aside / "two.lmk").write_bytes(b"2")
        plant()
    assert (out.stat().st_ino, names(tmp_path)) == (number, ["maps"])
    with pytest.raises(OutputError, match=f"holds {theirs.rstrip('/')}"), folder_aside(out, True):
        raise AssertionError("refused before anything is written")
    (out / MANIFEST).unlink()
    with pytest.raises(OutputError, match="no part of an export"), folder_aside(out, True):
        pass
    assert (out / theirs).exists()


def test_a_file_of_an_export_that_was_changed_is_kept(tmp_path):
    """Also a link, and a pipe that stands for the manifest: nothing waits for its writer."""
    out = tmp_path / "maps"
    with folder_aside(out) as aside:
        (aside / "one.lmk").write_bytes(b"1")
    exported = out / "one.lmk"
    exported.write_bytes(b"mine")
    with pytest.raises(OutputError, match=r"one\.lmk, which was changed"), folder_aside(out, True):
        raise AssertionError("refused before anything is written")
    exported.unlink()
    exported.symlink_to(tmp_path)
    with pytest.raises(OutputError, match=r"one\.lmk, which was changed"), folder_aside(out, True):
        pass
    exported.unlink()
    exported.write_bytes(b"1")
    with folder_aside(out, True) as aside:
        (aside / "one.lmk").write_bytes(b"2")
    (out / MANIFEST).unlink()
    os.mkfifo(out / MANIFEST)
    with pytest.raises(OutputError, match="no part of an export"), folder_aside(out, True):
        pass


def test_a_folder_that_holds_what_is_read_is_refused(tmp_path):
    out = tmp_path / "maps"
    for _ in range(2):
        read = [out / "one.lmk", out]
        with pytest.raises(OutputError, match="is read"), folder_aside(out, True, read):
            pass
        with folder_aside(out, True) as aside:
            (aside / "one.lmk").write_bytes(b"1")


@pytest.mark.parametrize("code", [None, errno.EINVAL, errno.ENOSYS])
def test_two_renames_where_names_cannot_be_exchanged(tmp_path, monkeypatch, code):
    """If the second fails, the former folder is back; after a kill between them, at the next run."""
    out = tmp_path / "maps"
    with folder_aside(out) as aside:
        (aside / "one.lmk").write_bytes(b"1")
    library = types.SimpleNamespace()
    if code is not None:
        library.renameat2 = lambda *_: -1
        monkeypatch.setattr(ctypes, "get_errno", lambda: code)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: library)
    with folder_aside(out, True) as aside:
        (aside / "two.lmk").write_bytes(b"2")
    assert _files(tmp_path) == ["maps", f"maps/{MANIFEST}", "maps/two.lmk"]
    rename = os.rename

    def fail(source, target):
        if not str(target).endswith(".former") and not str(source).endswith(".former"):
            raise OSError(errno.EIO, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(atomic_files.os, "rename", fail)
    with pytest.raises(OutputError, match="Input/output error"), folder_aside(out, True):
        pass
    assert _files(tmp_path) == ["maps", f"maps/{MANIFEST}", "maps/two.lmk"]
    monkeypatch.undo()
    left = tmp_path / ".maps.0.part"
    left.mkdir()
    (left / "lcp.lock").touch()
    out.rename(left / "maps.former")
    atomic_files.remove_leftovers(out)
    assert _files(tmp_path) == ["maps", f"maps/{MANIFEST}", "maps/two.lmk"]


def test_an_exchange_that_fails_otherwise_changes_nothing(tmp_path, monkeypatch):
    out = tmp_path / "maps"
    with folder_aside(out) as aside:
        (aside / "one.lmk").write_bytes(b"1")
    library = types.SimpleNamespace(renameat2=lambda *_: -1)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: library)
    monkeypatch.setattr(ctypes, "get_errno", lambda: errno.EIO)
    with pytest.raises(OutputError, match="Input/output error"), folder_aside(out, True):
        pass
    assert _files(tmp_path) == ["maps", f"maps/{MANIFEST}", "maps/one.lmk"]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux exchanges two names at once")
def test_there_is_always_a_whole_folder_while_it_is_replaced(tmp_path):
    """A second process looks for it all the time."""
    out = tmp_path / "maps"
    look = (
        "import os, sys\nprint('looks', flush=True)\n"
        "while not os.path.exists(sys.argv[2]):\n    assert os.path.exists(sys.argv[1])"
    )
    with folder_aside(out) as aside:
        (aside / "x.lmk").write_bytes(b"1")
    end = tmp_path / "end"
    words = [sys.executable, "-c", look, str(out / MANIFEST), str(end)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as watcher:
        watcher.stdout.readline()
        for number in range(200):
            with folder_aside(out, True) as aside:
                (aside / f"{number}.lmk").write_bytes(b"1")
        end.touch()
        error = watcher.communicate()[1].decode()
    assert (watcher.returncode, error) == (0, "")


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_failed_folder_leaves_nothing_and_keeps_the_old(tmp_path, error):
    out = tmp_path / "maps"
    for _ in range(2):
        with pytest.raises(error), folder_aside(out, overwrite=True) as aside:
            (aside / "half.lmk").write_bytes(b"1")
            raise error
        assert _files(tmp_path) in ([], ["maps"])
        out.mkdir(exist_ok=True)
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputExistsError), folder_aside(tmp_path / "file"):
        pass


@pytest.mark.parametrize("name", ["o.tif", "O.TIF", "o.tiff", "o.x.TifF"])
def test_an_ending_is_known_in_capitals_and_in_another_spelling(name):
    assert atomic_files.ending_of(name, (".h5", ".tif")) == ".tif"
    with pytest.raises(ConfigError, match=r"must end in \.h5 or \.png$"):
        atomic_files.ending_of(name, (".h5", ".png"))
