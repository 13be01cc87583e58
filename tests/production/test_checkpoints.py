"""Checkpoints: what is written is read again, in parts, and nothing that is damaged is taken for whole."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
from helpers.finished_areas import KIND, area

from lcp_catalog.errors import AreaFailedError
from lcp_catalog.production.checkpoints import Checkpoints, JoinedAreas

NAMES = ("r00001c00001", "r00001c00002", "r00001c00003")


AREAS = (area(1, (0, 3, 2, 0, 1)), area(2, ()), area(3, (4, 0, 4)))


@pytest.fixture
def checkpoints(tmp_path: Path) -> Checkpoints:
    found = Checkpoints.beside(tmp_path / "x.h5", {"source code": "ab" * 32})
    found.folder.mkdir()
    for name, one in zip(NAMES, AREAS, strict=True):
        found.write(name, one)
    return found


def test_the_records_of_any_rows_are_read(checkpoints: Checkpoints) -> None:
    """In the order of the rows, from several areas."""
    joined = JoinedAreas.read(checkpoints, NAMES)
    np.testing.assert_array_equal(joined.table, np.concatenate([one.table for one in AREAS]))
    found = joined.records(np.array([7, 4, 1, 5]), KIND)
    first, last = AREAS[0].records, AREAS[2].records
    np.testing.assert_array_equal(found, np.stack([last[1], first[2], first[0], last[0]]))
    assert (
        joined.plan.relief.reason
        == f"all 3 areas, the largest error bound in {NAMES[2]}: of area 3"
    )


def test_every_flipped_bit_is_noticed(checkpoints: Checkpoints) -> None:
    """At every eighth byte; an area that lacks its end is not whole either."""
    path, name = checkpoints.path(NAMES[0]), NAMES[0]
    whole = path.read_bytes()
    assert checkpoints.is_whole(name)
    for place in range(0, len(whole), 8):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place // 8 % 8
        path.write_bytes(damaged)
        assert not checkpoints.is_whole(name), place
    for length in (0, 10, 90, len(whole) // 2, len(whole) - 1, len(whole) + 1):
        path.write_bytes((whole + b"x")[:length])
        assert not checkpoints.is_whole(name), length
    path.write_bytes(whole)
    assert not dataclasses.replace(checkpoints, fingerprint="cd" * 32).is_whole(name)


def test_a_pipe_in_the_place_of_a_checkpoint_counts_as_damaged(checkpoints: Checkpoints) -> None:
    """Nothing waits for its writer."""
    checkpoints.path(NAMES[0]).unlink(missing_ok=True)
    os.mkfifo(checkpoints.path(NAMES[0]))
    assert not checkpoints.is_whole(NAMES[0])
    assert checkpoints.read(NAMES[0]) is None


def test_a_checkpoint_is_of_its_area_alone(
    checkpoints: Checkpoints, caplog: pytest.LogCaptureFixture
) -> None:
    here, other = (checkpoints.path(name) for name in NAMES[:2])
    other.write_bytes(here.read_bytes())
    assert checkpoints.is_whole(NAMES[0])
    assert caplog.text == ""
    assert not checkpoints.is_whole(NAMES[1])
    assert f"{other}: is damaged, or of another area or run" in caplog.text
    assert checkpoints.read(NAMES[1]) is None
    with pytest.raises(AreaFailedError, match=NAMES[1]):
        JoinedAreas.read(checkpoints, NAMES)


def test_a_record_that_is_damaged_after_the_choice_is_an_error(checkpoints: Checkpoints) -> None:
    """Its file is as long as before and its table is whole."""
    joined = JoinedAreas.read(checkpoints, NAMES)
    path = checkpoints.path(NAMES[2])
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    assert len(joined.records(np.array([5]), KIND)) == 1
    with pytest.raises(AreaFailedError, match=rf"{NAMES[2]}.*damaged.*`resume`"):
        joined.records(np.array([7]), KIND)
    path.unlink()
    with pytest.raises(AreaFailedError, match="no longer there"):
        JoinedAreas.read(checkpoints, NAMES)


@pytest.mark.parametrize(
    ("shared", "names", "kept"), [(False, (), False), (True, (), True), (False, NAMES[:1], True)]
)
def test_an_error_before_the_first_area_leaves_nothing(
    shared: bool, names: tuple[str, ...], kept: bool, tmp_path: Path
) -> None:
    """But for a part of a build: others may be at work in the folder."""
    found = Checkpoints.beside(tmp_path / "x.h5", {"source code": "ab" * 32})

    def fail() -> None:
        with found.locked(shared):
            found.begin(resume=False)
            for name, one in zip(names, AREAS, strict=False):
                found.write(name, one)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert found.folder.exists() == kept
    assert all(found.is_whole(name) for name in names)
