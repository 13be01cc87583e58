"""Catalogues that are written in parts, and files that cannot be written."""

from __future__ import annotations

import errno
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catalogs
from helpers.verified import verify

from lcp_catalog.catalog import catalogue, disk_stream
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.layout import GROUPS
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import new_catalog, write_catalog
from lcp_catalog.errors import CatalogError, OutputError


def write_in_parts(catalog: Catalog, path: Path, sizes: list[int], **spoilt: Any) -> None:
    values, first = catalogue.values(catalog) | spoilt, 0
    of_points = [name for name in values if GROUPS[""].get(name, ((),))[0][:1] == ("point",)]
    with new_catalog(catalog, len(catalog), ["WAC GLD100", "another product"], path) as file:
        for size in sizes:
            file.add({name: values[name][first : first + size] for name in of_points})
            first += size
        file.finish(catalog.coverage)


@pytest.mark.slow
@pytest.mark.parametrize(
    "sizes",
    [
        [300],
        [60] * 5,
        [1, 298, 1],
        [7] * 42 + [6],
    ],
)
def test_parts_of_any_size_give_the_same_catalogue(tmp_path: Path, sizes: list[int]) -> None:
    """Chunks of the larger variables hold fewer points than a part, and more."""
    found = catalogs.catalog(300)
    write_catalog(found, tmp_path / "whole.h5")
    write_in_parts(found, tmp_path / "parts.h5", sizes)
    assert verify(tmp_path / "parts.h5") == []
    whole, parts = (open_catalog(tmp_path / name) for name in ("whole.h5", "parts.h5"))
    assert catalogue.attributes(whole) == catalogue.attributes(parts)
    read = catalogue.values(parts)
    for name, values in catalogue.values(whole).items():
        np.testing.assert_array_equal(read[name], values, err_msg=name)


def test_parts_that_are_wrong_are_refused(tmp_path: Path) -> None:
    found = catalogs.catalog(4)
    path = tmp_path / "c.h5"
    with pytest.raises(CatalogError, match="3 points were added instead of 4"):
        write_in_parts(found, path, [3])
    numbers = found.point_id[[0, 0, 1, 2]]
    with pytest.raises(CatalogError, match="more than once"):
        write_in_parts(found, path, [1, 3], point_id=numbers)
    with pytest.raises(CatalogError, match="is not the place"):
        write_in_parts(found, path, [1, 3], latitude=np.array([0.0, 0.0, 0.0, 91.0]))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("room", [0, 3_000, 40_000, 100_000, -1])
def test_a_disk_that_is_full_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    """After any number of bytes, and when the file is synced (-1); HDF5 closes the file in order, so that
    the next one is written in the same process.
    """
    found, path, written = catalogs.catalog(60), tmp_path / "c.h5", []

    def limited(action: Callable[..., int]) -> Callable[..., int]:
        def write(file: int, data: Any, start: int) -> int:
            written.append(len(data))
            if 0 <= room < sum(written):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return action(file, data, start)

        return write

    def full(file: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(disk_stream.os, "pwrite", limited(os.pwrite))
        if room < 0:
            patch.setattr(disk_stream.os, "fsync", full)
        with pytest.raises(OutputError, match=r"c\.h5: the disk is full"):
            write_catalog(found, path)
    assert list(tmp_path.iterdir()) == []
    write_catalog(found, path)
    assert verify(path) == []
    assert path.stat().st_size > max(room, 0)


def test_a_signal_while_hdf5_writes_is_an_interrupt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It raised inside HDF5, which then crashed. Nothing is left, and the next file is whole."""
    found, path = catalogs.catalog(60), tmp_path / "c.h5"

    def interrupted(file: int, data: Any, start: int) -> int:
        signal.raise_signal(signal.SIGINT)
        return write(file, data, start)

    write = os.pwrite
    with monkeypatch.context() as patch:
        patch.setattr(disk_stream.os, "pwrite", interrupted)
        with pytest.raises(KeyboardInterrupt):
            write_catalog(found, path)
    assert list(tmp_path.iterdir()) == []
    write_catalog(found, path)
    assert verify(path) == []
