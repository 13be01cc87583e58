"""Tables of points and windows, read back by another parser."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace

import numpy as np
from helpers import verdicts

from lcp_catalog.matching.matches import REASONS
from lcp_catalog.validation.output import POINT_COLUMNS, WINDOW_COLUMNS, csv_text, windows_csv_text


def read(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text, newline=""), strict=True))


def value(text: str) -> float:
    return float(text) if text else math.nan


def test_points_read_back_are_the_matches() -> None:
    image = verdicts.image()
    rows = read(csv_text([image]))
    m = image.matches
    assert tuple(rows[0]) == POINT_COLUMNS
    wanted = {
        "longitude_deg": image.points.longitude_deg,
        "latitude_deg": image.points.latitude_deg,
        "predicted_column_px": m.predicted_px[:, 0],
        "predicted_row_px": m.predicted_px[:, 1],
        "found_column_px": m.found_px[:, 0],
        "found_row_px": m.found_px[:, 1],
        "correlation": m.correlation,
        "second_correlation": m.second,
        "back_px": m.back_px,
        "residual_column_px": m.found_px[:, 0] - image.points.corrected_px[:, 0],
        "residual_row_px": m.found_px[:, 1] - image.points.corrected_px[:, 1],
        "pixel_m": image.points.pixel_m,
    }
    for name, figures in wanted.items():
        found = np.array([value(row[name]) for row in rows])
        np.testing.assert_allclose(found, figures, rtol=1e-8, atol=1e-9, err_msg=name)
    assert [int(row["point_id"]) for row in rows] == image.points.point_id.tolist()
    assert [row["reason"] for row in rows] == [REASONS[k] for k in m.code]
    assert {row["image"] for row in rows} == {"frame.png"}
    lost = next(row for row in rows if row["reason"] == "weak")
    for name in ("found_row_px", "sigma_major_px", "major_axis_deg", "residual_row_px"):
        assert lost[name] == ""


def test_claims_read_back_are_those_of_the_image() -> None:
    """Unknown figures are empty cells, flags 0 or 1; the columns are the last ones, with
    the match's prior and posterior."""
    image = verdicts.image()
    rows, claims = read(csv_text([image])), image.claims
    assert list(rows[0])[18:] == [
        "detection_probability", "usable", "sigma_major_m", "sigma_minor_m", "sigma_angle_deg",
        "found", "error_east_m", "error_north_m", "prior", "posterior",
    ]  # fmt: skip
    wanted = {
        "detection_probability": claims.probability,
        "usable": np.where(np.isfinite(claims.probability), claims.usable, np.nan),
        "sigma_major_m": claims.sigma_m[:, 0],
        "sigma_minor_m": claims.sigma_m[:, 1],
        "sigma_angle_deg": claims.angle_deg,
        "found": np.where(claims.tried, claims.found, np.nan),
        "error_east_m": claims.error_m[:, 0],
        "error_north_m": claims.error_m[:, 1],
        "prior": image.matches.prior,
        "posterior": image.matches.posterior,
    }
    for name, figures in wanted.items():
        found = np.array([value(row[name]) for row in rows])
        np.testing.assert_allclose(found, figures, rtol=1e-8, err_msg=name)
        assert 0 < np.isnan(found).sum() < len(found), name
    assert {row["found"] for row in rows} == {"", "0", "1"}


def test_windows_read_back_are_those_compared() -> None:
    image = verdicts.image()
    rows, w = read(windows_csv_text([image, verdicts.nothing()])), image.windows.compared
    assert tuple(rows[0]) == WINDOW_COLUMNS
    assert len(rows) == w.count
    columns = [
        ("row", w.row),
        ("column", w.col),
        ("correlation", w.correlation),
        ("contrast", w.contrast),
    ]
    columns += [("offset_column_cells", w.offset_px[:, 0]), ("offset_row_cells", w.offset_px[:, 1])]
    columns += [
        ("longitude_deg", image.windows.longitude_deg),
        ("latitude_deg", image.windows.latitude_deg),
    ]
    for name, figures in columns:
        found = np.array([value(row[name]) for row in rows])
        np.testing.assert_allclose(found, figures, rtol=1e-9, atol=1e-12, err_msg=name)
    assert rows[0]["point_id"] == ""


def test_windows_of_patches_say_whose_they_are() -> None:
    image = verdicts.image()
    w = image.windows.compared
    patches = replace(
        image.windows,
        compared=replace(w, offset_px=None, patch=np.zeros(w.count, np.int64)),
        point_id=np.arange(w.count) + 10**15,
    )
    rows = read(windows_csv_text([replace(image, windows=patches)]))
    assert [int(row["point_id"]) for row in rows] == patches.point_id.tolist()
    assert {row["offset_column_cells"] for row in rows} == {""}


def test_tables_keep_to_rfc_4180() -> None:
    """Lines end in CRLF; commas, quotes and line ends in names do not break rows."""
    name = 'a "b", c\nd.png'
    image = verdicts.image(name, n=5)
    for text, columns in (
        (csv_text([image]), POINT_COLUMNS),
        (windows_csv_text([image]), WINDOW_COLUMNS),
    ):
        assert text.endswith("\r\n")
        assert text.split("\r\n", 1)[0] == ",".join(columns)
        assert '"a ""b"", c\nd.png",' in text
        assert {row["image"] for row in read(text)} == {name}
        assert "nan" not in text


def test_no_image_is_a_heading_alone() -> None:
    assert csv_text([]) == ",".join(POINT_COLUMNS) + "\r\n"
    assert csv_text([verdicts.nothing()]) == csv_text([])
    assert windows_csv_text([verdicts.nothing()]) == ",".join(WINDOW_COLUMNS) + "\r\n"
