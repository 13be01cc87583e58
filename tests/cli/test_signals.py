"""SIGTERM and SIGHUP end a run once, with their own exit codes."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.small_rasters import ISIS_OF_A_PIPE
from lcp_cli import main
from lcp_cli.signals import Stopped, stopping_signals


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_is_a_line_and_an_exit_code(
    sent: signal.Signals,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = signal.getsignal(sent)
    monkeypatch.setattr(main.cli, "invoke", lambda context: os.kill(os.getpid(), sent))
    assert main.run(["dem"]) == code
    assert capsys.readouterr().err.strip() == (
        f"lcp: stopped by {sent.name}; no incomplete output was left"
    )
    assert signal.getsignal(sent) is before


def test_repeated_signals_do_not_interrupt_the_clean_up() -> None:
    cleaned = []

    def stopped() -> None:
        with stopping_signals():
            try:
                os.kill(os.getpid(), signal.SIGHUP)
            finally:
                for sent in (signal.SIGHUP, signal.SIGTERM, signal.SIGINT):
                    os.kill(os.getpid(), sent)
                time.sleep(0.5)
                cleaned.append(True)

    with pytest.raises(Stopped) as caught:
        stopped()
    assert cleaned
    assert caught.value.exit_code == 129


def _lost(sent: signal.Signals) -> None:
    """A callback whose exceptions end in it."""
    with contextlib.suppress(BaseException):
        os.kill(os.getpid(), sent)


@pytest.mark.parametrize(
    ("sent", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)]
)
@pytest.mark.parametrize("after_s", [0.0, 20.0])
def test_a_signal_that_a_library_loses_ends_the_run(
    sent: signal.Signals,
    code: int,
    after_s: float,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    began = time.monotonic()
    monkeypatch.setattr(main.cli, "invoke", lambda context: (_lost(sent), time.sleep(after_s)))
    assert main.run(["dem"]) == code
    assert time.monotonic() - began < 10.0
    assert capsys.readouterr().err.strip().count("\n") == 0


BUSY = """
    while True:
        try:
            time.sleep(0.1)
        except BaseException:
            pass
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("work", "says"),
    [
        # GDAL waits for the writer of a pipe; what is raised in its callback for messages is lost
        ("rasterio.open('x.cub'); time.sleep(60)", "lcp: stopped by SIGTERM; no incomplete output was left"),
        (BUSY, "lcp: stopped by SIGTERM, and ended because it went on for 1 s; the next run removes what it has begun"),
    ],
    ids=["callback", "busy"],
)  # fmt: skip
def test_a_process_ends_wherever_a_signal_finds_it(work: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "x.cub").write_text(ISIS_OF_A_PIPE)
    os.mkfifo(tmp_path / "pipe")
    code = (
        "import rasterio, time\nfrom lcp_cli import main, signals\nsignals._LONGEST_S = 1.0\n"
        f"def work(context):\n    print('at work', flush=True)\n    {work.strip()}\n"
        "main.cli.invoke = work\nmain.main(['dem'])"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=tmp_path, stdout=-1, stderr=-1, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "at work\n"
        time.sleep(0.3)  # it waits
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (143, f"{says}\n")


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    """So that `nohup lcp ...` goes on when the terminal ends."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stopping_signals():
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)
