"""``--reflectance`` on the command line: names, sets, and what is said to wrong ones."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner
from lcp_cli.build_options import model_options
from lcp_cli.value_types import LAW


@click.command()
@model_options
def command(model):
    click.echo(f"law {model.reflectance}")


def run(*arguments):
    return CliRunner().invoke(command, arguments)


def test_the_help_has_one_metavar():
    assert run("--help").output.count("LAW[:SET]") == 1


@pytest.mark.parametrize(
    "spec",
    [
        "auto",
        "lambert",
        "hapke:wac-643-mare",
        "minnaert:0.7",
        "lunar-lambert:sp-low",
        "lommel-seeliger:rolo",
        "facet:a/b:c.toml",
    ],
)
def test_laws_and_their_sets(spec):
    result = run("--reflectance", spec)
    assert (result.exit_code, result.output) == (0, f"law {spec}\n")


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("hapkee", "is not a reflectance model; valid names: lommel-seeliger, lambert"),
        ("auto:x", "is not a reflectance model"),
        ("", "is not a reflectance model"),
        ("hapke:moon", "no Hapke parameters 'moon'; valid names: wac-643"),
        ("hapke:", "no parameter set after the colon"),
        ("lambert:0.3", "lambert has no parameters"),
        ("minnaert:2", "an exponent from 0 to 1"),
    ],
)
def test_wrong_ones_are_wrong_usage(spec, said):
    result = run("--reflectance", spec)
    assert result.exit_code == 2
    assert said in " ".join(result.output.split())


def test_the_value_is_left_as_it_was():
    assert LAW.convert("hapke", None, None) == "hapke"
