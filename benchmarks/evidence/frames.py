"""Simulated frames: an independent renderer sees a clone of the DEM, with height errors, unmapped brightness and noise as the
catalogue's error model states them.

    python -m benchmarks.evidence frames [-o FOLDER] [--data FOLDER] [--frames 200]

`lcp build-catalog` builds a catalogue of each site from the DEM as it is. A frame looks at a random place of it from a random
direction under a random Sun that can stand there, in pixels of 0.9 to 2 cells. Embree traces it over a new clone
(`tests/helpers/dem_clones.py`). Every point in view is searched for from the true camera, within the search radius of the build.
Then the frame is offered from a place and an attitude that are a little wrong, and located: the squared error of the position over
the covariance that `lcp query` states before is 3 in the mean if that covariance is true. Finished frames are kept in the folder.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.evidence.catalogues import by_command
from benchmarks.evidence.scores import (
    arrays,
    bins_table,
    kept,
    scores_table,
    together_table,
    write_diagrams,
)
from benchmarks.markdown import table
from benchmarks.sections import evidence_parser
from lcp_catalog.arrays import Array, Index, Mask
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import pixel_size_m
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.images.image import Image
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.matching.options import USUAL
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.point_search import Criteria
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.navigation.expected_position import Query, answers
from lcp_catalog.navigation.frame_points import PlannedImage
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.validation.claims import Claims, ClaimSearch
from tests.helpers.closed_loops import Draw, Shot, Site, embree_frame
from tests.helpers.dem_clones import Errors, clone
from tests.helpers.embree_camera import Ground
from tests.helpers.embree_mesh import Nodes, mcmf, read_nodes
from tests.helpers.posed import turned

LAW = "lommel-seeliger"  # that of the independent renderer
BITS = 12
SEED = 15
SMOOTH_TOML = (
    "[errors]\nshadow_shift = 0.0\n"  # the ground has no relief that the DEM's cells do not show
    # the clone's height errors and brightness are independent of the ground: all of the noise displaces matches
    "moving_share = 1.0\ncontrast_power = 0.0\n"
    '[model]\nalbedo = "none"\n'  # and no brightness but that of the error model
)
MARGIN = 1.2
"""Half the patch, times this, lies between a point that counts and the frame's border: patches are turned and foreshortened."""
REACH_M = 190e3  # of the mesh around a site's centre
BEFORE = USUAL
"""What is known of the camera before, as `lcp query` takes it for the probability to be located."""
INSIDE_95 = 7.8147  # 95th percentile of chi-square with three degrees of freedom
PIXEL_BINS = (0.9, 1.1, 1.5, 2.0)
SUN_BINS = (5, 10, 15, 20, 30, 37.5, 52.5, 65)


@dataclass(frozen=True)
class Place:
    """The DEM of a site, and the area of its catalogue."""

    dem: str  # in the shared data
    center_deg: tuple[float, float]
    size_km: float = 110.0
    gsd_m: float = 474.0
    spacing_km: float = 8.0


PLACES = {
    "descartes": Place(
        "images/apollo16-metric-series/gld100_064ppd_lat-16_-02_lon-01_020.tif", (9.5, -9.0)
    ),
    "farside": Place(
        "images/apollo15-metric-farside/gld100_064ppd_lat-28_-13_lon132-155.tif", (143.5, -20.5)
    ),
}
DRAW = Draw(
    fov_deg=(10.0, 40.0),
    off_nadir_deg=(0.0, 30.0),
    sun_elevation_deg=(5.0, 65.0),
    pixel_cells=(0.9, 2.0),
    size_px=256,
)


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame: how it was taken, the claims with their trials, what is stated before of its position, the covariance
    (m^2, MCMF, NaN: none) and the probability that it is located, and the error of the solved position (NaN: not located).
    """

    site: str
    shot: Shot
    claims: Claims
    covariance: Array  # (3, 3)
    chance: float
    error_m: Array  # (3,)

    @property
    def squared(self) -> float:
        """Squared error over the stated covariance, three degrees of freedom; NaN without either."""
        return float(self.error_m @ np.linalg.solve(self.covariance, self.error_m))


def work(folder: Path, data: Path, count: int) -> list[Frame]:
    """So many frames over all sites in turn; those in the folder are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    frames: list[Frame] = []
    for k, (name, place) in enumerate(PLACES.items()):
        own = count // len(PLACES) + (k < count % len(PLACES))
        if own:
            frames += _of_site(folder, data, name, place, own)
    return frames


