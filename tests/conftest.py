"""Paths that tests share. The real data beside the checkout are optional: a test that needs them
says so by its fixture.
"""

from __future__ import annotations

import dataclasses
import gc
import hashlib
import json
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from helpers.archive_files import Product

    from lcp_catalog.production.run import Level

HERE = Path(__file__).resolve().parent

gc.set_threshold(100_000, 20, 20)
"""As `lcp` does: imports, syntax trees and thousands of tests are objects that stay, and looking through them for garbage took a
sixth of the collection's time.
"""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a background job of a shell
    signal.signal(signal.SIGINT, signal.default_int_handler)

if "PYTEST_XDIST_WORKER" in os.environ:  # the workers share the processor: one thread each
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

os.environ.setdefault("OMP_WAIT_POLICY", "passive")
"""Read when numba starts its threads. Else those that wait for the next loop spin, and steal the processor from whatever runs
beside the tests: 14 x 14 nodes under one Sun then take 79 ms on a busy machine instead of 0.3."""


@pytest.fixture(scope="session")
def data() -> Path:
    """The small files that the repository holds (see PROVENANCE.md there)."""
    return HERE / "data"


@pytest.fixture(scope="session")
def labels(data: Path) -> Path:
    """Exact texts of PDS3 labels."""
    return data / "labels"


@pytest.fixture(scope="session")
def ldem_4(data: Path) -> Path:
    """Folder of the archive's own LDEM_4: .IMG and .JP2 with their labels."""
    return data / "ldem_4"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real lunar data: ``LCP_SHARED_DATA``, or ``shared/data`` in or beside the checkout; skipped
    without.
    """
    root = HERE.parent
    places = [root / "shared" / "data", root.parent / "shared" / "data"]
    if "LCP_SHARED_DATA" in os.environ:
        places = [Path(os.environ["LCP_SHARED_DATA"])]
    for place in places:
        if place.is_dir():
            return place
    pytest.skip("the shared lunar data are not here; set LCP_SHARED_DATA to their folder")


@pytest.fixture(scope="session")
def archive(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Product]:
    """One of each product of the archives by its image's name, made once: read them, change copies."""
    from helpers import archive_products

    found = archive_products.all_products(tmp_path_factory.mktemp("archive"))
    return {product.image.name: product for product in found}


@pytest.fixture
def archive_copy(archive: dict[str, Product], tmp_path: Path) -> Callable[[str], Path]:
    """Copies a product; gives its label, or the image where the label is in front of it."""
    return lambda image: archive[image].copied_to(tmp_path)


