"""Outputs that pages of the documentation quote, beside what the commands really print.

A page with the comment ``<!-- commands run in the checkout -->`` (or ``in an empty folder``) is a session: its fenced blocks
``bash`` and ``python`` are run in their order in one folder, and a block ``text`` quotes what the block before it prints, or a
part: a line of ``...`` stands for lines that are left out, ``...`` in a line for a part of it. Lines may be wrapped; words and
numbers are compared exactly. A comment on the line before a block changes this:

- ``<!-- not run: REASON -->``: the block is neither run nor compared;
- ``<!-- exit code N -->``: the commands end with N in place of 0;
- ``<!-- file NAME -->``: the block is the content of a file of this name.

In pages without a session every ``text`` needs its reason.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import SequenceMatcher
from pathlib import Path

ROOT = Path(__file__).parents[2]
SESSION = re.compile(r"^<!-- commands run in (the checkout|an empty folder) -->$", re.M)
_MARK = re.compile(r"<!-- (not run|exit code|file):? (.+) -->")
_PROGRESS = re.compile(
    r"^.*: \d+ of \d+, \S+ a minute.*\n|^.*: .*, .* so far\n|^compiling kernels .*\n", re.M
)
_WIDTH = 110


@dataclass(frozen=True)
class Block:
    """A fenced block: language, content, number of its first line of content, marks before it."""

    language: str
    text: str
    line: int
    marks: dict[str, str]


@dataclass(frozen=True)
class Output:
    """What a page quotes of a run (None: nothing), and what the run printed and ended with."""

    block: Block
    quoted: Block | None
    printed: str
    exit_code: int

    def fault(self) -> str | None:
        """What is wrong, in words; None if the page tells the truth."""
        wanted = int(self.block.marks.get("exit code", 0))
        if self.exit_code != wanted:
            return (
                f"line {self.block.line}: exit code {self.exit_code}, not {wanted}\n{self.printed}"
            )
        if self.quoted is None or agrees(self.quoted.text, self.printed):
            return None
        return f"line {self.quoted.line} quotes\n{self.quoted.text}\nprinted was\n{self.printed}"


def blocks(page: str) -> Iterator[Block]:
    """The fenced blocks of a page in their order, with included files in place of their marks."""
    lines = page.split("\n")
    at = 0
    while at < len(lines):
        begin = re.match(r"```(\w+)$", lines[at])
        if begin is None:
            at += 1
            continue
        end = lines.index("```", at + 1)
        text = "\n".join(lines[at + 1 : end]) + "\n"
        yield Block(begin[1], _included(text), at + 2, dict(_marks(lines[:at])))
        at = end + 1


def _marks(before: list[str]) -> Iterator[tuple[str, str]]:
    for line in reversed(before):
        found = _MARK.fullmatch(line)
        if found is None:
            return
        yield found[1], found[2]


def _included(text: str) -> str:
    return re.sub(
        r'^--8<-- "([\w./]+)"\n',
        lambda m: next(ROOT.glob(f"*/examples/{m[1]}")).read_text(encoding="utf-8"),
        text,
        flags=re.M,
    )


def agrees(quoted: str, printed: str) -> bool:
    """Whether a quotation is true: the same words; any lines for a line of ``...``, anything for ``...`` in a line."""
    lines = "".join(" ".join(line.split()) + "\n" for line in printed.split("\n") if line.strip())
    parts = re.split(r"^\.\.\.\n", quoted, flags=re.M)
    wanted = r"(?:.*\n)*".join(_pattern(part) for part in parts)
    return re.fullmatch(wanted, lines) is not None


def _pattern(part: str) -> str:
    """Regular expression of whole lines with these words, wrapped anywhere."""
    words = [re.escape(word).replace(r"\.\.\.", r".*") for word in part.split()]
    return r"[ \n]".join(words) + r"\n" if words else ""


def sample_catalog(out: Path) -> Path:
    """The sample's catalogue, built into a file."""
    data = ROOT / "sample_data"
    lcp = str(Path(sys.executable).parent / "lcp")
    command = [lcp, "build-catalog", str(data / "hadley_gld100_256ppd.tif"), "-o", str(out)]
    subprocess.run([*command, "--config", str(data / "hadley.toml")], check=True, timeout=1800)
    return out


def session_folder(folder: Path, catalog: Path) -> Path:
    """The folder as the checkout after ``make catalog``: data, examples and the sample's catalogue."""
    for name in ("sample_data", "docs"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "build").mkdir()
    shutil.copy(catalog, folder / "build/hadley.h5")
    return folder


def outputs(page: str, folder: Path) -> list[Output]:
    """Run a page's session in a folder."""
    found: list[Output] = []
    where = folder
    for block in blocks(page):
        if "not run" in block.marks:
            continue
        if "file" in block.marks:
            (where / block.marks["file"]).write_text(block.text, encoding="utf-8")
        elif block.language in ("bash", "python"):
            printed, exit_code, where = _run(block, where, folder)
            found.append(Output(block, None, printed, exit_code))
        elif block.language == "text":
            last = found.pop()
            assert last.quoted is None, f"line {block.line}: quotes no command"
            found.append(Output(last.block, block, last.printed, last.exit_code))
    return found


def _run(block: Block, where: Path, folder: Path) -> tuple[str, int, Path]:
    """Printed text without lines of progress, exit code, and the folder afterwards."""
    kept = folder / ".where"
    command = [sys.executable, "-c", block.text]
    if block.language == "bash":
        script = f"set -e\ntrap 'pwd > {kept}' EXIT\n{block.text}"
        command = ["bash", "-c", script]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        command,
        check=False,
        cwd=where,
        env={**os.environ, "PATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=1800,
    )
    after = Path(kept.read_text().strip()) if block.language == "bash" else where
    return _PROGRESS.sub("", done.stdout), done.returncode, after


def refreshed(page: str, runs: list[Output]) -> str:
    """The page with what was printed in place of what it quotes; lines that it leaves out stay out."""
    lines = page.split("\n")
    for run in reversed(runs):
        if run.quoted is None or run.fault() is None:
            continue
        count = run.quoted.text.count("\n")
        first = run.quoted.line - 1
        lines[first : first + count] = _excerpt(run.quoted.text, run.printed)
    return "\n".join(lines)


def _excerpt(quoted: str, printed: str) -> list[str]:
    """Of what was printed, the lines nearest to the quoted ones."""
    there = printed.rstrip("\n").split("\n")
    if "..." not in quoted:
        return [short for line in there for short in _wrapped(line)]
    taken: list[str] = []
    at = 0
    for line in quoted.rstrip("\n").split("\n"):
        if line == "...":
            taken.append(line)
            continue
        near = [SequenceMatcher(None, line, other).ratio() for other in there[at:]]
        if not near:
            break
        at += near.index(max(near))
        cut = there[at][: line.index("...")] + "..." if "..." in line else there[at]
        taken.extend(_wrapped(cut))
        at += 1
    return taken


def _wrapped(line: str) -> list[str]:
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    return textwrap.wrap(line, _WIDTH, subsequent_indent=indent, break_on_hyphens=False) or [line]
