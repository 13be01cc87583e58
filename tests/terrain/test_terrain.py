"""Areas and their heightfields: every node lies on the DEM's surface, also over seams and a pole,
and is the same in every window.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.one_patch import sample_patch
from helpers.products import cylinder, geotiff, hills, ldem_80s
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import AreaError
from lcp_catalog.geometry.frames import EnuFrame, lonlat_to_mcmf, mcmf_to_lonlat
from lcp_catalog.kernels.resampling import heights as resample
from lcp_catalog.terrain import terrain as terrain_module
from lcp_catalog.terrain.area import Area, NodeWindow
from lcp_catalog.terrain.terrain import (
    Terrain,
    build_terrain,
    sample_patches,
    terrain_from_area,
)

R = 1_737_400.0


@pytest.fixture(scope="module")
def moon(tmp_path_factory: pytest.TempPathFactory) -> DemSet:
    """The whole Moon at 8 pixels a degree (3790 m)."""
    path = tmp_path_factory.mktemp("moon") / "moon.tif"
    return DemSet.open([cylinder(path, 0.0, 90.0, (1440, 2880), 8.0)])


@pytest.fixture(scope="module")
def flat(tmp_path_factory: pytest.TempPathFactory) -> DemSet:
    path = tmp_path_factory.mktemp("flat") / "flat.tif"
    return DemSet.open(
        [cylinder(path, 0.0, 90.0, (180, 360), 1.0, surface=lambda lon, lat: 0.0 * lon)]
    )


def places(terrain: Terrain) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Longitude, latitude and height of the nodes, from the field alone."""
    field = terrain.field
    rows, cols = field.z_m.shape
    x, y = np.meshgrid(
        field.x0_m + np.arange(cols) * field.gsd_m, field.y0_m - np.arange(rows) * field.gsd_m
    )
    return mcmf_to_lonlat(
        terrain.frame.to_mcmf(np.stack([x, y, field.z_m.astype(np.float64)], axis=-1))
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "at", [(30.0, 20.0), (0.0, 0.0), (180.0, -50.0), (-90.0, 88.0), (77.0, 90.0), (10.0, -90.0)]
)
@pytest.mark.parametrize("gsd_m", [4000.0, 12_000.0])
def test_every_node_lies_on_the_surface(
    moon: DemSet, at: tuple[float, float], gsd_m: float
) -> None:
    terrain = terrain_from_area(moon, Area(*at, 240.0), gsd_m)
    lon, lat, height = places(terrain)
    want, _ = moon.heights(lon, lat, gsd_m)
    assert not np.isnan(terrain.field.z_m).any()
    np.testing.assert_allclose(height, want, atol=2e-3)
    if gsd_m < 5000.0:
        np.testing.assert_allclose(
            height, hills(lon, lat), atol=3.0
        )  # error of 8 pixels per degree on these hills


def test_curvature_is_inside(flat: DemSet) -> None:
    terrain = terrain_from_area(flat, Area(12.0, 34.0, 40.0), 1000.0)
    x = terrain.field.x0_m + np.arange(41) * 1000.0
    z = terrain.field.z_m[20]  # along y = 0
    np.testing.assert_allclose(z, np.sqrt(R * R - x * x) - R, atol=1e-3)
    assert z[x == 15_000.0] == pytest.approx(-64.75, abs=0.01)  # 15000^2 / (2 * 1737400)


def test_row_0_is_north_and_column_0_west(moon: DemSet) -> None:
    terrain = terrain_from_area(moon, Area(30.0, 20.0, 100.0), 4000.0)
    lon, lat, _ = places(terrain)
    assert (np.diff(lat[:, 12]) < 0).all()
    assert (np.diff(lon[12]) > 0).all()
    assert lon[13, 13] == pytest.approx(30.0)
    assert lat[13, 13] == pytest.approx(20.0)


