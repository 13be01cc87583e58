"""The documentation: commands that exist, links that resolve, paths of modules and files that are in the repository."""

from __future__ import annotations

import re
import runpy
import shlex
import tomllib
from pathlib import Path

import click
import pytest
from lcp_cli.main import cli

from lcp_catalog.catalog.schema import PROMISE, VARIABLES
from lcp_catalog.fields import meanings
from lcp_catalog.production.config import BuildConfig

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SOURCES = [
    path
    for folder in ("lcp_catalog", "cli", "tests", "benchmarks", "docs")
    for path in sorted((ROOT / folder).rglob("*.py"))
]


def _command_lines(text: str) -> list[str]:
    """Lines of code blocks and inline code that begin with `lcp `."""
    inline = re.findall(r"`(?:\$ )?(lcp [^`\n]+)`", text)
    blocks = re.findall(r"^(?:    |\t)?\s*(?:\$ )?(lcp (?:[^\n]*\\\n)*[^\n]*)$", text, re.M)
    return [line.replace("\\\n", " ") for line in inline + blocks]


def _wrong_words(line: str) -> list[str]:
    """Command or option names of a command line that the program does not have."""
    line = re.sub(r"\s(#|\|\||>) .*", "", line).replace("...", "").replace("…", "")
    words = shlex.split(re.sub(r"[\[\]|]", " ", line))[1:]
    command: click.Command = cli
    context = click.Context(cli)
    wrong = []
    for word in words:
        if word.startswith("-") and not re.match(r"-\d", word):
            known = {name for option in command.get_params(context) for name in option.opts}
            if word.split("=")[0] not in known | {"-h", "--help"}:
                wrong.append(word)
        elif isinstance(command, click.Group):
            found = command.get_command(context, word)
            if found is None and word != "COMMAND":
                return [word]
            if found is None:
                break
            command, context = found, click.Context(found)
    return wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_command_in_the_docs_exists_with_its_options(page: Path) -> None:
    lines = _command_lines(page.read_text(encoding="utf-8"))
    assert {line: _wrong_words(line) for line in lines if _wrong_words(line)} == {}


