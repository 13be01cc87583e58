"""Landmark files of other programs, read by readers of their own."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from helpers import catalogs
from helpers.landmark_readers import (
    lvs_node,
    read_lvs_map,
    read_spc_landmark,
    read_spc_maplet,
    spc_node,
)

from lcp_catalog.exports.dsk import write_dsk
from lcp_catalog.exports.frames import frame_named
from lcp_catalog.exports.landmarks import reflectance, write_landmark_maps, write_spc
from lcp_catalog.exports.points import ExportedPoints
from lcp_catalog.geometry.bounds import Bounds
from lcp_catalog.geometry.frames import direction_enu, enu_rotation, lonlat_to_mcmf

PATCH = 9
HALF = PATCH // 2
PLACES = [(0, 0), (-HALF, -HALF), (-HALF, HALF), (HALF, -HALF), (HALF, HALF), (1, -2)]
"""Nodes as (patch_row, patch_col): the centre, the corners, and one that is not symmetric."""


@pytest.fixture(scope="module", params=["MOON_ME", "MOON_PA"])
def points(request) -> ExportedPoints:
    return ExportedPoints.chosen(catalogs.catalog(7, PATCH), frame_named(request.param))


def node(points: ExportedPoints, k: int, row: int, col: int) -> np.ndarray:
    """Position of a node by the formula of the format's page, in the frame."""
    catalog = points.catalog
    own = [col * catalogs.GSD_M, -row * catalogs.GSD_M, catalog.dem[k, row + HALF, col + HALF]]
    place = catalog.position_mcmf[k] + catalog.rotation_mcmf_to_enu[k].T @ np.array(own)
    return points.frame.from_me @ place


