"""Frames and matches compared with images that Embree traces of the DEM's own mesh in MCMF, with a
camera written from the specification alone (`embree_camera`): a test of frames, signs, rolls and
half pixels. ``-rP`` prints the figures of every frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex", reason="Embree has wheels for Linux and Windows on x86-64 only")

from helpers.claiming import claiming
from helpers.closed_loops import cut
from helpers.dem_clones import Errors, clone
from helpers.embree_camera import Ground, Pinhole, above, photograph, read_out, sun_position
from helpers.embree_mesh import enu_axes, mcmf, read_nodes
from helpers.products import DEGREE_M, geotiff
from helpers.synthetic import cratered
from scipy import ndimage

from lcp_catalog.accuracy import TIERS
from lcp_catalog.arrays import Array
from lcp_catalog.cameras.frame_camera import Camera, camera_from_json
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.images.image import Image
from lcp_catalog.matching.point_choice import claimed
from lcp_catalog.matching.point_search import Criteria, find_points
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.simulation.detector import Detector
from lcp_catalog.simulation.frame import DemSurface, frame

LAW = reflectance_model("lommel-seeliger")
PER_DEGREE = 64
CELL_M = DEGREE_M / PER_DEGREE
SIZE = 140
BLUR_PX = 0.5
SHIFT_PX = 0.02
"""Accepted shift between two exact renders of one DEM, from the surface between its nodes and from
the noise of the rays.
"""
BIAS_PX = 0.05
CORRELATION = 0.98
"""Least correlation. At 58 S a pixel of the map is half as wide as it is high: the cells of the
render average what the mesh resolves; nine random rays per pixel add noise.
"""


@dataclass(frozen=True, eq=False)
class Site:
    """A synthetic DEM of the Moon, its mesh, and a catalogue of its middle."""

    lon_deg: float
    lat_deg: float
    dem: Path
    ground: Ground
    catalog: Catalog


PLACES = {
    "near north": (12.0, 31.0),
    "near south": (-20.0, -44.0),
    "far north": (140.0, 22.0),
    "far south": (201.0, -58.0),
}
VIEWS = [
    # off nadir, azimuth of the camera, roll, field, azimuth and elevation of the Sun
    (0.0, 0.0, 0.0, 30.0, 80.0, 25.0),
    (25.0, 40.0, 77.0, 20.0, 250.0, 18.0),
    (38.0, 290.0, 201.0, 12.0, 120.0, 40.0),
    (10.0, 170.0, 318.0, 45.0, 300.0, 12.0),
]
QUICK = [("near south", 1), ("far north", 2)]
"""Both hemispheres of latitude and of longitude, both oblique views."""
CASES = [
    pytest.param(name, number, marks=[] if (name, number) in QUICK else pytest.mark.slow)
    for name in PLACES
    for number in range(len(VIEWS))
]


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Site]:
    """Sites, made at their first use."""
    made: dict[str, Site] = {}

    def site(name: str) -> Site:
        if name not in made:
            made[name] = make_site(*PLACES[name], tmp_path_factory.mktemp("frames"))
        return made[name]

    return site


def make_site(lon: float, lat: float, folder: Path) -> Site:
    """Craters on fractal terrain, 150 km wide and smooth over a pixel, so that all renders show the
    same surface.
    """
    cols, rows = round(320 / np.cos(np.radians(lat))), 320
    made = ndimage.gaussian_filter(cratered(cols, CELL_M, seed=round(lon) % 97)[:rows], 1.0)
    west, north = lon - cols / 2 / PER_DEGREE, lat + rows / 2 / PER_DEGREE
    heights = made.astype("f4")
    path = geotiff(folder / "dem.tif", heights, west * DEGREE_M, north * DEGREE_M, CELL_M)
    ground = Ground.of(path, lon, lat, 110e3)
    step = np.arange(-3, 4) * 0.22
    east = step / np.cos(np.radians(lat))
    places = [(lon + x, lat + y) for y in step for x in east]
    return Site(lon, lat, path, ground, cut(path, places, 25, CELL_M))


def cameras(site: Site, number: int) -> tuple[Pinhole, Camera, Array]:
    """The independent camera of a view, the same camera read from its file, and the Sun."""
    off, azimuth, roll, fov, sun_azimuth, sun_elevation = VIEWS[number]
    pixel_m = 1.1 * CELL_M
    away = pixel_m * 0.5 * SIZE / np.tan(np.radians(fov) / 2.0)
    place = above(site.lon_deg, site.lat_deg, off, azimuth, away)
    middle = mcmf(site.lon_deg, site.lat_deg)
    judge = Pinhole.looking(middle, place, roll, fov, (SIZE, SIZE - 20))
    sun = sun_position(site.lon_deg, site.lat_deg, sun_azimuth, sun_elevation)
    return judge, camera_from_json(judge.document(sun)), sun


def shift_px(seen: Array, model: Array) -> Array:
    """Columns and rows by which the first image lies right of and below the second, with free gain
    and offset: three steps of least squares on spline-interpolated images.
    """
    inner, shift = np.s_[6:-6, 6:-6], np.zeros(2)
    for _ in range(3):
        moved = ndimage.shift(model, shift[::-1], order=3, mode="nearest")
        down, right = np.gradient(moved)
        columns = [-right[inner], -down[inner], moved[inner], np.ones_like(moved[inner])]
        a = np.stack([c.ravel() for c in columns], axis=1)
        solved, *_ = np.linalg.lstsq(a, seen[inner].ravel(), rcond=None)
        shift += solved[:2] / solved[2]
    return shift


@pytest.mark.slow
@pytest.mark.parametrize(("name", "number"), CASES)
def test_a_frame_and_its_matches_lie_where_embree_has_them(sites, name, number):
    site = sites(name)
    judge, camera, sun = cameras(site, number)
    light = photograph(site.ground, judge, sun, blur_px=BLUR_PX, samples=3, seed=number)
    require_telling(light)
    request = Request(
        DemSet.open([site.dem]),
        view=ViewChoice(camera),
        accuracy=TIERS["reference"],
        disc=False,
        model=LAW,
    )
    detector = Detector(blur_px=BLUR_PX)
    ours = frame(DemSurface.seen(request, detector.margin_px), camera, detector, 3).radiance
    shift = shift_px(light, ours.astype(float))
    photo = photo_of(light, camera, sun, number)
    count, bias = residuals(site.catalog, photo)
    correlation = np.corrcoef(light.ravel(), ours.ravel())[0, 1]
    print(f"{name} view {number}: shift {shift}, {correlation:.5f}; {count} matches: {bias}")
    assert correlation > CORRELATION
    assert np.abs(shift).max() < SHIFT_PX
    assert count >= 15
    assert np.abs(bias).max() < BIAS_PX


def photo_of(light: Array, camera: Camera, sun: Array, seed: int) -> Image:
    """The image of a detector with 10 bits and a signal-to-noise ratio of 50."""
    numbers = read_out(light, 50.0, 10, seed).astype(np.float32)
    weight = (numbers < 1023).astype(np.float32)
    return Image("embree", numbers, weight, camera, sun_position_mcmf_m=sun)


def residuals(catalog: Catalog, photo: Image) -> tuple[int, Array]:
    """Number of matches, and the mean (2,) of their places minus those of the true camera, weighted
    by their covariances.
    """
    matches = find_points(catalog, photo, LAW, 6.0)
    found = matches.found
    weight = 1.0 / matches.covariance_px2[found][:, [0, 1], [0, 1]]
    mean = np.sum(weight * matches.offset_px[found], axis=0) / np.sum(weight, axis=0)
    return int(found.sum()), mean


def require_telling(light: Array) -> None:
    """No pixel is missing, there is contrast, and most pixels are lit."""
    assert np.isfinite(light).all()
    assert light.std() / light.mean() > 0.1
    assert (light < 0.05 * light.mean()).mean() < 0.4


FACTOR = 4
ERRORS = Errors(24.5, 530.0, 0.05, 1900.0)


@pytest.mark.slow
def test_matches_are_better_in_a_reduced_image(sites):
    """Frames of clones of the DEM, taken by Embree with pixels of a quarter and reduced to those of the catalogue:
    templates as sharp as they are beside templates that assume 0.5 pixels of the reduced image (2 of the full one).
    Errors fall by 10 % (3 to 15 in single frames), no point is lost, and the claims fall alike.
    """
    site = sites("near south")
    taken = [reduced_frame(site, seed) for seed in (1, 2, 3)]
    sharp, dull = (
        [
            find_points(site.catalog, one, LAW, 6.0 * FACTOR, criteria=Criteria(psf_sigma_px=px))
            for one in taken
        ]
        for px in (0.5, 0.5 * FACTOR)
    )
    errors = [[], []]
    for ours, theirs in zip(sharp, dull, strict=True):
        assert ours.found.sum() >= theirs.found.sum() - 1 >= 40
        both = ours.found & theirs.found
        assert ours.correlation[both].mean() > theirs.correlation[both].mean()
        for name, one in zip(errors, (ours, theirs), strict=True):
            name.append(one.offset_px[both] / FACTOR)
    rms = [float(np.sqrt(np.mean(np.square(np.concatenate(one))))) for one in errors]
    assert 0.8 < rms[0] / rms[1] < 0.95
    own, full = (claim_of(site.catalog, taken[0], factor) for factor in (FACTOR, 1))
    assert own / full == pytest.approx(0.86, abs=1e-6)


def reduced_frame(site: Site, seed: int) -> Image:
    """A frame of a clone of a site's DEM, reduced to pixels of 1.1 cells."""
    nodes = read_nodes(site.dem, site.lon_deg, site.lat_deg, 110e3)
    surface, brightness = clone(nodes, ERRORS, np.random.default_rng(seed))
    middle, pixels = mcmf(site.lon_deg, site.lat_deg), SIZE * FACTOR
    away = 0.55 * CELL_M * SIZE / np.tan(np.radians(10.0))
    place = above(site.lon_deg, site.lat_deg, 10.0, 170.0, away)
    judge = Pinhole.looking(middle, place, 30.0, 20.0, (pixels, pixels))
    sun = sun_position(site.lon_deg, site.lat_deg, 100.0, 20.0)
    ground = Ground(surface, middle, brightness)
    light = photograph(ground, judge, sun, blur_px=BLUR_PX, samples=1, seed=seed)
    return photo_of(light, camera_from_json(judge.document(sun)), sun, seed).reduced(FACTOR)