def test_the_check_notices_wrong_commands_and_options() -> None:
    assert _wrong_words("lcp nonsense file.h5") == ["nonsense"]
    assert _wrong_words("lcp dem look file.h5") == ["look"]
    assert _wrong_words("lcp render a.tif -o b.tif --no-such-option 3") == ["--no-such-option"]
    assert _wrong_words("lcp -v render a.tif -o b.tif --center -3.5 26 --size 10") == []
    assert _command_lines(
        "`lcp --help`\n\n    lcp dem info A\n    $ lcp sun --lon 0 \\\n  --lat 1\n"
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_relative_link_of_a_page_resolves(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    targets = re.findall(r"\]\(([^)\s]+)\)", text)
    files = [target.partition("#")[0] for target in targets if "://" not in target]
    assert [file for file in files if file and not (page.parent / file).exists()] == []


def test_paths_of_files_and_modules_in_pages_are_in_the_repository() -> None:
    """Paths of the library, tests, benchmarks and sample data, and dotted names of modules."""
    folders = "lcp_catalog|cli|tests|benchmarks|docs|sample_data"
    missing = set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for name in re.findall(rf"(?<![\w/.-])((?:{folders})/[\w./-]*\.\w+)", text):
            if not (ROOT / name).exists():
                missing.add((page.name, name))
        for name in re.findall(r"\blcp_catalog((?:\.[a-z_0-9]+)+)", text):
            if not _is_module_or_member(name.strip(".").split(".")):
                missing.add((page.name, f"lcp_catalog{name}"))
    assert missing == set()


def test_pages_that_the_source_refers_to_exist() -> None:
    missing = {
        (str(file.relative_to(ROOT)), name)
        for file in SOURCES
        for name in re.findall(r"\bdocs/[\w/-]+\.md", file.read_text(encoding="utf-8"))
        if not (ROOT / name).exists()
    }
    assert missing == set()


def _is_module_or_member(parts: list[str]) -> bool:
    """True for a module of the library, and for a name of the package itself or of one of its modules."""
    import lcp_catalog

    package = ROOT / "lcp_catalog"
    for count in range(len(parts), 0, -1):
        place = package.joinpath(*parts[:count])
        if place.is_dir() or place.with_suffix(".py").exists():
            return len(parts) - count <= 1
    return len(parts) == 1 and hasattr(lcp_catalog, parts[0])


def test_build_toml_of_the_reference_is_the_default_configuration() -> None:
    text = (ROOT / "docs" / "reference" / "build-toml.md").read_text(encoding="utf-8")
    block = re.search(r"```toml\n(.*?)```", text, re.S)
    assert block is not None
    assert BuildConfig.from_dict(tomllib.loads(block[1])) == BuildConfig.from_dict(
        {"model": {"accuracy": "standard"}}
    )
    names = set(re.findall(r"^(?:# )?([a-z_]+)(?: |$)", block[1], re.M))
    fields = {
        name
        for section in BuildConfig.from_dict({}).__dataclass_fields__
        for name in getattr(BuildConfig.from_dict({}), section).__dataclass_fields__
    }
    assert fields - names == {"tolerance"}
    assert "tolerance" in block[1]


def test_every_field_of_the_configuration_is_told() -> None:
    """The page's table is made from the meanings of the fields, which a hook puts in place of a mark."""
    hook = runpy.run_path(str(ROOT / "docs" / "hooks" / "fields.py"))
    page = (ROOT / "docs" / "reference" / "build-toml.md").read_text(encoding="utf-8")
    table = hook["on_page_markdown"](page)
    assert hook["MARK"] in page
    for section in BuildConfig.__dataclass_fields__:
        for name, meaning in meanings(getattr(BuildConfig(), section)).items():
            assert meaning.text.endswith("."), name
            assert f"| `{section}.{name}` | {meaning.text} |" in table
    assert "| be above 0 and at most 50000 | about half of what the DEM resolves" in table


def test_every_variable_of_a_catalogue_is_told() -> None:
    """The tables are made from the file's schema, which a hook puts in place of marks."""
    hook = runpy.run_path(str(ROOT / "docs" / "hooks" / "fields.py"))
    page = (ROOT / "docs" / "reference" / "catalogue-format.md").read_text(encoding="utf-8")
    table = hook["on_page_markdown"](page)
    for name, one in {**VARIABLES, **PROMISE}.items():
        assert one.dims == (name,) or f"| `{name}` | {', '.join(one.dims)} |" in table, name
    assert "| `gsd` | point | m | cell size of the patch |" in table


def test_every_page_is_in_the_navigation() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = [p.relative_to(ROOT / "docs").as_posix() for p in PAGES if p.parent != ROOT]
    assert [page for page in pages if page not in navigation] == []


def test_the_home_page_links_every_how_to_page_and_both_tutorials() -> None:
    home = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    linked = set(re.findall(r"\]\(((?:howto|tutorial)/[\w-]+\.md)\)", home))
    there = {
        page.relative_to(ROOT / "docs").as_posix()
        for part in ("howto", "tutorial")
        for page in (ROOT / "docs" / part).glob("*.md")
    }
    assert linked == there
    assert {page for page in there if f"(docs/{page})" not in readme} == set()


def test_the_glossary_is_sorted() -> None:
    text = (ROOT / "docs" / "reference" / "glossary.md").read_text(encoding="utf-8")
    terms = re.findall(r"^\*\*(.+?)\*\*.*\n:   \S", text, re.M)
    assert len(terms) >= 30
    assert terms == sorted(terms, key=str.lower)


def test_the_api_page_documents_every_public_name() -> None:
    import lcp_catalog

    page = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"^::: lcp_catalog\.(\w+)$", page, re.M)) | {"__version__"}
    assert documented == set(lcp_catalog.__all__)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\blcp\.(\w+)\(", readme)) <= documented


def test_the_example_is_included() -> None:
    """A formatter once broke the marks that include the program in two pages."""
    for page in ("tutorial/index.md", "reference/api.md"):
        text = (ROOT / "docs" / page).read_text(encoding="utf-8")
        assert '\n--8<-- "locate_camera.py"\n' in text, page
