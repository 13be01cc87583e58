"""``lcp dem check`` as a user meets it: one line a file, exit code 4 when one is broken."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from helpers.products import ldem_80s, sldem_512
from lcp_cli.main import run


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path, Path]:
    """A sound product, one cut short, one sound again."""
    first, third = sldem_512(tmp_path, 10, 20, 64, 48), ldem_80s(tmp_path, 60)
    for key in ("MAXIMUM", "MINIMUM"):  # of the archive's whole file
        for label in (first, third):
            text = label.read_text(encoding="latin-1")
            label.write_text(
                text.replace(f"    {key} ", f"    NO_{key} ").replace(
                    f"DERIVED_{key}", f"NO_{key}"
                ),
                encoding="latin-1",
            )
    (tmp_path / "cut").mkdir()
    second = Path(shutil.copy(first, tmp_path / "cut"))
    second.with_suffix(".IMG").write_bytes(first.with_suffix(".IMG").read_bytes()[:-4])
    return first, second, third


def test_all_sound(files: tuple[Path, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["dem", "check", str(files[0]), str(files[2])]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines() == [
        f"{files[0]}: sound, SLDEM2015_512",
        f"{files[2]}: sound, LDEM_80S_20M",
    ]
    assert err == ""


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (1, 2, 0)])
def test_all_files_are_checked_also_behind_a_broken_one(
    files: tuple[Path, ...], order: tuple[int, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    given = [str(files[i]) for i in order]
    assert run(["dem", "check", *given]) == 4
    lines = capsys.readouterr().out.splitlines()
    heads = [line for line in lines if not line.startswith("  ")]
    assert [head.split(": ")[0] for head in heads] == given
    assert [": sound" in head for head in heads] == [i != 1 for i in order]
    (problem,) = [line for line in lines if line.startswith("  ")]
    assert lines.index(problem) == lines.index(f"{files[1]}: NOT SOUND") + 1
    assert str(files[1].with_suffix(".IMG")) in problem
    assert problem.endswith("cut short; fetch it again")


def test_json_is_one_document(files: tuple[Path, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["dem", "check", *map(str, files), "--json"]) == 4
    out, err = capsys.readouterr()
    found = json.loads(out)
    keys = {"path", "product", "sound", "problems", "notes", "warnings"}
    assert [set(one) for one in found] == [keys] * 3
    assert [one["path"] for one in found] == [str(path) for path in files]
    assert [one["sound"] for one in found] == [True, False, True]
    assert [one["product"] for one in found] == ["SLDEM2015_512", None, "LDEM_80S_20M"]
    assert [len(one["problems"]) for one in found] == [0, 1, 0]
    assert err == ""


def test_notes_do_not_make_a_file_unsound(
    files: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    label = files[0]
    label.with_suffix(".IMG").rename(label.with_name("MINE.IMG"))
    label.rename(label.with_name("MINE.LBL"))
    assert run(["dem", "check", str(label.with_name("MINE.IMG"))]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0].endswith(": sound, SLDEM2015_512")
    assert out[1].startswith("  note: the label names its image ")


def test_what_is_no_dem_is_an_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "text.tif").write_text("hello")
    (tmp_path / "empty.IMG").write_bytes(b"")
    given = [str(tmp_path / name) for name in ("text.tif", "empty.IMG", ".")]
    assert run(["dem", "check", *given]) == 4
    out, err = capsys.readouterr()
    assert out.count("NOT SOUND") == 3
    assert err == ""
    assert run(["dem", "check", *given, str(tmp_path / "none.LBL")]) == 1
    assert capsys.readouterr() == ("", f"lcp: {tmp_path / 'none.LBL'}: there is no such file\n")


@pytest.mark.parametrize("arguments", [[], ["x.tif", "--nope"]])
def test_wrong_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["dem", "check", *arguments]) == 2
    assert "Error: " in capsys.readouterr().err


def test_help_says_what_it_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["dem", "--help"]) == 0
    assert "check" in capsys.readouterr().out
