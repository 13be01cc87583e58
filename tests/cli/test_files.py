"""No command writes over one of its inputs, or writes one file twice. The commands and their files are taken
from the command line itself, so that a new command is tested too.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
from pathlib import Path
from typing import Any

import click
import pytest
from helpers.commands import leaves, refusal
from lcp_cli.files import FileCommand, InputFile, OutputFile
from lcp_cli.main import cli

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
NAMES = {"simulate": "frame.png"}
"""Names of outputs of the commands that are particular about endings."""

PLAIN = {
    "--lon": "0",
    "--lat": "0",
    "--center": "0 0",
    "--range": "2026-01-01 2026-01-02 1d",
}
"""Values of required options that are no files."""


COMMANDS = dict(leaves(cli))


def _files(command: click.Command, kind: type) -> list[click.Parameter]:
    return [one for one in command.params if isinstance(one.type, kind)]


PAIRS = [
    (name, output.name, other.name)
    for name, command in COMMANDS.items()
    for output in _files(command, OutputFile)
    for other in (*_files(command, InputFile), *_files(command, OutputFile))
    if other is not output
]


def _line(name: str, values: dict[str, str]) -> list[str]:
    """A command line with these files, and others for what else is required."""
    line = name.split()
    for one in COMMANDS[name].params:
        value = values.get(one.name or "", f"other_{one.name}" if one.required else None)
        if isinstance(one, click.Argument):
            line += [value] if value else []
        elif value is not None:
            line += [one.opts[0], *PLAIN.get(one.opts[0], value).split()]
    return line


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_knows_its_files(name: str) -> None:
    command = COMMANDS[name]
    assert isinstance(command, FileCommand)
    for one in command.params:
        flag = one.opts[0].removeprefix("--")
        suffix = (one.metavar or "").rstrip(".]").rpartition(".")[2].lower()
        if "." in (one.metavar or "") and suffix in (
            "json",
            "toml",
            "h5",
            "tif",
            "png",
            "html",
            "csv",
            "svg",
        ):
            assert isinstance(one.type, InputFile | OutputFile), one.name
        if flag in (
            "dem",
            "albedo",
            "depfile",
            "environment",
            "background",
            "output",
            "o",
            "images",
        ):
            if COMMANDS[name].name == "fit-reflectance" and flag == "albedo":
                continue  # a number
            assert isinstance(one.type, InputFile | OutputFile), one.name


LINKS = itertools.cycle(["same", "symbolic", "hard"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "output", "other", "link"),
    [(*pair, link) for pair, link in zip(PAIRS, LINKS, strict=False)],
)
def test_an_output_that_is_another_file_is_refused(
    name: str,
    output: str,
    other: str,
    link: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Any,
) -> None:
    """Both names are stated, and nothing is written, with ``--overwrite`` where there is one."""
    monkeypatch.chdir(tmp_path)
    for one in COMMANDS[name].params:
        Path(f"other_{one.name}").write_bytes(b"other")
    taken = tmp_path / NAMES.get(name, "taken.dat")
    taken.write_bytes(b"mine")
    [kind] = [one.type for one in COMMANDS[name].params if one.name == output]
    assert isinstance(kind, OutputFile)
    places = {one.name: str(taken) for one in COMMANDS[name].params if one.name == other}
    if (
        kind.written and len(list(kind.outputs("d"))) > 2
    ):  # a folder: its first file is the other one
        written = next(kind.outputs("folder"))
        written.parent.mkdir()
        places |= {output: "folder"}
    else:
        written = Path(taken if link == "same" else f"link_{taken.name}")
        places |= {output: str(written)}
    if link == "symbolic" or (link == "same" and written != taken):
        written.symlink_to(taken)
    elif link == "hard":
        written.hardlink_to(taken)
    of_other = next(one.type for one in COMMANDS[name].params if one.name == other)
    if (
        isinstance(of_other, OutputFile)
        and of_other.written
        and next(of_other.outputs("x")).parent.name
    ):
        written.unlink()  # the other is a folder: name the file in it
        Path("folder").mkdir()
        inside = next(of_other.outputs("folder"))
        places = {output: str(inside), other: "folder"}
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    flags = [flag for one in COMMANDS[name].params for flag in one.opts if flag == "--overwrite"]
    for extra in ([], flags):
        error = refusal([*_line(name, places), *extra], 2, capsys)
        assert "is the same file as" in error
        assert places[output] in error
        assert places[other] in error
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def _refused(line: list[str], capsys: Any, *names: str) -> None:
    error = refusal(line, 2, capsys)
    assert all(name in error for name in (*names, "is the same file as")), error


def test_files_that_are_read_with_another_one(
    tmp_path: Path, ldem_4: Path, monkeypatch: Any, capsys: Any
) -> None:
    """The label of an image, the image of a label, the source of a virtual raster, what a BUILD.toml
    names, the model of a law, and the camera beside a frame.
    """
    monkeypatch.chdir(tmp_path)
    for file in ldem_4.iterdir():
        shutil.copy(file, tmp_path)
    dem, albedo = SAMPLE / "hadley_gld100_256ppd.tif", SAMPLE / "hadley_albedo_643nm_11ppd.tif"
    shutil.copy(dem, "dem.tif")
    shutil.copy(albedo, "albedo.tif")
    sun = ["--sun-azimuth", "9", "--sun-elevation", "9"]
    render = ["render", "--overwrite", *sun, "-o"]
    image = next(name for name in os.listdir() if name.endswith((".IMG", ".JP2")))
    label = next(
        name
        for name in os.listdir()
        if name.startswith("LDEM")
        and name.endswith(".LBL")
        and ("JP2" in name) == image.endswith("JP2")
    )
    _refused([*render, label, image], capsys, label, image)
    _refused([*render, image, label], capsys, label, image)
    Path("dem.vrt").write_text(
        '<VRTDataset rasterXSize="9" rasterYSize="9"><VRTRasterBand dataType="Int16" band="1"><SimpleSource>'
        '<SourceFilename relativeToVRT="1">dem.tif</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    _refused([*render, "dem.tif", "dem.vrt"], capsys, "dem.tif", "dem.vrt")
    Path("build.toml").write_text(
        '[model]\nalbedo = "albedo.tif"\nreflectance = "facet:paint.toml"\n'
    )
    build = ["build-catalog", "--overwrite", "dem.tif", "--config", "build.toml", "-o"]
    _refused([*build, "albedo.tif"], capsys, "albedo.tif", "build.toml")
    _refused([*build, "paint.toml"], capsys, "paint.toml", "build.toml")
    _refused(
        [*render, "paint.toml", "dem.tif", "--reflectance", "facet:paint.toml"],
        capsys,
        "facet:paint.toml",
    )
    Path("frame_camera.json").write_text(json.dumps({}))
    simulate = ["simulate", "--overwrite", *sun, "dem.tif", "--camera", "frame_camera.json", "-o"]
    _refused([*simulate, "frame.png"], capsys, "frame_camera.json", "frame.png")
