"""Each command that reads a catalogue or a DEM refuses every damage that `inspect` or `dem check` rejects, in one
line and without an output; so do those that read SPICE kernels or CCSDS messages. The commands and their inputs are
those of `tests/helpers/small_commands.py`; a command that is not there fails a test.
"""

from __future__ import annotations

import functools
import itertools
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import rasterio
from helpers import catalogs
from helpers.commands import leaves
from helpers.damaged import edit
from helpers.products import cut as cut_text
from helpers.small_commands import COMMANDS, SUN, Words, prepare
from lcp_cli.main import cli, run

Damage = Callable[[Path], None]


OTHERS = {"warm-up"}
"""Commands that read only compiled kernels: `tests/kernels/test_cache.py`."""


def test_every_command_is_in_the_table() -> None:
    named = {name for name, _ in leaves(cli)} - OTHERS
    assert named == {
        name for name in named if any(f"{key} ".startswith(f"{name} ") for key in COMMANDS)
    }
    assert all(
        words.line.startswith(key.partition(" -")[0].partition(" .")[0])
        for key, words in COMMANDS.items()
    )


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    prepare(folder)
    return folder


# -- catalogues


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])


def no_hdf5(path: Path) -> None:
    path.write_bytes(b"not HDF5" + path.read_bytes()[8:])


def chunk_bit(path: Path) -> None:
    """One bit of the heights of a patch."""
    with h5py.File(path) as file:
        place = file["dem"].id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[place + 5] ^= 4
    path.write_bytes(content)


def exchanged_chunks(path: Path) -> None:
    """The stored bytes of one variable's chunk at the place of another's, each with a valid checksum."""
    with h5py.File(path) as file:
        own = [file[name].id.get_chunk_info(0) for name in ("longitude", "latitude")]
    content = bytearray(path.read_bytes())
    first, second = (slice(one.byte_offset, one.byte_offset + one.size) for one in own)
    content[first], content[second] = content[second], content[first]
    path.write_bytes(content)


def edited(change: Callable[[Any], None], sign: bool = False) -> Damage:
    """A change by h5py, which gives it valid checksums; ``sign``: with valid digests, too."""

    def damage(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            change(file)
            if sign:
                catalogs.sign(file)

    return damage


def _exchange(file: Any, name: str, order: Any) -> None:
    file[name][...] = file[name][()][order]


def _attribute(file: Any, name: str, value: str) -> None:
    file.attrs[name] = value


def _set(file: Any, name: str, value: float) -> None:
    file[name][0] = value


def _link(file: Any) -> None:
    del file["elevation"]
    file["elevation"] = h5py.ExternalLink("other.h5", "/elevation")


def _delete(file: Any, name: str) -> None:
    del file[name]


CATALOG_DAMAGE: dict[str, Damage] = {
    "cut": cut,
    "no HDF5": no_hdf5,
    "a bit of a chunk": chunk_bit,
    "exchanged chunks": exchanged_chunks,
    "mirrored patches": edited(lambda file: _exchange(file, "dem", np.s_[:, :, ::-1])),
    "exchanged ids": edited(lambda file: _exchange(file, "point_id", np.s_[::-1])),
    "a moved point": edited(lambda file: _set(file, "longitude", 3.50001)),
    "sigma of nothing": edited(lambda file: _set(file, "elevation_sigma", 0.0)),
    "a latitude of 95": edited(lambda file: _set(file, "latitude", 95.0), sign=True),
    "an infinite height": edited(lambda file: _set(file, "elevation", np.inf), sign=True),
    "another schema": edited(lambda file: _attribute(file, "schema_version", "2.5")),
    "no configuration": edited(lambda file: _attribute(file, "config", "[points"), sign=True),
    "an external link": edited(_link),
    "a variable less": edited(lambda file: _delete(file, "gsd")),
    "no digests": edited(lambda file: _delete(file, "integrity")),
    "another digest": edited(lambda file: _attribute(file, "content_sha256", "0" * 64)),
}


def _uses(ending: str) -> list[tuple[str, str]]:
    """Commands and their inputs with an ending; of the exports, which open a catalogue in one place, two."""
    found = []
    for name, words in COMMANDS.items():
        line = words.line.split()
        given = [word for before, word in itertools.pairwise(line) if before != "-o"]
        if name in ("export .gpkg", "export .lmk") or not name.startswith(
            ("export", "build-catalog --jobs")
        ):
            found += [(name, word) for word in given if word.endswith(ending)]
    return found


def _refused(line: str, words: Words, capsys: Any, whole: bytes = b"", names: str = "") -> str:
    """What is wrong with a command's answer to a damaged input. ``whole``: an output that is right, too; ``names``: what
    the line must hold.
    """
    before = set(Path().iterdir())
    code = run(line.split())
    out, err = capsys.readouterr()
    left = set(Path().iterdir()) - before
    same = bool(whole) and code == 0 and [path.read_bytes() for path in left] == [whole]
    for path in left:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    said = "NOT " in out or out.endswith(": made by lcp 0.2; build it again\n")
    if same or (words.verdict and code == 4 and said and names in out):
        return ""
    lines = [
        one
        for one in err.splitlines()
        if "not recognised as a product with a known error" not in one
        and "the stated Sun is" not in one
        and not re.search(r": \d+ of \d+, | so far$", one)  # progress, where a machine is slow
    ]
    right = code == 1 and len(lines) == 1 and re.match("lcp: (?!unexpected)", lines[0])
    right = right and names in lines[0]
    return "" if right and not out and not left else f"exit {code}, {lines}, {out[:80]!r}, {left}"


@functools.cache
def _damaged(catalog: Path, kind: str) -> bytes:
    copy = catalog.with_suffix(".damaged")
    shutil.copy(catalog, copy)
    CATALOG_DAMAGE[kind](copy)
    return copy.read_bytes()


def _put(words: Words, inputs: Path) -> dict[str, bytes]:
    """Put the inputs of a command into the working folder; their names and contents."""
    files = words.inputs(inputs)
    for file, content in files.items():
        Path(file).write_bytes(content)
    return dict(files)


USES = _uses(".h5")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "catalog"), USES)
def test_a_damaged_catalogue_is_refused(
    name: str,
    catalog: str,
    inputs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Any,
) -> None:
    monkeypatch.chdir(tmp_path)
    words = COMMANDS[name]
    _put(words, inputs)
    before = set(Path().iterdir())
    assert run(words.line.split()) in (0, 4), capsys.readouterr()
    capsys.readouterr()
    for path in set(Path().iterdir()) - before:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    wrong = {}
    for kind in CATALOG_DAMAGE:
        Path(catalog).write_bytes(_damaged(inputs / catalog, kind))
        wrong[kind] = _refused(words.line, words, capsys)
    assert {kind: text for kind, text in wrong.items() if text} == {}


