"""Parts of a catalogue that are read from its file, without the rest."""

from __future__ import annotations

import contextlib
import dataclasses
import pickle
import threading
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers import catalogs, many_points
from helpers.verified import verify

from lcp_catalog.catalog import catalogue, model, summary, verification
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.stored import StoredFile
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CatalogError


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("catalog") / "c.h5"
    write_catalog(catalogs.catalog(30), path)
    return path


@pytest.fixture(params=["file", "memory"])
def found(request: pytest.FixtureRequest, written: Path) -> Catalog:
    return open_catalog(written) if request.param == "file" else catalogs.catalog(30)


def test_parts_are_those_of_the_whole(found: Catalog) -> None:
    whole = catalogs.catalog(30)
    rows = np.array([29, 3, 3, 17])
    np.testing.assert_array_equal(found.part("dem", 7), whole.dem[7])
    np.testing.assert_array_equal(found.part("dem", rows), whole.dem[rows])
    np.testing.assert_array_equal(found.part("dem", rows[:0]), whole.dem[:0])
    one = found.part("sigma_major", slice(None), 1, 2, 3, 4)
    np.testing.assert_array_equal(one, whole.sigma_major[:, 1, 2, 3, 4])
    assert found.part("dem_product", slice(2, 4)).tolist() == ["WAC GLD100"] * 2
    status = found.part("coverage/status", slice(0, 5))
    np.testing.assert_array_equal(status, whole.coverage.status[:5])
    with pytest.raises(CatalogError, match="has no albedo"):
        found.part("albedo", 0)


def test_nothing_is_read_before_it_is_used(written: Path) -> None:
    found = open_catalog(written)
    assert (len(found), found.patch_nodes) == (30, 9)
    assert found.part("dem", 0).shape == (9, 9)
    for name in ("dem", "condition", "sigma_major"):
        assert isinstance(model.held(found, name), model.StoredArray)
    assert found.dem is found.dem
    assert isinstance(model.held(found, "dem"), np.ndarray)


def test_the_text_of_a_catalogue_is_a_line_and_reads_nothing(written: Path) -> None:
    opened = open_catalog(written)
    assert repr(opened).startswith("<Catalog: 30 points, ")
    assert "\n" not in repr(opened)
    assert isinstance(model.held(opened, "dem"), model.StoredArray)


@pytest.mark.parametrize(
    "box",
    [(2.9, 25.5, 4.0, 26.6), (-177.1, 25.5, 4.0, 26.6), (4.0, -90.0, 2.9, 90.0), (0, 80, 9, 90)],
)
def test_a_box_holds_the_points_within(found: Catalog, box: tuple[float, ...]) -> None:
    whole = catalogs.catalog(30)
    west, south, east, north = box
    turned = np.where(whole.longitude < west % 360, whole.longitude + 360, whole.longitude)
    width = (east - west) % 360
    inside = turned - west % 360 <= width
    inside &= (whole.latitude >= south) & (whole.latitude <= north)
    part = found.within(*box)
    np.testing.assert_array_equal(part.point_id, whole.point_id[inside])
    for name in ("dem", "condition", "detection_probability", "sigma_angle"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[inside])
    assert 0 <= len(part.coverage.status) < len(whole.coverage.status)
    assert part.coverage.usable is not None


def test_a_box_may_be_written(found: Catalog, tmp_path: Path) -> None:
    part = found.within(2.9, 25.5, 4.0, 26.6)
    assert 0 < len(part) < 30
    write_catalog(part, tmp_path / "part.h5")
    assert verify(tmp_path / "part.h5") == []
    with pytest.raises(CatalogError, match="the south 3 is above the north 2"):
        found.within(0.0, 3.0, 1.0, 2.0)


def test_a_stored_catalogue_is_copied_and_sent_as_others_are(written: Path) -> None:
    found = pickle.loads(pickle.dumps(open_catalog(written)))
    np.testing.assert_array_equal(found.condition, catalogs.catalog(30).condition)
    changed = dataclasses.replace(open_catalog(written), title="other")
    assert (changed.title, len(changed)) == ("other", 30)


