"""Images of line scanners and push-frame cameras: rays by a second reading of the ISD and brute force
over all triangles, frame cameras that see the same, the Sun of each line's time, orthoimages.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.renders import rolling, write_dem
from helpers.scan_files import CENTRE_ET, scan
from helpers.twins_isd import TwinIsd

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.camera_file import read_sensor
from lcp_catalog.cameras.frame_camera import Camera, fields_of_plane
from lcp_catalog.cameras.scanners import PushFrame
from lcp_catalog.cameras.trajectory import Attitude, Track
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.ephemeris.solar_position import sun_direction_at
from lcp_catalog.errors import CameraError
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.images.image import Image
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.pipeline import SUN_MOVES_DEG, prepare, prepare_terrain
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.terrain.area import Area
from lcp_catalog.terrain.relief_bounds import nodes_enu
from lcp_catalog.validation.orthoimage import orthorectify

KINDS = ["LINE_SCANNER", "PUSH_FRAME"]
LAW = reflectance_model("lommel-seeliger")
HOW = {"accuracy": TIERS["reference"], "disc": False, "model": LAW, "surface": "heightfield"}


@pytest.fixture(scope="module")
def dem(tmp_path_factory) -> str:
    return write_dem(tmp_path_factory.mktemp("dem") / "hills.tif", rolling(256, 256), 30.0, 11.0)


def request(dem, path: Path, plane: bool = True, **changes) -> Request:
    view = ViewChoice(read_sensor(path))
    return Request(DemSet.open([dem]), view=view, in_camera_plane=plane, **(HOW | changes))


def first_hit(field, origin, ray) -> float:
    """Range of the first of all triangles that a ray meets (Moeller and Trumbore), inf without one."""
    rows, cols = field.shape
    y, x = np.meshgrid(
        field.y0_m - field.gsd_m * np.arange(rows),
        field.x0_m + field.gsd_m * np.arange(cols),
        indexing="ij",
    )
    nodes = np.stack([x, y, field.z_m.astype(float)], -1)
    nw, ne, sw, se = nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, :-1], nodes[1:, 1:]
    best = np.inf
    for a, b, c in ((nw, ne, se), (nw, sw, se)):
        one, two, off = b - a, c - a, origin - a
        p = np.cross(ray, two)
        scale = np.sum(one * p, -1)
        u = np.sum(off * p, -1) / scale
        q = np.cross(off, one)
        v = q @ ray / scale
        meets = (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1.0 + 1e-12)
        best = min(best, np.where(meets, np.sum(two * q, -1) / scale, np.inf).min())
    return best


@pytest.mark.parametrize("kind", KINDS)
def test_pixels_show_what_their_own_rays_meet(dem, tmp_path, kind):
    path = scan(tmp_path / "scan.json", kind)
    scene = prepare_terrain(request(dem, path))
    shot, twin, frame = scene.expose(), TwinIsd(path), scene.frame
    assert shot.visible.all()
    assert shot.radiance.shape == (60, 80)
    sun = frame.direction_from_mcmf(
        shot.position_mcmf_m[0, 0] * 0 + scene.request.view.sensor.sun_position_mcmf_m
    )
    rng = np.random.default_rng(3)
    for row, col in rng.integers([60, 80], size=(12, 2)):
        origin, ray = twin.ray(row + 0.5, col + 0.5)
        origin, ray = frame.from_mcmf(origin), frame.direction_from_mcmf(ray)
        point = origin + first_hit(scene.terrain.field, origin, ray) * ray
        found = frame.from_mcmf(shot.position_mcmf_m[row, col])
        assert np.abs(found - point).max() < 1e-3
        phase = np.degrees(np.arccos(-ray @ sun / np.linalg.norm(sun)))
        assert shot.phase_deg[row, col] == pytest.approx(phase, abs=1e-3)
        normal = scene.terrain.field.normals_at(*point[:2])
        assert shot.emission_deg[row, col] == pytest.approx(
            np.degrees(np.arccos(-normal @ ray)), abs=1e-4
        )


def test_hits_of_lines_are_those_of_cameras_at_their_positions(dem, tmp_path):
    """Line by line the same to the last bit; rays without a position or direction hit nothing."""
    path = scan(tmp_path / "scan.json")
    field = prepare_terrain(request(dem, path)).terrain.field
    origins, rays = read_sensor(path).rays_enu(EnuFrame(30.5, 10.5))
    rays[3, 5], rays[4], origins[5] = np.nan, -rays[4], np.nan
    found = field.first_hits_of_lines(origins, rays)
    for row in (0, 3, 4, 31, 59):
        np.testing.assert_array_equal(found[row], field.first_hits(origins[row], rays[row]))
    assert np.isnan(found[3, 5])
    assert np.isnan(found[4:6]).all()
    assert np.isnan(found).sum() == 1 + 2 * 80


def still(scanner):
    """The scanner without any motion: it stays where it is at time 0."""
    now, path = np.zeros(1), scanner.trajectory
    here = replace(
        path,
        track=Track(now, path.track.at(now)),
        body=Attitude(now, path.body.at(now)),
        pointing=Attitude(now, path.pointing.at(now)),
    )
    return replace(scanner, trajectory=here)


def frame_camera(scanner, shape):
    now = np.zeros(3)
    return Camera(
        **fields_of_plane(scanner.plane),
        position_mcmf_m=scanner.trajectory.positions(now)[0],
        rotation_mcmf_to_camera=scanner.trajectory.to_mcmf(now, np.eye(3)),
        image_size_px=shape[::-1],
        sun_position_mcmf_m=scanner.sun_position_mcmf_m,
        time_utc=scanner.time_utc,
    )


def test_a_scanner_with_one_position_is_a_frame_camera(dem, tmp_path):
    """Every framelet shows the frame, every line the frame's row at the line of the detector."""
    frames = still(read_sensor(scan(tmp_path / "f.json", "PUSH_FRAME")))
    lines = still(read_sensor(scan(tmp_path / "l.json")))
    lines = replace(lines, line_px=5.0)
    scene = prepare_terrain(replace(request(dem, tmp_path / "l.json"), view=ViewChoice(frames)))
    for scanner, repeat in ((frames, np.arange(60) % 12), (lines, np.full(60, 5))):
        camera = frame_camera(scanner, (12, 80))
        whole, scanned = scene.picture(camera), scene.picture(scanner)
        for band in ("radiance", "sunlit", "emission_deg", "phase_deg", "position_mcmf_m"):
            expected = getattr(whole, band)[repeat]
            np.testing.assert_allclose(getattr(scanned, band), expected, rtol=1e-12, atol=1e-5)
        assert np.isfinite(scanned.radiance).all()