# -- DEMs


def heights(change: Callable[[Any], Any]) -> Damage:
    """Other heights in the GeoTIFF."""

    def damage(path: Path) -> None:
        with rasterio.open(path, "r+") as file:
            file.write(change(file.read(1)), 1)

    return damage


def text(change: Callable[[str], str]) -> Damage:
    """Another text of the label."""
    return lambda path: edit(path, change)


def samples(change: Callable[[Any], Any]) -> Damage:
    """Other samples of the image beside the label."""

    def damage(path: Path) -> None:
        image = path.with_suffix(".IMG")
        image.write_bytes(change(np.fromfile(image, "<i2")).tobytes())

    return damage


TIF_DAMAGE: dict[str, Damage] = {
    "cut": cut,
    "no TIFF": lambda path: path.write_bytes(b"no TIFF!" + path.read_bytes()[8:]) and None,
    "impossible heights": heights(lambda z: z * 1000.0),
    "a code for missing data": heights(lambda z: np.where(z > np.percentile(z, 90), -32768.0, z)),
}
LABEL_DAMAGE: dict[str, Damage] = {
    "a short image": samples(lambda z: z[:-100]),
    "a long image": samples(lambda z: np.append(z, z[:100])),
    "swapped bytes": samples(lambda z: z.byteswap()),
    "no image": lambda path: path.with_suffix(".IMG").unlink(),
    "another maximum": text(lambda label: cut_text(label, MAXIMUM=-4000)),
    "another latitude": text(lambda label: cut_text(label, MINIMUM_LATITUDE=-80)),
    "another scale": text(lambda label: cut_text(label, SCALING_FACTOR=1000)),
}


@pytest.mark.slow
@pytest.mark.parametrize("given", ["dem.tif", "LDEM_64.LBL"])
@pytest.mark.parametrize("name", sorted({name for name, _ in _uses(".tif")}))
def test_a_damaged_dem_is_refused(
    name: str,
    given: str,
    inputs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Any,
) -> None:
    """Of the GeoTIFF, or of the same heights with a label in its place."""
    monkeypatch.chdir(tmp_path)
    words = COMMANDS[name]
    for file, content in words.inputs(inputs).items():
        Path(file).write_bytes(content)
    wrong = {}
    for kind, damage in (TIF_DAMAGE if given == "dem.tif" else LABEL_DAMAGE).items():
        for file in ("dem.tif", "LDEM_64.LBL", "LDEM_64.IMG"):
            shutil.copy(inputs / file, file)
        damage(Path(given))
        wrong[kind] = _refused(words.line.replace("dem.tif", given), words, capsys)
    assert {kind: text for kind, text in wrong.items() if text} == {}


