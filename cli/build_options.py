"""Options made from the fields of a build's configuration: `production.config` states what each means, its
range, choices and default; here stand only the option's name and how it is typed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import click

from lcp_catalog.choices import NO_MAP
from lcp_catalog.errors import NAMED
from lcp_catalog.fields import Meaning, meanings
from lcp_catalog.production.config import BuildConfig

from .files import BRIGHTNESS, RASTER, InputFile, config_files
from .groups import Decorator, collected, option_group
from .value_types import AREA_BOUNDS, LAW, PLACE, Names, Number, ParamType, Read

if TYPE_CHECKING:
    from lcp_catalog.production.model_config import ModelConfig

NUMBERS_MAX = 3600
"""Most numbers of a list START:STOP:STEP: a tenth of a degree around the horizon."""


class NumberList(Read):
    """Comma-separated numbers, or START:STOP:STEP with both ends included."""

    name = "numbers"

    def read(self, text: str) -> tuple[float, ...]:
        try:
            if ":" not in text:
                return tuple(float(part) for part in text.split(","))
            start, stop, step = (float(part) for part in text.split(":"))
        except ValueError:
            raise click.BadParameter(f"{text!r} is neither A,B,C nor START:STOP:STEP") from None
        if not step > 0 or not math.isfinite((stop - start) / step):
            raise click.BadParameter(f"{text!r}: the step must be positive")
        count = math.floor((stop - start) / step + 1e-9) + 1
        if count > NUMBERS_MAX:
            raise click.BadParameter(f"{text!r} is {count} numbers, at most {NUMBERS_MAX}")
        return tuple(start + i * step for i in range(count))


class ViewParam(Read):
    """OFF_NADIR[:AZIMUTH[:ALTITUDE_KM]]."""

    name = "view"

    def read(self, text: str) -> tuple[float, ...]:
        try:
            parts = [float(part) for part in text.split(":")]
        except ValueError:
            parts = []
        if not 1 <= len(parts) <= 3 or (len(parts) == 1 and parts[0] != 0.0):
            raise click.BadParameter(f"{text!r} is not OFF_NADIR:AZIMUTH[:ALTITUDE_KM] (or 0)")
        return (*parts, *(0.0, math.inf)[len(parts) - 1 :])


class Altitudes(Read):
    """KM-KM, lowest and highest altitude."""

    name = "altitudes"

    def read(self, text: str) -> tuple[float, ...]:
        try:
            low, high = (float(part) for part in text.split("-"))
        except ValueError:
            low, high = math.nan, math.nan
        if not 0.0 < low <= high < math.inf:
            raise click.BadParameter(
                f"{text!r} is not KM-KM, lowest and highest, for example 5-100"
            )
        return low, high


class PartParam(Read):
    """K/N."""

    name = "part"

    def read(self, text: str) -> tuple[int, int]:
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise click.BadParameter(f"{text!r} is not K/N with K from 1 to N, for example 3/16")
        return int(found[1]), int(found[2])


@dataclass(frozen=True)
class Spelling:
    """How a field is typed on the command line. ``kind``: None for that of the field's type."""

    flag: str
    metavar: str | None = None
    kind: ParamType | None = None


NUMBERS = NumberList()

OPTIONS = {
    "area.center_deg": Spelling("--center", "LON LAT", PLACE),
    "area.size_km": Spelling("--size", "KM"),
    "area.bounds_deg": Spelling("--bounds", "W S E N", AREA_BOUNDS),
    "area.gsd_m": Spelling("--gsd", "M"),
    "area.levels_m": Spelling("--levels", "M,M,...", NUMBERS),
    "area.altitudes_km": Spelling("--altitudes", "KM-KM", Altitudes()),
    "area.ifov_rad": Spelling("--ifov", "RAD"),
    "dem.product_order": Spelling("--product-order", "NAME,NAME...", Names()),
    "dem.sigma_map": Spelling("--dem-sigma", "MAP", RASTER),
    "dem.resolution_map": Spelling("--dem-resolution", "MAP", RASTER),
    "sun.azimuths_deg": Spelling("--sun-azimuths", "LIST", NUMBERS),
    "sun.elevations_deg": Spelling("--sun-elevations", "LIST", NUMBERS),
    "points.spacing_m": Spelling("--spacing", "KM"),
    "points.located_probability": Spelling("--located-probability", "P"),
    "points.per_view": Spelling("--per-view", "N"),
    "points.footprint_km": Spelling("--footprint", "KM"),
    "points.max_points": Spelling("--max-points", "N"),
    "points.max_bytes": Spelling("--max-bytes", "N"),
    "points.search_m": Spelling("--search", "KM"),
    "points.passes": Spelling("--passes", "1|2"),
    "model.reflectance": Spelling("--reflectance", None, LAW),
    "model.accuracy": Spelling("--accuracy"),
    "model.tolerance": Spelling("--tolerance", "T"),
    "model.albedo": Spelling("--albedo", "MAP|moon|none", BRIGHTNESS),
    "model.albedo_encoding": Spelling("--albedo-encoding"),
    "model.albedo_reference": Spelling("--albedo-reference", "V"),
    "errors.sensor_noise": Spelling("--noise", "SHARE"),
}
"""The options by the fields that they set."""

VIEWS = ("view.off_nadir_deg", "view.azimuth_deg", "view.altitude_km")
"""Fields of ``--view``, in the order of its parts."""

KEYS = {name.partition(".")[2]: name for name in OPTIONS}
"""Fields by the names of the options' values: a field's own name, without its section."""


