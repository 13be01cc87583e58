"""Files that are damaged or made on purpose: one line says so, whatever they do to the HDF5 library."""

from __future__ import annotations

import errno
import json
import os
import shutil
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers import catalogs, damaged_catalogs
from helpers.commands import run
from helpers.verified import verify

from lcp_catalog import child_process
from lcp_catalog.catalog import file_structure, verification
from lcp_catalog.catalog.report import write_report
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CatalogError


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("catalog") / "sound.h5"
    write_catalog(catalogs.full(6), path)
    return path


@pytest.fixture
def copy(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(written, tmp_path / "copy.h5"))


def _signed(path: Path, **attributes: str) -> None:
    """Change attributes, and the digest with them."""
    with h5py.File(path, "r+") as file:
        file.attrs.update(attributes)
        catalogs.sign(file)


@pytest.mark.slow
@pytest.mark.usefixtures("checks_apart")
def test_a_crash_of_the_library_is_one_line(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """As HDF5 2.0 crashes on some damaged files; here the process is ended instead."""
    monkeypatch.setattr(verification, "structure_problems", lambda *_: os.abort())
    monkeypatch.setattr(verification, "call_apart", _forked(verification.call_apart))
    assert verify(copy) == ["damaged: reading it crashed with signal 6"]
    with pytest.raises(CatalogError, match=r"copy\.h5: damaged: reading it crashed"):
        open_catalog(copy)
    assert run(["inspect", str(copy)]) == 4
    assert run(["report", str(copy), "-o", str(copy.parent / "r.html")]) == 1
    assert os.listdir(copy.parent) == ["copy.h5"]
    assert capfd.readouterr().err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.usefixtures("checks_apart")
def test_a_bit_on_which_hdf5_crashes_is_one_line(
    copy: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A bit in the type of an attribute, on which HDF5 2.0.0 dies of a segmentation fault in a file of the format
    1.8; here the checksum of the record holds.
    """
    content = bytearray(copy.read_bytes())
    content[content.index(b"units\0\x19") + 6] ^= 8
    copy.write_bytes(content)
    problems = verify(copy)
    assert any("is damaged" in line for line in problems), problems
    assert run(["inspect", str(copy)]) == 4
    assert capfd.readouterr().err == ""


def _forked(call: Callable) -> Callable:
    """`call_apart` by a fork, whatever threads the tests before have started."""

    def forced(*given: object) -> object:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(child_process, "_single_thread", lambda: True)
            return call(*given)

    return forced


def _replace(file: h5py.File, name: str, link: object) -> None:
    del file[name]
    file[name] = link


def _other(path: Path) -> Path:
    """A sound catalogue beside."""
    return Path(shutil.copy(path, path.with_name("other.h5")))


def _soft(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file.move("gsd", "real")
        file["gsd"] = h5py.SoftLink("/real")


def _external_link(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        _replace(file, "dem", h5py.ExternalLink(str(_other(path)), "/dem"))


def _external_group(path: Path) -> None:
    os.mkfifo(path.with_name("pipe"))  # opening it would wait for a writer
    with h5py.File(path, "r+") as file:
        _replace(file, "overview", h5py.ExternalLink(str(path.with_name("pipe")), "/"))


def _external_storage(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        shape, kind = file["longitude"].shape, file["longitude"].dtype
        del file["longitude"]
        file.create_dataset("longitude", shape, kind, external=[("/dev/zero", 0, 48)])


def _virtual(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        layout = h5py.VirtualLayout(file["latitude"].shape, file["latitude"].dtype)
        layout[:] = h5py.VirtualSource(str(_other(path)), "latitude", layout.shape)
        del file["latitude"]
        file.create_virtual_dataset("latitude", layout)


def _claim(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["second_peak"]
        file.create_dataset("second_peak", (2**44,), "f8", chunks=(2**10,), fletcher32=True)


def _holes(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["gsd_min"]
        file.create_dataset("gsd_min", (6,), "f8", chunks=(6,), fletcher32=True)


STRUCTURES = {
    _soft: "gsd: the variable is a link to another place, which is not followed",
    _external_link: "dem: the variable is a link to another place, which is not followed",
    _external_group: "overview: the group is a link to another place, which is not followed",
    _external_storage: "longitude: is stored in another file, which is not followed",
    _virtual: "latitude: is stored in another file, which is not followed",
    _claim: "second_peak: claims 140737488355328 bytes of a file of",
    _holes: "gsd_min: has 0 chunks of 1",
}


@pytest.mark.slow
@pytest.mark.parametrize("change", STRUCTURES, ids=lambda change: change.__name__)
def test_nothing_outside_is_read_and_no_claim_is_believed(
    copy: Path, change: Callable[[Path], None]
) -> None:
    change(copy)
    start = time.process_time()
    problems = verify(copy)
    assert time.process_time() - start < 5.0
    assert any(line.startswith(STRUCTURES[change]) for line in problems), problems
    with pytest.raises(CatalogError):
        open_catalog(copy, check=False)


@pytest.mark.parametrize("start", [0, 2, 4])
def test_an_index_names_each_chunk_once_in_its_place(tmp_path: Path, start: int) -> None:
    """In an index of HDF5 1.8, which has no checksum, the second chunk's place along the axis is changed."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver="earliest") as file:
        file.create_dataset("a", data=np.arange(4.0), chunks=(2,), fletcher32=True)
    content = bytearray(path.read_bytes())
    entry = content.index(b"TREE\x01") + 24 + 32  # size, mask and offset of the second chunk
    assert struct.unpack_from("<IIQ", content, entry) == (20, 0, 2)
    struct.pack_into("<Q", content, entry + 8, start)
    path.write_bytes(content)
    with h5py.File(path) as file:
        fault = file_structure._storage_fault(file["a"], len(content))
    assert fault == ("" if start == 2 else "has chunks that are not each in a place of their own")


def test_an_attribute_that_claims_much_is_not_read(copy: Path) -> None:
    with h5py.File(copy, "r+", libver="latest") as file:
        file.attrs["title"] = np.zeros(2**18)
    assert "the attribute title claims 2097152 bytes" in verify(copy)


def test_unknown_members_are_named_but_not_visited(copy: Path) -> None:
    os.mkfifo(copy.with_name("pipe"))
    with h5py.File(copy, "r+") as file:
        file["unknown"] = h5py.ExternalLink(str(copy.with_name("pipe")), "/")
        for number in range(100):
            file.create_group(f"more/{number}")
        file["overview/more"] = 1.0
    assert verify(copy) == [
        f"{name}: does not belong to a catalogue" for name in ("more", "unknown", "overview/more")
    ]
    with pytest.raises(CatalogError, match="more: does not belong"):
        open_catalog(copy, check=False)


@pytest.mark.parametrize("kind", ["pipe", "folder"])
def test_what_is_not_a_plain_file_is_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "c.h5"
    os.mkfifo(path) if kind == "pipe" else path.mkdir()
    assert verify(path) == ["is not a plain file"]
    with pytest.raises(CatalogError, match="is not a plain file"):
        open_catalog(path)


DEEP = "[" * 100_000 + "]" * 100_000

TEXTS = {
    "sources as an object": ("sources", "{}", "sources: is not a list of files"),
    "a source as text": ("sources", '["a"]', "sources: is not a list of files"),
    "a source without size": ("sources", '[{"name": "a", "sha256": "b"}]', "sources: is not a"),
    "deep sources": ("sources", DEEP, "sources: is JSON of more than 40 levels"),
    "a deep plan": ("scene_plan", DEEP, "scene_plan: is JSON of more than 40 levels"),
    "a plan with NaN": ("scene_plan", "[NaN]", "scene_plan: is not JSON"),
    "half a character": ("scene_plan", '["\\ud800"]', "scene_plan: is not JSON"),
    "a long number": ("scene_plan", "[" + "9" * 5000 + "]", "scene_plan: is not JSON"),
    "errors as a list": ("errors", "[1]", "errors: is not an object"),
    "escape sequences": ("title", "\x1b[2J", "title: has characters that cannot be printed"),
    "no TOML": ("config", "a = ", "config: is not TOML"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TEXTS)
def test_texts_that_a_report_could_not_show_are_refused(copy: Path, name: str) -> None:
    attribute, text, says = TEXTS[name]
    _signed(copy, **{attribute: text})
    problems = verify(copy)
    assert any(line.startswith(says) for line in problems), problems
    with pytest.raises(CatalogError, match=r"copy\.h5") as caught:
        write_report(copy, copy.with_suffix(".html"))
    assert "\n" not in str(caught.value)


def test_group_numbers_are_checked(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        file["coverage"].attrs["spacing_m"] = np.nan
        catalogs.sign(file)
    assert verify(copy) == ["coverage: spacing_m: nan is not in its range"]


def test_a_file_that_changes_after_it_was_opened_is_refused(copy: Path) -> None:
    found = open_catalog(copy)
    assert len(found.longitude) == 6
    write_catalog(catalogs.catalog(2), copy, overwrite=True)
    with pytest.raises(CatalogError, match="was changed since it was opened"):
        _ = found.latitude


@pytest.mark.slow
@pytest.mark.usefixtures("checks_apart")
@pytest.mark.parametrize("what", ["open", "close"])
def test_a_system_that_fails(
    what: str, copy: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A file that is not opened is not called damaged: nothing is known of it. One that was read and fails to close is as
    good as before.
    """

    def no_more(*_: object) -> None:
        raise OSError(errno.EMFILE, "Unable to synchronously open file (Too many open files)")

    def fails(file: h5py.File) -> None:
        closed(file)
        raise RuntimeError("Can't decrement id ref count (unable to close file)")

    closed = h5py.File.close
    # a process that is forked has the functions of this test, whatever threads earlier tests have left
    monkeypatch.setattr(child_process, "_single_thread", lambda: True)
    if what == "open":
        monkeypatch.setattr(h5py, "File", no_more)
    else:
        monkeypatch.setattr(h5py.File, "close", fails)
    if what == "close":
        assert len(open_catalog(copy).longitude) == 6
    else:
        with pytest.raises(CatalogError, match=r"copy\.h5: .*cannot be read: Too many open files"):
            open_catalog(copy)
    assert run(["inspect", str(copy)]) == {"open": 1, "close": 0}[what]
    assert "NOT INTACT" not in capfd.readouterr().err


def test_inspect_needs_no_numbers_of_its_own_to_survive(copy: Path) -> None:
    """The command as a user runs it, on a file whose first structures are cleared."""
    content = bytearray(copy.read_bytes())
    content[64:4096] = bytes(4032)
    copy.write_bytes(content)
    command = [str(Path(sys.executable).with_name("lcp")), "inspect", "--json", str(copy)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    said = [line for line in done.stderr.splitlines() if not line.endswith("so far")]
    assert (done.returncode, said) == (4, [])
    assert json.loads(done.stdout)["intact"] is False


@pytest.mark.slow
@pytest.mark.usefixtures("checks_apart")
def test_damage_is_noticed_or_changes_no_value(written: Path, tmp_path: Path) -> None:
    """`benchmarks/faults/damage.py` in small."""
    count = 300
    for damages in ((damaged_catalogs.flip,), damaged_catalogs.RANGES):
        *_, found = damaged_catalogs.tried(written, tmp_path / "c.h5", damages, 3, count)
        assert found["noticed"] + found["harmless"] == found["tried"] == count
        assert found["noticed"] > 0.1 * count