def claim_of(catalog: Catalog, photo: Image, factor: int) -> float:
    """Claimed 1 sigma, metres, of the first point that has a claim, in an image of the same pixels that was reduced."""
    claims = claiming(catalog, 20.0, 0.5 * CELL_M)
    sensor = photo.sensor if factor > 1 else photo.sensor.full
    suns = photo.sun_directions(catalog.position_mcmf)
    stated = claimed(claims, np.arange(len(catalog)), sensor, suns).sigma_major_m
    return float(stated[np.isfinite(stated)][0])


# The judge judged


def test_the_judges_camera_is_opencvs():
    """`cv2.projectPoints` without distortion; rays and pixels are inverse to each other."""
    import cv2

    place = above(33.0, -41.0, 20.0, 70.0, 4e5)
    camera = Pinhole.looking(mcmf(33.0, -41.0), place, 123.0, 30.0, (300, 200))
    around = np.random.default_rng(3).uniform(-2, 2, (2, 50))
    points = mcmf(33.0 + around[0], -41.0 + around[1], 500.0)
    f, (cx, cy) = camera.focal_px, camera.principal_px
    matrix = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1.0]])
    turn, _ = cv2.Rodrigues(camera.axes)
    theirs, _ = cv2.projectPoints(points - place, turn, np.zeros(3), matrix, None)
    np.testing.assert_allclose(camera.pixels(points), theirs[:, 0], atol=1e-6)
    column, row = camera.pixels(points).T
    looks = camera.directions(column, row)
    away = points - place
    np.testing.assert_allclose(
        looks, away / np.linalg.norm(away, axis=1, keepdims=True), atol=1e-12
    )