@pytest.mark.parametrize("at", [(30.0, 20.0), (0.0, 10.0), (0.0, 90.0)])
@pytest.mark.parametrize("tolerance_m", [1e-3, 1100.0])
def test_windows_of_one_frame_share_their_nodes(
    moon: DemSet, at: tuple[float, float], tolerance_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Heights are equal to the bit in any window, so that the same terrain gets the same id in
    every build.

    With a large tolerance the iteration stops at different steps: no node may depend on others.
    """
    monkeypatch.setattr(terrain_module, "_TOLERANCE_M", tolerance_m)
    frame = EnuFrame(*at)
    for gsd_m in (3000.0, 9000.0):
        whole = build_terrain(moon, frame, NodeWindow(-30, 31, -40, 21), gsd_m, ring_m=5 * gsd_m)
        part = build_terrain(moon, frame, NodeWindow(-3, 9, -12, 4), gsd_m)
        at_row, at_col = -3 - whole.window.row0, -12 - whole.window.col0
        np.testing.assert_array_equal(
            whole.field.z_m[at_row : at_row + 12, at_col : at_col + 16], part.field.z_m
        )
        assert (part.field.x0_m, part.field.y0_m) == (-12 * gsd_m, 3 * gsd_m)


def test_core_and_ring(moon: DemSet) -> None:
    terrain = build_terrain(
        moon, EnuFrame(5.0, 6.0), NodeWindow(-2, 3, -4, 5), 4000.0, ring_m=9000.0
    )
    assert terrain.core == (3, 8, 3, 12)
    assert terrain.field.z_m.shape == (11, 15)
    assert terrain.window == NodeWindow(-5, 6, -7, 8)
    assert (terrain.product_index == 0).all()
    assert terrain.products == ("moon",)


def test_a_polar_product_over_its_pole(tmp_path: Path) -> None:
    dems = DemSet.open([ldem_80s(tmp_path, 120)])
    terrain = terrain_from_area(dems, Area(40.0, -90.0, 1.6))
    assert terrain.field.gsd_m == 20.0
    lon, lat, height = places(terrain)
    assert not np.isnan(height).any()
    np.testing.assert_allclose(height, hills(lon, lat), atol=0.3)
    np.testing.assert_allclose(height, dems.heights(lon, lat, 20.0)[0], atol=2e-3)


def test_the_first_product_is_on_top_and_named(tmp_path: Path, moon: DemSet) -> None:
    polar = ldem_80s(tmp_path, 120)
    dems = DemSet.open([polar, moon.dems[0].path])
    terrain = terrain_from_area(dems, Area(0.0, -90.0, 6.0), 100.0)
    assert set(terrain.product_index.ravel()) == {0, 1}
    assert terrain.product_index[30, 30] == 0
    assert terrain.products == ("LDEM_80S_20M", "moon")


def test_the_whole_disc(flat: DemSet) -> None:
    terrain = terrain_from_area(flat, Area.from_bounds(0.0, -90.0, 360.0, 90.0), 40_000.0)
    z = terrain.field.z_m
    assert np.isnan(z[0, 0])  # beyond the limb
    assert not np.isnan(z[z.shape[0] // 2, z.shape[1] // 2])
    _, _, height = places(terrain)
    assert np.nanmax(np.abs(height)) < 0.25  # float32 of z down to -1400 km


@pytest.mark.parametrize(
    "at", [(0.0, 0.0), (359.9, 40.0), (12.0, 89.9), (200.0, -90.0), (5.0, 90.0)]
)
def test_longitude_and_latitude_over_nodes(at: tuple[float, float]) -> None:
    """Against the frame's own transformation, near the origin and up to 80 deg from it."""
    rng = np.random.default_rng(7)
    away = np.repeat([100.0, 3e4, 5e5, 1.7e6], 500) * rng.uniform(-0.7, 0.7, (2, 2000))
    (x, y), height = away, rng.uniform(-9e3, 1e4, 2000)
    some = np.sort(rng.permutation(2000)[:1900])
    lon, lat = np.empty((2, 1900))
    origins, which = np.array([(1.0, 2.0), at]), np.ones(2000, np.int64)
    resample.lonlat_over(x, y, height, some, which, origins, lon, lat)
    z = np.sqrt((R + height) ** 2 - x * x - y * y) - R
    points = EnuFrame(*at).to_mcmf(np.stack([x, y, z], axis=-1)[some])
    _, _, found_m = mcmf_to_lonlat(points)
    np.testing.assert_allclose(found_m, height[some], atol=1e-6)
    assert ((lon >= 0.0) & (lon < 360.0) & (np.abs(lat) <= 90.0)).all()
    np.testing.assert_allclose(lonlat_to_mcmf(lon, lat, height[some]), points, atol=1e-6)


def test_patches_are_those_taken_one_by_one(moon: DemSet) -> None:
    lon, lat = np.array([359.9999, 12.0, 77.0]), np.array([40.0, -3.0, 89.99])
    for patch, place in zip(
        sample_patches(moon, lon, lat, 9, 2000.0), zip(lon, lat, strict=True), strict=True
    ):
        alone = sample_patch(moon, *place, 9, 2000.0)
        assert patch.frame == alone.frame
        np.testing.assert_array_equal(patch.z_m, alone.z_m)
    assert sample_patches(moon, lon[:0], lat[:0], 9, 2000.0) == []


class TestPatch:
    def test_origin_is_the_surface_point(self, moon: DemSet) -> None:
        patch = sample_patch(moon, 359.9999, 40.0, 9, 2000.0)
        height, _ = moon.heights(359.9999, 40.0, 2000.0)
        assert patch.z_m.dtype == np.float32
        assert patch.z_m.shape == (9, 9)
        assert patch.z_m[4, 4] == 0.0
        assert patch.product == 0
        assert (patch.frame.lon_deg, patch.frame.lat_deg, patch.frame.height_m) == (
            359.9999,
            40.0,
            float(height),
        )
        at = (np.arange(9) - 4) * 2000.0
        x, y = np.meshgrid(at, -at)
        lon, lat, heights = mcmf_to_lonlat(
            patch.frame.to_mcmf(np.stack([x, y, patch.z_m.astype(np.float64)], axis=-1))
        )
        np.testing.assert_allclose(heights, moon.heights(lon, lat, 2000.0)[0], atol=2e-3)

    def test_refusals(self, tmp_path: Path) -> None:
        dems = DemSet.open(
            [geotiff(tmp_path / "a.tif", np.full((9, 9), 5.0, np.float32), 0.0, 900.0, 100.0)]
        )
        with pytest.raises(AreaError, match="must be odd"):
            sample_patch(dems, 0.01, 0.01, 8, 100.0)
        with pytest.raises(AreaError, match=r"no DEM has a height at longitude 50"):
            sample_patch(dems, 50.0, 0.01, 9, 100.0)
        assert np.isnan(sample_patch(dems, 0.001, 0.01, 9, 100.0).z_m[:, 0]).all()


class TestArea:
    @pytest.mark.parametrize(
        ("bounds", "inside", "outside"),
        [
            (
                (170.0, -10.0, -170.0, 10.0),
                [(180.0, 0.0), (-175.0, 9.0), (185.0, 9.0), (175.0, 0.0)],
                [(0.0, 0.0), (169.0, 0.0)],
            ),
            (
                (350.0, -10.0, 10.0, 10.0),
                [(0.0, 0.0), (360.0, 0.0), (-5.0, 0.0), (355.0, 0.0)],
                [(11.0, 0.0), (345.0, 0.0)],
            ),
            (
                (-30.0, 0.0, 20.0, 30.0),
                [(-29.0, 1.0), (331.0, 1.0), (19.0, 29.0)],
                [(21.0, 1.0), (0.0, -1.0)],
            ),
            ((0.0, -90.0, 360.0, 90.0), [(0.0, 0.0), (359.9, -90.0), (-180.0, 90.0)], []),
            ((-180.0, 80.0, 180.0, 90.0), [(77.0, 90.0), (180.0, 80.0)], [(0.0, 79.0)]),
        ],
    )
    def test_boxes(self, bounds: tuple, inside: list, outside: list) -> None:
        area = Area.from_bounds(*bounds)
        assert all(area.contains(*place) for place in inside)
        assert not any(area.contains(*place) for place in outside)
        west, south, east, north = area.bounds
        assert (south, north) == bounds[1::2]
        assert 0.0 < east - west <= 360.0
        assert area.contains(area.lon_deg, area.lat_deg)

    def test_size_in_the_plane(self) -> None:
        area = Area(-30.0, 60.0, (100.0, 50.0))
        x, y = (
            np.array([0.0, 49_999.0, 50_001.0, 0.0, 0.0]),
            np.array([0.0, 0.0, 0.0, 24_999.0, 25_001.0]),
        )
        lon, lat, _ = mcmf_to_lonlat(
            area.frame.to_mcmf(np.stack([x, y, np.sqrt(R * R - x * x - y * y) - R], axis=-1))
        )
        assert area.contains(lon, lat).tolist() == [True, True, False, True, False]
        assert not area.contains(150.0, -60.0)  # the other side of the Moon has the same x and y
        assert area.bounds.west < -30.0 < area.bounds.east

    @given(
        lon=st.floats(-180, 360),
        lat=st.floats(-90, 90),
        size=st.floats(1.0, 900.0),
        u=st.floats(-1, 1),
        v=st.floats(-1, 1),
    )
    def test_bounds_hold_the_area(
        self, lon: float, lat: float, size: float, u: float, v: float
    ) -> None:
        area = Area(lon, lat, size)
        x, y = 500.0 * size * u, 500.0 * size * v
        at, where, _ = mcmf_to_lonlat(
            area.frame.to_mcmf(np.array([x, y, np.sqrt(R * R - x * x - y * y) - R]))
        )
        west, south, east, north = area.bounds
        slack = 0.02 + 0.01 * size / 30.0  # bounds come from points along the edge
        assert south - slack <= where <= north + slack
        if abs(where) < 89.0 and east - west < 359.0:
            assert (
                at - west + slack / np.cos(np.radians(where))
            ) % 360.0 <= east - west + 2 * slack / np.cos(np.radians(where))

    def test_a_pole_inside_has_all_longitudes(self) -> None:
        assert Area(0.0, 89.5, 100.0).bounds[::2] == (0.0, 360.0)
        assert Area(0.0, 89.5, 100.0).bounds.north == 90.0

    def test_extent_of_a_box_covers_it(self) -> None:
        area = Area.from_bounds(170.0, 60.0, -170.0, 70.0)
        lon, lat = np.meshgrid(np.linspace(170.0, 190.0, 40), np.linspace(60.0, 70.0, 40))
        x, y, _ = np.moveaxis(area.frame.from_mcmf(lonlat_to_mcmf(lon, lat)), -1, 0)
        x0, x1, y0, y1 = area.extent_m
        assert x0 <= x.min() + 1.0
        assert x1 >= x.max() - 1.0
        assert y0 <= y.min() + 1.0
        assert y1 >= y.max() - 20.0  # the edge is sampled

    def test_nodes_of_a_size_that_fits(self) -> None:
        assert NodeWindow.covering(Area(0.0, 0.0, 8.0).extent_m, 100.0) == NodeWindow(
            -40, 41, -40, 41
        )
        assert NodeWindow.covering(Area(0.0, 0.0, 8.1).extent_m, 100.0) == NodeWindow(
            -41, 42, -41, 42
        )

    @pytest.mark.parametrize(
        ("make", "says"),
        [
            (lambda: Area(400000.0, 0.0, 1.0), "longitude 400000"),
            (lambda: Area(0.0, 91.0, 1.0), "latitude 91"),
            (lambda: Area(float("nan"), 0.0, 1.0), "longitude nan"),
            (lambda: Area(0.0, 0.0, 0.0), "above 0"),
            (lambda: Area(0.0, 0.0, -5.0), "above 0"),
            (lambda: Area(0.0, 0.0, float("inf")), "at most"),
            (lambda: Area(0.0, 0.0, None), "a size or bounds"),
            (lambda: Area.from_bounds(0.0, 10.0, 10.0, 10.0), "south 10 must lie below north 10"),
            (lambda: Area.from_bounds(5.0, 0.0, 5.0, 10.0), "no width"),
            (lambda: Area.from_bounds(0.0, -91.0, 5.0, 10.0), "latitudes -91"),
            (lambda: Area.from_bounds(-180.0, 0.0, 360.0, 10.0), "more than once"),
            (lambda: NodeWindow(0, 0, 0, 4), "is empty"),
        ],
    )
    def test_refusals(self, make: object, says: str) -> None:
        with pytest.raises(AreaError, match=says):
            make()  # type: ignore[operator]


class TestNoGround:
    def test_outside_the_dem_names_its_bounds(self, tmp_path: Path) -> None:
        dems = DemSet.open(
            [geotiff(tmp_path / "a.tif", np.full((30, 30), 5.0, np.float32), 0.0, 3000.0, 100.0)]
        )
        for gsd_m in (None, 100.0):
            with pytest.raises(
                AreaError, match=r"no height in the DEM, which covers longitude 0\.\.0\.0989"
            ):
                terrain_from_area(dems, Area(50.0, 10.0, 2.0), gsd_m)

    def test_all_nodata(self, tmp_path: Path) -> None:
        dems = DemSet.open(
            [geotiff(tmp_path / "a.tif", np.full((30, 30), np.nan, np.float32), 0.0, 3000.0, 100.0)]
        )
        with pytest.raises(AreaError, match="no height in the DEM"):
            terrain_from_area(dems, Area(0.05, 0.05, 1.0))

    def test_a_hole_at_the_centre_does_not_decide_the_cell(self, tmp_path: Path) -> None:
        heights = np.full((31, 31), 5.0, np.float32)
        heights[12:19, 12:19] = np.nan
        dems = DemSet.open([geotiff(tmp_path / "a.tif", heights, -1550.0, 1550.0, 100.0)])
        terrain = terrain_from_area(dems, Area(0.0, 0.0, 2.0))
        assert terrain.field.gsd_m == 100.0
        assert np.isnan(terrain.field.z_m[10, 10])
        assert terrain.product_index[10, 10] == -1
        assert terrain.field.z_m[0, 0] == pytest.approx(5.0 - 1.0 / 1.7374, abs=0.01)

    def test_part_of_the_area_outside_is_nan(self, tmp_path: Path) -> None:
        dems = DemSet.open(
            [geotiff(tmp_path / "a.tif", np.full((30, 30), 5.0, np.float32), 0.0, 3000.0, 100.0)]
        )
        z = terrain_from_area(dems, Area(0.0, 0.05, 2.0), 100.0).field.z_m
        assert np.isnan(z[:, 0]).all()
        assert np.isfinite(z[:, -1]).all()

    def test_a_terrain_without_any_ground_is_for_the_caller_to_judge(self, tmp_path: Path) -> None:
        dems = DemSet.open(
            [geotiff(tmp_path / "a.tif", np.full((30, 30), 5.0, np.float32), 0.0, 3000.0, 100.0)]
        )
        assert np.isnan(
            build_terrain(dems, EnuFrame(90.0, 0.0), NodeWindow(0, 5, 0, 5), 100.0).field.z_m
        ).all()

    def test_too_many_nodes_and_bad_cells(self, flat: DemSet) -> None:
        with pytest.raises(AreaError, match="coarser `gsd_m`"):
            terrain_from_area(flat, Area(0.0, 0.0, 1000.0), 1.0)
        for gsd_m in (0.0, -1.0, float("nan")):
            with pytest.raises(AreaError, match="positive"):
                terrain_from_area(flat, Area(0.0, 0.0, 10.0), gsd_m)
        with pytest.raises(AreaError, match="ring"):
            build_terrain(flat, EnuFrame(0.0, 0.0), NodeWindow(0, 5, 0, 5), 100.0, ring_m=-1.0)
