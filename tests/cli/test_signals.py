"""SIGTERM and SIGHUP end a run once, with their own exit codes."""

from __future__ import annotations

import os
import signal

import pytest
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
    with stopping_signals():
        with pytest.raises(Stopped):
            os.kill(os.getpid(), signal.SIGHUP)
        os.kill(os.getpid(), signal.SIGHUP)
        os.kill(os.getpid(), signal.SIGTERM)


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    """So that `nohup lcp ...` goes on when the terminal ends."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stopping_signals():
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)
