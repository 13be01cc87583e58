"""Damaged catalogues in every use: refused, or the result of the whole file. `benchmarks/faults/damage.py` tries all
edits and many more bits.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catalog_uses, catalogs, damaged_catalogs, merges

from lcp_catalog.catalog.writing import write_catalog


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("uses") / "whole.h5"
    write_catalog(replace(catalogs.full(3), config=merges.config(2.1, 4.9)), path)
    return path


@pytest.fixture(scope="module")
def sound(whole: Path) -> dict[str, Any]:
    return {use: catalog_uses.outcome(use, whole, whole.parent) for use in catalog_uses.USES}


def test_the_whole_file_is_taken_by_every_use(sound: dict[str, Any]) -> None:
    assert [use for use, found in sound.items() if isinstance(found, str)] == []
    assert len({str(found) for found in sound.values()}) == len(sound)


def damaged(whole: Path) -> Iterator[Path]:
    """Edits of which the checks of values find none, and a bit near an index of chunks."""
    path, edits = whole.with_name("damaged.h5"), damaged_catalogs.edits(whole)
    assert len(edits) >= 193
    for name, change in (("point_id", "rows exchanged"), ("dem", "mirrored")):
        assert (name, change) in edits
        shutil.copy(whole, path)
        damaged_catalogs.edit(path, name, change)
        yield path
    turned = bytearray(whole.read_bytes())
    damaged_catalogs.flip_index(turned, np.random.default_rng(5))
    path.write_bytes(turned)
    yield path


def test_a_damaged_file_is_refused_or_gives_the_same(whole: Path, sound: dict[str, Any]) -> None:
    refused = dict.fromkeys(sound, 0)
    for path in damaged(whole):
        for use, expected in sound.items():
            found = catalog_uses.outcome(use, path, whole.parent)
            assert not catalog_uses.taken(use, expected, found), (use, path)
            if isinstance(found, str):
                refused[use] += 1
                assert path.name in found
                assert "\n" not in found
    assert all(refused.values()), refused