def test_lvs_maps(points: ExportedPoints, tmp_path: Path) -> None:
    write_landmark_maps(points, tmp_path)
    assert len(list(tmp_path.glob("*.lmk"))) == 7
    for k, point_id in enumerate(points.catalog.point_id):
        lmk = read_lvs_map(tmp_path / f"{point_id}.lmk")
        assert lmk["version"] == b"#! LVS Map v3.0".ljust(32, b"\0")
        assert lmk["id"] == f"{point_id} {points.frame.name}"
        assert lmk["body"] == 1
        np.testing.assert_array_equal(lmk["height_m"], points.catalog.dem[k])
        assert (lmk["reflectance"] == 100).all()
        for row, col in PLACES:
            found = lvs_node(lmk, col + HALF, row + HALF)
            np.testing.assert_allclose(found, node(points, k, row, col), rtol=0, atol=1e-6)
    with (tmp_path / "points.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["point_id"]) for row in rows] == points.catalog.point_id.tolist()


def test_reflectance_is_written_as_it_is_computed(points: ExportedPoints, tmp_path: Path) -> None:
    write_landmark_maps(points, tmp_path, (90.0, 10.0))
    lmk = read_lvs_map(tmp_path / f"{points.catalog.point_id[0]}.lmk")
    dem = points.catalog.dem[0]
    expected = reflectance(dem, catalogs.GSD_M, direction_enu(90.0, 10.0), None)
    np.testing.assert_array_equal(lmk["reflectance"], expected)
    assert lmk["reflectance"].max() == 255


def test_a_wall_throws_its_shadow_away_from_the_sun() -> None:
    """A wall of 100 m under a Sun 45 deg high in the west: dark to 100 m in the east, level beyond."""
    dem = np.zeros((21, 21), np.float32)
    dem[:, 5] = 100.0
    seen = reflectance(dem, 20.0, direction_enu(270.0, 45.0), None)[10]
    assert (seen[6:10] == 0).all()
    level = seen[11:]
    assert (level == level[0]).all()
    assert 0 < level[0] < seen[4] == 255  # the slope before the wall faces the Sun
    half = reflectance(
        dem, 20.0, direction_enu(270.0, 45.0), np.where(np.arange(21) < 15, 1.0, 0.5)
    )
    assert half[10, 18] == pytest.approx(level[0] / 2.0, abs=1.0)


def test_spc_landmarks_and_maplets(points: ExportedPoints, tmp_path: Path) -> None:
    write_spc(points, tmp_path)
    with (tmp_path / "points.csv").open(newline="") as file:
        names = {int(row["point_id"]): row["name"] for row in csv.DictReader(file)}
    assert len(set(names.values())) == 7
    for k, point_id in enumerate(points.catalog.point_id):
        lmk = read_spc_landmark(tmp_path / "LMKFILES" / f"{names[int(point_id)]}.LMK")
        assert lmk["name"] == names[int(point_id)]
        assert lmk["half"] == HALF
        assert lmk["labels"] == ["VLM", "UX", "UY", "UZ", "SIGMA_LMK"]
        assert points.frame.name in lmk["last"]
        np.testing.assert_allclose(1e3 * lmk["position_km"], points.position_m[k], atol=1e-3)
        assert np.linalg.det(lmk["axes"]) == pytest.approx(1.0, abs=1e-9)
        maplet = read_spc_maplet(tmp_path / "MAPFILES" / f"{names[int(point_id)]}.MAP")
        assert maplet["frame"] == points.frame.name.replace("_", "")
        np.testing.assert_allclose(maplet["axes"], lmk["axes"], atol=1e-7)
        assert (maplet["albedo"] == 1.0).all()
        heights_m = 1e3 * maplet["scale_km"] * maplet["height_cells"]
        step_m = (
            max(1.0, np.abs(points.catalog.dem[k]).max() / catalogs.GSD_M) / 3e4 * catalogs.GSD_M
        )
        assert np.abs(heights_m - points.catalog.dem[k]).max() < 0.51 * step_m
        for row, col in PLACES:  # UX is south, UY east; places are float32 kilometres
            found = 1e3 * spc_node(maplet, row, col)
            np.testing.assert_allclose(found, node(points, k, row, col), rtol=0, atol=0.2)


def test_spc_sigmas_are_along_the_axes_of_the_frame(tmp_path: Path) -> None:
    """25 m along east and north, 20 m along up; an unknown sigma counts as 0."""
    stated = catalogs.ERRORS | {"position_sigma_m": 25.0}
    catalog = catalogs.catalog(4, PATCH, errors=stated)
    write_spc(ExportedPoints.chosen(catalog, frame_named("MOON_ME")), tmp_path)
    own = np.diag([25.0**2, 25.0**2, 20.0**2])
    turn = catalog.rotation_mcmf_to_enu[1]
    expected = np.sqrt(np.diag(turn.T @ own @ turn))
    lmk = read_spc_landmark(tmp_path / "LMKFILES" / "P00001.LMK")
    np.testing.assert_allclose(1e3 * lmk["sigma_km"], expected, rtol=1e-6)
    maplet = read_spc_maplet(tmp_path / "MAPFILES" / "P00001.MAP")
    found = 1e3 * maplet["sigma_km"] * maplet["sigma_share"]
    np.testing.assert_allclose(found, expected, atol=0.1)


def test_missing_heights_are_missing(tmp_path: Path) -> None:
    """Nodes without a height are NaN in a landmark map, height and albedo 0 in a maplet."""
    from lcp_catalog.exports import landmarks

    catalog = catalogs.catalog(2, PATCH)
    found = ExportedPoints.chosen(catalog, frame_named("MOON_ME"))
    dem = catalog.dem[0].copy()
    dem[0, 3] = np.nan
    content = landmarks._maplet(found, 0, np.eye(3), np.zeros(3), dem, None)
    (tmp_path / "a.MAP").write_bytes(content)
    maplet = read_spc_maplet(tmp_path / "a.MAP")
    assert np.argwhere(maplet["albedo"] == 0.0).tolist() == [[0, 3]]
    assert maplet["height_cells"][0, 3] == 0.0


@pytest.mark.slow
def test_rays_of_spice_meet_the_patches(points: ExportedPoints, tmp_path: Path) -> None:
    """Rays from 100 km above hit the nodes, and between the nodes of a cell its triangles."""
    path = tmp_path / "site.bds"
    write_dsk(points, path)
    handle = spiceypy.dasopr(str(path))
    try:
        segment = spiceypy.dlabfs(handle)
        about = spiceypy.dskgd(handle, segment)
        assert (about.center, about.surfce, about.dtype) == (301, 1, 2)
        assert about.frmcde == {"MOON_ME": 31007, "MOON_PA": 31008}[points.frame.name]
        count, plates = spiceypy.dskz02(handle, segment)
        assert (count, plates) == (7 * PATCH**2, 7 * 2 * (PATCH - 1) ** 2)
        for k in range(7):
            up = 1e-3 * points.rotation[k][2]
            for row, col in PLACES[:1] + PLACES[5:]:
                wanted = 1e-3 * node(points, k, row, col)
                _assert_hit(handle, segment, wanted, up)
            edge = ((-HALF, -HALF), (-HALF, 1 - HALF), (1 - HALF, 1 - HALF))
            corner = [1e-3 * node(points, k, *place) for place in edge]
            _assert_hit(handle, segment, np.average(corner, axis=0, weights=(0.98, 0.01, 0.01)), up)
            cell = [1e-3 * node(points, k, row, col) for row, col in ((2, 1), (3, 1), (3, 2))]
            _assert_hit(handle, segment, np.mean(cell, axis=0), up)
    finally:
        spiceypy.dascls(handle)


def _assert_hit(handle, segment, wanted_km: np.ndarray, up: np.ndarray) -> None:
    start = wanted_km + 100.0 * up / np.linalg.norm(up)
    _, found, hit = spiceypy.dskx02(handle, segment, start, -up)
    assert hit
    assert np.linalg.norm(found - wanted_km) < 1e-6  # a millimetre


@pytest.mark.slow
def test_a_site_around_a_pole_is_a_shape_kernel(tmp_path: Path) -> None:
    """SPICE refuses a segment wider than a full turn. Rays hit the nodes on both sides of the antimeridian."""
    lon, lat = np.arange(7) * 50.0, np.full(7, -89.5)
    axes = np.array([enu_rotation(*place) for place in zip(lon, lat, strict=True)])
    places = {
        "longitude": lon,
        "latitude": lat,
        "elevation": np.zeros(7),
        "rotation_mcmf_to_enu": axes,
    }
    site = catalogs.catalog(7, PATCH, position_mcmf=lonlat_to_mcmf(lon, lat, np.zeros(7)), **places)
    points = ExportedPoints.chosen(site, frame_named("MOON_ME"))
    write_dsk(points, tmp_path / "pole.bds")
    handle = spiceypy.dasopr(str(tmp_path / "pole.bds"))
    try:
        segment = spiceypy.dlabfs(handle)
        about = spiceypy.dskgd(handle, segment)
        assert about.co1min == pytest.approx(-np.pi, abs=1e-9)
        assert about.co1max == pytest.approx(np.pi, abs=1e-9)
        assert about.co2min == pytest.approx(-np.pi / 2.0)
        for k in range(7):
            _assert_hit(handle, segment, 1e-3 * node(points, k, 1, -2), 1e-3 * axes[k][2])
    finally:
        spiceypy.dascls(handle)


@pytest.mark.slow
def test_plates_face_outwards_and_the_pool_stays_clean(
    points: ExportedPoints, tmp_path: Path
) -> None:
    write_dsk(points, tmp_path / "site.bds")
    assert spiceypy.namfrm(points.frame.spice_name) == 0
    handle = spiceypy.dasopr(str(tmp_path / "site.bds"))
    try:
        segment = spiceypy.dlabfs(handle)
        vertices = spiceypy.dskv02(handle, segment, 1, 7 * PATCH**2)
        plates = spiceypy.dskp02(handle, segment, 1, 7 * 2 * (PATCH - 1) ** 2)
    finally:
        spiceypy.dascls(handle)
    a, b, c = np.moveaxis(vertices[plates - 1], 1, 0)
    assert (np.einsum("ni,ni->n", np.cross(b - a, c - a), a) > 0.0).all()


@pytest.mark.slow
def test_too_many_plates_need_a_box(points: ExportedPoints, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("lcp_catalog.exports.dsk.PLATES_MAX", 100)
    with pytest.raises(ValueError, match=r"896 plates are too many for a site .*`bounds`"):
        write_dsk(points, tmp_path / "site.bds")
    write_dsk(dataclasses.replace(points, box=Bounds(-180, -90, 180, 90)), tmp_path / "site.bds")


def test_spc_has_no_more_names_than_its_six_characters(points: ExportedPoints, tmp_path: Path, monkeypatch) -> None:  # fmt: skip
    monkeypatch.setattr("lcp_catalog.exports.landmarks._NAMES", 6)
    with pytest.raises(OSError, match="6 landmarks at most"):
        write_spc(points, tmp_path)