class FieldOption(click.Option):
    """An option that sets ``fields`` of the configuration; its value times ``factor`` is the field's."""

    def __init__(
        self, names: Sequence[str], fields: tuple[str, ...], factor: float = 1.0, **settings: Any
    ) -> None:
        super().__init__(names, **settings)
        self.fields, self.factor = fields, factor

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        found = super().type_cast_value(ctx, value)
        return found if self.factor == 1.0 or found is None else self.factor * found


def field_option(name: str, default_words: str | None = None, **settings: Any) -> Decorator:
    """The option of a field, ``section.key``; its value has the name ``key`` and the field's unit. ``default_words``:
    the default, where a command has its own; ``settings``: those of click that differ.
    """
    section, _, key = name.partition(".")
    kind = get_type_hints(BuildConfig)[section]
    meaning, spelling = meanings(kind)[key], OPTIONS[name]
    factor = 1e3 if spelling.metavar == "KM" and key.endswith("_m") else 1.0
    own = next(one.default for one in fields(kind) if one.name == key)
    words = default_words or meaning.default or (f"{own:g}" if isinstance(own, float) else "")
    lists = " A,B,C or START:STOP:STEP." if section == "sun" else ""
    text = f"{meaning.text}{lists}" + (f" Default: {words}." if words else "")
    facts: dict[str, Any] = {
        "fields": (name,),
        "factor": factor,
        "type": spelling.kind or _type(get_type_hints(kind)[key], meaning, factor),
        "metavar": spelling.metavar,
        "help": NAMED.sub(_option_or_name, text),
        "show_default": False,
    }
    return click.option(spelling.flag, key, cls=FieldOption, **(facts | settings))


def _option_or_name(found: re.Match[str]) -> str:
    """The flag of a field that a text names; the field's own name where no option sets it."""
    return OPTIONS[found[1]].flag if found[1] in OPTIONS else found[1]


def _type(hint: object, meaning: Meaning, factor: float) -> ParamType:
    """Type of an option for a field's type and range."""
    if meaning.choices:
        return click.Choice(meaning.choices)
    low = meaning.least if meaning.above is None else meaning.above
    below = None if meaning.below == math.inf else meaning.below
    high = meaning.most if below is None else below
    if "int" in str(hint):
        return click.IntRange(
            None if low is None else int(low), None if high is None else int(high)
        )
    least, most = (None if v is None else _short(v / factor) for v in (low, high))
    return Number(least, most, min_open=meaning.above is not None, max_open=below is not None)


def _short(value: float) -> float:
    """A number that a help shows without a decimal point where it has no decimals."""
    return int(value) if value == int(value) else value


_view_option: Decorator = click.option(
    "--view",
    "views",
    cls=FieldOption,
    fields=VIEWS,
    type=ViewParam(),
    multiple=True,
    metavar="OFF:AZ[:KM]",
    help="View: angle from the vertical at the point and azimuth, degrees, and altitude, km (default: infinity). Repeat "
    "for more views. Default: those of --camera, else 0, and 50 degrees from four azimuths.",
)


def build_options(fields_set: Iterable[str]) -> Decorator:
    """Options of a build, which a command gets as ``config``, a BuildConfig: ``--config``, ``--view``, and those of
    fields.
    """
    names = ["config_path", "views", *(name.partition(".")[2] for name in fields_set)]
    config_option: Decorator = click.option(
        "--config",
        "config_path",
        type=InputFile(config_files),
        metavar="BUILD.toml",
        help="Configuration of the build; options of the command line replace its values. Default: every value its "
        "default.",
    )
    every = option_group(config_option, _view_option, *map(field_option, fields_set))
    return collected("config", configuration, every, names=names)


def configuration(
    config_path: str | None, views: tuple[tuple[float, ...], ...], **given: object
) -> BuildConfig:
    """The configuration of the file with the values of the options. ConfigError for values that contradict each
    other.
    """
    config = BuildConfig.from_toml(Path(config_path)) if config_path else BuildConfig()
    values = {KEYS[key]: value for key, value in given.items() if value is not None}
    values |= dict(zip(VIEWS, zip(*views, strict=True), strict=False))
    return config.replaced(values)


def model_config(
    reflectance: str | None,
    accuracy: str | None,
    tolerance: float | None,
    albedo: str | None,
    albedo_encoding: str | None,
    albedo_reference: float | None,
) -> ModelConfig:
    """The model of a single image. ConfigError for values that contradict each other."""
    from lcp_catalog.choices import AUTO_LAW
    from lcp_catalog.production.model_config import ModelConfig

    return ModelConfig(
        reflectance or AUTO_LAW,
        albedo or NO_MAP,
        albedo_encoding,
        albedo_reference,
        accuracy,
        tolerance,
    )


AREA = ("area.center_deg", "area.size_km", "area.bounds_deg", "area.gsd_m")
SWEEP = ("sun.azimuths_deg", "sun.elevations_deg")
POINTS = (*(name for name in OPTIONS if name.startswith("points.")), "errors.sensor_noise")
ACCURACY = ("model.accuracy", "model.tolerance")
ALBEDO = ("model.albedo", "model.albedo_encoding", "model.albedo_reference")


def image_model(law: Decorator) -> Decorator:
    """Options of the model of an image, with the ``law``, which a command gets as ``model``. An image shows the relief
    alone unless an albedo map is named.
    """
    bright = field_option("model.albedo", NO_MAP)
    return collected(
        "model", model_config, law, bright, *map(field_option, (*ACCURACY, *ALBEDO[1:]))
    )


model_options = image_model(field_option("model.reflectance"))
"""Reflectance, accuracy and albedo of a single image, which a command gets as ``model``."""
