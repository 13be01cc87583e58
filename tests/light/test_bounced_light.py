"""Light by way of other ground: path tracing by brute force, albedo, the bound, and the plan's choice."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio

from lcp_catalog.accuracy import TIERS
from lcp_catalog.approximations import APPROXIMATIONS
from lcp_catalog.cameras.view import oblique_view
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.light import bounced_light
from lcp_catalog.light.bounced_light import SHOWS, bounced_at_points, bounced_bound, bounced_sample
from lcp_catalog.light.solar_disc import share_at_points
from lcp_catalog.light.sources import Lighting, SurfacePoints
from lcp_catalog.photometry.laws import LAMBERT_ALBEDO, radiance_under, reflectance_model
from lcp_catalog.rendering import decisions
from lcp_catalog.rendering.plan import plan_scene
from lcp_catalog.rendering.renderer import Method, render_enu
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.relief_bounds import nodes_enu
from lcp_catalog.terrain.terrain import Terrain

ROOT = Path(__file__).resolve().parents[2]
LAMBERT = reflectance_model("lambert")
UP = np.array([0.0, 0.0, 1.0])
SUN = direction_enu(90.0, 25.0)
CELL_M = 100.0
SIDE = 17


def crater(depth_m=700.0):
    """A bowl with a flat floor in a plain."""
    place = (np.arange(SIDE) - SIDE // 2) * CELL_M
    away = np.hypot(*np.meshgrid(place, place)) / 600.0
    z = (-depth_m * np.clip(1.2 - away**2, 0.0, 1.0)).astype(np.float32)
    field = Heightfield(z, CELL_M, place[0], -place[0])
    half, index = SIDE // 2, np.zeros(z.shape, np.int16)
    window = NodeWindow(-half, half + 1, -half, half + 1)
    return Terrain(field, EnuFrame(0.0, 0.0), field.whole, window, index, ("made",))


def dark_nodes(terrain):
    """Points and normals of the nodes that the Sun does not reach."""
    shot = render_enu(terrain, Lighting.of_sun(SUN), oblique_view(0.0, 0.0), Method(model=LAMBERT))
    dark = np.isfinite(shot.radiance) & (shot.sunlit == 0.0)
    points = nodes_enu(terrain.field, terrain.core)[dark]
    return dark, points, terrain.field.normals()[dark].astype(np.float64)


def traced(field, point, normal, rays, rng):
    """Radiance factor of a Lambert point under one bounce: random directions about its normal, every
    triangle tried by Moeller and Trumbore, a shadow ray from each hit.
    """
    nodes, faces = nodes_enu(field, field.whole), field.normals().astype(np.float64)
    cells = [(i, j) for i in range(SIDE - 1) for j in range(SIDE - 1)]
    corners = [((i, j), (i, j + 1), (i + 1, j + 1)) for i, j in cells]
    corners += [((i, j), (i + 1, j), (i + 1, j + 1)) for i, j in cells]
    v = np.array([[nodes[c] for c in three] for three in corners])
    n = np.array([[faces[c] for c in three] for three in corners])
    e1, e2 = v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]

    def first(origin, ray):
        g = np.cross(ray, e2)
        determinant = np.einsum("ij,ij->i", g, e1)
        s = origin - v[:, 0]
        q = np.cross(s, e1)
        with np.errstate(all="ignore"):
            a = np.einsum("ij,ij->i", g, s) / determinant
            b = (q @ ray) / determinant
            t = np.einsum("ij,ij->i", q, e2) / determinant
        t = np.where((a >= 0) & (b >= 0) & (a + b <= 1) & (t > 1e-3), t, np.inf)
        k = int(np.argmin(t))
        return k, t[k], a[k], b[k]

    east = np.cross([0.0, 1.0, 0.0], normal)
    east /= np.linalg.norm(east)
    north, total = np.cross(normal, east), 0.0
    for x, y in rng.random((rays, 2)):
        sine, turn = math.sqrt(x), 2.0 * math.pi * y
        ray = sine * (math.cos(turn) * east + math.sin(turn) * north) + math.sqrt(1 - x) * normal
        k, t, a, b = first(point + 1e-3 * normal, ray)
        if not math.isfinite(t):
            continue
        face = (1 - a - b) * n[k, 0] + a * n[k, 1] + b * n[k, 2]
        face /= np.linalg.norm(face)
        hit = point + t * ray
        cosine = face @ SUN
        if face @ ray < 0.0 < cosine and not math.isfinite(first(hit + 1e-3 * face, SUN)[1]):
            total += LAMBERT_ALBEDO * cosine
    return LAMBERT_ALBEDO * total / rays


@pytest.mark.slow
def test_against_path_tracing_by_brute_force():
    terrain = crater()
    _, points, normals = dark_nodes(terrain)
    some = np.linspace(0, len(points) - 1, 4).astype(int)
    light, high = Lighting.of_sun(SUN), TIERS["high"]
    ours = bounced_at_points(
        terrain, light, SurfacePoints(points[some], normals[some], UP), LAMBERT, high
    )
    rng = np.random.default_rng(5)
    judged = np.array([traced(terrain.field, points[k], normals[k], 1500, rng) for k in some])
    assert judged.min() > 1e-4
    assert ours == pytest.approx(judged, rel=0.15)  # 1500 rays: up to 6 %
    assert ours.mean() == pytest.approx(judged.mean(), rel=0.06)


def bowl(side, half_deg=55.0):
    """A part of a sphere below a plain, 1500 m wide, seen from the sphere's centre under this angle on either side."""
    place = np.linspace(-800.0, 800.0, side)
    away, half = np.hypot(*np.meshgrid(place, place)), math.radians(half_deg)
    radius = 750.0 / math.sin(half)
    z = radius * math.cos(half) - np.sqrt(np.maximum(radius**2 - away**2, 0.0))
    z = np.minimum(z, 0.0).astype(np.float32)
    return replace(crater(), field=Heightfield(z, 1600.0 / (side - 1), -800.0, 800.0))