# -- kernels, messages and cameras

CAMERA_DAMAGE: dict[str, Damage] = {
    "cut": cut,
    "the last byte": lambda path: path.write_bytes(path.read_bytes()[:-1]) and None,
    "empty": lambda path: path.write_bytes(b"") and None,
    "zeros": lambda path: path.write_bytes(bytes(path.stat().st_size)) and None,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in COMMANDS if re.match("camera (from|ex)", name)])
def test_a_damaged_kernel_message_or_camera_is_refused(
    name: str,
    inputs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Any,
) -> None:
    """Or the output is as without damage, where nothing is lost that is used: fill bytes behind a kernel's end, another
    instrument.
    """
    monkeypatch.chdir(tmp_path)
    words = COMMANDS[name]
    files = _put(words, inputs)
    assert run(words.line.split()) == 0
    output = Path(words.line.split()[-1])
    whole = output.read_bytes()
    output.unlink()
    capsys.readouterr()
    wrong = {}
    for file in files:
        for kind, damage in CAMERA_DAMAGE.items():
            damage(Path(file))
            wrong[file, kind] = _refused(words.line, words, capsys, whole)
            Path(file).write_bytes(files[file])
    assert {pair: text for pair, text in wrong.items() if text} == {}


# -- indexes of catalogues

INDEXED = {
    "inspect": Words("inspect both.lcpx", verdict=True),
    "report": Words("report both.lcpx -o r.html"),
    "query": Words(f"query both.lcpx --camera camera.json {SUN} -o q.csv"),
    "windows": Words("windows both.lcpx --center 3 26 --range 2026-01-27 2026-01-29 12h"),
    "export": Words("export both.lcpx -o out.csv"),
    "diff": Words("diff both.lcpx east.h5 -o d.csv"),
    "merge": Words("merge both.lcpx east.h5 -o m.h5"),
    "camera info": Words("camera info camera.json --catalog both.lcpx --plot c.svg"),
    "validate": Words("validate both.lcpx frame.png --camera frame.json -o v"),
    "simulate": Words("simulate both.lcpx --camera frame.json --sun point -o f2.png"),
}
"""Commands on an index of ``west.h5`` and ``east.h5``."""

OF_POINTS = ("a bit of a chunk", "exchanged chunks", "mirrored patches", "exchanged ids")
OF_POINTS += ("a moved point", "sigma of nothing", "a latitude of 95", "an infinite height")
"""Damage that an index without points cannot have."""

INDEX_DAMAGE: dict[str, Damage] = {
    **{kind: damage for kind, damage in CATALOG_DAMAGE.items() if kind not in OF_POINTS},
    "no list": edited(lambda file: _attribute(file, "shards", "[{}]"), sign=True),
    "a point less": edited(
        lambda file: _attribute(file, "shards", file.attrs["shards"].replace("points", "rows"))
    ),
    "another sum": edited(
        lambda file: _attribute(
            file,
            "shards",
            re.sub('sha256": "[0-9a-f]{8}', 'sha256": "00000000', file.attrs["shards"]),
        ),
        sign=True,
    ),
}
SHARD_DAMAGE: dict[str, Damage] = {
    **CATALOG_DAMAGE,
    "missing": lambda path: path.unlink(),
    "another": lambda path: shutil.copy(path.with_name("usable.h5"), path) and None,
    "a folder": lambda path: path.unlink() or path.mkdir(),
}


@pytest.fixture(scope="module")
def indexed(inputs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("indexed")
    shutil.copytree(inputs, folder, dirs_exist_ok=True)
    words = [str(folder / name) for name in ("west.h5", "east.h5", "both.lcpx")]
    assert run(["merge", *words[:2], "-o", words[2]]) == 0
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", INDEXED)
def test_a_damaged_index_or_shard_is_refused(
    name: str,
    indexed: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Any,
) -> None:
    """And the shard is named."""
    shutil.copytree(indexed, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    words, wrong = INDEXED[name], {}
    whole = Path("whole")
    whole.mkdir()
    for file in ("both.lcpx", "west.h5"):
        shutil.copy(file, whole)
    before = set(Path().iterdir())
    assert run(words.line.split()) in (0, 4), capsys.readouterr()
    for path in set(Path().iterdir()) - before:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    capsys.readouterr()
    for file, kinds in (("both.lcpx", INDEX_DAMAGE), ("west.h5", SHARD_DAMAGE)):
        for kind in kinds:
            kinds[kind](Path(file))
            wrong[file, kind] = _refused(words.line, words, capsys, names=file)
            shutil.rmtree(file) if Path(file).is_dir() else None
            shutil.copy(whole / file, file)
    assert {pair: text for pair, text in wrong.items() if text} == {}
