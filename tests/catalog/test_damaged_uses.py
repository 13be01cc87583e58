"""Damaged catalogues in every use: refused, or the result of the whole file. `benchmarks/faults/damage.py` tries all
edits and many more bits.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from helpers import catalog_uses, damaged_catalogs

from lcp_catalog.catalog import verification


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return catalog_uses.written(tmp_path_factory.mktemp("uses"))


@pytest.fixture(scope="module")
def sound(whole: Path) -> dict[str, Any]:
    return catalog_uses.sound_outcomes(whole)


@pytest.mark.slow
def test_the_whole_file_is_taken_by_every_use(sound: dict[str, Any]) -> None:
    assert [use for use, found in sound.items() if isinstance(found, str)] == []
    assert len({str(found) for found in sound.values()}) == len(sound)


SILENT = (("point_id", "rows exchanged"), ("dem", "mirrored"))
"""Edits of which the checks of values find none."""


@pytest.mark.slow
def test_a_damaged_file_is_refused_or_gives_the_same(
    whole: Path, sound: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Read as a large file is, whose chunks some uses check when they need them."""
    monkeypatch.setattr(verification, "_WHOLE_BYTES", 0)
    edits, refused = damaged_catalogs.edits(whole), dict.fromkeys(sound, 0)
    assert len(edits) >= 193
    assert {*SILENT} < {*edits}
    for what, path in catalog_uses.damaged(whole, 1, SILENT):
        rejected = isinstance(catalog_uses.outcome("inspect", path, whole.parent), str)
        for use, expected in sound.items():
            found = catalog_uses.outcome(use, path, whole.parent)
            assert use in catalog_uses.OF_PARTS or isinstance(found, str) == rejected, (use, what)
            assert not catalog_uses.taken(use, expected, found), (use, what)
            if isinstance(found, str):
                refused[use] += 1
                assert path.name in found
                assert "\n" not in found
    assert all(refused.values()), refused