@pytest.mark.parametrize("kind", KINDS)
def test_the_orthoimage_of_a_picture_is_the_picture_of_the_nodes(dem, tmp_path, kind):
    """The rendered image, mapped to the nodes by the sensor, against the render at the nodes."""
    path = scan(tmp_path / "scan.json", kind, shape=(120, 160), pixel_m=50.0)
    plane = prepare_terrain(request(dem, path)).expose()
    scene = prepare_terrain(request(dem, path, plane=False))
    nodes = scene.expose()
    sensor, whole = read_sensor(path), np.ones(plane.radiance.shape, "f4")
    photo = Image("shot", plane.radiance.astype("f4"), whole, sensor, sensor.sun_position_mcmf_m)
    points = scene.frame.to_mcmf(nodes_enu(scene.terrain.field, scene.terrain.core))
    ortho = orthorectify(photo, points, nodes.visible)
    inside = (ortho.weight > 0.99) & nodes.visible
    assert inside.sum() > 1500
    off = np.abs(ortho.signal - nodes.radiance)[inside] / np.nanmean(nodes.radiance)
    assert np.median(off) < 0.006
    assert np.corrcoef(ortho.signal[inside], nodes.radiance[inside])[0, 1] > 0.999
    both = inside[:, 1:] & nodes.visible[:, :-1]
    shifted = np.corrcoef(ortho.signal[:, 1:][both], nodes.radiance[:, :-1][both])[0, 1]
    assert shifted < 0.96


