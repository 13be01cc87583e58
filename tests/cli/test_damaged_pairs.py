"""Each command that reads a catalogue or a DEM refuses every damage that `inspect` or `dem check` rejects, in one
line and without an output. The commands and their inputs are those of `benchmarks/faults/commands.py`; a command
that is not there fails a test.
"""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable
from dataclasses import replace
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
from lcp_cli.main import cli, run

from benchmarks.faults.commands import COMMANDS, prepare

Damage = Callable[[Path], None]


def test_every_command_is_in_the_table() -> None:
    named = {name for name, _ in leaves(cli)}
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
    """Commands and their inputs with an ending."""
    found = []
    for name, words in COMMANDS.items():
        line = words.line.split()
        given = [word for before, word in itertools.pairwise(line) if before != "-o"]
        found += [(name, word) for word in given if word.endswith(ending)]
    return found


def refused(
    name: str,
    inputs: Path,
    damages: dict[str, Callable[[], object]],
    monkeypatch: Any,
    capsys: Any,
    own: bool,
) -> list[str]:
    """What is wrong with the command's answers."""
    wrong = []
    line = COMMANDS[name].line.split()
    before = sorted(path.name for path in Path().iterdir())
    for damage, make in damages.items():
        make()
        code = run(line)
        out, err = capsys.readouterr()
        lines = [one for one in err.splitlines() if "not recognised as a known product" not in one]
        if own and code == 4 and "NOT" in out:
            continue
        left = sorted(path.name for path in Path().iterdir())
        if code != 1 or len(lines) != 1 or out or left != before or "unexpected" in err:
            wrong.append(f"{damage}: exit {code}, {lines}, {out[:80]!r}, {set(left) - set(before)}")
            for path in set(left) - set(before):
                shutil.rmtree(path) if Path(path).is_dir() else Path(path).unlink()
    return wrong


@pytest.mark.parametrize(("name", "catalog"), _uses(".h5"))
def test_a_damaged_catalogue_is_refused(
    name: str,
    catalog: str,
    inputs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Any,
) -> None:
    monkeypatch.chdir(tmp_path)
    for file, content in COMMANDS[name].inputs(inputs).items():
        Path(file).write_bytes(content)

    def made(damage: Damage) -> Callable[[], object]:
        def make() -> None:
            shutil.copy(inputs / catalog, catalog)
            damage(Path(catalog))

        return make

    kinds = {kind: made(damage) for kind, damage in CATALOG_DAMAGE.items()}
    assert refused(name, inputs, kinds, monkeypatch, capsys, name == "inspect") == []


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
    "every height zero": heights(np.zeros_like),
    "every height missing": heights(lambda z: np.full_like(z, np.nan)),
}
LABEL_DAMAGE: dict[str, Damage] = {
    "a short image": samples(lambda z: z[:-100]),
    "a long image": samples(lambda z: np.append(z, z[:100])),
    "swapped bytes": samples(lambda z: z.byteswap()),
    "every height zero": samples(np.zeros_like),
    "no image": lambda path: path.with_suffix(".IMG").unlink(),
    "other lines": text(lambda label: cut_text(label, LINES=150)),
    "another maximum": text(lambda label: cut_text(label, MAXIMUM=9999)),
    "another latitude": text(lambda label: cut_text(label, MINIMUM_LATITUDE=-80)),
    "another scale": text(lambda label: cut_text(label, SCALING_FACTOR=1000)),
}


@pytest.mark.parametrize("kind", ["tif", "label"])
@pytest.mark.parametrize(
    "name", sorted({name for name, _ in _uses(".tif") if COMMANDS[name].others == () or True})
)
def test_a_damaged_dem_is_refused(
    name: str, kind: str, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    for file, content in COMMANDS[name].inputs(inputs).items():
        Path(file).write_bytes(content)
    given = "dem.tif" if kind == "tif" else "LDEM_64.LBL"
    line = COMMANDS[name].line.replace("dem.tif", given) if kind == "label" else COMMANDS[name].line
    monkeypatch.setitem(COMMANDS, name, replace(COMMANDS[name], line=line))

    def made(damage: Damage) -> Callable[[], object]:
        def make() -> None:
            for file in ("dem.tif", "LDEM_64.LBL", "LDEM_64.IMG"):
                shutil.copy(inputs / file, file)
            damage(Path(given))

        return make

    for file in ("dem.tif", "LDEM_64.LBL", "LDEM_64.IMG"):
        shutil.copy(inputs / file, file)
    table = TIF_DAMAGE if kind == "tif" else LABEL_DAMAGE
    kinds = {kind: made(damage) for kind, damage in table.items()}
    assert refused(name, inputs, kinds, monkeypatch, capsys, name == "dem check") == []
