"""A line scanner's image of real terrain, traced line by line, located from wrong positions. Every
sample of every line has its own origin and ray, so that a matcher or a solver that took the scanner
for a frame could not find its points.
"""

import numpy as np
import pytest
from helpers.catalogs import HADLEY as HADLEY_DEM
from helpers.twins_match import catalog_of_dem

from lcp_catalog.cameras.distortion import FocalPlane, NoLens
from lcp_catalog.cameras.scanners import BEYOND, LineScanner
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.cameras.trajectory import Attitude, Track, Trajectory
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.geometry.rotations import quaternion_of
from lcp_catalog.images.image import Image
from lcp_catalog.matching.fix import LOCATED
from lcp_catalog.matching.pose import position_error
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.photometry.laws import photometry, reflectance_model
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.terrain import build_terrain
from lcp_catalog.validation.ground_comparison import RenderSettings, WindowChoice, against_dem

FRAME = EnuFrame(3.6, 26.1)
SUN = direction_enu(97.0, 22.0)
LINES, COLUMNS, LINE_S = 240, 220, 0.075
ALTITUDE_M, PIXEL_M, SPEED_M_S = 60e3, 120.0, 1600.0
RAYS = 2
LAW = reflectance_model("lommel-seeliger")


def scanner() -> LineScanner:
    """A scanner flying south-south-east over the place, looking down, with a sway of 2 mrad (a
    pixel) over 40 lines.
    """
    heading = direction_enu(160.0, 0.0)
    times = LINE_S * (np.arange(-BEYOND, LINES + BEYOND) - LINES / 2)
    positions = FRAME.to_mcmf([0.0, 0.0, ALTITUDE_M] + SPEED_M_S * times[:, None] * heading)
    turns = []
    for t, position in zip(times, positions, strict=True):
        ahead = -position / np.linalg.norm(position)
        ahead = ahead + 2e-3 * np.sin(2.0 * np.pi * t / (40 * LINE_S)) * FRAME.direction_to_mcmf(
            np.cross(heading, [0.0, 0.0, 1.0])
        )
        ahead /= np.linalg.norm(ahead)
        right = np.cross(FRAME.direction_to_mcmf(heading), ahead)
        right /= np.linalg.norm(right)
        turns.append(quaternion_of(np.stack([right, np.cross(ahead, right), ahead])))
    still = Attitude(times[:1], np.array([[1.0, 0.0, 0.0, 0.0]]))
    way = Trajectory(
        Track(times, positions),
        still,
        Attitude.of_table(times, np.array(turns), np.eye(3)),
        fixed=True,
    )
    plane = FocalPlane(ALTITUDE_M / PIXEL_M, ((COLUMNS - 1) / 2.0, 0.0), NoLens())
    return LineScanner(
        name="swaying", image_shape=(LINES, COLUMNS), plane=plane, trajectory=way, times_s=times, line_px=0.0
    )  # fmt: skip


@pytest.fixture(scope="module")
def photo() -> Image:
    """`RAYS` x `RAYS` rays per pixel, 2 % of noise."""
    window = NodeWindow(-170, 171, -170, 171)
    field = build_terrain(DemSet.open([HADLEY_DEM], ()), FRAME, window, 118.45).field
    sensor = scanner()
    steps = (np.arange(RAYS) + 0.5) / RAYS - 0.5
    columns = (np.arange(COLUMNS)[:, None] + steps).ravel()
    light = np.empty((LINES * RAYS, len(columns)))
    for k, row in enumerate((np.arange(LINES)[:, None] + steps).ravel()):
        origins, rays = sensor.looks(np.stack([columns, np.full(len(columns), row)], axis=-1))
        origin, ahead = FRAME.from_mcmf(origins[0]), FRAME.direction_from_mcmf(rays)
        points = origin + field.first_hits(origin, ahead)[:, None] * ahead
        normals = field.normals_at(points[:, 0], points[:, 1])
        lit = ~field.occluded_points(points, SUN)
        light[k] = photometry(normals, SUN, -ahead, lit, np.isfinite(points[:, 2]), LAW).radiance
    image = light.reshape(LINES, RAYS, COLUMNS, RAYS).mean(axis=(1, 3))
    image += 0.02 * np.nanmean(image) * np.random.default_rng(1).normal(size=image.shape)
    sun = FRAME.direction_to_mcmf(SUN)
    weight = np.isfinite(image).astype(np.float32)
    return Image("swaying", image.astype(np.float32), weight, sensor, sun_direction_mcmf=sun)


@pytest.fixture(scope="module")
def catalog():
    along = np.linspace(-0.36, 0.36, 7)
    lon, lat = (
        grid.ravel() for grid in np.meshgrid(FRAME.lon_deg + 1.1 * along, FRAME.lat_deg + along)
    )
    return catalog_of_dem(lon, lat, 25, 118.45, HADLEY_DEM)


@pytest.mark.slow
def test_the_whole_image_is_seen(photo) -> None:
    assert photo.valid.mean() > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_it_is_located_from_a_wrong_position(photo, catalog, seed) -> None:
    known = photo.sensor
    wrong = 1000.0 * np.random.default_rng(seed).normal(size=3)
    given = photo.with_sensor(known.moved([*wrong, 0.0, 0.0, 0.0]))
    found = locate(catalog, given, Uncertainty(1000.0), LAW)
    assert found.verdict == LOCATED, found.reason
    assert found.matches.found.sum() >= 20
    off = position_error(found.pose, known)
    assert off.error.whole_m < 0.5 * PIXEL_M
    assert off.squared < 16.0  # 3 expected, chance of more 0.1 %
    residual = found.matches.found_px - known.project(catalog.position_mcmf[found.matches.point])
    residual = residual[found.matches.found]
    assert np.abs(residual.mean(axis=0)).max() < 0.1  # no half pixel, no line late
    assert np.abs(residual).max() < 1.0  # a frame in its place would be a pixel off where it sways


@pytest.mark.slow
def test_the_whole_image_looks_like_the_dem(photo) -> None:
    """Rendered as each line saw it, at what the DEM resolves (1 km): the comparison smooths the image
    to that, and finer cells would show the render's detail beside an image without it.
    """
    choice = WindowChoice(6, 6, 1000.0)
    found = against_dem(photo, DemSet.open([HADLEY_DEM]), RenderSettings(LAW), choice).windows
    assert found.count >= 12
    assert found.share_above(0.95) > 0.9
