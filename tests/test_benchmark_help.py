"""Every benchmark prints its help and measures nothing."""

from __future__ import annotations

import importlib

import pytest

from benchmarks import flight, sections

SECTIONS = [
    (f"benchmarks.{name}", section)
    for name in ("evidence", "faults", "speed")
    for section in importlib.import_module(f"benchmarks.{name}.__main__").SECTIONS
]


@pytest.mark.parametrize(("package", "section"), SECTIONS)
def test_a_section_prints_its_help(
    package: str, section: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        importlib.import_module(f"{package}.{section}").main(["--help"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: python -m {package} {section} [-h]")


def test_the_flight_file_prints_its_help(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["flight.py", "--help"])
    with pytest.raises(SystemExit) as ended:
        flight.main()
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("usage: python -m benchmarks.flight [-h]")


def test_a_package_prints_its_sections(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["benchmarks", "--help"])
    assert sections.run("benchmarks.speed", {"kernels": "rates"}) == 0
    assert capsys.readouterr().out.startswith("usage: python -m benchmarks.speed SECTION [--help]")
