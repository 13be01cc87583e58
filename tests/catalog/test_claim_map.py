"""The numbers of the page's script, decoded as its description says, against the catalogue."""

from __future__ import annotations

import base64
import dataclasses
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catalogs
from helpers.pages import in_browser, logged, parsed

from lcp_catalog.catalog import report
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.charts import ReliefMap
from lcp_catalog.catalog.summary import Statistics, summary


def given(catalog: Catalog) -> tuple[Catalog, ReliefMap, np.ndarray]:
    """What `claim_map` takes: the catalogue, its chart and its evaluated Suns."""
    return catalog, chart_of(catalog), Statistics.of(catalog).suns


def chart_of(catalog: Catalog) -> ReliefMap:
    view = catalog.overview
    return ReliefMap(view.height, view.x, view.y, view.plane)


def unpacked(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text))


def decoded(found: dict[str, Any]) -> dict[str, np.ndarray]:
    """Planes (n, s, v, k) and the condition (n, v, k)."""
    content = np.frombuffer(unpacked(found["data"]), np.uint8)
    n, s, v, k = (len(found[name]) for name in ("points", "scales", "views", "suns"))
    condition, rest = content[: n * v * k].reshape(n, v, k), content[n * v * k :]
    assert len(rest) == 4 * n * s * v * k
    probability, size, shape, angle = rest.reshape(4, n, s, v, k)
    major = np.where(size == 255, np.nan, found["sigma_m"] * found["sigma_ratio"] ** size.astype(float))  # fmt: skip
    return {
        "condition": condition,
        "detection_probability": np.where(probability == 255, np.nan, probability / 250),
        "sigma_major": major,
        "sigma_minor": major * shape / 254,
        "sigma_angle": np.where(angle == 255, np.nan, angle.astype(float)),
    }


def test_the_page_holds_what_the_catalogue_claims() -> None:
    catalog = catalogs.catalog(20)
    found = report.claim_map(*given(catalog))
    assert found is not None
    planes = decoded(found)
    suns = np.array(found["suns"])
    assert len(suns) == Statistics.of(catalog).suns.sum()
    at = (..., suns[:, 0], suns[:, 1])
    np.testing.assert_array_equal(planes["condition"], catalog.condition[at])
    for name, relative, absolute in (
        ("detection_probability", 0.0, 1e-6),
        ("sigma_major", 0.0101, 0.0),
        ("sigma_minor", 0.02, 0.1),
        ("sigma_angle", 0.0, 1e-6),
    ):
        want = getattr(catalog, name)[at]
        assert np.isfinite(want).any()
        np.testing.assert_allclose(planes[name], want, rtol=relative, atol=absolute, err_msg=name)


def test_a_page_for_many_points_shows_an_even_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    catalog = catalogs.catalog(40)
    suns = Statistics.of(catalog).suns.sum()
    one = suns * 3
    found = []
    for most in (40 * one * 13, 40 * one * 13 - 1, 10 * one * 5):
        monkeypatch.setattr(report, "BYTES_MAX", most)
        found.append(report.claim_map(*given(catalog)))
    whole, fewer, some = found
    assert whole is not None
    assert fewer is not None
    assert some is not None
    assert (len(whole["scales"]), len(whole["points"])) == (3, 40)
    assert (len(fewer["scales"]), len(fewer["points"])) == (1, 40)
    assert (len(some["scales"]), len(some["points"]), some["of"]) == (1, 10, 40)
    assert len(unpacked(some["data"])) <= 10 * one * 5
    shown = [str(i) for i in catalog.point_id]
    steps = np.diff([shown.index(point[0]) for point in some["points"]])
    assert set(steps.tolist()) <= {4, 5}
    planes = decoded(some)
    rows = [shown.index(point[0]) for point in some["points"]]
    at = np.array(some["suns"])
    want = catalog.detection_probability[rows][:, :1][..., at[:, 0], at[:, 1]]
    np.testing.assert_allclose(planes["detection_probability"], want, atol=1e-6)


def test_a_point_north_of_another_is_drawn_above_it() -> None:
    catalog = catalogs.catalog(9)
    found = report.claim_map(*given(catalog))
    assert found is not None
    by_latitude = sorted(found["points"], key=lambda point: point[2])
    assert by_latitude[0][4] > by_latitude[-1][4]
    # the meridians of 26 N converge northward: north leans west (left) east of the centre
    turns = np.array([[point[1] - catalogs.CENTER[0], point[6]] for point in found["points"]])
    expected = -turns[:, 0] * np.sin(np.radians(26.0))
    np.testing.assert_allclose(turns[:, 1], expected, atol=0.06)


def test_the_section_is_there_with_claims_only() -> None:
    html = report.render_report(catalogs.catalog(20), "c.h5")
    page = parsed(html)
    assert {"chooser", "numbers", "dots", "sky", "found", "outcome"} <= set(page.ids)
    (text,) = re.findall(r"<script type='application/json' id='numbers'>(.*?)</script>", html)
    assert len(json.loads(text)["points"]) == 20
    assert (
        len(re.findall(r'data-sun="\d+"', html)) == Statistics.of(catalogs.catalog(20)).suns.sum()
    )
    assert "<noscript>" in html
    assert not re.search(r"url\(|@import|https?://|//cdn|<link|<iframe", html)
    empty = catalogs.catalog(0)
    assert not {"chooser", "numbers"} & set(parsed(report.render_report(empty, "c.h5")).ids)
    assert report.claim_map(*given(empty)) is None


