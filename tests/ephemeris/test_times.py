"""Instants, compared with the calendar, published time scales and the list of leap seconds."""

import datetime as dt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.ephemeris.times import MOST_INSTANTS, instant_range, instants, step_seconds
from lcp_catalog.errors import SunError

# IERS Bulletin C: days whose last second was a leap second.
LEAP_DAYS = [
    "1972-06-30", "1972-12-31", "1973-12-31", "1974-12-31", "1975-12-31", "1976-12-31",
    "1977-12-31", "1978-12-31", "1979-12-31", "1981-06-30", "1982-06-30", "1983-06-30",
    "1985-06-30", "1987-12-31", "1989-12-31", "1990-12-31", "1992-06-30", "1993-06-30",
    "1994-06-30", "1995-12-31", "1997-06-30", "1998-12-31", "2005-12-31", "2008-12-31",
    "2012-06-30", "2015-06-30", "2016-12-31",
]  # fmt: skip


def terrestrial_seconds(*times: str) -> np.ndarray:
    """TT of each instant, seconds after that of the first."""
    jd1, jd2 = instants(times).terrestrial()
    return ((jd1 - jd1[0]) + (jd2 - jd2[0])) * 86400.0


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ("2024-01-01", "2024-01-01T00:00:00Z"),
        ("2024-01-01T03:00:00+03:00", "2024-01-01T00:00:00Z"),
        (" 2024-02-29T23:59:59.5Z ", "2024-02-29T23:59:59.500000Z"),
        ("20240101T000001", "2024-01-01T00:00:01Z"),
        ("1969-07-20T20:17:40", "1969-07-20T20:17:40Z"),
        ("1971-12-31T23:59:59", "1971-12-31T23:59:59Z"),  # in ERFA that day has 86400.1 s
        ("2060-06-30T12:00:00.000001", "2060-06-30T12:00:00.000001Z"),
        ("2016-12-31T23:59:60", "2016-12-31T23:59:60Z"),
        ("2016-12-31T23:59:60.25Z", "2016-12-31T23:59:60.250000Z"),
        ("2017-01-01T02:59:60+03:00", "2016-12-31T23:59:60Z"),
        ("1900-01-01", "1900-01-01T00:00:00Z"),
        ("2099-12-31T23:59:59.999999", "2099-12-31T23:59:59.999999Z"),
    ],
)
def test_text_to_instants_and_back(text, label):
    assert instants(text).labels() == [label]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("yesterday", "invalid time"),
        ("2024-13-01", "invalid time"),
        ("", "invalid time"),
        ("2024-01-01T25:00", "invalid time"),
        ("2024-01-01T00:00:60", "no leap second"),
        ("2017-12-31T23:59:60", "no leap second"),
        ("2016-12-31T22:59:60", "no leap second"),
        ("2016-12-31T23:59:60+03:00", "no leap second"),
        ("1899-12-31T23:59:59", "1900-2099"),
        ("2100-01-01", "1900-2099"),
        ("1900-01-01T00:00:00+01:00", "1900-2099"),
        ("0001-01-01T00:00:00+14:00", "1900-2099"),
        ("9999-12-31T23:59:59-14:00", "1900-2099"),
    ],
)
def test_invalid_times(text, says):
    with pytest.raises(SunError, match=says) as error:
        instants(text)
    assert "\n" not in str(error.value)


def test_terrestrial_time_runs_ahead_by_the_published_seconds():
    # IERS: TAI - UTC is 10 s from 1972, 37 s from 2017; TT is TAI + 32.184 s
    for text, ahead in (("1972-01-01", 42.184), ("2017-01-01", 69.184), ("2050-01-01", 69.184)):
        jd1, jd2 = instants(text).terrestrial()
        days = (dt.date.fromisoformat(text) - dt.date(2000, 1, 1)).days
        noon = (jd1[0] - 2451544.5) + jd2[0] - days
        assert noon * 86400.0 == pytest.approx(ahead, abs=1e-4)


def test_every_leap_second_lasts_a_second():
    for day in LEAP_DAYS:
        after = (dt.date.fromisoformat(day) + dt.timedelta(days=1)).isoformat()
        seconds = terrestrial_seconds(f"{day}T23:59:59", f"{day}T23:59:60", f"{after}T00:00:00")
        assert seconds == pytest.approx([0, 1, 2], abs=1e-4), day