@pytest.mark.parametrize("kind", KINDS)
def test_every_line_has_the_sun_of_its_time(dem, tmp_path, kind):
    """A flight of an hour, in which the Sun moves by half a degree; the file's own Sun is moved as the
    Sun of the ephemeris.
    """
    path = scan(tmp_path / "scan.json", kind, lasts_s=3600.0)
    scene = prepare_terrain(request(dem, path, sun=SunChoice(time_utc="2024-03-18T12:00:00")))
    shot, twin = scene.expose(), TwinIsd(path)
    for row in (0, 17, 42, 59):
        _, ray = twin.ray(row + 0.5, 40.5)
        seconds = (
            twin.line_time(row + 0.5) if kind == "LINE_SCANNER" else twin.framelet_time(row // 12)
        )
        moment = np.datetime64("2024-03-18T12:00:00.000") + np.timedelta64(
            round(1e3 * seconds), "ms"
        )
        sun = sun_direction_at(str(moment))
        phase = np.degrees(np.arccos(-ray @ sun))
        assert shot.phase_deg[row, 40] == pytest.approx(phase, abs=1.1 * SUN_MOVES_DEG)
    motion = scene.plan.decisions[-1]
    assert (motion.effect, motion.modelled) == ("motion of the Sun", True)
    assert "the Sun moves by 0." in motion.reason


def test_colours_of_framelets_stay_with_their_rows(dem, tmp_path):
    class Red:
        def at_points(self, terrain, points):
            return np.multiply.outer([2.0, 1.0, 0.5], np.ones(len(points)))

    scene = prepare_terrain(request(dem, scan(tmp_path / "scan.json", "PUSH_FRAME")))
    plain = scene.expose().radiance
    shot = replace(scene, request=replace(scene.request, albedo=Red())).expose()
    for factor, band in zip((2.0, 1.0, 0.5), shot.colour, strict=True):
        np.testing.assert_allclose(band, factor * plain, rtol=1e-12)


def test_one_sun_is_enough_for_seconds(dem, tmp_path):
    path = scan(tmp_path / "scan.json")
    motion = prepare(request(dem, path)).plan.decisions[-1]
    assert not motion.modelled
    assert motion.error_bound == pytest.approx(2.0 * 1.41e-4, rel=0.05)  # 12.2 deg a day for 2 s
    angles = prepare(request(dem, path, sun=SunChoice(100.0, 30.0))).plan.decisions[-1]
    assert (angles.modelled, angles.error_bound) == (False, 0.0)


@pytest.mark.slow
def test_nodes_are_hidden_along_their_own_lines_of_sight(tmp_path):
    """A wide framelet over two walls, each a row of nodes: each hides ground on its far side, seen from
    a camera between them.
    """
    z = np.zeros((256, 256))
    z[:, [100, 156]] = 800.0
    dem = write_dem(tmp_path / "walls.tif", z, 30.0, 11.0)
    path = scan(tmp_path / "scan.json", "PUSH_FRAME", shape=(24, 300), pixel_m=60.0, altitude_m=6e3)
    scene = prepare_terrain(request(dem, path, plane=False, sun=SunChoice(0.0, 80.0)))
    seen, rows = scene.expose().visible, scene.terrain.core
    middle = seen[seen.shape[0] // 2]
    x = scene.corner_m[0] + scene.gsd_m * np.arange(len(middle))
    wall_m = 28.0 * scene.gsd_m * np.cos(np.radians(10.5))
    assert rows is not None
    far = {
        side: middle[(side * x > wall_m + 150.0) & (side * x < wall_m + 350.0)] for side in (-1, 1)
    }
    near = middle[np.abs(x) < wall_m - 300.0]
    assert near.all()
    assert not far[-1].any()
    assert not far[1].any()
    out = np.abs(nodes_enu(scene.terrain.field, scene.terrain.core)[..., 1]) > 2000.0
    assert not seen[out].any()


@pytest.mark.parametrize("kind", KINDS)
def test_only_nodes_in_the_image_are_visible(dem, tmp_path, kind):
    path = scan(tmp_path / "scan.json", kind)
    scene = prepare_terrain(request(dem, path, plane=False, area=Area(30.5, 10.5, 12.0)))
    seen, sensor = scene.expose().visible, read_sensor(path)
    points = scene.frame.to_mcmf(nodes_enu(scene.terrain.field, scene.terrain.core))
    inside = sensor.in_image(sensor.project(points))
    assert 0.2 < inside.mean() < 0.6
    np.testing.assert_array_equal(seen, inside)


def test_what_a_scanner_cannot_have_is_refused(dem, tmp_path):
    path = scan(tmp_path / "scan.json")
    with pytest.raises(CameraError, match="plain sphere"):
        prepare(request(dem, path, surface="sphere"))
    away = scan(tmp_path / "away.json", place=(32.5, 10.5))
    with pytest.raises(Exception, match="the DEM covers"):
        prepare(request(dem, away))


def test_parts_are_parts_of_the_image(tmp_path):
    for kind in KINDS:
        sensor = read_sensor(scan(tmp_path / "s.json", kind))
        whole = sensor.exposures[0]
        part = whole.part((3, 9, -4, 30), 3)
        assert part.shape == (18, 102)
        for a, b in zip(
            part.looks([7.0, 4.0]), whole.looks([7 / 3 - 4 - 1 / 3, 3 + 4 / 3 - 1 / 3]), strict=True
        ):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-8)
        rows = [one.shape[0] for one in sensor.divided(3)]
        assert rows == ([20, 20, 20] if kind == KINDS[0] else [24, 24, 12])
        second = sensor.divided(3)[1].looks([[3.0, 1.0], [3.0, 13.0]])
        for a, b in zip(
            second, sensor.looks([[3.0, 1.0 + rows[0]], [3.0, 13.0 + rows[0]]]), strict=True
        ):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-8)
        around = sensor.around(5)
        assert around.shape[0] >= sensor.shape[0] + 10
        assert around.shape[1] == sensor.shape[1] + 10
        off = (around.shape[0] - sensor.shape[0]) // 2
        np.testing.assert_allclose(
            around.looks([5.0, off])[1], sensor.looks([0.0, 0.0])[1], atol=1e-12
        )
    assert isinstance(sensor, PushFrame)
    with pytest.raises(ValueError, match="one framelet"):
        sensor.part((0, 3, 0, 3))
    assert CENTRE_ET > 0
