"""Instants in UTC: parsed from text, ranges, output as text, and in terrestrial time."""

from __future__ import annotations

import datetime as dt
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

import erfa
import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..errors import SunError, not_a

FIRST_YEAR, LAST_YEAR = 1900, 2099
"""First and last year in which the Earth's series (epv00 of ERFA) is valid."""

MOST_INSTANTS = 1_000_000
"""Largest number of instants of one range."""

_LEAP = re.compile(r"([T ]\d\d:?\d\d:?)60")
_STEP = re.compile(r"(\d+(?:\.\d+)?) *(s|m|min|h|d)")
_ISO_STEP = re.compile(
    r"P(?:(\d+(?:\.\d+)?)D)?(?:T(?:(\d+(?:\.\d+)?)H)?(?:(\d+(?:\.\d+)?)M)?(?:(\d+(?:\.\d+)?)S)?)?"
)
_AHEAD_OF_TAI_S = {"TAI": 0.0, "TT": 32.184, "TDB": 32.184}
_SECONDS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants in UTC: calendar time, datetime64[us] (n,), and seconds to add (n,): 1 in a leap
    second, which the calendar cannot express, else 0.
    """

    civil: NDArray[np.datetime64]
    leap: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.civil)

    def __getitem__(self, which: slice) -> Instants:
        return Instants(self.civil[which], self.leap[which])

    def terrestrial(self) -> tuple[Array, Array]:
        """Two-part Julian dates of terrestrial time (TT), each (n,).

        There was no UTC before 1960: the times are taken as universal time, with TT - UT = 32.184
        s. The true difference was -3 s in 1900 and 33 s in 1960; the error turns the Sun by at most
        0.005 deg. Future leap seconds are unknown: 0.00014 deg each.
        """
        months, days = self.civil.astype("M8[M]"), self.civil.astype("M8[D]")
        year, month = np.divmod(months.astype(np.int64), 12)
        day = (days - months.astype("M8[D]")).astype(np.int64)
        seconds, micro = np.divmod((self.civil - days).astype(np.int64), 1_000_000)
        minutes, seconds = np.divmod(seconds, 60)
        hours, minutes = np.divmod(minutes, 60)
        seconds_and_leap = seconds + self.leap + micro * 1e-6
        with _dubious_years():
            utc = erfa.dtf2d(
                "UTC", year + 1970, month + 1, day + 1, hours, minutes, seconds_and_leap
            )
            jd1, jd2 = erfa.taitt(*erfa.utctai(*utc))
        return jd1, jd2

    def years(self) -> tuple[int, int]:
        """The first and the last year."""
        first, last = np.array([self.civil.min(), self.civil.max()]).astype("M8[Y]")
        return int(str(first)), int(str(last))

    def labels(self) -> list[str]:
        """ISO 8601 text with ``Z`` of each instant, with microseconds where they are not 0."""
        texts = np.datetime_as_string(self.civil, unit="us").tolist()
        seconds = [
            ":60" if leap else text[16:19] for text, leap in zip(texts, self.leap, strict=True)
        ]
        return [
            f"{text[:16]}{second}{text[19:].removesuffix('.000000')}Z"
            for text, second in zip(texts, seconds, strict=True)
        ]


def utc_of_ephemeris_time(seconds: float) -> str:
    """UTC, to a millisecond, of a SPICE ephemeris time: seconds of barycentric dynamical time since
    J2000.

    Terrestrial time approximates barycentric time within 2 ms. Before 1972 UTC had other rates,
    which SPICE leaves out: 0.4 s in 1971.
    """
    with _dubious_years():
        utc = erfa.taiutc(*erfa.tttai(2451545.0, seconds / 86400.0))
        year, month, day, of_day = erfa.d2dtf("UTC", 3, *utc)
    h, m, s, fraction = of_day.item()
    return (
        f"{int(year):04d}-{int(month):02d}-{int(day):02d}T{h:02d}:{m:02d}:{s:02d}.{fraction:03d}Z"
    )


def ephemeris_time(time_utc: Time) -> float:
    """SPICE ephemeris time of an instant: `ephemeris_times`."""
    return float(ephemeris_times(time_utc)[0])


def ephemeris_times(times: Times, system: str = "UTC") -> Array:
    """SPICE ephemeris times (n,): seconds of barycentric dynamical time (TDB) since J2000, by SPICE's own formula.

    ``system``: that of the times; UTC, TAI, TT or TDB. SunError for another. For UTC before 1972 see
    `utc_of_ephemeris_time`.
    """
    given = instants(times)
    if system == "UTC":
        jd1, jd2 = given.terrestrial()
        terrestrial: Array = np.asarray(((jd1 - 2451545.0) + jd2) * 86400.0)
    elif system in _AHEAD_OF_TAI_S:
        since = (given.civil - np.datetime64("2000-01-01T12:00:00", "us")).astype(np.int64)
        terrestrial = np.asarray(1e-6 * since + 32.184 - _AHEAD_OF_TAI_S[system])
    else:
        raise SunError(f"the time system {system or 'is missing'}: UTC, TAI, TT and TDB are known")
    if system == "TDB":
        return np.asarray(terrestrial)
    anomaly = 6.239996 + 1.99096871e-7 * terrestrial
    return np.asarray(terrestrial + 1.657e-3 * np.sin(anomaly + 1.671e-2 * np.sin(anomaly)))


@runtime_checkable
class AstropyTime(Protocol):
    """What is used of astropy.time.Time."""

    isscalar: bool
    utc: Any


Time: TypeAlias = str | dt.datetime | np.datetime64 | AstropyTime
"""An instant. One without a time zone is UTC; datetime64 has no leap seconds."""

Times: TypeAlias = Instants | Time | Sequence[Time] | NDArray[np.datetime64]
"""One instant or several."""


def instants(times: Times) -> Instants:
    """One or many instants.

    KindError for what is no time, SunError for an invalid time, a year outside 1900-2099, or a second 60 that is not a leap
    second.
    """
    if isinstance(times, Instants):
        return times
    if isinstance(times, np.ndarray) and times.dtype.kind == "M":
        return _checked(times.astype("M8[us]"))
    one = isinstance(times, str) or getattr(times, "isscalar", not isinstance(times, Iterable))
    every: Any = [times] if one else times
    parsed = [_civil(time) for time in every]
    civil = np.array([time for time, _ in parsed], dtype="M8[us]")
    return Instants(civil, np.array([leap for _, leap in parsed], dtype=np.int64))


def instant_range(start: Time, stop: Time, step_s: float | str) -> Instants:
    """A range of instants in equal steps of calendar time: a day from midnight ends at midnight, with or
    without a leap second.

    Parameters
    ----------
    start, stop:
        First and last instant, UTC: ISO text, datetime, datetime64 or astropy's; ``stop`` is included if a step falls on
        it.
    step_s:
        Step, seconds, or text such as ``6h`` (`step_seconds`).

    Raises
    ------
    SunError
        For a stop before the start, a step below a microsecond, more than `MOST_INSTANTS` instants.

    Examples
    --------
    >>> len(lcp.instant_range("2026-03-01", "2026-03-02", "1h"))
    25
    """
    (first, leap1), (last, leap2) = _civil(start), _civil(stop)
    if leap1 or leap2:
        raise SunError("a range cannot start or stop in a leap second")
    if last < first:
        raise SunError(f"the range stops at {stop}, before it starts at {start}")
    step_s = step_seconds(step_s) if isinstance(step_s, str) else step_s
    step_us = round(step_s * 1e6)
    if step_us < 1:
        raise SunError(f"invalid step: {step_s} s")
    count = (last - first) // dt.timedelta(microseconds=step_us) + 1
    if count > MOST_INSTANTS:
        raise SunError(
            f"the range has {count} instants, more than {MOST_INSTANTS}: take a longer step"
        )
    steps = np.arange(count, dtype=np.int64) * step_us
    return _checked(np.datetime64(first, "us") + steps.astype("m8[us]"))


def step_seconds(text: str) -> float:
    """Seconds of a step like 30m, 6h, 1d, 3600s or PT6H; SunError for any other text."""
    plain = _STEP.fullmatch(text.strip())
    if plain:
        seconds = float(plain[1]) * _SECONDS[plain[2]]
    else:
        iso = _ISO_STEP.fullmatch(text.strip())
        parts = iso.groups() if iso else ()
        units = (86400.0, 3600.0, 60.0, 1.0)
        seconds = sum(float(p) * unit for p, unit in zip(parts, units, strict=False) if p)
    if not 1e-6 <= seconds <= 1e10:
        raise SunError(f"invalid step: {text!r} (like 30m, 6h, 1d or PT6H)")
    return seconds


def _civil(time: Time) -> tuple[dt.datetime, int]:
    """UTC without time zone, and 1 for a leap second, else 0."""
    leap = 0
    if isinstance(time, np.datetime64):
        time = str(time.astype("M8[us]"))
    elif isinstance(time, AstropyTime):
        utc = time.utc
        utc.precision = 6
        time = str(utc.isot)
    stated = time
    if isinstance(time, str):
        text, leap = _LEAP.subn(r"\g<1>59", time.strip(), count=1)
        try:
            time = dt.datetime.fromisoformat(text)
        except ValueError as error:
            why = "" if re.search("isoformat|timedelta", str(error)) else f": {error}"
            raise SunError(f"invalid time: {stated!r} (like 2024-01-01T00:00:00){why}") from error
    if not isinstance(time, dt.datetime):
        raise not_a(time, "time", "ISO text, a datetime, a datetime64 or a time of astropy")
    _require_year(time.year, 1)  # a zone may overflow the calendar
    if time.tzinfo is not None:
        time = time.astimezone(dt.UTC).replace(tzinfo=None)
    _require_year(time.year)
    if leap and not _ends_with_a_leap_second(time):
        raise SunError(f"invalid time: {stated!r}: there was no leap second")
    return time, leap


def _ends_with_a_leap_second(time: dt.datetime) -> bool:
    """True for the last minute of a day that has 86401 seconds."""
    if (time.hour, time.minute) != (23, 59):
        return False
    after = time.date() + dt.timedelta(days=1)
    with _dubious_years():
        today, tomorrow = (erfa.dat(d.year, d.month, d.day, 0.0) for d in (time.date(), after))
    return abs(float(tomorrow - today) - 1.0) < 1e-9


def _require_year(year: int, more: int = 0) -> None:
    if not FIRST_YEAR - more <= year <= LAST_YEAR + more:
        raise SunError(
            f"the year {year} is outside {FIRST_YEAR}-{LAST_YEAR}, where the series of the Sun is valid"
        )


def _checked(civil: NDArray[np.datetime64]) -> Instants:
    """Instants without leap seconds; SunError for NaT and years outside the series."""
    if np.isnat(civil).any():
        raise SunError("invalid time: NaT")
    found = Instants(civil, np.zeros(len(civil), dtype=np.int64))
    for year in found.years() if len(found) else ():
        _require_year(year)
    return found


@contextmanager
def _dubious_years() -> Iterator[None]:
    """Silence ERFA's warnings for years before UTC and years with unknown leap seconds; both are
    intended here.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        yield
