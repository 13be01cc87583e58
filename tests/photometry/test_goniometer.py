"""Goniometer measurements from CSV: accepted formats, and messages for invalid files."""

import hashlib

import numpy as np
import pytest

from lcp_catalog.errors import MeasurementError
from lcp_catalog.photometry.facet_fit import IncidenceSeries, read_measurements

ANGLES = range(-75, 76, 15)


def written(tmp_path, text, name="g.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def table(value, header="incidence_deg,emission_deg,intensity", incidences=(30,), separator=","):
    """One value for each direction, by a function of incidence and emission (degrees)."""
    rows = [separator.join([str(i), str(e), str(value(i, e))]) for i in incidences for e in ANGLES]
    return "\n".join([header.replace(",", separator), *rows]) + "\n"


def cosine(e):
    return np.cos(np.radians(e))


def test_three_quantities_say_the_same(tmp_path):
    """Lambert's surface of albedo 0.4 as intensity, brightness and I/F."""
    texts = [
        table(lambda i, e: 0.4 * cosine(e), incidences=(0, 30)),
        table(lambda i, e: 0.4, "incidence_deg,emission_deg,brightness", (0, 30)),
        table(lambda i, e: 0.4 * cosine(i), "incidence_deg,emission_deg,radiance_factor", (0, 30)),
    ]
    read = [read_measurements(written(tmp_path, text)) for text in texts]
    assert [m.absolute for m in read] == [False, False, True]
    for m in read:
        assert [s.incidence_deg for s in m.samples] == [0, 30]
        for s in m.samples:
            assert s.intensity == pytest.approx(0.4 * cosine(s.emission_deg))
            scaled = s.scaled()
            assert scaled.level == pytest.approx(0.4 * cosine(s.incidence_deg))
            assert scaled.in_plane(-s.incidence_deg) == pytest.approx(1.0)


def test_separators_remarks_and_order(tmp_path):
    plain = read_measurements(written(tmp_path, table(lambda i, e: 1.5 + e / 1000)))
    text = table(lambda i, e: f"{1.5 + e / 1000:.4f}".replace(".", ","), separator=";")
    other = "\ufeff# a remark\n\n" + text.replace("\n", "\n# more\n", 1)
    semicolon = read_measurements(written(tmp_path, other))
    assert semicolon.samples[0].intensity == pytest.approx(plain.samples[0].intensity)
    turned = ["intensity, Incidence_deg, note, emission_deg"]
    turned += [f"{1.5 + e / 1000},30,fine,{e}" for e in reversed(ANGLES)]
    reordered = read_measurements(written(tmp_path, "\n".join(turned)))
    assert reordered.samples[0].intensity[::-1] == pytest.approx(plain.samples[0].intensity)
    assert plain.largest_emission_deg == 75.0
    path = written(tmp_path, "\n".join(turned))
    assert read_measurements(path).sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_specular_direction():
    """Between neighbours, in either description of the plane; None without near neighbours."""
    emission = np.array([-80.0, -40, -20, 0, 20, 40, 60])
    values = np.array([8.0, 4, 2, 1, 1, 1, 1])
    sample = IncidenceSeries(30, emission, np.zeros(7), values)
    assert sample.in_plane(-30) == pytest.approx(3.0)
    assert sample.in_plane(-40) == 4.0
    assert sample.in_plane(-60) is None  # the gap from -80 to -40
    assert sample.in_plane(-85) is None
    other = IncidenceSeries(30, -emission, np.full(7, 180.0), values)
    assert other.in_plane(-30) == pytest.approx(3.0)
    assert IncidenceSeries(30, emission, np.full(7, 20.0), values).in_plane(-30) is None
    with pytest.raises(
        MeasurementError, match="incidence 60 deg: no intensity around the specular"
    ):
        IncidenceSeries(60, emission, np.zeros(7), values).scaled()


GOOD = table(lambda i, e: 1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "empty"),
        ("# only a remark\n", "empty"),
        ("incidence_deg,emission_deg,intensity\n", "no measurements"),
        (
            GOOD.replace("incidence_deg", "psi"),
            "no column incidence_deg; the columns are psi, emission_deg",
        ),
        (GOOD.replace("emission_deg", "theta"), "no column emission_deg"),
        (
            GOOD.replace("intensity", "value"),
            "one column of intensity, brightness, radiance_factor is needed; the file has none",
        ),
        (GOOD.replace("intensity", "intensity,brightness", 1), "both intensity and brightness"),
        (GOOD.replace("intensity", "intensity,intensity", 1), "appears twice"),
        (GOOD.replace("30,0,1.0", "30,0,bright"), "line 7: intensity is not a number: 'bright'"),
        (GOOD.replace("30,0,1.0", "30,0"), "line 7 has 2 values; the header names 3"),
        (GOOD.replace("30,0,1.0", "30,0,nan"), "line 7: intensity nan is not within 0 or more"),
        (GOOD.replace("30,0,1.0", "30,0,inf"), "line 7: intensity inf is not within"),
        (GOOD.replace("30,0,1.0", "30,0,-1"), "line 7: intensity -1 is not within 0 or more"),
        (GOOD.replace("30,0,1.0", "95,0,1.0"), "line 7: incidence_deg 95 is not within 0..89.9"),
        (GOOD.replace("30,0,1.0", "30,-90,1.0"), "line 7: emission_deg -90 is not within"),
        (
            "\n".join(GOOD.splitlines()[:7]),
            "incidence 30 deg has 6 measurements; a fit of six parameters needs 7",
        ),
        (table(lambda i, e: 0), "incidence 30 deg: every value is 0"),
    ],
)
def test_refused(tmp_path, text, said):
    path = written(tmp_path, text)
    with pytest.raises(MeasurementError) as failure:
        read_measurements(path)
    assert said in str(failure.value)
    assert str(failure.value).startswith(str(path))
    assert "\n" not in str(failure.value)


def test_not_a_text_file(tmp_path):
    (tmp_path / "g.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(MeasurementError, match="UTF-8"):
        read_measurements(tmp_path / "g.csv")
    with pytest.raises(MeasurementError, match="No such file"):
        read_measurements(tmp_path / "none.csv")
