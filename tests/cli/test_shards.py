"""An index of catalogues (`lcp merge -o MOON.lcpx`): every command gives the answer of the merged catalogue; shards that
are not needed are not opened; one that is missing, damaged or another is named in one line.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import merges, navigable, posed, twins_match
from helpers.small_commands import DEM, prepare
from lcp_cli.main import run

import lcp_catalog as lcp
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.choices import EXPORTS
from lcp_catalog.errors import CatalogError
from lcp_catalog.exports.flight import HEADER
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.production.overlap import Agreement

pytestmark = pytest.mark.slow

SUN = "--sun-azimuth 100 --sun-elevation 17"
HALVES = {"west": (2.1, 3.7), "east": (3.4, 4.9)}


def halves(every: Catalog, name: str, folder: Path) -> list[str]:
    """Files of the western and the eastern points, which overlap; in the overlap some differ."""
    every = merges.moved(every, every.longitude, every.latitude)
    files = []
    for side, (west, east) in HALVES.items():
        part = merges.part(every, west, east)
        if side == "east":
            part = (
                merges.disturbed(part, seed=5)
                if len(np.shape(part.condition)) and name == "u"
                else part
            )
        part = replace(part, config=merges.config(west, east, float(every.gsd[0])))
        files.append(f"{name}-{side}.h5")
        write_catalog(part, folder / files[-1])
    return files


@pytest.fixture(scope="module", autouse=True)
def uncompared() -> Iterator[None]:
    """Whether heights agree, which takes half of a merge's time, is asked in tests/production/test_overlap."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lcp_catalog.production.merging.agreement", lambda *_: Agreement())
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Catalogues u (30 points) and p (patches of a frame): halves, merged (.h5), and an index (.lcpx)."""
    made = tmp_path_factory.mktemp("index")
    prepare(made, ["query", "query --trajectory", "validate"])
    points = navigable.everywhere_usable(30)
    lon, lat = (
        grid.ravel() for grid in np.meshgrid(np.linspace(3.3, 3.9, 5), np.linspace(25.8, 26.4, 4))
    )
    patches = twins_match.catalog_of_dem(lon, lat, 33, 118.45, DEM)
    for name, every in {"u": points, "p": patches}.items():
        files = [str(made / file) for file in halves(every, name, made)]
        for ending in (".h5", ".lcpx"):
            lcp.merge(files, made / f"{name}{ending}")
    return made


LINES = {
    "inspect": "inspect u.h5 --json",
    "report": "report u.h5 -o out.html",
    "dossier": f"report u.h5 -o out.html --dossier --camera camera.json {SUN}",
    "query": f"query u.h5 --camera camera.json {SUN} --json",
    "query .csv": f"query u.h5 --camera camera.json {SUN} --max 5 -o out.csv",
    "trajectory": f"query u.h5 --trajectory way.csv --camera camera.json {SUN} --json --plot out.svg",
    "windows": "windows u.h5 --center 3.5 26 --range 2026-01-27 2026-01-29 12h --json",
    "windows --camera": "windows u.h5 --center 3 26 --camera camera.json --range 2026-01-27 2026-01-29 12h --json",
    "diff": "diff u.h5 u-west.h5 --json -o out.csv",
    "camera info": "camera info camera.json --catalog u.h5 --json",
    "validate": "validate p.h5 frame.png --camera frame.json --dem dem.tif --attitude-sigma 0 -o out",
    "simulate": "simulate p.h5 --camera frame.json -o out.png --sun point",
    **{f"export {ending}": f"export u.h5 -o out{ending}" for ending in EXPORTS},
    "export --bounds": "export u.h5 -o out.csv --bounds 3.5 25 4.5 27",
}
"""Commands on the merged catalogue."""


def answer(line: str, capsys: Any) -> dict[str, bytes]:
    """What a command prints and writes; the catalogue's name is that of the merged one."""
    before = set(Path().iterdir())
    code = run(line.split())
    out, err = capsys.readouterr()
    assert code in (0, 4), (line, err)
    found = {"code": str(code).encode(), "stdout": out.encode()}
    for path in sorted(set(Path().iterdir()) - before):
        for file in [path, *sorted(path.rglob("*"))]:
            if file.is_file():
                found[str(file)] = file.read_bytes()
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return {name: content.replace(b".lcpx", b".h5") for name, content in found.items()}


