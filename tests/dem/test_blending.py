"""Many products as one surface: seams at the table's latitudes and at outer edges, holes, poles, meridians, against `hills`
and against products that differ by a constant.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.products import DEGREE_M, RADIUS_M, cylinder, geotiff, hills
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.dem.tiles import Edge, Tile, clear_of, edge_weight, outer_edges, smoothstep

SEAMS = (60.0, 75.0, 80.0, 85.0)
POLAR = (("LDEM_75{}_30M", 75.0, 3000.0), ("LDEM_80{}_20M", 80.0, 2000.0), ("LDEM_85{}_10M", 85.0, 1000.0))  # fmt: skip


def polar(path: Path, pole: int, equatorward: float, pixel_m: float, surface: Callable) -> Path:
    """A polar stereographic GeoTIFF out to 5 degrees beyond a latitude."""
    reach = 2.0 * RADIUS_M * np.tan(np.radians(95.0 - equatorward) / 2.0)
    half = int(np.ceil(reach / pixel_m))
    x, y = np.meshgrid(*[(np.arange(2 * half) - half + 0.5) * pixel_m] * 2)
    y = -y
    lat = pole * (90.0 - 2.0 * np.degrees(np.arctan(np.hypot(x, y) / (2.0 * RADIUS_M))))
    heights = surface(np.degrees(np.arctan2(x, -pole * y)), lat)
    crs = f"+proj=stere +lat_0={90 * pole} +lon_0=0 +k=1 +R=1737400 +units=m +no_defs"
    return geotiff(path, heights, -half * pixel_m, half * pixel_m, pixel_m, crs)


def table(folder: Path, surfaces: Callable[[int], Callable]) -> DemSet:
    """The method's table on coarse pixels: SLDEM2015 in two tiles to 60 degrees, LDEM_512 everywhere, polar maps."""
    shape = (720, 1080)
    paths = [
        cylinder(folder / "SLDEM2015_512_a.tif", 0.0, 60.0, shape, 6.0, surfaces(0)),
        cylinder(folder / "SLDEM2015_512_b.tif", 180.0, 60.0, shape, 6.0, surfaces(0)),
        cylinder(folder / "LDEM_512.tif", -180.0, 90.0, (1080, 2160), 6.0, surfaces(1)),
    ]
    for pole, letter in ((1, "N"), (-1, "S")):
        for number, (name, latitude, pixel_m) in enumerate(POLAR):
            path = folder / f"{name.format(letter)}.tif"
            paths.append(polar(path, pole, latitude, pixel_m, surfaces(2 + number)))
    return DemSet.open(paths)


@pytest.fixture(scope="module")
def moon(tmp_path_factory: pytest.TempPathFactory) -> DemSet:
    return table(tmp_path_factory.mktemp("moon"), lambda number: hills)


@pytest.fixture(scope="module")
def steps(tmp_path_factory: pytest.TempPathFactory) -> DemSet:
    """Every product is a constant of its own: 0, 10, 20, 30, 40 m."""

    def surface(number: int) -> Callable:
        return lambda lon, lat: np.full(np.broadcast_shapes(lon.shape, lat.shape), 10.0 * number)

    return table(tmp_path_factory.mktemp("steps"), surface)


near_seams = st.one_of(
    *[st.floats(lat - 0.8, min(lat + 0.8, 90.0)) for lat in (*SEAMS, 90.0, 30.0)]
)
near_meridians = st.one_of(
    *[st.floats(lon - 0.5, lon + 0.5) for lon in (-180.0, 0.0, 180.0, 360.0, 77.0)]
)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(near_meridians, near_seams, st.sampled_from((-1.0, 1.0)), st.floats(0.0, 360.0))
def test_products_that_agree_are_one_surface(
    moon: DemSet, lon: float, lat: float, side: float, azimuth: float
) -> None:
    """A patch of 40 x 40 nodes anywhere over tile edges, meridians, seams and poles: no error beyond that of interpolating
    `hills` at 5 km pixels (2.7 m beside the pole of a cylinder, where polar maps answer 0.05 m), and no jump in it."""
    frame = np.array([[np.cos(azimuth), -np.sin(azimuth)], [np.sin(azimuth), np.cos(azimuth)]])
    steps_m = (np.arange(40) - 19.5) * 400.0
    x, y = np.tensordot(frame, np.array(np.meshgrid(steps_m, steps_m)), axes=1)
    lons, lats = _around(lon, side * lat, x, y)
    height, index = moon.heights(lons, lats, 1000.0)
    assert (index >= 0).all()
    error = height - hills(lons, lats)
    assert np.abs(error).max() < 0.15
    for axis in (0, 1):
        assert np.abs(np.diff(error, axis=axis)).max() < 0.04  # in 400 m