def share_of_the_second(monkeypatch, terrain, points, normals):
    """Light by two other places over that by one, mean over points: what reaches each hit is that of another bounce."""
    where = terrain, Lighting.of_sun(SUN)
    at, direct = SurfacePoints(points, normals, UP), bounced_light._direct

    def arriving(_terrain, _light, hits, *_):
        with monkeypatch.context() as inner:
            inner.setattr(bounced_light, "_direct", direct)
            return bounced_at_points(*where, hits, LAMBERT, TIERS["draft"])

    one = bounced_at_points(*where, at, LAMBERT, TIERS["draft"])
    with monkeypatch.context() as outer:
        outer.setattr(bounced_light, "_direct", arriving)
        return bounced_at_points(*where, at, LAMBERT, TIERS["draft"]).sum() / one.sum()


def test_the_second_bounce_of_a_bowl(monkeypatch):
    """Albedo times the bowl's share of its sphere, as every place of a sphere lights every other alike; the rim's cells
    take away as much as they are wide.
    """
    found = []
    for side in (33, 65):
        field = (terrain := bowl(side)).field
        points, normals = nodes_enu(field, field.whole), field.normals().astype(np.float64)
        dark = np.argwhere((normals @ SUN < 0.0) & (points[..., 2] < -100.0))
        some = tuple(dark[np.linspace(0, len(dark) - 1, 30).astype(int)].T)
        found.append(share_of_the_second(monkeypatch, terrain, points[some], normals[some]))
    expected = LAMBERT_ALBEDO * (1.0 - math.cos(math.radians(55.0))) / 2.0
    assert found[0] < found[1] < expected
    assert 2.0 * found[1] - found[0] == pytest.approx(expected, rel=0.02)


