"""Claims in simulated frames: an independent renderer sees a clone of the DEM, with height errors, unmapped brightness and
noise as the catalogue's error model states them.

`lcp build-catalog` builds a catalogue of each site from the DEM as it is. A frame looks at a random place of it from a random
direction under a random Sun that can stand there, in pixels of 0.9 to 2 cells. Embree traces it over a new clone
(`tests/helpers/dem_clones.py`). Every point in view is searched for from the true camera, within the search radius of the build.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from helpers.closed_loops import Draw, Shot, Site, embree_frame
from helpers.dem_clones import Errors, clone
from helpers.embree_camera import Ground
from helpers.embree_mesh import mcmf, read_nodes
from lcp_cli.main import run

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import pixel_size_m
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.hdf5 import open_catalog
from lcp_catalog.images.image import Image
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.point_search import Criteria, find_points
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.validation.claim_trials import ClaimSearch, search_radius_m
from lcp_catalog.validation.claims import Claims, Scores, score

LAW = "lommel-seeliger"  # that of the independent renderer
BITS = 12
SEED = 14
SMOOTH_TOML = (
    "[errors]\nshadow_shift = 0.0\n"  # the ground has no relief that the DEM's cells do not show
)
MARGIN = 1.2
"""Half the patch, times this, lies between a point that counts and the frame's border: patches are turned and foreshortened."""
REACH_M = 190e3  # of the mesh around a site's centre
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
NAMES = ("probability", "usable", "sigma_m", "angle_deg", "tried", "found", "error_m")


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame: how it was taken, and the claims with their trials."""

    site: str
    shot: Shot
    rows: np.ndarray  # of the catalogue
    claims: Claims
    accepted: np.ndarray  # (n,) bool, by the matcher, at the true place or not


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
    nodes, frames = None, []
    for shot, camera in Site(name, dem, catalog).shots(count, SEED, DRAW):
        path = folder / f"{name}-{shot.number}.npz"
        if not path.exists():
            nodes = nodes or read_nodes(dem, *place.center_deg, REACH_M)
            photo = taken(catalog, nodes, place, shot, camera)
            _keep(path, shot, *_tried(catalog, photo))
            print(path.name, flush=True)
        frames.append(_kept(path, name))
    return frames


def built(path: Path, dem: Path, place: Place) -> Path:
    """The catalogue of a site, built by the command unless it is there."""
    if not path.exists():
        centre = [str(v) for v in place.center_deg]
        where = ["--center", *centre, "--size", str(place.size_km), "--gsd", str(place.gsd_m)]
        how = ["--spacing", str(place.spacing_km), "--reflectance", LAW, "--jobs", "2"]
        config = path.with_suffix(".toml")
        config.write_text(SMOOTH_TOML, encoding="utf-8")
        words = ["build-catalog", str(dem), "-o", str(path), *where, *how, "--config", str(config)]
        if run(words):
            raise SystemExit(f"{path.name}: the build failed")
    return path


def taken(catalog: Catalog, nodes, place: Place, shot: Shot, camera: Camera) -> Image:
    """A frame of a new clone by the independent renderer."""
    model = catalog.errors
    errors = Errors(*(float(model[k]) for k in Errors.__dataclass_fields__))
    surface, brightness = clone(nodes, errors, np.random.default_rng([SEED, shot.number]))
    ground = Ground(surface, mcmf(*place.center_deg), brightness)
    snr = 1.0 / float(model["sensor_noise"])
    return embree_frame(ground, camera, snr, BITS, samples=2, seed=shot.number)


def _tried(catalog: Catalog, photo: Image) -> tuple[np.ndarray, Claims, np.ndarray]:
    """Rows of the points whose patches are whole, their claims, and which of them the matcher accepts anywhere."""
    rows = points_in_view(catalog, photo.sensor)
    rows = rows[_whole(catalog, photo.sensor, rows)]
    search = ClaimSearch(catalog, photo, reflectance_model(LAW), Criteria(), photo.sensor)
    reach = search_radius_m(catalog, rows) / pixel_size_m(photo.sensor, catalog.position_mcmf[rows])
    matches = find_points(catalog, photo, reflectance_model(LAW), reach, points=rows)
    return rows, search.claims(rows, searched=True), matches.found


def _whole(catalog: Catalog, camera: Camera, rows: np.ndarray) -> np.ndarray:
    """True for points whose whole patch lies in the frame."""
    places = catalog.position_mcmf[rows]
    half = 0.5 * MARGIN * catalog.patch_nodes * catalog.gsd[rows] / pixel_size_m(camera, places)
    pixels, last = camera.project(places), np.array(camera.shape[::-1]) - 1.0
    return ((pixels > half[:, None]) & (pixels < last - half[:, None])).all(axis=1)


def _keep(path: Path, shot: Shot, rows: np.ndarray, claims: Claims, accepted: np.ndarray) -> None:
    beside = path.with_suffix(".part.npz")
    arrays = {name: getattr(claims, name) for name in NAMES}
    np.savez(beside, shot=json.dumps(asdict(shot)), rows=rows, accepted=accepted, **arrays)
    beside.rename(path)


def _kept(path: Path, site: str) -> Frame:
    with np.load(path) as saved:
        shot = Shot(**json.loads(str(saved["shot"])))
        claims = Claims(**{name: saved[name] for name in NAMES})
        return Frame(site, shot, saved["rows"], claims, saved["accepted"])


# Tables


HEAD = (
    "| | frames | trials | usable | found of usable | within 3 sigma | usable of found | found of others | Brier | of the mean | "
    "calibration error | squared error |\n| --- |" + " ---: |" * 11
)


def line(name: str, frames: int, claims: Claims) -> str:
    """One row of `HEAD`. ``within 3 sigma``: share of the usable points that were found and lie within 3 stated sigma."""
    of, near = score(claims), share_near(claims)
    cells = [
        name,
        f"{frames}",
        f"{of.count}",
        f"{of.usable}",
        f"{of.found_of_usable:.3f}",
        f"{near:.3f}",
    ]
    cells += [f"{of.usable_of_found:.3f}", f"{of.found_of_unusable:.3f}", f"{of.brier:.4f}"]
    cells += [f"{of.brier_of_the_mean:.4f}", f"{of.expected_calibration_error:.4f}"]
    cells += [f"{of.normalised_squared_error:.2f} ({of.errors})"]
    return "| " + " | ".join(cells) + " |"


def share_near(claims: Claims) -> float:
    """Share of the usable points that were tried that were found within 3 stated sigma."""
    usable = claims.usable & claims.tried
    near = claims.found & (np.nan_to_num(claims.squared_error, nan=np.inf) <= 9.0)
    return float(near[usable].mean()) if usable.any() else float("nan")


def bins_of(scored: dict[str, Scores]) -> str:
    """Reliability by bin, counts in brackets."""
    lines = ["| predicted | " + " | ".join(scored) + " |", "| --- |" + " --- |" * len(scored)]
    for k in range(10):
        cells = []
        for of in scored.values():
            b = of.reliability[k]
            cells.append(f"{b.predicted:.2f} -> {b.observed:.2f} ({b.count})" if b.count else "-")
        lines.append(f"| {k / 10:.1f}..{(k + 1) / 10:.1f} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def report(frames: list[Frame]) -> tuple[str, dict[str, object], dict[str, Scores]]:
    """Markdown, figures for the JSON, and the scores for diagrams."""
    groups = {"all": frames}
    groups |= {site: [f for f in frames if f.site == site] for site in PLACES}
    for low, high in pairwise(SUN_BINS):
        here = [f for f in frames if low <= f.shot.sun_elevation_deg < high]
        groups[f"Sun {low:g}..{high:g} deg"] = here
    for low, high in ((0.9, 1.1), (1.1, 1.5), (1.5, 2.0)):
        gsd = 474.0
        groups[f"pixel {low:g}..{high:g} cells"] = [
            f for f in frames if low <= f.shot.pixel_m / gsd < high
        ]
    lines, figures, scored = [HEAD], {}, {}
    for name, some in groups.items():
        pooled = Claims.pooled([f.claims for f in some])
        if some and (pooled.tried & pooled.claimed).any():
            lines.append(line(name, len(some), pooled))
            scored[name] = score(pooled)
            figures[name] = scored[name].figures() | {
                "frames": len(some),
                "near": share_near(pooled),
            }
    lines += [
        "",
        bins_of({name: of for name, of in scored.items() if not name.startswith(("Sun", "pixel"))}),
    ]
    return "\n".join(lines) + "\n", figures, scored
