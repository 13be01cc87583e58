"""Types of option values. An invalid value is a usage error that names the option."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import click

from lcp_catalog.choices import AUTO_LAW, REFLECTANCE_MODELS

if TYPE_CHECKING:
    ParamType: TypeAlias = click.ParamType[Any]
else:  # generic since click 8.5
    ParamType = click.ParamType


class _Finite(ParamType):
    """Part of a number's type that refuses nan and inf."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return float(number)


class Number(_Finite, click.FloatRange):
    """A finite number within bounds; nan and inf are invalid."""

    name = "number"


class Finite(_Finite, click.types.FloatParamType):
    """A finite number; nan and inf are invalid."""


class Distance(Number):
    """A length of at least 0, in km or with its unit: ``300m``, ``2km``; converted to km."""

    name = "distance"

    def __init__(self) -> None:
        super().__init__(min=0.0)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        text = str(value).strip().lower()
        for unit, km in (("km", 1.0), ("m", 1e-3)):
            if text.endswith(unit):
                return km * super().convert(text.removesuffix(unit).strip(), param, ctx)
        return super().convert(value, param, ctx)


class Read(ParamType):
    """A value that `read` makes of its text, and BadParameter if it cannot; an error of the library is one, too."""

    read: Callable[[str], Any]

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from lcp_catalog.errors import LcpError

        try:
            return self.read(value) if isinstance(value, str) else value
        except LcpError as error:
            self.fail(f"{error}.", param, ctx)


class Instant(Read):
    """A time in ISO 8601; UTC if it has no time zone."""

    name = "time"

    def read(self, text: str) -> str:
        from lcp_catalog.ephemeris.times import instants  # imports erfa

        instants(text)
        return text


class Step(Read):
    """Time step like 30m, 6h, 1d, 3600s or PT6H; converted to seconds."""

    name = "step"

    def read(self, text: str) -> float:
        from lcp_catalog.ephemeris.times import step_seconds

        return step_seconds(text)


class Law(Read):
    """Name of a reflectance model, with an optional parameter set after a colon, or ``auto``."""

    name = "law"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        return "LAW[:SET]"

    def read(self, text: str) -> str:
        law, colon, _ = text.partition(":")
        if law not in REFLECTANCE_MODELS and text != AUTO_LAW:
            raise click.BadParameter(
                f"{text!r} is not a reflectance model; valid names: {', '.join(REFLECTANCE_MODELS)}."
            )
        if colon and law != "facet":  # a facet model's file is checked when it is read
            from lcp_catalog.photometry.laws import reflectance_model  # imports numba

            reflectance_model(text)
        return text

    def inputs(self, value: str) -> Iterator[Path]:
        """The MODEL.toml of a model that has one (`cli.files`)."""
        from lcp_catalog.photometry.facet_model import law_file

        file = law_file(value)
        if file is not None:
            yield file


LAW = Law()


class Ratio(Number):
    """A number within bounds, or ``auto`` or ``found``."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if value in ("auto", "found") else super().convert(value, param, ctx)


POSITIVE = Number(min=0.0, min_open=True)
SUN_SKY_RATIO = Ratio(min=0.0, min_open=True)
LONGITUDE, LATITUDE = Number(-180, 360), Number(-90, 90)
AZIMUTH = Number(-360, 360)
PLACE, AREA_BOUNDS = click.Tuple([LONGITUDE, LATITUDE]), click.Tuple([LONGITUDE, LATITUDE] * 2)


class Names(Read):
    """Names separated by commas."""

    name = "names"

    def read(self, text: str) -> tuple[str, ...]:
        names = tuple(name.strip() for name in text.split(","))
        if not all(names):
            raise click.BadParameter(f"{text!r} is not NAME,NAME...")
        return names


class KeyNumbers(Read):
    """``KEY=NUMBER``, or several numbers separated by commas."""

    name = "numbers"

    def read(self, text: str) -> tuple[str, tuple[float, ...]]:
        key, _, numbers = text.partition("=")
        try:
            return key.strip(), tuple(float(one) for one in numbers.split(","))
        except ValueError:
            raise click.BadParameter(
                f"{text!r} is not KEY=NUMBER or KEY=NUMBER,NUMBER..."
            ) from None