def _of_site(folder: Path, data: Path, name: str, place: Place, count: int) -> list[Frame]:
    dem = data / place.dem
    catalog = open_catalog(built(folder / f"{name}.h5", dem, place))
    nodes: Nodes | None = None
    frames = []
    for shot, camera in Site(name, dem, catalog).shots(count, SEED, DRAW):
        path = folder / f"{name}-{shot.number}.npz"
        if not path.exists():
            nodes = nodes or read_nodes(dem, *place.center_deg, REACH_M)
            photo = taken(catalog, nodes, place, shot, camera)
            stated, chance, error = _positioned(catalog, photo, camera, shot.number)
            claims = arrays(_tried(catalog, photo, camera))
            beside = path.with_suffix(".part.npz")
            facts: dict[str, Any] = {
                "shot": json.dumps(asdict(shot)),
                "stated": stated,
                "chance": chance,
            }
            np.savez(beside, error=error, **facts, **claims)
            beside.rename(path)
            print(path.name, flush=True)
        frames.append(_kept(path, name))
    return frames


def built(path: Path, dem: Path, place: Place) -> Path:
    """The catalogue of a site, built by the command unless it is there."""
    centre = [str(v) for v in place.center_deg]
    where = ["--center", *centre, "--size", str(place.size_km), "--gsd", str(place.gsd_m)]
    how = ["--spacing", str(place.spacing_km), "--reflectance", LAW]
    config = path.with_suffix(".toml")
    config.write_text(SMOOTH_TOML, encoding="utf-8")
    if by_command(path, dem, [*where, *how, "--config", str(config)]) is None:
        raise SystemExit(f"{path.name}: the build failed")
    return path


def taken(catalog: Catalog, nodes: Nodes, place: Place, shot: Shot, camera: Camera) -> Image:
    """A frame of a new clone by the independent renderer."""
    model = catalog.errors
    errors = Errors(*(float(model[k]) for k in Errors.__dataclass_fields__))
    surface, brightness = clone(nodes, errors, np.random.default_rng([SEED, shot.number]))
    ground = Ground(surface, mcmf(*place.center_deg), brightness)
    snr = 1.0 / float(model["sensor_noise"])
    # rays are random: with 4 a pixel the mean of a pixel scatters by 0.09 of the mean brightness at 9 deg of Sun, more than the
    # noise of 0.07; with 16 by 0.045 (0.02 at 20 deg)
    return embree_frame(ground, camera, snr, BITS, samples=4, seed=shot.number)


def _tried(catalog: Catalog, photo: Image, camera: Camera) -> Claims:
    """Claims on the points whose patches are whole, searched for from the true camera."""
    rows = points_in_view(catalog, photo.sensor)
    rows = rows[_whole(catalog, camera, rows)]
    search = ClaimSearch(catalog, photo, reflectance_model(LAW), Criteria(), photo.sensor)
    return search.claims(rows, searched=True)


def _positioned(
    catalog: Catalog, photo: Image, camera: Camera, number: int
) -> tuple[Array, float, Array]:
    """The covariance of the position and the probability to be located that are stated before, and the error of the
    solved position.
    """
    query = Query(attitude_sigma_rad=BEFORE.attitude_rad)
    (answer,) = answers(catalog, [PlannedImage.lit(camera, SunChoice())], query)
    stated = answer.position.position_covariance_m2
    known = np.linalg.inv(np.full((3, 3), np.nan) if stated is None else stated)
    known = known + np.eye(3) / BEFORE.position_m**2  # what `locate` is told beside the attitude
    dice = np.random.default_rng([SEED, 1, number])
    wrong = replace(
        camera,
        position_mcmf_m=camera.position_mcmf_m + dice.normal(0.0, BEFORE.position_m, 3),
        rotation_mcmf_to_camera=turned(dice.normal(0.0, BEFORE.attitude_rad, 3))
        @ camera.rotation_mcmf_to_camera,
    )
    fix = locate(catalog, photo.with_sensor(wrong), BEFORE, reflectance_model(LAW))
    error = np.full(3, np.nan)
    if fix.pose is not None:
        error = fix.pose.position_mcmf_m - camera.position_mcmf_m
    return np.linalg.inv(known), answer.joint.located, error