def test_there_are_no_other_leap_seconds():
    ends = [f"{y}-{end}" for y in range(1972, 2030) for end in ("06-30", "12-31")]
    for day in sorted(set(ends) - set(LEAP_DAYS)):
        with pytest.raises(SunError, match="no leap second"):
            instants(f"{day}T23:59:60")


moments = st.datetimes(dt.datetime(1901, 1, 1), dt.datetime(2098, 12, 31))


@given(moments, st.integers(-720, 720))
def test_zones_and_kinds_mean_the_same(moment, minutes):
    zone = dt.timezone(dt.timedelta(minutes=minutes))
    local = moment.replace(tzinfo=dt.UTC).astimezone(zone)
    label = instants(moment.isoformat() + "Z").labels()
    assert dt.datetime.fromisoformat(label[0]).replace(tzinfo=None) == moment
    assert instants(local).labels() == instants(local.isoformat()).labels() == label
    assert instants(np.array([moment], "M8[us]")).labels() == label


@given(moments, st.integers(1, 10**12), st.integers(0, 40))
def test_a_range_counts_like_the_calendar(start, step_us, steps):
    step = dt.timedelta(microseconds=step_us)
    stop = min(start + steps * step, dt.datetime(2099, 12, 31))
    expected = []
    while start + len(expected) * step <= stop:
        expected.append((start + len(expected) * step).isoformat() + "Z")
    assert instants(expected).labels() == instant_range(start, stop, step_us * 1e-6).labels()


def test_a_range_across_a_leap_second_keeps_to_midnight():
    when = instant_range("2016-12-30", "2017-01-02", 86400.0)
    assert [label[:19] for label in when.labels()] == [
        "2016-12-30T00:00:00",
        "2016-12-31T00:00:00",
        "2017-01-01T00:00:00",
        "2017-01-02T00:00:00",
    ]
    assert when.years() == (2016, 2017)


def test_slices_of_instants():
    when = instant_range("2024-01-01", "2024-01-02", 3600.0)
    assert (len(when), when[3:5].labels()) == (25, ["2024-01-01T03:00:00Z", "2024-01-01T04:00:00Z"])
    assert instants(when) is when
    assert len(instants([])) == 0


@pytest.mark.parametrize(
    ("start", "stop", "step", "says"),
    [
        ("2024-01-02", "2024-01-01", 1.0, "before it starts"),
        ("2024-01-01", "2024-01-02", 0.0, "invalid step"),
        ("2024-01-01", "2024-01-02", -5.0, "invalid step"),
        ("2016-12-31T23:59:60", "2017-01-02", 1.0, "leap second"),
        ("2000-01-01", "2020-01-01", 60.0, "longer step"),
        ("2024-01-01", "2100-01-01", 1e6, "1900-2099"),
    ],
)
def test_invalid_ranges(start, stop, step, says):
    with pytest.raises(SunError, match=says):
        instant_range(start, stop, step)


def test_the_longest_range():
    last = dt.datetime(2024, 1, 1) + dt.timedelta(seconds=MOST_INSTANTS - 1)
    assert len(instant_range("2024-01-01", last, 1.0)) == MOST_INSTANTS
    with pytest.raises(SunError, match="1000001 instants"):
        instant_range("2024-01-01", last + dt.timedelta(seconds=1), 1.0)


def test_arrays_are_checked():
    with pytest.raises(SunError, match="1900-2099"):
        instants(np.array(["2024-01-01", "2100-01-01"], "M8[us]"))
    with pytest.raises(SunError, match="1900-2099"):
        instants(np.array(["1899-12-31", "2024-01-01"], "M8[us]"))
    with pytest.raises(SunError, match="NaT"):
        instants(np.array(["2024-01-01", "NaT"], "M8[us]"))


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("6h", 21600), ("30m", 1800), ("30min", 1800), ("1d", 86400), ("3600s", 3600), ("0.5s", 0.5),
        ("1.5 h", 5400), (" 1d ", 86400), ("PT6H", 21600), ("P1D", 86400), ("PT1H30M", 5400),
        ("P1DT12H", 129600), ("PT0.25S", 0.25), ("PT90M5S", 5405),
    ],
)  # fmt: skip
def test_steps(text, seconds):
    assert step_seconds(text) == seconds


@pytest.mark.parametrize(
    "text",
    ["", "h", "6", "-6h", "6 hours", "0s", "PT", "P", "P1M", "1h30m", "nan s", "1e9d", "PT0S"],
)
def test_invalid_steps(text):
    with pytest.raises(SunError, match="invalid step"):
        step_seconds(text)
