"""Tasks on a dask cluster of two processes on this machine."""

from __future__ import annotations

import gc
import json
import os
import platform
import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from lcp_catalog.errors import ClusterError
from lcp_catalog.production import cluster as engine
from lcp_catalog.production.code_facts import code_facts
from lcp_catalog.production.executor import run_tasks

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from distributed import LocalCluster

distributed = pytest.importorskip(
    "distributed", reason="an extra: pip install 'lcp-catalog[cluster]'"
)


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    """Two workers of one thread. A task may kill one worker, not two (by default four)."""
    import dask

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as made,
    ):
        yield made


@pytest.fixture(autouse=True)
def workers(cluster: LocalCluster) -> None:
    """Both workers, also after a test that has killed some: dask gives one up that does not start in time on a loaded
    machine, and a build waits for ever.
    """
    if len(cluster.scheduler.workers) < 2:
        cluster.scale(0)
        cluster.scale(2)
    cluster.get_client().wait_for_workers(2, timeout=120)


def first_line(path: Path) -> str:
    return path.read_text().splitlines()[0]


def square_or_die(value: int) -> int:
    if value == 3:
        os._exit(9)
    if value == 13:
        raise ValueError("unlucky")
    return value * value


def test_relative_paths_are_those_of_the_sender(
    cluster: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The workers have another working folder."""
    monkeypatch.chdir(tmp_path)
    Path("a.txt").write_text("here\n")
    tasks = [Path("a.txt")]
    outcomes = run_tasks(first_line, tasks, 1, cluster.scheduler_address, inputs=tasks)
    assert dict(outcomes) == {0: "here"}


def faults(_: int) -> int:
    """Pages that are faulted in for 50 arrays of 8 MB, one after the other."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(50):
        np.ones(1_000_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="mallopt is glibc's")
def test_workers_keep_their_memory(cluster: LocalCluster) -> None:
    """An array has 1953 pages, some of them large ones; dask's own setting lets each of 50 be faulted in."""
    own = cluster.get_client().submit(faults, 0).result()
    (_, kept), *_ = run_tasks(faults, [0], 1, cluster.scheduler_address)
    assert (own > 15_000, kept < 8_000) == (True, True), (own, kept)


def test_a_task_that_kills_its_workers_is_left_out(cluster: LocalCluster) -> None:
    outcomes = dict(run_tasks(square_or_die, [1, 2, 3, 13, 5, 6], 1, cluster.scheduler_address))
    assert {index: outcomes[index] for index in (0, 1, 4, 5)} == {0: 1, 1: 4, 4: 25, 5: 36}
    assert isinstance(outcomes[3], ValueError)
    assert isinstance(outcomes[2], RuntimeError)
    assert "workers that computed it died" in str(outcomes[2])


def test_few_tasks_are_in_the_cluster_and_no_result_stays(cluster: LocalCluster) -> None:
    most = 0
    with distributed.Client(cluster) as watching:
        for _ in run_tasks(square_or_die, [*range(20, 60)], 1, cluster.scheduler_address):
            held = watching.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))
            most = max(most, held)
        deadline = time.monotonic() + 5.0
        while watching.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)):
            assert time.monotonic() < deadline
            time.sleep(0.05)
    assert 1 <= most <= 2 * engine._AHEAD + 1


WORKERS = {
    "source code": "0" * 64,
    "NumPy": "1.0",
    "processor level": "SSE2, kernels for x86-64",
}


@pytest.mark.parametrize("what", [*WORKERS, "content", "missing"])
def test_a_worker_that_differs_is_refused(
    what: str, cluster: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "dem.img"
    file.write_text("one\n")
    if what in WORKERS:
        facts = code_facts() | {what: WORKERS[what]}
        monkeypatch.setattr(engine, "code_facts", lambda: facts)
        says = f"has another {what}.* than the process that sends the areas"
    elif what == "content":
        monkeypatch.setattr(engine, "file_facts", lambda paths: [{"sha256": "another"}])
        says = "dem.img: has other content"
    else:
        facts = engine.file_facts([file])
        monkeypatch.setattr(engine, "file_facts", lambda paths: facts)
        file.unlink()
        says = "dem.img: No such file"
    with pytest.raises(ClusterError, match=f"worker tcp://.*{says}") as raised:
        list(run_tasks(first_line, [file], 1, cluster.scheduler_address, inputs=[file]))
    assert len(str(raised.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("scheduler", "says"),
    [
        ("tcp://127.0.0.1:1", "cannot connect"),
        ("tcp://no.such.host.invalid:8786", "cannot connect"),
        ("nonsense://x:1", "cannot connect"),
        ("tcp://127.0.0.1:port", "cannot connect"),
        ("missing.json", "neither a file nor an address"),
        ("text.json", "is not a scheduler file"),
        (".", "is not a scheduler file"),
    ],
)
def test_a_wrong_scheduler_is_one_line(
    scheduler: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(engine, "_CONNECT_S", 1)
    Path("text.json").write_text("[1, 2]")
    with pytest.raises(ClusterError, match=says) as raised:
        list(run_tasks(square_or_die, [1], 1, scheduler))
    assert len(str(raised.value).splitlines()) == 1


def test_a_connection_that_fails_leaves_no_client(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask closes a failed client when it is collected; if another starts at that moment, both wait."""
    monkeypatch.setattr(engine, "_CONNECT_S", 1)
    gc.collect()
    before = _clients()
    gc.disable()
    try:
        with pytest.raises(ClusterError, match="cannot connect"):
            list(run_tasks(square_or_die, [1], 1, "tcp://127.0.0.1:1"))
        assert _clients() == before
    finally:
        gc.enable()


def _clients() -> int:
    return sum(issubclass(type(one), distributed.Client) for one in gc.get_objects())


def test_a_scheduler_file(cluster: LocalCluster, tmp_path: Path) -> None:
    file = tmp_path / "sched.json"
    file.write_text(json.dumps({"type": "Scheduler", "address": cluster.scheduler_address}))
    assert dict(run_tasks(square_or_die, [4], 1, str(file))) == {0: 16}


def test_a_lost_scheduler_is_one_line() -> None:
    import dask

    with (
        dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
        distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=":0") as lost,
    ):
        outcomes = run_tasks(square_or_die, [*range(20, 60)], 1, lost.scheduler_address)
        next(outcomes)
        lost.close()
        with pytest.raises(ClusterError, match="is lost; finished areas are kept"):
            list(outcomes)
