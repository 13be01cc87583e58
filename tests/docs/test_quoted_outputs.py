"""What tutorial, how-to pages and reference quote of the program's outputs is what it prints."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.quoted_outputs import (
    ROOT,
    SESSION,
    agrees,
    blocks,
    outputs,
    refreshed,
    sample_catalog,
    session_folder,
)

PAGES = [
    ROOT / "README.md",
    ROOT / "docs/index.md",
    *(
        page
        for part in ("tutorial", "howto", "reference")
        for page in sorted((ROOT / "docs" / part).glob("*.md"))
    ),
]
TEXTS = {page.relative_to(ROOT).as_posix(): page.read_text(encoding="utf-8") for page in PAGES}
SESSIONS = [name for name, text in TEXTS.items() if SESSION.search(text)]
LANGUAGES = {"bash", "python", "text", "toml", "json", "yaml", "make", "c", "csv"}
COMMANDS = re.compile(
    r"lcp|make|pip|python3?|cd|mkdir|\.|job=|sbatch|parallel|dask|helm|kubectl|head|ls|xdg-open|git|gdal\w+|tar|cc|isd_generate|#"
)


@pytest.fixture(scope="module")
def catalog(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample's catalogue."""
    return sample_catalog(tmp_path_factory.mktemp("sample") / "hadley.h5")


def _faults(name: str, folder: Path) -> list[str]:
    runs = outputs(TEXTS[name], folder)
    assert runs
    return [fault for run in runs if (fault := run.fault()) is not None]


@pytest.mark.slow
@pytest.mark.parametrize("name", SESSIONS)
def test_a_page_quotes_what_its_commands_print(name: str, catalog: Path, tmp_path: Path) -> None:
    if "<!-- commands run in the checkout -->" in TEXTS[name]:
        session_folder(tmp_path, catalog)
    assert _faults(name, tmp_path) == []


@pytest.mark.parametrize("name", TEXTS)
def test_every_quoted_output_is_compared_or_says_why_not(name: str) -> None:
    """Commands are in blocks of their own; a language says what a block is; nothing hides in an indented block."""
    text = TEXTS[name]
    found = list(blocks(text))
    assert {block.language for block in found} <= LANGUAGES
    assert len(found) == len(re.findall(r"^```\w", text, re.M))
    outside = re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)
    assert re.findall(r"(?:^|\n)\n(?: {4}|\t)(\S.*)", outside) == []
    is_session = name in SESSIONS
    for block in found:
        if block.language == "text" and not is_session:
            assert len(block.marks.get("not run", "")) > 10, f"{name}:{block.line}"
        if block.language == "bash" and "#!" not in block.text:
            whole = block.text.replace("\\\n", " ").splitlines()
            assert [line for line in whole if line and not COMMANDS.match(line)] == []


def test_the_evidence_has_the_windows_that_the_tutorial_quotes() -> None:
    """One photograph, one result: its row for the sample's albedo map, and the mode, in the table of windows."""
    quoted = re.search(
        r"cells of 1001 m: ([\d.]+) % above 0\.9.*?mode ([\d.]+);\s+without smoothing ([\d.]+) %",
        TEXTS["docs/tutorial/index.md"],
        re.S,
    )
    page = (ROOT / "docs/measurements/evidence.md").read_text(encoding="utf-8")
    row = re.search(
        r"^\| 0414, the sample's albedo map \|.*\| (\d+) % \([\d.]+\) \| (\d+) % \(([\d.]+)\) \|$",
        page,
        re.M,
    )
    assert quoted is not None
    assert row is not None
    assert (f"{float(quoted[3]):.0f}", f"{float(quoted[1]):.0f}", quoted[2]) == row.groups()


def test_a_line_may_be_left_out_but_no_number_may_differ() -> None:
    printed = "a  1.25 m\nb  2 m\nc  3 m, of which 17\n"
    assert agrees(printed, printed)
    assert agrees("a 1.25 m\nb 2\n  m\nc 3 m, of which 17\n", printed)
    assert agrees("a  1.25 m\n...\nc  3 m, ...\n", printed)
    assert not agrees("a  1.25 m\nc  3 m, of which 17\n", printed)
    assert not agrees("a  1.26 m\n...\n", printed)
    assert not agrees("a  1.2\n...\n", printed)
    assert not agrees("...\nc  3 m, of which\n", printed)
    assert not agrees("...\n17\n", printed)
    assert not agrees("a  1.25 m\n", printed)


PAGE = """
```bash
mkdir there && cd there
```

<!-- exit code 3 -->
```bash
printf 'one 1\\ntwo 2\\nthree 3\\n'
exit 3
```

```text
one 1
...
three 4
```

<!-- file add.py -->
```python
print(6 * 7)
```

```bash
python add.py
```

```text
42
```

<!-- not run: nobody has this file -->
```bash
lcp inspect none.h5
```
"""


def test_a_session_is_run_compared_and_refreshed(tmp_path: Path) -> None:
    runs = outputs(PAGE, tmp_path)
    assert (tmp_path / "there/add.py").exists()
    faults = [run.fault() for run in runs]
    assert [fault is None for fault in faults] == [True, False, True]
    assert "three 4" in str(faults[1])
    new = refreshed(PAGE, runs)
    assert new == PAGE.replace("three 4", "three 3")
    other = PAGE.replace("<!-- exit code 3 -->\n", "").replace("three 4", "three 3")
    (tmp_path / "again").mkdir()
    assert "exit code 3, not 0" in str(outputs(other, tmp_path / "again")[1].fault())
