"""The flight file: read by a reader of its own, byte by byte as on its page, and damaged."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catalogs
from lcp_cli.main import run

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.prediction import view_plane
from lcp_catalog.catalog.schema import usable
from lcp_catalog.errors import AreaError, CatalogError, ConfigError
from lcp_catalog.exports.export import export
from lcp_catalog.exports.flight import FlightFile, KeptConditions, point_type, stored, tables_type
from lcp_catalog.exports.frames import frame_named

COUNT = 150


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    content = catalogs.arrays(COUNT)
    brightness = np.random.default_rng(5).uniform(0.6, 1.5, content["dem"].shape)
    brightness[3] = np.nan
    return Catalog(**content | {"albedo": brightness, "albedo_map": catalogs.ALBEDO_MAP})


@pytest.fixture(scope="module")
def site(catalog: Catalog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "site.lcpf"
    assert export(catalog, path) == COUNT
    return path


def read(path: Path) -> dict[str, Any]:
    """The file by the offsets of its page, without the library."""
    b = path.read_bytes()

    def at(kind: str, place: int) -> Any:
        return struct.unpack_from("<" + kind, b, place)[0]

    def row(kind: str, place: int, count: int) -> np.ndarray:
        return np.array(struct.unpack_from(f"<{count}{kind}", b, place))

    assert b[:8] == b"LCPF\r\n\x1a\n"
    assert at("Q", 16) == len(b)
    assert at("I", 188) == zlib.crc32(b[:188])
    n, tiles, stride = at("I", 24), at("I", 28), at("I", 32)
    p, s, u, v, e, a, frame, albedo = (int(x) for x in row("H", 36, 8))
    names = {"elevation": e, "azimuth": a, "off": v, "view_azimuth": v, "altitude": v, "scale": s}
    out: dict[str, Any] = {"frame": frame, "stride": stride}
    place = 192
    for name, count in names.items():
        out[name] = row("f", place, count)
        place += 4 * count
    out["number"] = row("H", place, e * a).reshape(e, a)
    place += 2 * e * a
    out["triangles"] = row("B", place, 3 * at("H", 132)).reshape(-1, 3)
    out["errors"] = row("f", 136, 2)
    place += 3 * at("H", 132)
    place += -(place - 192) % 8
    assert at("I", 52) == zlib.crc32(b[192:place])
    assert at("I", 56) == zlib.crc32(b[place : place + 40 * tiles])
    index, place = place, place + 40 * tiles
    step, least = at("f", 68), at("d", 72)
    log = at("d", 80)
    out["worst_m"], points = at("f", 60), []
    for t in range(tiles):
        centre, radius = row("d", index + 40 * t, 3), at("f", index + 40 * t + 24)
        first, count, crc = (at("I", index + 40 * t + k) for k in (28, 32, 36))
        block = b[place + first * stride : place + (first + count) * stride]
        assert zlib.crc32(block) == crc
        for k in range(first, first + count):
            q = place + k * stride
            one: dict[str, Any] = {"id": at("q", q), "position": row("d", q + 8, 3)}
            assert np.linalg.norm(one["position"] - centre) <= radius
            one["rotation"] = row("f", q + 32, 9).reshape(3, 3)
            one["gsd"], middle, up = at("f", q + 68), at("f", q + 72), at("f", q + 76)
            one["height"] = middle + up * row("h", q + 96, p * p).reshape(p, p)
            q2 = q + 96 + 2 * p * p
            if albedo:
                number = row("b", q2, p * p).reshape(p, p)
                one["albedo"] = at("f", q + 80) + at("f", q + 84) * number
                q2 += p * p
            claims = row("B", q2, 4 * s * u * v).reshape(s, u, v, 4)
            none = claims == 255
            one["probability"] = np.where(none[..., 0], np.nan, claims[..., 0] * step)
            one["sigma"] = np.where(none, np.nan, np.exp(least + log * claims))[..., 1:3]
            one["angle"] = claims[..., 3] % 128 * 180.0 / 128.0
            one["free"] = claims[..., 3] < 128
            points.append(one)
    assert len(points) == n
    assert place + n * stride == len(b)
    return out | {"points": {one["id"]: one for one in points}, "sigma_step": log}


def test_it_says_what_the_catalogue_says(catalog: Catalog, site: Path) -> None:
    found = read(site)
    where = found["number"]
    assert len(found["points"]) == COUNT
    np.testing.assert_allclose(found["elevation"], catalog.sun_elevation)
    np.testing.assert_allclose(found["altitude"], catalog.view_altitude)
    known = (catalog.condition & 1).any(axis=(0, 1)) > 0
    np.testing.assert_array_equal(where != 65535, known)
    views = view_plane(catalog.view_off_nadir, catalog.view_azimuth)[found["triangles"]]
    assert views.shape == (2, 3, 2)  # one view straight down, a segment to two at 100 km
    np.testing.assert_allclose(found["errors"], [0.05, 20.0 / 600.0])
    works = usable(catalog.condition)
    worst = 0.0
    for k, point_id in enumerate(catalog.point_id.tolist()):
        one = found["points"][point_id]
        np.testing.assert_array_equal(one["position"], catalog.position_mcmf[k])
        np.testing.assert_allclose(one["rotation"], catalog.rotation_mcmf_to_enu[k], atol=6e-8)
        worst = max(worst, np.abs(one["height"] - catalog.dem[k]).max())
        assert worst <= found["worst_m"] * (1.0 + 1e-6)
        tenth = np.nanmin(catalog.elevation_sigma) / 10.0
        assert worst < tenth
        albedo = np.nan_to_num(catalog.albedo[k], nan=1.0)
        np.testing.assert_allclose(one["albedo"], albedo, atol=np.ptp(albedo) / 507)
        probability = np.moveaxis(catalog.detection_probability[k][..., known], 1, 2)
        np.testing.assert_allclose(one["probability"], probability, atol=1e-6)
        there = np.isfinite(probability)
        for axis, name in enumerate(("sigma_major", "sigma_minor")):
            sigma = np.moveaxis(getattr(catalog, name)[k][..., known], 1, 2)
            off = np.log(one["sigma"][..., axis] / sigma)[there]
            assert np.abs(off).max() <= 0.501 * found["sigma_step"]
        angle = np.moveaxis(catalog.sigma_angle[k][..., known], 1, 2)
        turned = np.abs((one["angle"] - angle + 90.0) % 180.0 - 90.0)[there]
        assert turned.max() <= 90.0 / 128.0 + 1e-9
        good = (probability[0] >= catalog.min_detection - 0.002) & one["free"][0]
        np.testing.assert_array_equal(good, np.moveaxis(works[k][..., known], 0, 1))


def test_the_library_reads_the_same(catalog: Catalog, site: Path) -> None:
    ours, twin = FlightFile.of(site), read(site)
    for k, point_id in enumerate(ours.points["point_id"].tolist()):
        one = twin["points"][point_id]
        np.testing.assert_array_equal(stored(ours.points, "heights")[k], one["height"])
        np.testing.assert_allclose(stored(ours.points, "albedo")[k], one["albedo"], rtol=1e-12)
        np.testing.assert_allclose(ours.detection_probability[k], one["probability"], atol=1e-7)
        np.testing.assert_allclose(ours.sigma_m[k], one["sigma"])
    share = usable(catalog.condition).sum() / (catalog.condition & 1).sum()
    assert ours.usable[:, 0].sum() / np.isfinite(ours.detection_probability[:, 0]).sum() == share


def test_one_scale_and_another_frame(catalog: Catalog, tmp_path: Path) -> None:
    path = tmp_path / "one.lcpf"
    export(catalog, path, frame="MOON_PA", image_scale=2.0)
    found = read(path)
    assert (found["frame"], found["scale"].tolist()) == (1, [2.0])
    turn = frame_named("MOON_PA").from_me
    one = found["points"][int(catalog.point_id[7])]
    np.testing.assert_allclose(one["position"], turn @ catalog.position_mcmf[7], atol=1e-6)
    known = found["number"] != 65535
    expected = np.moveaxis(catalog.detection_probability[7, 1][..., known], 0, 1)
    np.testing.assert_allclose(one["probability"][0], expected, atol=1e-6)
    with pytest.raises(ConfigError, match="`image_scale` 3 is not one of the catalogue's: 1, 2, 4"):
        export(catalog, path, image_scale=3.0, overwrite=True)
    with pytest.raises(ConfigError, match=r"for \.lcpf files only"):
        export(catalog, tmp_path / "a.csv", image_scale=2.0)


def test_some_conditions(catalog: Catalog, site: Path, tmp_path: Path) -> None:
    every = read(site)
    common = np.isfinite(catalog.detection_probability[:9, 0, ::2]).all(axis=(0, 1))
    suns = np.zeros_like(common)
    suns.flat[np.flatnonzero(common)[[0, 3, 8]]] = True
    views = np.array([True, False, True])
    path = tmp_path / "few.lcpf"
    assert export(catalog, path, conditions=KeptConditions(np.arange(9), views, suns)) == 9
    few = read(path)
    assert few["off"].tolist() == [0.0, 30.0]
    assert (few["number"] != 65535).sum() == 3
    for point_id, one in few["points"].items():
        whole = every["points"][point_id]["probability"][:, every["number"][suns]][:, :, views]
        np.testing.assert_array_equal(one["probability"], whole)
    with pytest.raises(AreaError, match="no point has a claim"):
        export(
            catalog,
            path,
            conditions=KeptConditions(np.arange(9), views, ~suns & suns),
            overwrite=True,
        )


@pytest.mark.parametrize(
    ("scales", "albedo", "most"), [(1, 0, 3100), (3, 0, 4600), (1, 1, 4200), (3, 1, 5700)]
)
def test_a_point_takes_no_more_than_promised(scales: int, albedo: int, most: int) -> None:
    """33 x 33 nodes, 5 views, 38 Suns of 8 x 24; 150 points in 4 tiles."""
    sizes = {"nodes": 33, "albedo": albedo, "scales": scales, "suns": 38, "views": 5}
    sizes |= {"elevations": 8, "azimuths": 24, "triangles": 4}
    whole = 192 + tables_type(sizes).itemsize + 4 * 40 + COUNT * point_type(sizes).itemsize
    assert whole / COUNT <= most


@pytest.mark.parametrize("place", [0, 9, 100, 190, 200, 700, 5000, -1])
def test_a_wrong_byte_is_found(place: int, site: Path, tmp_path: Path, capsys) -> None:
    content = bytearray(site.read_bytes())
    content[place] ^= 8
    path = tmp_path / "x.lcpf"
    path.write_bytes(content)
    with pytest.raises(CatalogError, match=r"x\.lcpf: .*; export it again"):
        FlightFile.of(path)
    assert run(["inspect", str(path), "--json"]) == 4
    found = json.loads(capsys.readouterr().out)
    assert not found["intact"]
    assert len(found["problems"]) == 1


@pytest.mark.parametrize("length", [0, 5, 100, 192, 900, 20_000])
def test_a_cut_file_is_found(length: int, site: Path, tmp_path: Path, capsys) -> None:
    path = tmp_path / "x.lcpf"
    path.write_bytes(site.read_bytes()[:length])
    assert run(["inspect", str(path)]) == 4
    assert "NOT INTACT" in capsys.readouterr().out


def test_inspect_shows_it(site: Path, capsys) -> None:
    assert run(["inspect", str(site)]) == 0
    text = capsys.readouterr().out
    assert f"{site}: intact" in text
    assert "150 in 4 tiles, MOON_ME" in text
    assert run(["inspect", str(site), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["points"] == COUNT
    assert found["bytes"] == site.stat().st_size
    assert 1.0 < found["bounds"]["west"] < found["bounds"]["east"] < 6.0
    assert run(["inspect", str(site.with_name("none.lcpf"))]) == 1
