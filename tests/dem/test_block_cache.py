"""Kept means of blocks: the same as made anew, within their memory, and never of a file that has changed."""

from __future__ import annotations

import os
from collections import OrderedDict

import numpy as np
import pytest
from helpers.products import geotiff

from lcp_catalog.dem import block_cache
from lcp_catalog.dem.mosaic import DemSet


@pytest.fixture(autouse=True)
def empty():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(block_cache, "_store", block_cache._Store())
        patch.setattr(block_cache, "_windows", OrderedDict())
        yield


def blocks(calls: list):
    """A source whose block (row, column) is 1000 row + column."""

    def read(row0: int, row1: int, col0: int, col1: int) -> np.ndarray:
        calls.append((row0, row1, col0, col1))
        rows, cols = np.mgrid[row0:row1, col0:col1]
        return (1000.0 * rows + cols).astype(np.float32)

    return read


@pytest.mark.parametrize("factor", [2, 7, 16, 100])
def test_a_window_is_put_together_from_tiles(factor) -> None:
    calls: list = []
    for window in ((-70, 200, -130, 3), (5, 6, 1500, 1502), (0, 64, 0, 64)):
        found = block_cache.window("a", factor, *window, blocks(calls))
        rows, cols = np.mgrid[window[0] : window[1], window[2] : window[3]]
        np.testing.assert_array_equal(found, (1000.0 * rows + cols).astype(np.float32))
    made = len(calls)
    block_cache.window("a", factor, -70, 200, -130, 3, blocks(calls))
    assert len(calls) == made  # kept
    block_cache.window("b", factor, 0, 1, 0, 1, blocks(calls))
    block_cache.window("a", factor + 1, 0, 1, 0, 1, blocks(calls))
    assert len(calls) == made + 2  # another source, another size


def test_the_oldest_go_first(monkeypatch) -> None:
    monkeypatch.setattr(block_cache._store, "limit_bytes", 3 * 64 * 64 * 4)
    calls: list = []
    for column in (0, 64, 128, 0, 192):  # the fourth asks for the first again
        block_cache.window("a", 64, 0, 1, column, column + 1, blocks(calls))
    assert len(calls) == 4
    block_cache.window("a", 64, 0, 1, 0, 1, blocks(calls))
    assert len(calls) == 4  # was asked for again, and stayed
    block_cache.window("a", 64, 0, 1, 64, 65, blocks(calls))
    assert len(calls) == 5  # had gone


def test_a_file_that_was_written_anew_is_another(tmp_path) -> None:
    path = geotiff(tmp_path / "a.tif", np.full((64, 64), 5.0, np.float32), 0.0, 6400.0, 100.0)
    before, _ = DemSet.open([path]).heights(0.05, 0.1, 800.0)
    geotiff(path, np.full((64, 64), 9.0, np.float32), 0.0, 6400.0, 100.0)
    os.utime(path, ns=(1, 2))
    after, _ = DemSet.open([path]).heights(0.05, 0.1, 800.0)
    assert (round(float(before)), round(float(after))) == (5, 9)


def test_a_far_cell_takes_the_coarsest_product_that_is_fine_enough(tmp_path) -> None:
    """50, 100 and 400 m: the level tells which answered."""
    made = {50.0: 1.0, 100.0: 2.0, 400.0: 3.0}
    paths = [
        geotiff(tmp_path / f"{pixel:g}.tif", np.full((n, n), level, np.float32), 0.0, 25.6e3, pixel)
        for pixel, level in made.items()
        for n in (int(25.6e3 / pixel),)
    ]
    dems = DemSet.open(paths)
    assert round(float(dems.heights(0.4, 0.4, 800.0)[0])) == 1  # near by the finest comes first
    for cell, level in (
        (60.0, 1.0),
        (100.0, 2.0),
        (399.0, 2.0),
        (400.0, 3.0),
        (5e3, 3.0),
        (10.0, 1.0),
    ):
        assert round(float(dems.for_cells(cell).heights(0.4, 0.4, cell)[0])) == level


def test_a_recent_window_is_read_once(monkeypatch) -> None:
    calls: list = []

    def pixels(source: str, *wanted: int) -> np.ndarray:
        read = blocks(calls)
        found, top, left = block_cache.recent(source, wanted, (2, 3), lambda box: read(*box))
        row0, row1, col0, col1 = wanted
        return found[row0 - top : row1 - top, col0 - left : col1 - left]

    for source, window, reads in (
        ("a", (5, 9, -4, 6), 1),
        ("a", (3, 11, -7, 9), 1),  # the first with its margins
        ("b", (5, 9, -4, 6), 2),
        ("a", (2, 9, -4, 6), 3),  # a row more
        ("a", (5, 9, -4, 10), 4),
    ):
        rows, cols = np.mgrid[window[0] : window[1], window[2] : window[3]]
        np.testing.assert_array_equal(pixels(source, *window), 1000.0 * rows + cols)
        assert len(calls) == reads
    monkeypatch.setattr(block_cache, "RECENT_PIXELS", 50)
    assert pixels("c", 0, 5, 0, 5).shape == (5, 5)
    assert calls[-1] == (0, 5, 0, 5)  # too large to be kept
    for number in range(block_cache.RECENT):
        pixels(str(number), 0, 1, 0, 1)
    assert list(block_cache._windows) == ["0", "1", "2", "3"]
