"""Types of option values. An invalid value is a usage error that names the option."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from lcp_catalog.choices import AUTO_LAW, GSD_MAX_M, REFLECTANCE_MODELS


class _Finite(click.ParamType):
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


class Instant(click.ParamType):
    """A time in ISO 8601; UTC if it has no time zone."""

    name = "time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from lcp_catalog.ephemeris.times import instants  # imports erfa
        from lcp_catalog.errors import SunError

        try:
            instants(value)
        except SunError as error:
            self.fail(f"{error}.", param, ctx)
        return str(value)


class Law(click.ParamType):
    """Name of a reflectance model, with an optional parameter set after a colon, or ``auto``."""

    name = "law"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        return "LAW[:SET]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        law, colon, _ = str(value).partition(":")
        if law not in REFLECTANCE_MODELS and value != AUTO_LAW:
            self.fail(
                f"{value!r} is not a reflectance model; valid names: {', '.join(REFLECTANCE_MODELS)}.",
                param,
                ctx,
            )
        if colon and law != "facet":  # a facet model's file is checked when it is read
            from lcp_catalog.errors import ConfigError
            from lcp_catalog.photometry.laws import reflectance_model  # imports numba

            try:
                reflectance_model(value)
            except ConfigError as error:
                self.fail(f"{error}.", param, ctx)
        return str(value)

    def inputs(self, value: str) -> Iterator[Path]:
        """The MODEL.toml of a model that has one (`cli.files`)."""
        from lcp_catalog.photometry.facet_file import law_file

        file = law_file(value)
        if file is not None:
            yield file


LAW = Law()


class Step(click.ParamType):
    """Time step like 30m, 6h, 1d, 3600s or PT6H; converted to seconds."""

    name = "step"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        from lcp_catalog.ephemeris.times import step_seconds
        from lcp_catalog.errors import SunError

        try:
            return step_seconds(str(value))
        except SunError as error:
            self.fail(f"{error}.", param, ctx)


class NumberOr(Number):
    """A number within bounds, or one of some words."""

    def __init__(self, *words: str, **bounds: Any) -> None:
        super().__init__(**bounds)
        self.words = words

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if value in self.words else super().convert(value, param, ctx)


POSITIVE = Number(min=0.0, min_open=True)
SUN_SKY_RATIO = NumberOr("auto", "found", min=0.0, min_open=True)
CELL_SIZE = Number(min=0.0, max=GSD_MAX_M, min_open=True)
LONGITUDE, LATITUDE = Number(-180, 360), Number(-90, 90)
AZIMUTH = Number(-360, 360)
PLACE, AREA_BOUNDS = click.Tuple([LONGITUDE, LATITUDE]), click.Tuple([LONGITUDE, LATITUDE] * 2)


class Names(click.ParamType):
    """Names separated by commas."""

    name = "names"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        if isinstance(value, tuple):
            return value
        names = tuple(name.strip() for name in value.split(","))
        if not all(names):
            self.fail(f"{value!r} is not NAME,NAME...", param, ctx)
        return names
