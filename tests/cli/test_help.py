"""Every command: its help, and what it says of files that are missing or have the ending of another format."""

from __future__ import annotations

import logging
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from lcp_cli.files import InputFile, OutputFile
from lcp_cli.help_text import GROUPS, grouped
from lcp_cli.main import cli, run
from lcp_cli.messages import show_log


def _commands(group: click.Group = cli, path: str = "") -> Iterator[tuple[str, click.Command]]:
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from _commands(command, f"{path}{name} ")
        else:
            yield f"{path}{name}", command


COMMANDS = dict(_commands())
EVERY = pytest.mark.parametrize("name", list(COMMANDS))
WITHOUT_INPUT = {"help", "sample", "flight-source", "warm-up"}


@EVERY
def test_options_stand_in_groups_and_an_example_is_valid(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([*name.split(), "--help"]) == 0
    said = capsys.readouterr().out
    command = COMMANDS[name]
    groups = grouped(command, click.Context(command))
    assert {f"{heading}:" for heading in groups} <= set(said.splitlines())
    assert sum(map(len, groups.values())) == sum(
        isinstance(one, click.Option) for one in command.get_params(click.Context(command))
    )
    example = re.findall(r"^Example:\n((?:  lcp .*\n?)+)", said, re.M)
    assert len(example) == 1
    words = shlex.split(example[0].strip().splitlines()[0])
    assert words[: 1 + len(name.split())] == ["lcp", *name.split()]
    command.make_context(
        name, words[1 + len(name.split()) :]
    )  # raises a usage error if it is wrong


def test_a_flag_has_one_group() -> None:
    flags = [flag for flags in GROUPS.values() for flag in flags]
    assert len(flags) == len(set(flags))
    every = (flag for one in COMMANDS.values() for p in one.params for flag in p.opts)
    assert set(flags) == {flag for flag in every if flag.startswith("--")} | {"--help"}


@EVERY
def test_a_default_stands_in_the_help(name: str) -> None:
    for option in COMMANDS[name].params:
        own = isinstance(option, click.Option) and not option.is_flag
        if own and isinstance(option.default, str | int | float | tuple):
            assert option.show_default or "default" in (option.help or "").lower(), option.opts


def test_the_top_help_has_exit_codes_and_completion(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--help"]) == 0
    said = capsys.readouterr().out
    for words in ("0  done", "2  wrong usage", "4  the answer is no", "_LCP_COMPLETE=bash_source"):
        assert words in said


def _least(command: click.Command, folder: Path, missing: str) -> list[str]:
    """Arguments that a command needs, with an input that is missing."""
    words = []
    for one in command.params:
        if isinstance(one, click.Argument):
            words += [missing] * (2 if one.name == "catalogs" else 1)
        elif isinstance(one.type, OutputFile) and one.name == "output":
            name = (one.metavar or "OUT").split("|")[0]
            words += ["-o", str(folder / name)]
    return words


REQUIRED = {
    "sun": ["--center", "0", "0", "--time", "2026-03-01", "--dem", "none.tif"],
    "windows": ["--center", "0", "0", "--range", "2026-03-01", "2026-03-02", "6h"],
    "query": ["--camera", "none.json"],
    "camera from-ccsds": [
        *("--oem", "none.oem", "--aem", "none.aem", "--camera", "none.json"),
        *("--time", "2026-03-01"),
    ],
    "camera from-spice": [
        *("--kernels", "none.tm", "--observer", "X", "--instrument", "Y", "--time", "2026-03-01"),
    ],
    "render": ["--sun-azimuth", "96", "--sun-elevation", "14"],
    "simulate": ["--camera", "none.json", "--sun-azimuth", "96", "--sun-elevation", "14"],
}


def test_a_missing_model_is_a_missing_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was wrong usage: exit code 2."""
    dem = Path(__file__).parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"
    words = [str(dem), "--reflectance", "facet:none.toml", "--center", "3.5", "26", "--size", "20"]
    for name, out in (("build-catalog", "c.h5"), ("trade", "t")):
        assert run([name, str(dem), "--config", "none.toml", "-o", str(tmp_path / out)]) == 1
        assert capsys.readouterr().err == "lcp: none.toml: there is no such file\n"
    for name, out in (("render", "o.tif"), ("build-catalog", "c.h5"), ("trade", "t")):
        sun = REQUIRED["render"] if name == "render" else []
        assert run([name, *words, *sun, "-o", str(tmp_path / out)]) == 1
        said = capsys.readouterr().err.splitlines()  # a slow machine shows progress before
        assert said[-1] == "lcp: none.toml: there is no such file"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - WITHOUT_INPUT))
def test_a_missing_input_is_exit_code_1(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*name.split(), *_least(COMMANDS[name], tmp_path, "none.h5"), *REQUIRED.get(name, [])]
    assert run(words) == 1
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert re.match(r"lcp: .*none\.\w+.*(no such file|does not exist)", error, re.I), error
    assert list(tmp_path.iterdir()) == []


OUTPUTS = [
    (name, option)
    for name, command in COMMANDS.items()
    for option in command.params
    if isinstance(option.type, OutputFile) and re.search(r"\.\w", option.metavar or "")
]


@pytest.mark.parametrize("wrong", ["out.jpg", "out.abc", "out", "out.v1.2"])
@pytest.mark.parametrize(("name", "option"), OUTPUTS, ids=lambda v: getattr(v, "name", v))
def test_another_ending_than_the_option_names_is_refused(
    name: str, option: click.Option, wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*_least(COMMANDS[name], tmp_path, "none.h5"), *REQUIRED.get(name, [])]
    assert run([*name.split(), *words, option.opts[0], str(tmp_path / wrong)]) == 2
    meant = re.findall(r"[.]\w+", str(option.metavar))
    said = f"{option.opts[0]} {tmp_path / wrong}: the output must end in {' or '.join(meant)}\n"
    assert capsys.readouterr().err.endswith(said)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "option"),
    [one for one in OUTPUTS if one[0] != "build-catalog"],  # which decides by --resume and --plan
    ids=lambda v: getattr(v, "name", v),
)
def test_an_output_that_exists_is_refused_before_anything_is_read(
    name: str, option: click.Option, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ending = re.findall(r"[.]\w+", str(option.metavar))[0]
    there = tmp_path / f"there{ending}"
    there.write_text("kept")
    words = [*_least(COMMANDS[name], tmp_path, "none.h5"), *REQUIRED.get(name, [])]
    assert run([*name.split(), *words, option.opts[0], str(there)]) == 1
    assert f"{there} exists; use --overwrite to replace it" in capsys.readouterr().err
    assert there.read_text() == "kept"


def test_every_command_that_writes_has_a_depfile() -> None:
    writers = {
        name
        for name, command in COMMANDS.items()
        if any(isinstance(p.type, InputFile) for p in command.params)
        and any(isinstance(p.type, OutputFile) for p in command.params)
    }
    with_rule = {
        name
        for name, command in COMMANDS.items()
        if any("--depfile" in p.opts for p in command.params)
    }
    assert writers == with_rule
    assert {"report", "trade", "dem info", "sun"} <= with_rule


def test_a_depfile_lists_what_was_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dem = Path(__file__).parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"
    out, rule = tmp_path / "sun.csv", tmp_path / "sun.d"
    words = ["sun", "--center", "3.63", "26.13", "--time", "1971-07-31T01:25:52"]
    assert run([*words, "--depfile", str(rule)]) == 2
    assert "--depfile needs an output: -o" in capsys.readouterr().err
    assert run([*words, "--dem", str(dem), "-o", str(out), "--depfile", str(rule)]) == 0
    assert rule.read_text().startswith(f"{out}: {dem}")
    assert run([*words, "-o", str(out), "--overwrite", "--depfile", str(out)]) == 2


@pytest.mark.parametrize("name", ["validate", "trade"])
def test_a_folder_is_not_named_like_a_file(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = _least(COMMANDS[name], tmp_path, "none.h5")
    words[words.index("-o") + 1] = str(tmp_path / "report.html")
    assert run([name, *words]) == 2
    assert "report.html: the output is a folder" in capsys.readouterr().err
    words[words.index("-o") + 1] = str(tmp_path / "v1.2")
    assert run([name, *words]) == 1


def test_the_help_speaks_of_the_command_itself(capsys: pytest.CaptureFixture[str]) -> None:
    """`build-catalog` and `trade` have no camera; `--seed` had the type "INTEGER RANGE"."""
    for name, whole in (("render", True), ("build-catalog", False), ("trade", False)):
        assert run([name, "--help"]) == 0
        assert ("what the camera sees" in " ".join(capsys.readouterr().out.split())) == whole
    for name in COMMANDS:
        assert run([*name.split(), "--help"]) == 0
        assert "RANGE" not in capsys.readouterr().out.replace("--range", "").replace("PHRASE", "")


def test_sun_takes_the_place_once(capsys: pytest.CaptureFixture[str]) -> None:
    when = ["--time", "1971-07-31T01:25:52", "--json"]
    said = []
    for place in (["--center", "3.63", "26.13"], ["--lon", "3.63", "--lat", "26.13"]):
        assert run(["sun", *place, *when]) == 0
        said.append(capsys.readouterr().out)
    assert said[0] == said[1]
    for place in ([], ["--lon", "3"], ["--center", "3", "26", "--lat", "26"]):
        assert run(["sun", *place, *when]) == 2
        assert "give the place once" in capsys.readouterr().err


def test_json_needs_a_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["build-catalog", __file__, "-o", str(tmp_path / "c.h5"), "--json"]) == 2
    assert "--json needs --plan or --list-parts" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        "c.h5 i.png --dem a.tif b.tif -o out",
        "c.h5 i.png --dem a.tif --dem b.tif -o out",
        "--dem a.tif c.h5 i.png --dem b.tif -o out",
        "-o out --dem a.tif c.h5 --gsd 5 i.png --dem b.tif",
        "c.h5 i.png -o out --known-pose --dem a.tif b.tif --sun-elevation -3 --sun-azimuth 9",
    ],
)
def test_validate_takes_several_dems_after_one_option(words: str) -> None:
    values = COMMANDS["validate"].make_context("validate", words.split()).params
    assert values["dems"] == ("a.tif", "b.tif")
    assert (values["catalog"], values["images"], values["output"]) == ("c.h5", ("i.png",), "out")


def test_the_log_is_ours_alone(capfd: pytest.CaptureFixture[str]) -> None:
    """-vv once showed every variable that h5py opened and every option that rasterio set."""
    assert run(["-vv", "sun", "--center", "0", "0", "--time", "2026-03-01"]) == 0
    said = capfd.readouterr().err
    assert "sun: reads no file" in said
    assert "sun: done in" in said
    dem = Path(__file__).parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"
    assert run(["-v", "dem", "info", str(dem)]) == 0
    said = capfd.readouterr().err
    assert f"dem info: reads {dem}\n" in said  # once, and with the command's whole name
    show_log(logging.DEBUG)
    for name in ("rasterio.env", "h5py._conv", "numba.core"):
        assert not logging.getLogger(name).isEnabledFor(logging.INFO)
    assert logging.getLogger("lcp_catalog.production").isEnabledFor(logging.DEBUG)
    assert run(["sun", "--center", "0", "0", "--time", "2026-03-01"]) == 0
    assert "reads" not in capfd.readouterr().err


def test_the_sun_model_of_a_validation_is_that_of_the_renders(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["validate", __file__, __file__, "-o", str(tmp_path / "out")]
    for name, value in (("--sun", "disc"), ("--bounce", "on")):
        assert run([*words, name, value]) == 2
        assert f"{name} needs --dem" in capsys.readouterr().err