def _whole(catalog: Catalog, camera: Camera, rows: Index) -> Mask:
    """True for points whose whole patch lies in the frame."""
    places = catalog.position_mcmf[rows]
    half = 0.5 * MARGIN * catalog.patch_nodes * catalog.gsd[rows] / pixel_size_m(camera, places)
    pixels, last = camera.project(places), np.array(camera.shape[::-1]) - 1.0
    inside = (pixels > half[:, None]) & (pixels < last - half[:, None])
    return np.asarray(inside.all(axis=1))


def _kept(path: Path, site: str) -> Frame:
    with np.load(path) as saved:
        shot = Shot(**json.loads(str(saved["shot"])))
        return Frame(
            site, shot, kept(saved), saved["stated"], float(saved["chance"]), saved["error"]
        )


# -- tables


def groups_of(frames: list[Frame]) -> dict[str, list[Frame]]:
    """All frames, and those of each site, Sun and size of the pixel."""
    groups = {"all": frames}
    groups |= {site: [f for f in frames if f.site == site] for site in PLACES}
    for low, high in pairwise(SUN_BINS):
        here = [f for f in frames if low <= f.shot.sun_elevation_deg < high]
        groups[f"Sun {low:g}..{high:g} deg"] = here
    for low, high in pairwise(PIXEL_BINS):
        cells = [(f, f.shot.pixel_m / PLACES[f.site].gsd_m) for f in frames]
        groups[f"pixel {low:g}..{high:g} cells"] = [f for f, size in cells if low <= size < high]
    return {name: some for name, some in groups.items() if some}


def positions_table(groups: dict[str, list[Frame]]) -> str:
    """Stated covariances against errors of the positions."""
    rows = []
    for name, some in groups.items():
        judged = [f for f in some if np.isfinite(f.squared)]
        squared = np.array([f.squared for f in judged])
        errors = [float(np.linalg.norm(f.error_m)) for f in judged]
        stated = [float(np.sqrt(np.trace(f.covariance))) for f in judged]
        located = sum(bool(np.isfinite(f.error_m).all()) for f in some)
        expected = sum(bool(np.isfinite(f.covariance).all()) for f in some)
        chance = f"{sum(f.chance for f in some):.1f}"
        cells = ["-"] * 4
        if judged:
            inside = np.mean(squared <= INSIDE_95)
            cells = [
                f"{squared.mean() / 3.0:.2f}",
                f"{inside:.2f}",
                f"{np.median(errors):.0f}",
                f"{np.median(stated):.0f}",
            ]
        rows.append([name, len(some), expected, chance, located, *cells])
    head = [
        "",
        "frames",
        "with a stated position",
        "located: stated",
        "located",
        "squared error / 3",
        "within 95 %",
    ]
    return table([*head, "error, m (median)", "stated, m (median)"], rows)


def main(words: Sequence[str]) -> int:
    parser = evidence_parser("frames", __doc__, "frames")
    parser.add_argument("--frames", type=int, default=200)
    asked = parser.parse_args(words)
    groups = groups_of(work(asked.output, asked.data, asked.frames))
    claims = {name: [f.claims for f in some] for name, some in groups.items()}
    few = {name: some for name, some in claims.items() if not name.startswith(("Sun", "pixel"))}
    text = "\n\n".join(
        [scores_table(claims), bins_table(few), together_table(few), positions_table(groups)]
    )
    (asked.output / "frames.md").write_text(text + "\n", encoding="utf-8")
    write_diagrams(asked.output / "frames.html", "Simulated frames", claims)
    print(text)
    return 0