@pytest.mark.parametrize("name", LINES)
def test_an_index_answers_as_the_merged_catalogue(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(folder)
    line = LINES[name]
    merged, index = (
        answer(one, capsys)
        for one in (line, line.replace("u.h5", "u.lcpx").replace("p.h5", "p.lcpx"))
    )
    assert merged.keys() == index.keys()
    assert [file for file in merged if not same(file, merged[file], index[file])] == []


def same(name: str, one: bytes, other: bytes) -> bool:
    """True for files that are the same but for the digest of the catalogue that a flight file states."""
    if not name.endswith(".lcpf"):
        return one == other
    headers = [np.frombuffer(content, HEADER, 1)[0].copy() for content in (one, other)]
    assert headers[0]["catalog_sha256"].tobytes() != headers[1]["catalog_sha256"].tobytes()
    for header in headers:
        header["catalog_sha256"], header["crc"] = b"", 0
    size = HEADER.itemsize
    return headers[0].tobytes() == headers[1].tobytes() and one[size:] == other[size:]


def test_it_can_be_merged_again(folder: Path, tmp_path: Path) -> None:
    """With a catalogue of the same ground: the points of both are chosen among, as those of the merged one."""
    for ending in (".h5", ".lcpx"):
        lcp.merge([folder / f"u{ending}", folder / "u-west.h5"], tmp_path / f"from{ending}.h5")
    assert not lcp.diff(tmp_path / "from.h5.h5", tmp_path / "from.lcpx.h5").differs
    with pytest.raises(CatalogError, match=r"u\.lcpx: is an index; name its catalogues"):
        lcp.merge([folder / "u.lcpx", folder / "u-west.h5"], tmp_path / "again.lcpx")
    with pytest.raises(CatalogError, match="an index is of files"):
        lcp.merge(
            [lcp.open_catalog(folder / "u.h5")[:5], folder / "u-west.h5"], tmp_path / "a.lcpx"
        )


def test_every_part_of_every_variable(folder: Path) -> None:
    """Against the merged file: rows in any order, boxes of conditions, one row, none."""
    merged, index = (lcp.open_catalog(folder / f"u{ending}") for ending in (".h5", ".lcpx"))
    assert len(index) == len(merged) > 20
    rows = np.random.default_rng(3).permutation(len(merged))[:9]
    for name in merged.point_variables:
        for which in (slice(None), rows, 4, slice(0, 0), slice(3, 7)):
            mine, its = index.part(name, which), merged.part(name, which)
            assert mine.dtype == its.dtype
            np.testing.assert_array_equal(mine, its, err_msg=name)
    some = (slice(None), 0, slice(1, 3), slice(None))
    np.testing.assert_array_equal(index.part("condition", *some), merged.part("condition", *some))


def test_shards_that_are_not_in_view_are_not_opened(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """The western half is there, the eastern one is gone: a question about the west is answered as by the merged
    catalogue; one about the whole names the file.
    """
    monkeypatch.chdir(tmp_path)
    every = merges.moved(found := navigable.everywhere_usable(30), found.longitude, found.latitude)
    far = merges.part(every, 4.2, 4.9)
    far = merges.moved(far, far.longitude + 20.0, far.latitude)
    write_catalog(merges.part(every, 2.1, 2.9), "west.h5")
    write_catalog(replace(far, config=merges.config(24.2, 24.9)), "east.h5")
    for ending in (".h5", ".lcpx"):
        lcp.merge(["west.h5", "east.h5"], f"u{ending}")
    Path("camera.json").write_text(json.dumps(posed.camera(EnuFrame(2.2, 26.0)).to_json()))
    lines = [
        f"query u.h5 --camera camera.json {SUN} --json",
        "windows u.h5 --center 2.4 26 --size 20 --range 2026-01-27 2026-01-29 12h --json",
        "windows u.h5 --center 2.2 26 --camera camera.json --range 2026-01-27 2026-01-29 12h --json",
    ]
    wanted = [answer(line, capsys) for line in lines]
    Path("east.h5").rename("elsewhere.h5")
    for line, want in zip(lines, wanted, strict=True):
        assert json.loads(want["stdout"])["counts" if "query" in line else "points"]
        assert answer(line.replace("u.h5", "u.lcpx"), capsys) == want
    assert run(["inspect", "u.lcpx"]) == 4
    assert "its shard east.h5: there is no such file" in capsys.readouterr().out
    assert run(["export", "u.lcpx", "-o", "out.csv"]) == 1
    assert (
        capsys.readouterr().err.strip().endswith("u.lcpx: its shard east.h5: there is no such file")
    )
    assert not Path("out.csv").exists()


def test_a_file_of_an_index_is_no_output(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """Nor missing in the rule for make."""
    monkeypatch.chdir(folder)
    assert run(["merge", "u.lcpx", "p-west.h5", "-o", "u-east.h5", "--overwrite"]) == 2
    assert "same file" in capsys.readouterr().err
    assert run(["export", "u.lcpx", "-o", "rule.csv", "--depfile", "rule.d"]) == 0
    assert {"u.lcpx", "u-west.h5", "u-east.h5"} <= set(Path("rule.d").read_text().split())
    assert run(["export", "u.lcpx", "-o", "u.h5"]) != 0
