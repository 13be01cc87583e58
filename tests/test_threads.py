"""The one owner of thread counts."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace

import numba
import pytest

from lcp_catalog.threads import limit_threads, thread_limit


@pytest.fixture(autouse=True)
def _restore():
    before = numba.get_num_threads()
    yield
    numba.set_num_threads(before)


def test_a_call_holds_until_the_next():
    limit_threads(1)
    assert numba.get_num_threads() == 1
    limit_threads(10_000)
    assert numba.get_num_threads() == thread_limit()


def test_a_block_is_undone_even_after_an_error():
    limit_threads(thread_limit())
    with pytest.raises(RuntimeError, match="inside"):
        _fail_inside()
    assert numba.get_num_threads() == thread_limit()


def _fail_inside():
    with limit_threads(1):
        assert numba.get_num_threads() == 1
        raise RuntimeError("inside")


def test_opencv_follows_where_it_is_there_and_is_not_loaded_otherwise(monkeypatch):
    told = []
    fake = SimpleNamespace(getNumThreads=lambda: 7, setNumThreads=told.append)
    monkeypatch.setitem(sys.modules, "cv2", fake)
    with limit_threads(1):
        assert told == [1]
    assert told == [1, 7]
    monkeypatch.delitem(sys.modules, "cv2")
    limit_threads(1)
    assert "cv2" not in sys.modules


@pytest.mark.parametrize("count", [0, -1])
def test_fewer_than_one_is_refused(count):
    with pytest.raises(ValueError, match="at least one"):
        limit_threads(count)


@pytest.mark.skipif(
    sys.platform != "linux",
    reason="the spin count is GNU's, whose OpenMP numba takes on Linux alone",
)
@pytest.mark.parametrize(
    ("given", "spins"),
    [({}, 0), ({"GOMP_SPINCOUNT": "7"}, 7), ({"OMP_WAIT_POLICY": "active"}, 30_000_000_000)],
)
def test_threads_sleep_between_kernels_unless_the_environment_says_otherwise(given, spins):
    """As OpenMP itself states its settings; what this process hands to others is unchanged."""
    code = (
        "import os, lcp_catalog.kernels.points, numba.np.ufunc.omppool;"
        "print(os.environ.get('OMP_WAIT_POLICY'))"
    )
    plain = {k: v for k, v in os.environ.items() if k not in {"OMP_WAIT_POLICY", "GOMP_SPINCOUNT"}}
    environment = {**plain, "OMP_DISPLAY_ENV": "verbose", **given}
    ran = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert f"GOMP_SPINCOUNT = '{spins}'" in ran.stderr
    assert ran.stdout.strip() == str(given.get("OMP_WAIT_POLICY"))
