"""The types of values that flags take: what is refused where it stands, with the flag's name."""

from __future__ import annotations

import math
from typing import Any

import click

REFLECTANCES = ("lommel-seeliger", "lambert", "lunar-lambert", "minnaert", "hapke", "facet")
"""Written out, so that no flag needs the kernels to be imported; a test holds it against
`lcp_catalog.photometry.laws`.
"""


class Number(click.FloatRange):
    """A number within bounds; nan and inf are none."""

    name = "number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return float(number)


class Finite(click.types.FloatParamType):
    """A number without bounds; nan and inf are none."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return float(number)


class Instant(click.ParamType):
    """A time in ISO 8601; without a zone it is UTC."""

    name = "time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from lcp_catalog.errors import SunError
        from lcp_catalog.sun.times import instants  # erfa: only when a time is given

        try:
            instants(value)
        except SunError as error:
            self.fail(f"{error}.", param, ctx)
        return str(value)


class Law(click.ParamType):
    """A law of reflection by name, with what may follow a colon; or auto, which leaves it to the scene."""

    name = "law"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        return "LAW[:SET]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        law, colon, _ = str(value).partition(":")
        if law not in REFLECTANCES and value != "auto":
            self.fail(
                f"{value!r} is no law of reflection; there are {', '.join(REFLECTANCES)}.",
                param,
                ctx,
            )
        if colon and law != "facet":  # a facet's file is read, and complained of, with the others
            from lcp_catalog.errors import ConfigError
            from lcp_catalog.photometry.laws import (
                reflectance_model,  # numba: only when it is asked
            )

            try:
                reflectance_model(value)
            except ConfigError as error:
                self.fail(f"{error}.", param, ctx)
        return str(value)


LAW = Law()


class Step(click.ParamType):
    """A step of time like 30m, 6h, 1d, 3600s or PT6H, in seconds."""

    name = "step"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        from lcp_catalog.errors import SunError
        from lcp_catalog.sun.times import step_seconds

        try:
            return step_seconds(str(value))
        except SunError as error:
            self.fail(f"{error}.", param, ctx)


POSITIVE = Number(min=0.0, min_open=True)
LONGITUDE, LATITUDE = Number(-180, 360), Number(-90, 90)
AZIMUTH = Number(-360, 360)


class Names(click.ParamType):
    """Names with commas between them."""

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
