"""Options that are made from the fields of the configuration, and messages in which fields become options."""

from __future__ import annotations

from pathlib import Path
from typing import get_type_hints

import click
import pytest
from lcp_cli.build_catalog import command
from lcp_cli.build_options import OPTIONS, VIEWS, FieldOption, Spelling, build_options, field_option
from lcp_cli.main import run
from lcp_cli.names import in_options, runs
from lcp_cli.validate import command as validate

from lcp_catalog.errors import NAMED, ConfigError
from lcp_catalog.fields import meanings
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.point_config import PointConfig

OF_FIELDS = [one for one in command.params if isinstance(one, FieldOption)]


def test_every_option_states_a_field_of_the_configuration() -> None:
    assert {name for one in OF_FIELDS for name in one.fields} == {*OPTIONS, *VIEWS}
    for name in OPTIONS:
        section, _, key = name.partition(".")
        assert key in meanings(get_type_hints(BuildConfig)[section])


@pytest.mark.parametrize("option", OF_FIELDS, ids=lambda one: one.name)
def test_the_range_of_an_option_is_that_of_its_field(option: FieldOption) -> None:
    """A value that the option admits at its limits is one that the field admits, in the field's unit."""
    section, _, key = option.fields[0].partition(".")
    meaning = meanings(get_type_hints(BuildConfig)[section])[key]
    if isinstance(option.type, click.FloatRange | click.IntRange):
        for limit, is_open in (
            (option.type.min, option.type.min_open),
            (option.type.max, option.type.max_open),
        ):
            assert limit is None or meaning.admits(limit * option.factor) != is_open
        if option.type.max is not None:
            assert not meaning.admits(1.01 * option.type.max * option.factor + 1)
    elif isinstance(option.type, click.Choice):
        assert tuple(option.type.choices) == meaning.choices
    assert option.help
    words = NAMED.split(meaning.text)[::2]  # between the names of other fields
    assert option.name == "views" or all(word in option.help for word in words)
    assert "`" not in option.help


@pytest.mark.parametrize(
    ("name", "named"), [("points.search_doubt", "points.min_detection"), ("model.bounce", "on")]
)
def test_a_help_may_name_what_is_no_option(
    name: str, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(OPTIONS, name, Spelling("--planted"))
    planted = click.command()(field_option(name)(lambda: None))
    text = planted.params[0].to_info_dict()["help"]
    assert f" {named}" in text
    assert "`" not in text


def _config(words: list[str]) -> BuildConfig:
    """The configuration that a command line makes."""
    found: list[BuildConfig] = []

    @click.command()
    @build_options(OPTIONS)
    def taken(config: BuildConfig) -> None:
        found.append(config)

    taken.main(words, standalone_mode=False)
    return found[0]


def test_options_replace_the_values_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "build.toml"
    file.write_text(
        "[area]\ncenter_deg = [3, 26]\nsize_km = 30\nlevels_m = [100, 200]\n[points]\nspacing_m = 900\n"
        '[model]\ntolerance = 0.1\nalbedo = "a.tif"\nalbedo_encoding = "srgb"\n'
    )
    words = ["--config", str(file)]
    plain = _config(words)
    assert plain.points == PointConfig(spacing_m=900.0)
    config = _config(
        [*words, "--gsd", "50", "--spacing", "2", "--accuracy", "high", "--albedo", "b.tif"]
    )
    assert config.area == AreaConfig((3.0, 26.0), 30.0, gsd_m=50.0)
    assert config.points == PointConfig(spacing_m=2000.0)
    assert config.model == ModelConfig(albedo="b.tif", accuracy="high")
    assert _config([*words, "--bounds", "1", "2", "3", "4"]).area.size_km is None
    views = _config([*words, "--view", "0", "--view", "30:90:100"]).view
    assert (views.off_nadir_deg, views.altitude_km[1]) == ((0.0, 30.0), 100.0)
    assert _config([*words, "--sun-elevations", "5:15:5"]).sun == SunConfig(
        elevations_deg=(5.0, 10.0, 15.0)
    )


def test_options_that_exclude_each_other_are_not_replaced() -> None:
    for words, fields in (
        (["--gsd", "50", "--levels", "50,100"], "`area.gsd_m` and `area.levels_m`"),
        (["--accuracy", "high", "--tolerance", "0.1"], "`model.accuracy` and `model.tolerance`"),
    ):
        with pytest.raises(ConfigError, match=fields) as caught:
            _config(words)
        assert caught.value.field == fields.split("`")[1]


def test_a_message_names_the_options_of_the_command() -> None:
    runs(command)
    try:
        said = in_options(
            "`points.spacing_m`, `view.azimuth_deg`, `overwrite`, `model.ring_max_km`, `lcp --debug`"
        )
        assert said == "--spacing, --view, --overwrite, model.ring_max_km, `lcp --debug`"
        assert (
            in_options("`sun.elevations_deg` and `sun_azimuth_deg`")
            == "--sun-elevations and sun_azimuth_deg"
        )
    finally:
        runs(None)
    assert in_options("`points.spacing_m`") == "points.spacing_m"


def test_a_key_of_another_build_is_an_option_of_build_catalog() -> None:
    """`lcp validate --gsd` is the scale of its windows, and `lcp query` has no --bounds."""
    runs(validate)
    try:
        for field, spelling in OPTIONS.items():
            said = in_options(f"take `build_catalog` with `{field}` 50, not `area.gsd_m` 60")
            assert said == f"take lcp build-catalog {spelling.flag} 50, not --gsd 60"
        said = in_options("`build_catalog` with `points.max_dependence` 0.5")
        assert said == "lcp build-catalog --config with points.max_dependence 0.5"
    finally:
        runs(None)


def test_a_key_of_a_file_is_named_as_it_stands_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The message about a BUILD.toml names its keys, not the options."""
    file = tmp_path / "build.toml"
    file.write_text("[points]\nspacing_m = -1\n")
    assert (
        run(["build-catalog", __file__, "-o", str(tmp_path / "c.h5"), "--config", str(file)]) == 2
    )
    assert "points.spacing_m must be above 0" in capsys.readouterr().err
