"""What reads a catalogue's file, by name: each gives a result that is compared with that of the whole file. A new
reader joins `USES`; `benchmarks/faults/damage.py` and `tests/catalog/test_damaged_uses.py` try them all.
"""

from __future__ import annotations

import functools
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import lcp_catalog as lcp
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.view import looking_camera
from lcp_catalog.catalog import catalogue, verification
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CatalogError
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.matching.templates import render_patches
from lcp_catalog.navigation.documents import document

from . import catalogs, damaged_catalogs, merges

SUN = (90.0, 20.0)
DAMAGED = "damaged.h5"


def camera() -> Camera:
    """One that sees the points of `catalogs.catalog`, 100 km below."""
    frame = EnuFrame(*catalogs.CENTER)
    return looking_camera(frame, (0.0, 0.0, 100e3), catalogs.GSD_M, (60e3, 60e3))


def _values(path: Path, _folder: Path) -> Any:
    return catalogue.values(lcp.open_catalog(path, check=False))


def _inspect(path: Path, _folder: Path) -> Any:
    found = lcp.inspect(path)
    if not found["intact"]:
        raise CatalogError(f"{path}: {found['problems'][0]}")
    return found


def _export(path: Path, folder: Path) -> bytes:
    lcp.export(path, folder / "points.csv", overwrite=True)
    return (folder / "points.csv").read_bytes()


def _merge(path: Path, folder: Path) -> bytes:
    lcp.merge([path, path], folder / "merged.h5", overwrite=True)
    return (folder / "merged.h5").read_bytes()


def _report(path: Path, folder: Path) -> bytes:
    lcp.report(path, folder / "page.html", overwrite=True)
    return (folder / "page.html").read_bytes()


def _query(path: Path, _folder: Path) -> Any:
    return document(lcp.query(path, camera(), sun=SUN), lcp.open_catalog(path, check=False))


def _windows(path: Path, _folder: Path) -> Any:
    times = lcp.instant_range("2026-03-01", "2026-03-08", step_s=86400.0)
    return lcp.windows(path, catalogs.CENTER, times, size_km=40).usable


def _diff(path: Path, _folder: Path) -> Any:
    return lcp.diff(path, path.with_name("whole.h5")).summary()


def _patches(path: Path, _folder: Path) -> Any:
    suns = np.array([[0.0, -0.9, 0.4]] * 3)
    return render_patches(path, [0, 1, 2], camera(), suns).values


USES: dict[str, Callable[[Path, Path], Any]] = {
    "values": _values,
    "inspect": _inspect,
    "export": _export,
    "merge": _merge,
    "report": _report,
    "query": _query,
    "windows": _windows,
    "diff": _diff,
    "patches": _patches,
}


OF_PARTS = ("values", "query", "windows", "export")
"""Uses that check of a large file no more than they need (``values`` needs all but the axes that number points and
cells, ``export`` to a CSV file what it writes); the others refuse whatever `inspect` rejects.
"""


def outcome(use: str, path: Path, folder: Path) -> Any:
    """A use's result, or the text of its CatalogError."""
    try:
        return USES[use](path, folder)
    except CatalogError as error:
        return str(error)


def taken(use: str, sound: Any, found: Any) -> bool:
    """True if a use of a damaged file gave another result than that of the whole file, and no error."""
    if isinstance(found, str):
        return False
    try:
        np.testing.assert_equal(found, sound)
    except AssertionError:
        return True
    return False


def written(folder: Path) -> Path:
    """A catalogue with all groups, which can be merged, in a folder."""
    path = folder / "whole.h5"
    write_catalog(replace(catalogs.full(3), config=merges.config(2.1, 4.9)), path)
    return path


def sound_outcomes(whole: Path, uses: Iterable[str] = USES) -> dict[str, Any]:
    """Outcomes of uses of a whole file, under the name of the damaged ones, which merges and pages hold."""
    copy = Path(shutil.copy(whole, whole.with_name(DAMAGED)))
    return {use: outcome(use, copy, whole.parent) for use in uses}


def damaged(
    whole: Path, flips: int, some: Sequence[tuple[str, str]] = ()
) -> Iterator[tuple[str, Path]]:
    """Copies of a file with each of `damaged_catalogs.edits` (or ``some`` of them), and with so many bits turned near
    indices of chunks.
    """
    path, rng = whole.with_name(DAMAGED), np.random.default_rng(1)
    for name, change in some or damaged_catalogs.edits(whole):
        shutil.copy(whole, path)
        damaged_catalogs.edit(path, name, change)
        yield f"{name}: {change}", path
    for number in range(flips):
        turned = bytearray(whole.read_bytes())
        damaged_catalogs.flip_index(turned, rng)
        path.write_bytes(turned)
        yield f"bit {number}", path


def tried(folder: Path, flips: int, uses: Sequence[str]) -> Iterator[Counter[str]]:
    """Outcomes of some uses of all damaged copies, read as large files are, summed up: ``tried``, ``refused``, ``same``
    as of the whole file. AssertionError for one that is taken. What the process of a check says of a file is asked
    for once, and not by each use again.
    """
    verification._WHOLE_BYTES = 0
    verification.apart = functools.lru_cache(4)(verification.apart)
    whole = written(folder)
    sound = sound_outcomes(whole, uses)
    found = Counter[str]()
    for what, path in damaged(whole, flips):
        got = {use: outcome(use, path, folder) for use in uses}
        for use, result in got.items():
            assert not taken(use, sound[use], result), (use, what)
            assert use in OF_PARTS or isinstance(result, str) == isinstance(got["inspect"], str), (
                use,
                what,
            )
            found.update({"tried": 1, "refused" if isinstance(result, str) else "same": 1})
        yield found