def _around(lon: float, lat: float, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places on the sphere from metres east and north of one."""
    o, a = np.radians(lon), np.radians(lat)
    up = np.array([np.cos(a) * np.cos(o), np.cos(a) * np.sin(o), np.sin(a)])
    east = np.array([-np.sin(o), np.cos(o), 0.0])
    p = up + (x[..., None] * east + y[..., None] * np.cross(up, east)) / RADIUS_M
    p /= np.linalg.norm(p, axis=-1, keepdims=True)
    return np.degrees(np.arctan2(p[..., 1], p[..., 0])), np.degrees(np.arcsin(p[..., 2]))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("seam", "low", "high"), [(60.0, 0, 1), (75.0, 1, 2), (80.0, 2, 3), (85.0, 3, 4)])  # fmt: skip
def test_a_step_between_products_becomes_a_bounded_slope(
    steps: DemSet, seam: float, low: int, high: int, side: float
) -> None:
    """From one product's height to the other's in one band, never steeper than 1.5 times the difference over the band (1.6 where
    the product ends at the very seam), with a slope that bends no faster than 6 of them."""
    lat = np.linspace(seam - 2.2, seam + 2.2, 8801)
    height, index = steps.heights(np.full(lat.size, 12.3), side * lat, 1000.0)
    band_m = 16.0 * max(DEGREE_M / 6.0 if low < 2 else 3000.0, 1.0) if low < 3 else 16.0 * 2000.0
    band = min(band_m / DEGREE_M, 1.0)
    below = seam - (1.0 if low else 16.0 / 6.0) * band  # a product's own edge lies wholly inside it
    np.testing.assert_allclose(height[lat < min(below, seam - band) - 1e-9], 10.0 * low, atol=1e-9)
    np.testing.assert_allclose(height[lat > seam + band / 2.0 + 1e-9], 10.0 * high, atol=1e-9)
    slope = np.diff(height) / np.diff(lat)
    assert (slope >= -1e-9).all()
    assert slope.max() <= 10.0 * (1.6 if low == 0 else 1.5) / band * (1.0 + 1e-6)
    assert np.abs(np.diff(slope)).max() / np.diff(lat)[0] <= 10.0 * 6.6 / band**2
    names = np.array(steps.products)[index]
    first, last = names[0], names[-1]
    switch = np.flatnonzero(names != first)[0]
    assert set(names) == {first, last}
    assert (names[switch:] == last).all()
    assert height[switch] == pytest.approx(10.0 * low + 5.0, abs=0.1)  # the greater weight names it


def over(tmp_path: Path, local: np.ndarray, nodata: float | None = None) -> DemSet:
    """A local product of 100 m pixels above a wide one of constant 10 m on the same pixels."""
    wide = geotiff(tmp_path / "wide.tif", np.full((500, 500), 10.0), -1e4, 4e4, 100.0)
    top = geotiff(tmp_path / "local.tif", local, 0.0, 2e4, 100.0, nodata=nodata)
    return DemSet.open([top, wide])


@pytest.fixture(scope="module")
def faded(tmp_path_factory: pytest.TempPathFactory) -> DemSet:
    return over(tmp_path_factory.mktemp("faded"), np.zeros((200, 200)))


class TestEdges:
    @pytest.mark.parametrize("side", ["north", "west", "east", "south"])
    def test_a_product_fades_inside_its_outer_edge(self, tmp_path: Path, side: str) -> None:
        """Closed form across an edge: 10 - 10 s(d / 16 pixels), d from the edge; flat outside and further in."""
        dems = over(tmp_path, np.zeros((200, 200)))
        d = np.linspace(-500.0, 2500.0, 3001)
        across = d if side in ("west", "south") else 2e4 - d
        x, y = (across, 1e4) if side in ("west", "east") else (1e4, across)
        stretch = np.cos(np.asarray(y) / RADIUS_M) if side in ("west", "east") else 1.0
        height, index = dems.heights(x / DEGREE_M, y / DEGREE_M, 100.0)
        t = np.clip(d * stretch / 1600.0, 0.0, 1.0)
        np.testing.assert_allclose(height, 10.0 - 10.0 * t * t * (3.0 - 2.0 * t), atol=1e-6)
        clear = np.abs(t - 0.5) > 1e-3
        np.testing.assert_array_equal(index[clear], (t < 0.5)[clear])

    @settings(max_examples=50, deadline=None)
    @given(st.floats(0.0, 2 * np.pi), st.floats(-1.2e4, 1.2e4))
    def test_no_line_over_it_is_steep(self, faded: DemSet, azimuth: float, past: float) -> None:
        """Over edges and corners, in any direction: 1.5 x difference / band."""
        along = np.arange(-17e3, 17e3, 20.0)
        x = 1e4 + along * np.cos(azimuth) - past * np.sin(azimuth)
        y = 1e4 + along * np.sin(azimuth) + past * np.cos(azimuth)
        height, _ = faded.heights(x / DEGREE_M, y / DEGREE_M, 100.0)
        known = height[np.isfinite(height)]
        assert known.min() >= -1e-9
        assert known.max() <= 10.0 + 1e-9
        assert np.nanmax(np.abs(np.diff(height))) <= 20.0 * 1.5 * 10.0 / 1600.0 * 1.001

    def test_the_rim_of_a_hole_is_continuous(self, tmp_path: Path) -> None:
        """The next product fills the hole exactly; over 4 pixels around it the two are mixed, at most 1.5 / 4 of their difference
        in a pixel (twice that where two rims face each other)."""
        local = np.zeros((200, 200))
        local[90:110, 95:105] = -1.0
        dems = over(tmp_path, local, nodata=-1.0)
        u, v = np.meshgrid(np.linspace(80.0, 120.0, 801), [93.3, 100.0, 89.6])
        height, index = dems.heights(*dems.dems[0].grid.lonlat(u, v), 100.0)
        hole = (np.abs(u - 99.5) < 5.0 - 1e-6) & (v > 89.5)
        np.testing.assert_allclose(height[hole], 10.0, atol=1e-9)
        assert (index[hole] == 1).all()
        far = np.abs(u - 99.5) > 9.0 + 1e-6
        np.testing.assert_allclose(height[far], 0.0, atol=1e-9)
        assert np.abs(np.diff(height, axis=1)).max() <= 10.0 * 1.5 / 4.0 * 0.05 * 1.001
        assert 0.0 < height[0, np.abs(u[0] - 91.0).argmin()] < 10.0
        for k in range(0, 801, 50):  # alone as in company, as far as the hole is felt
            place = dems.dems[0].grid.lonlat(u[:, k], v[:, k])
            alone = [dems.heights(*one, 100.0)[0] for one in zip(*place, strict=True)]
            np.testing.assert_array_equal(alone, height[:, k])

    def test_alone_it_counts_alone(self, tmp_path: Path) -> None:
        """Where nothing lies beneath, a product gives its own height up to its edge."""
        ramp = np.arange(200.0)[:, None] + np.zeros(200)
        other = geotiff(tmp_path / "o.tif", np.full((50, 50), 9e3), 9e5, 9e5, 100.0)
        path = geotiff(tmp_path / "ramp.tif", ramp, 0.0, 2e4, 100.0)
        alone, both = DemSet.open([path]), DemSet.open([path, other])
        lon, lat = alone.dems[0].grid.lonlat(*np.meshgrid(np.linspace(-0.5, 199.5, 77), np.linspace(-0.5, 199.5, 77)))  # fmt: skip
        want, _ = alone.heights(lon, lat, 100.0)
        got, index = both.heights(lon, lat, 100.0)
        np.testing.assert_allclose(got, want, atol=1e-9)
        assert (index == 0).all()

    def test_between_tiles_of_one_product_nothing_is_mixed(self, tmp_path: Path) -> None:
        """Two tiles side by side over a constant: no outer edge lies between them."""
        zero = np.zeros((200, 100))
        one = geotiff(tmp_path / "LDEM_1024_a.tif", zero, 0.0, 2e4, 100.0)
        two = geotiff(tmp_path / "LDEM_1024_b.tif", zero, 1e4, 2e4, 100.0)
        wide = geotiff(tmp_path / "wide.tif", np.full((500, 500), 10.0), -1e4, 4e4, 100.0)
        dems = DemSet.open([one, two, wide])
        assert [layer.dems[0].product for layer in dems.layers] == ["LDEM_1024", "wide"]
        x = np.linspace(0.7e4, 1.3e4, 601) / DEGREE_M
        for y in (1e4, 2e4 - 500.0):
            height, _ = dems.heights(x, np.full(x.size, y / DEGREE_M), 100.0)
            assert np.ptp(height) < 1e-9
        assert height[0] > 1.0  # 500 m inside the edge of both


class TestGeometry:
    @settings(max_examples=60, deadline=None)
    @given(st.lists(st.tuples(*[st.integers(0, 7)] * 4), min_size=1, max_size=5))
    def test_outer_edges_are_where_the_cover_ends(self, boxes: list[tuple[int, ...]]) -> None:
        """Reference: a raster of unit cells. Along every lattice line, an edge lies exactly between covered and free cells."""
        tiles = [Tile(c, c + w + 1, r, r + h + 1) for c, r, w, h in boxes]
        cover = np.zeros((18, 18), bool)
        for t in tiles:
            cover[int(t.top) + 1 : int(t.bottom) + 1, int(t.left) + 1 : int(t.right) + 1] = True
        found = outer_edges(tiles, 0.0, (False, False))
        total = sum(e.high - e.low for e in found)
        changes = np.count_nonzero(np.diff(cover, axis=0)) + np.count_nonzero(
            np.diff(cover, axis=1)
        )
        assert total == pytest.approx(changes)
        for edge in found:
            middle = round((edge.low + edge.high) / 2.0 - 0.01)
            at = int(edge.at)
            pair = cover[middle + 1, at : at + 2] if edge.column else cover[at : at + 2, middle + 1]
            assert pair[0] != pair[1]

    def test_around_the_moon_and_at_poles_there_is_no_edge(self) -> None:
        half = [Tile(-0.5, 49.5, -0.5, 19.5), Tile(49.5, 99.5, -0.5, 19.5)]
        assert outer_edges(half, 100.0, (True, True)) == ()
        assert outer_edges(half, 100.0, (True, False)) == (Edge(False, 19.5, -0.5, 99.5),)
        assert len(outer_edges(half[:1], 100.0, (True, True))) == 2

    @settings(max_examples=100, deadline=None)
    @given(st.tuples(*[st.floats(-30.0, 130.0)] * 2), st.floats(0.05, 1.0), st.floats(1.0, 30.0))
    def test_clear_of_never_promises_too_much(
        self, place: tuple[float, float], stretch: float, band: float
    ) -> None:
        edges = outer_edges([Tile(-0.5, 60.5, -0.5, 50.5)], 100.0, (False, True))
        u, v = place[0] + np.linspace(0, 5, 9), place[1] + np.linspace(0, 5, 9)
        weight = edge_weight(u, v, np.full(9, stretch), edges, 100.0, band)
        if clear_of(edges, (u[0], u[-1]), (v[0], v[-1]), stretch, 100.0, band):
            np.testing.assert_array_equal(weight, 1.0)
        turned = edge_weight(u + 100.0, v, np.full(9, stretch), edges, 100.0, band)
        np.testing.assert_allclose(turned, weight, atol=1e-9)  # once around the Moon

    def test_an_edge_ends_where_it_ends(self) -> None:
        """An L of two tiles: the distance is that to the nearest point of a piece of edge, found by trying them all."""
        edges = outer_edges(
            [Tile(-0.5, 60.5, -0.5, 20.5), Tile(-0.5, 20.5, 20.5, 60.5)], 0.0, (False, False)
        )
        inner = [e for e in edges if e.at == 20.5]
        assert len(edges) == 6
        assert len(inner) == 2
        u, v = np.meshgrid(np.arange(0.0, 60.0, 3.0), np.arange(0.0, 20.0, 3.0))
        for edge in inner:
            along = np.linspace(edge.low, edge.high, 4001)[:, None, None]
            at, beside = (u, v) if edge.column else (v, u)
            away = np.hypot(at - edge.at, beside - along).min(axis=0)
            found = edge_weight(u.ravel(), v.ravel(), 1.0, [edge], 0.0, 12.0)
            want = smoothstep(away.ravel() / 12.0)
            np.testing.assert_allclose(found, want, atol=1e-3)

    def test_smoothstep(self) -> None:
        t = np.array([-1.0, 0.0, 0.25, 0.5, 1.0, 2.0])
        np.testing.assert_allclose(smoothstep(t), [0.0, 0.0, 0.15625, 0.5, 1.0, 1.0])


@pytest.mark.slow
def test_a_place_depends_on_nothing_else_that_is_asked(moon: DemSet, steps: DemSet) -> None:
    """Bit for bit: all at once, one by one, and in any company; over seams, edges, meridians, poles."""
    rng = np.random.default_rng(4)
    lat = np.concatenate([side * (seam + rng.uniform(-1, 1, 12)) for seam in (*SEAMS, 89.0) for side in (-1, 1)])  # fmt: skip
    lon = rng.choice([-180.0, 0.0, 180.0, 359.9, 50.0], lat.size) + rng.uniform(-0.5, 0.5, lat.size)
    for dems in (moon, steps):
        for gsd_m in (1000.0, 9000.0):
            together, index = dems.heights(lon, lat, gsd_m)
            for k in range(0, lat.size, 3):
                height, number = dems.heights(lon[k], lat[k], gsd_m)
                assert height.tobytes() == together[k].tobytes()
                assert number == index[k]
            some = rng.permutation(lat.size)[:40]
            np.testing.assert_array_equal(dems.heights(lon[some], lat[some], gsd_m)[0], together[some])  # fmt: skip