def _one_thread_in_a_worker() -> None:
    """Kernels and OpenCV use one thread in each process of a parallel run, unless a test asks for more."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        import cv2  # noqa: F401  limit_threads sees it only if it is imported

        from lcp_catalog.threads import limit_threads

        limit_threads(1)


def _silent(patch: pytest.MonkeyPatch) -> None:
    """Commands that run in this process do not say how long they or their tasks are at work: on a slow machine each
    would. Tests of that set it back.
    """
    patch.setattr("lcp_cli.progress.alive", lambda name: nullcontext())
    patch.setattr("lcp_cli.progress._FIRST_S", 600.0)


def _checks_in_this_process(patch: pytest.MonkeyPatch) -> None:
    """Files of catalogues are checked by a call here: the process of its own that a check has takes 0.3 s
    to start, for a thousand files. What a check found in a file without a fault is remembered for files of the
    same bytes, and what the last check found in a faulty one. Tests of damaged files ask for `checks_apart`.
    """
    from lcp_catalog.catalog import verification

    sound: dict[tuple[Callable[[Any], object], bytes], str] = {}
    last: dict[object, object] = {}

    def call_here(check: Callable[[Any], object], facts: list[Any], _seconds: float) -> object:
        path = Path(facts[0])
        content = hashlib.sha256(path.read_bytes()).digest() if path.is_file() else b""
        if (check, content) in sound:
            return json.loads(sound[check, content])
        key = check, content, json.dumps(facts)
        if key in last:
            return last[key]
        found = json.loads(text := json.dumps(check(json.loads(json.dumps(facts)))))
        if content and found[0] == []:
            sound[check, content] = text
        elif content:
            last.clear()
            last[key] = found
        return found

    patch.setattr(verification, "call_apart", call_here)


def _resolution_of_equal_heights(patch: pytest.MonkeyPatch) -> None:
    """The effective resolution of a DEM, which takes 0.4 s for the sample, is estimated once for all copies of a file."""
    from lcp_catalog.dem import effective_resolution

    known: dict[object, effective_resolution.Resolution] = {}
    of_windows = effective_resolution.of_windows

    def remembered(
        windows: Sequence[effective_resolution.Heights], posting_m: float
    ) -> effective_resolution.Resolution:
        content = hashlib.sha256()
        for window in windows:
            content.update(repr((window.z_m.shape, window.z_m.dtype, window.steps_m)).encode())
            content.update(window.z_m.tobytes())
        key = content.digest(), posting_m
        if key not in known:
            known[key] = of_windows(windows, posting_m)
        return known[key]

    patch.setattr(effective_resolution, "of_windows", remembered)


def _rasters_opened_here(patch: pytest.MonkeyPatch) -> None:
    """A raster that is no plain GeoTIFF is opened without the process of its own before, which shows whether GDAL waits
    for the writer of a pipe and takes 0.2 s for each new file. Tests of pipes ask for `rasters_apart`.
    """
    from lcp_catalog.dem import raster_files

    patch.setattr(raster_files, "call_apart", lambda function, name, seconds: None)


def _start_measured_once(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """What a build takes beside its areas, for which a small one is made in a process of its own (2 s of processor time), is
    measured once, with the first number of jobs that is asked for, by all workers of a parallel run together.
    """
    from lcp_catalog.production import estimate
    from lcp_catalog.tradeoff import knobs

    start_of = estimate.start_of
    folder = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder

    def remembered(level: Level, jobs: int) -> estimate.Start:
        known = folder / "start.json"
        if not known.is_file():
            aside = known.with_suffix(f".{os.getpid()}")
            aside.write_text(json.dumps(dataclasses.asdict(start_of(level, jobs))))
            aside.replace(known)
        return estimate.Start(**json.loads(known.read_text()))

    for module in (estimate, knobs):
        patch.setattr(module, "start_of", remembered)


@pytest.fixture(scope="session", autouse=True)
def as_tests_want_it(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The session's changes of the library, in one fixture: each of 7000 tests asks for all that are there."""
    _one_thread_in_a_worker()
    with pytest.MonkeyPatch.context() as patch:
        _silent(patch)
        _checks_in_this_process(patch)
        _resolution_of_equal_heights(patch)
        _rasters_opened_here(patch)
        _start_measured_once(patch, tmp_path_factory.getbasetemp())
        yield


@pytest.fixture
def rasters_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rasters are opened as for users: in another process first, where GDAL could wait for a pipe."""
    from lcp_catalog.child_process import call_apart
    from lcp_catalog.dem import raster_files

    monkeypatch.setattr(raster_files, "call_apart", call_apart)


@pytest.fixture
def checks_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each check of a catalogue's file has a process of its own, as for users: for files that may crash HDF5. By the
    fixture that a test takes for more, which would else put this one back for all later tests.
    """
    from lcp_catalog.catalog import verification
    from lcp_catalog.child_process import call_apart

    monkeypatch.setattr(verification, "call_apart", call_apart)


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """For scenes of a hundred nodes: waking a second thread takes longer than they do."""
    from lcp_catalog.threads import limit_threads

    with limit_threads(1):
        yield


def pytest_configure(config: pytest.Config) -> None:
    """Every second worker of a parallel run imports the test modules in reverse. In a new clone their assertions are rewritten
    first (8 s of processor time): each worker does half, and reads what the other has written.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0")
    if int(worker.removeprefix("gw")) % 2 and [Path(one).resolve() for one in config.args] == [
        HERE
    ]:
        found = [*HERE.glob("test_*.py"), *(path.parent for path in HERE.glob("*/test_*.py"))]
        config.args = [str(path) for path in sorted({*found}, reverse=True)]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All workers have the same order. `make test` draws a third of the examples that a test of hypothesis states, other ones
    in each run; `make test-slow` draws all.
    """
    if "PYTEST_XDIST_WORKER" in os.environ:
        items.sort(key=lambda item: item.path.parts)
    if os.environ.get("LCP_ALL_EXAMPLES"):
        return
    tests = {getattr(one, "__func__", one) for one in (getattr(i, "obj", None) for i in items)}
    for test in tests:
        if getattr(test, "is_hypothesis_test", False):
            stated = test._hypothesis_internal_use_settings
            fewer = min(stated.max_examples, max(8, stated.max_examples // 3))
            test._hypothesis_internal_use_settings = settings(stated, max_examples=fewer)


def pytest_collection_finish() -> None:
    """Six thousand tests stay to the end: the collector need not look at them again every few seconds."""
    gc.collect()
    gc.freeze()


settings.register_profile("people", deadline=None)  # times are for benchmarks; machines are busy
settings.register_profile("ci", deadline=None, derandomize=True)
"""A landing never hangs on the day's dice; people's runs explore."""

settings.load_profile("ci" if os.environ.get("CI") else "people")