def test_the_second_bounce_of_a_crater_is_the_share_that_is_stated(monkeypatch):
    terrain = crater()
    _, points, normals = dark_nodes(terrain)
    found = share_of_the_second(monkeypatch, terrain, points, normals)
    assert 100.0 * found == pytest.approx(stated_error("second bounce of light"), rel=0.02)


def stated_error(name):
    return next(one for one in APPROXIMATIONS if one.name == name).error.value


@pytest.fixture(scope="module")
def sample():
    """The sample's heights in cells of 474 m, without the Moon's curvature."""
    with rasterio.open(ROOT / "sample_data/hadley_gld100_256ppd.tif") as file:
        z = file.read(1)
    return z.reshape(z.shape[0] // 4, 4, z.shape[1] // 4, 4).mean((1, 3))


def part_of(z, row0, row1, col0, col1):
    """The terrain of a part of the heights, its first node in the place that it has in the whole."""
    cell_m = 473.8
    part = np.ascontiguousarray(z[row0:row1, col0:col1], np.float32)
    field = Heightfield(part, cell_m, col0 * cell_m, -row0 * cell_m)
    window = NodeWindow(row0, row1, col0, col1)
    index = np.zeros(part.shape, np.int16)
    return Terrain(field, EnuFrame(0.0, 0.0), field.whole, window, index, ("made",))


def in_shadow(z, row, col, sun):
    """The whole terrain, its light, and up to 4000 of its nodes in shadow in the area of 96 nodes around a node."""
    whole, light = part_of(z, 0, z.shape[0], 0, z.shape[1]), Lighting.of_sun(sun)
    area = np.s_[row - 48 : row + 48, col - 48 : col + 48]
    nodes = nodes_enu(whole.field, whole.field.whole)[area].reshape(-1, 3)
    at = SurfacePoints(nodes, whole.field.normals()[area].reshape(-1, 3).astype(np.float64), UP)
    dark = np.flatnonzero(~bounced_light._reached(whole, light.first, at))
    some = dark[np.linspace(0, len(dark) - 1, min(len(dark), 4000)).astype(int)]
    return whole, light, at.some(some)


def test_penumbrae_of_ground_that_reflects_are_as_stated(monkeypatch, sample):
    """Each place met sees a share of the disc, in place of its centre or nothing."""
    whole, light, at = in_shadow(sample, 320, 320, direction_enu(200.0, 5.0))
    plain = bounced_at_points(whole, light, at, LAMBERT, TIERS["draft"])

    def shared(terrain, lights, hits, model, _brightness):
        sun = lights.first.direction.vector
        share = share_at_points(terrain.field, hits.points_m, sun, TIERS["high"])
        return share * radiance_under(
            hits.normals, sun, hits.towards, hits.normals @ sun > 0.0, model
        )

    monkeypatch.setattr(bounced_light, "_direct", shared)
    soft = bounced_at_points(whole, light, at, LAMBERT, TIERS["draft"])
    rms = np.sqrt(np.mean((soft - plain) ** 2)) / plain.mean()
    assert 100.0 * rms == pytest.approx(
        stated_error("penumbrae on the ground that reflects"), rel=0.02
    )
    assert abs(soft.mean() / plain.mean() - 1.0) < 0.002


@pytest.mark.parametrize(
    ("row", "col", "azimuth_deg", "elevation_deg", "border", "lost"),
    [(320, 320, 90.0, 20.0, 0, None), (200, 400, 90.0, 2.0, 36, 0.13)],
)
def test_light_by_way_of_ground_beyond_an_area_is_as_stated(
    monkeypatch, sample, row, col, azimuth_deg, elevation_deg, border, lost
):
    """The same directions and the same shadows, but only ground of the area and its border."""
    whole, light, at = in_shadow(sample, row, col, direction_enu(azimuth_deg, elevation_deg))
    reached, directions = bounced_light._reached, bounced_light._directions
    monkeypatch.setattr(bounced_light, "_directions", lambda _, tier: directions(whole.field, tier))
    monkeypatch.setattr(bounced_light, "_reached", lambda _, *given: reached(whole, *given))
    every = bounced_at_points(whole, light, at, LAMBERT, TIERS["draft"])
    reach = 48 + border
    part = part_of(sample, row - reach, row + reach, col - reach, col + reach)
    found = bounced_at_points(part, light, at, LAMBERT, TIERS["draft"])
    stated = 0.01 * stated_error("ground beyond an area, in its bounced light")
    assert 1.0 - found.mean() / every.mean() == pytest.approx(lost or stated, abs=0.005)


def test_tiers_agree_within_their_errors():
    terrain = crater()
    _, points, normals = dark_nodes(terrain)
    found = {
        name: bounced_at_points(
            terrain, Lighting.of_sun(SUN), SurfacePoints(points, normals, UP), LAMBERT, tier
        )
        for name, tier in TIERS.items()
    }
    exact = found["high"]
    for name, share in (("draft", 0.25), ("standard", 0.15)):
        assert np.sqrt(np.mean((found[name] - exact) ** 2)) < share * exact.mean()
    assert (found["reference"] == exact).all()


def test_bright_ground_reflects_more_and_the_bound_holds():
    terrain = crater()
    _, points, normals = dark_nodes(terrain)
    where = terrain, Lighting.of_sun(SUN), SurfacePoints(points, normals, UP)
    for name in ("lambert", "lommel-seeliger", "lunar-lambert", "hapke"):
        model = reflectance_model(name)
        one = bounced_at_points(*where, model, TIERS["draft"])
        assert 0.0 < one.max() < bounced_bound(terrain.field, model)
    twice = bounced_at_points(*where, model, TIERS["draft"], lambda p: np.full(len(p), 2.0))
    assert twice == pytest.approx(2.0 * one)


def plan_of(terrain, choice, tier):
    light, view = Lighting.of_sun(SUN), oblique_view(0.0, 0.0)
    sample = bounced_sample(terrain, light, UP, LAMBERT) if choice != "off" else None
    words, bound = decisions.LightWords.of(light), bounced_bound(terrain.field, LAMBERT)
    decided = decisions.bounced_light(choice, words, bound, sample, 0.25, SHOWS[tier])
    return decided, plan_scene(terrain, SUN, view, model=LAMBERT, scattered=decided)


@pytest.mark.parametrize(
    ("depth_m", "choice", "tier", "modelled"),
    [
        (700.0, "auto", "high", True),
        (700.0, "auto", "standard", False),
        (700.0, "off", "high", False),
        (140.0, "auto", "high", False),
        (250.0, "on", "standard", True),
    ],
)
def test_the_plan_models_what_shows(depth_m, choice, tier, modelled):
    terrain, light = crater(depth_m), Lighting.of_sun(SUN)
    decided, plan = plan_of(terrain, choice, tier)
    assert plan.bounces is decided.modelled is modelled
    how = {"model": LAMBERT, "accuracy": TIERS["standard"], "plan": plan}
    shot = render_enu(terrain, light, oblique_view(0.0, 0.0), Method(**how))
    dark, points, normals = dark_nodes(terrain)
    bounced = bounced_at_points(
        terrain, light, SurfacePoints(points, normals, UP), LAMBERT, TIERS["standard"]
    )
    if modelled:
        assert shot.radiance[dark] == pytest.approx(bounced, rel=1e-5)
        assert (bounced > 0.0).any()
    else:
        assert (shot.radiance[dark] == 0.0).all()
        assert bounced.max(initial=0.0) <= decided.error_bound
    plain = render_enu(
        terrain, light, oblique_view(0.0, 0.0), Method(model=LAMBERT, accuracy=TIERS["standard"])
    )
    assert (shot.radiance[~dark] == plain.radiance[~dark]).all()
