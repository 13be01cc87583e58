"""A signal while a catalogue is written: handled at once during long work between the calls of HDF5."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from helpers import catalogs

from lcp_catalog.catalog import catalogue
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.held_signals import HeldSignals
from lcp_catalog.catalog.writing import new_catalog


def send_soon(sent: list[float]) -> None:
    """Ctrl-C for this process in a moment; its time is noted."""

    def send() -> None:
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    threading.Timer(0.1, send).start()


def work_on_flags(catalog: Catalog, path: Path, sent: list[float]) -> None:
    """Write a catalogue that needs long for work on its flags; a signal comes meanwhile."""
    values = catalogue.values(catalog)
    with new_catalog(catalog, len(catalog), values["dem_product"], path) as file:
        file.add(values)
        with file.flags() as condition:
            assert condition.shape == catalog.condition.shape
            np.testing.assert_array_equal(condition[0:2], catalog.condition[:2])
            send_soon(sent)
            while not sent or time.monotonic() < sent[0] + 5.0:
                assert len(condition[0 : len(condition)]) == len(catalog)


def test_work_on_the_flags_is_interrupted(tmp_path: Path) -> None:
    """Until then a signal waited for the whole coverage of a region: 76 s with a million points."""
    sent: list[float] = []
    with pytest.raises(KeyboardInterrupt):
        work_on_flags(catalogs.catalog(), tmp_path / "a.h5", sent)
    assert time.monotonic() < sent[0] + 2.0
    assert list(tmp_path.iterdir()) == []


def release_after_a_signal(came: list[str]) -> None:
    with HeldSignals() as signals:
        with signals.let_through():
            pass
        os.kill(os.getpid(), signal.SIGINT)
        came.append("held")
        signals.release()
        came.append("not handled")


def test_signals_wait_again_after_they_were_let_through() -> None:
    came: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        release_after_a_signal(came)
    assert came == ["held"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
