"""Runs of `lcp` that a command must refuse."""

from __future__ import annotations

import pytest
from lcp_cli.main import run


def refusal(arguments: list[str], code: int, capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command that fails with exit code ``code`` and one line of error; return stderr.

    The lines "Usage: ..." and "Try ..." of a wrong usage do not count.
    """
    assert run(arguments) == code
    error = capsys.readouterr().err
    assert "Traceback" not in error
    lines = [line for line in error.splitlines() if line and not line.startswith(("Usage", "Try"))]
    assert len(lines) == 1, error
    return error