def test_figures_do_not_depend_on_the_blocks(
    written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = summary.describe(written)
    for module in (catalogue, verification):
        monkeypatch.setattr(module, "BLOCK_BYTES", 5000)
    assert summary.summary(open_catalog(written)).items() <= whole.items()
    assert verify(written) == []


def test_faults_of_all_blocks_are_counted_together(
    written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "c.h5"
    path.write_bytes(written.read_bytes())
    with h5py.File(path, "r+") as file:
        file["longitude"][[3, 22]] = 500.0
    monkeypatch.setattr(verification, "BLOCK_BYTES", 5000)
    problems = verify(path)
    assert "longitude: not in 0..360 (2 of 30; the first at [3])" in problems


@pytest.mark.slow
def test_a_window_of_many_points_needs_little_memory(tmp_path: Path) -> None:
    """`benchmarks/speed/scale.py` in small."""
    path = tmp_path / "many.h5"
    write_catalog(many_points.catalog(8000), path)
    tracemalloc.start()
    try:
        found = open_catalog(path, check=False)
        part = found.within(-5.0, -5.0, 5.0, 5.0)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 10 < len(part) < 100
    assert peak < 6e6  # the claims of all points alone are 31 MB


@pytest.mark.parametrize("block_bytes", [1, 200_000])
def test_values_at_points_and_indices(
    block_bytes: int, found: Catalog, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Points in any order and more than once, in one block or in many."""
    monkeypatch.setattr(model, "BLOCK_BYTES", block_bytes)
    whole, dice = catalogs.catalog(30), np.random.default_rng(5)
    rows = dice.integers(0, 30, 50)
    for name in ("condition", "sigma_major", "detection_probability"):
        lengths = getattr(whole, name).shape[1:]
        index = [dice.integers(0, length, (50, 6)) for length in lengths]
        got = found.at(name, rows, index)
        np.testing.assert_array_equal(got, getattr(whole, name)[(rows[:, None], *index)])
        none = found.at(name, rows[:0], [along[:0] for along in index])
        assert none.shape == (0, 6)


# -- a name that comes to mean another file


@pytest.fixture
def switched(written: Path, tmp_path: Path) -> tuple[Path, Callable[[], None]]:
    """A link to a catalogue, and what makes it in one step a link to another one or back."""
    link, files = tmp_path / "link.h5", [written, tmp_path / "other.h5"]
    write_catalog(dataclasses.replace(catalogs.catalog(31), title="other"), files[1])
    link.symlink_to(files[0])

    def switch() -> None:
        files.reverse()
        (tmp_path / "new").symlink_to(files[0])
        (tmp_path / "new").replace(link)

    return link, switch


def test_the_file_that_is_open_is_judged_and_not_its_name(
    switched: tuple[Path, Callable[[], None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    link, switch = switched

    def late(*given: Any) -> h5py.File:
        switch()
        return opened(*given)

    opened = h5py.File
    found = open_catalog(link)
    monkeypatch.setattr(h5py, "File", late)
    monkeypatch.setattr(verification, "call_apart", lambda check, facts, _: check(facts))  # now
    for attempt in (lambda: open_catalog(link), lambda: found.longitude):
        with pytest.raises(CatalogError, match=r"link\.h5: was changed since it was opened"):
            attempt()
        switch()  # back


@pytest.mark.parametrize("other", [b"text", b"\x89HDF\r\n\x1a\n"])
def test_a_link_that_meant_no_catalogue_for_a_moment(
    other: bytes, written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It means the catalogue again when the error of HDF5 is looked at."""
    link = tmp_path / "link.h5"
    link.symlink_to(written)
    (tmp_path / "other").write_bytes(other)
    opened = h5py.File

    def switched(name: object, mode: str) -> h5py.File:
        return opened(tmp_path / "other" if name == str(link) else name, mode)

    stored = StoredFile.of(link)
    monkeypatch.setattr(h5py, "File", switched)
    with pytest.raises(CatalogError) as caught, stored.opened():
        pass
    assert str(caught.value) == f"{link}: was changed since it was opened; open it again"


def test_a_link_that_switches_while_it_is_read_gives_one_file_or_an_error(
    switched: tuple[Path, Callable[[], None]],
) -> None:
    link, switch = switched
    """On a busy machine the two threads may take turns so that no opening meets a switch."""
    done, taken = threading.Event(), 0
    titles = {link.stat().st_ino: Catalog.title}

    def switching() -> None:
        while not done.is_set():
            switch()

    thread = threading.Thread(target=switching)
    thread.start()
    try:
        for _ in range(200):
            one = StoredFile.of(link)
            with contextlib.suppress(CatalogError), one.opened() as file:
                assert file.attrs["title"] == titles.get(one.stamp[1], "other")
                taken += 1
    finally:
        done.set()
        thread.join()
    assert taken