def test_the_page_holds_coverage_and_heights() -> None:
    catalog = catalogs.catalog(20)
    found = report.claim_map(*given(catalog))
    assert found is not None
    suns = np.array(found["suns"])
    cells, near = found["cells"], catalog.coverage.usable
    assert near is not None
    near = near[:, :, suns[:, 0], suns[:, 1]]
    assert cells["of"] == len(near) == len(cells["x"])
    bits = np.unpackbits(np.frombuffer(unpacked(cells["data"]), np.uint8).reshape(len(near), -1), axis=1)  # fmt: skip
    count = near[0].size
    np.testing.assert_array_equal(bits[:, :count].reshape(near.shape), near == 1)
    np.testing.assert_array_equal(cells["known"], (near != 255).any(axis=0))
    unknown = dataclasses.replace(
        catalog, coverage=dataclasses.replace(catalog.coverage, usable=None)
    )
    without = report.claim_map(*given(unknown))
    assert without is not None
    assert (without["cells"]["x"], without["cells"]["of"]) == ([], 0)
    north = dataclasses.replace(
        catalog.coverage, latitude=np.full(len(near), 80.0), usable=np.zeros_like(catalog.coverage.usable)
    )  # fmt: skip
    polar = report.claim_map(*given(dataclasses.replace(catalog, coverage=north)))
    assert polar is not None
    bits = np.unpackbits(np.frombuffer(unpacked(polar["cells"]["data"]), np.uint8).reshape(len(near), -1), axis=1)  # fmt: skip
    no_hole = bits[:, :count].reshape(near.shape)
    elevation = catalog.sun_elevation[suns[:, 0]]
    assert no_hole[..., elevation >= 20.0].all()  # the Sun rises to 11.8 deg there
    assert not no_hole[..., elevation <= 10.0].all()
    patches = found["patches"]
    z = np.frombuffer(unpacked(patches["data"]), "<i2").reshape(
        -1, patches["side"], patches["side"]
    )
    assert patches["of"] == list(range(20))
    np.testing.assert_allclose(z * patches["step_m"], catalog.dem, atol=patches["step_m"])


@pytest.mark.slow
@in_browser
@pytest.mark.parametrize(("view", "sun", "scale"), [(0, 0, 0), (1, 3, 0), (2, 5, 1)])
def test_the_script_counts_as_the_catalogue_does(
    tmp_path: Path, view: int, sun: int, scale: int
) -> None:
    """In a browser: usable points, and cells without one, for a choice of view, Sun and image scale."""
    catalog = catalogs.catalog(60)
    suns = np.argwhere(Statistics.of(catalog).suns)
    e, a = suns[sun * len(suns) // 6]
    script = f"""<script>const waiting = setInterval(() => {{
      if (document.getElementById('chooser').hidden) return;
      clearInterval(waiting);
      const form = document.getElementById('choices').elements;
      for (const [name, value] of [['view', {view}], ['scale', {scale}]]) {{
        form[name].value = value;
        form[name].dispatchEvent(new Event('change'));
      }}
      document.querySelectorAll('#sky use')[{sun * len(suns) // 6}].dispatchEvent(new Event('click'));
      const words = id => document.getElementById(id).textContent;
      requestAnimationFrame(() => setTimeout(() => console.log('said', words('outcome'), words('holes')), 0));
    }}, 20)</script></body>"""
    page = tmp_path / "page.html"
    page.write_text(report.render_report(catalog, "c.h5").replace("</body>", script))
    shown = logged(page, "said", tmp_path)
    flags, chance = catalog.condition[:, view, e, a], catalog.detection_probability[:, scale, view, e, a]  # fmt: skip
    seen = (flags & 1 > 0) & np.isfinite(chance)
    works = flags == 31 if scale == 0 else (flags & 25 == 25) & (chance >= catalog.min_detection)
    assert f"{(works & seen).sum()} of {seen.sum()} points are usable" in shown
    near = catalog.coverage.usable
    assert near is not None
    without = (near[:, view, e, a] != 1).sum()
    assert f"{without} of {len(near)} spacing cells have no usable point within" in shown


def test_figures_by_sun_elevation_are_counts() -> None:
    catalog = catalogs.catalog(20)
    rows = summary(catalog)["usable_by_sun_elevation"]
    assert len(rows) >= 6
    for row in rows:
        e = catalog.sun_elevation.tolist().index(row["sun_elevation_deg"])
        flags = catalog.condition[:, :, e].reshape(20, -1)
        known, works = (flags & 1) > 0, flags == 31
        assert row["usable_share"] == pytest.approx(works.sum() / known.sum())
        assert row["points_evaluated"] == sum(bool(k.any()) for k in known)
        assert row["points_usable"] == sum(bool(w.any()) for w in works)
        always = sum(bool(k.any() and (w == k).all()) for w, k in zip(works, known, strict=True))
        assert row["points_always_usable"] == always