@pytest.mark.parametrize("roll", [0.0, 90.0, 217.0])
@pytest.mark.parametrize("place", PLACES.values())
def test_a_roll_is_clockwise_from_north_up(place, roll):
    """Terrain north of the middle is above it in the image; for a camera rolled clockwise it turns
    the other way.
    """
    lon, lat = place
    camera = Pinhole.looking(mcmf(lon, lat), above(lon, lat, 0.0, 0.0, 1e5), roll, 30.0, (99, 99))
    np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.axes) == pytest.approx(1.0)
    east, north, _ = enu_axes(lon, lat)
    for ground, clockwise in ((north, 0.0), (east, 90.0)):
        column, row = camera.pixels(mcmf(lon, lat) + 2e3 * ground) - np.array([49.0, 49.0])
        turned = np.radians(clockwise - roll)
        assert np.arctan2(column, -row) == pytest.approx(
            np.arctan2(np.sin(turned), np.cos(turned)), abs=1e-2
        )


def test_the_shift_is_the_images():
    wide = ndimage.gaussian_filter(np.random.default_rng(2).random((90, 100)), 2.0)
    moved = 3.0 * ndimage.shift(wide, (-0.21, 0.34), order=5) + 1.0
    np.testing.assert_allclose(shift_px(moved, wide), [0.34, -0.21], atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["half a pixel", "mirrored roll", "east is west"])
def test_the_comparison_finds_faults(sites, fault):
    """A camera file with a small error gives another place, or no match."""
    site = sites("near north")
    judge, camera, sun = cameras(site, 0 if fault == "half a pixel" else 1)
    light = photograph(site.ground, judge, sun, blur_px=BLUR_PX, samples=2, seed=1)
    document = camera.to_json()
    axes = np.array(document["rotation_mcmf_to_camera"])
    if fault == "half a pixel":
        document["principal_point_px"] = [p + 0.5 for p in document["principal_point_px"]]
    elif fault == "mirrored roll":
        document["rotation_mcmf_to_camera"] = (np.diag([-1.0, -1.0, 1.0]) @ axes).tolist()
    else:
        light = light[:, ::-1]
    wrong = camera_from_json(document)
    count, bias = residuals(site.catalog, photo_of(light, wrong, sun, 1))
    assert count < 10 or np.abs(bias).max() > BIAS_PX
    if fault == "half a pixel":
        np.testing.assert_allclose(bias, -0.5, atol=BIAS_PX)
