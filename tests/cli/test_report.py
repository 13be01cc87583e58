"""``lcp report``: one page, not replaced without --overwrite, and one line for an error."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers import catalogs, navigable
from lcp_cli.main import run

from lcp_catalog.catalog.writing import write_catalog


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "c.h5").write_bytes(catalogs.content(5))
    return tmp_path / "c.h5"


@pytest.mark.slow
def test_it_writes_one_page(path: Path, capsys: pytest.CaptureFixture) -> None:
    page = path.with_name("page.html")
    assert run(["report", str(path), "-o", str(page)]) == 0
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert sorted(p.name for p in path.parent.iterdir()) == ["c.h5", "page.html"]
    assert capsys.readouterr().out == ""
    before = page.read_bytes()
    assert run(["report", str(path), "-o", str(page)]) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert run(["report", str(path), "-o", str(page), "--overwrite"]) == 0
    assert page.read_bytes() == before


def test_a_damaged_catalogue_is_one_line(path: Path, capsys: pytest.CaptureFixture) -> None:
    path.write_bytes(path.read_bytes()[:-100])
    page = path.with_name("page.html")
    assert run(["report", str(path), "-o", str(page)]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert str(path) in err
    assert not page.exists()


def test_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert run(["report", str(tmp_path / "none.h5"), "-o", str(tmp_path / "p.html")]) == 1
    assert "none.h5" in capsys.readouterr().err
    assert run(["report", str(tmp_path)]) == 2


def test_it_has_a_depfile_with_and_without_a_dossier(path: Path) -> None:
    """`lcp report -o r.html --depfile r.d` was refused: "--depfile needs --dossier"."""
    write_catalog(navigable.everywhere_usable(9), path.with_name("claims.h5"))
    for name, more in (("c", []), ("claims", ["--dossier"])):
        of, page, rule = (path.with_name(f"{name}.{ending}") for ending in ("h5", "html", "d"))
        words = ["report", str(of), "-o", str(page), "--depfile", str(rule)]
        assert run([*words, *more]) == 0
        assert rule.read_text().startswith(f"{page}: {of}")
