"""Expected positions in simulated frames: `lcp query` states a covariance before the frame is taken; the frame is taken by an
independent renderer over a clone of the DEM (`claims_frames`), offered from a place and an attitude that are a little wrong, and
located. The error of the position, squared and over the stated covariance, is 1 in the mean if the covariance is true.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from claims_frames import LAW, PLACES, SEED, built, taken
from helpers.closed_loops import Draw, Site
from helpers.embree_mesh import read_nodes
from helpers.posed import turned

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.hdf5 import open_catalog
from lcp_catalog.images.image import Image
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.matching.position_fix import LOCATED, locate
from lcp_catalog.navigation.expected_position import Query, answers
from lcp_catalog.navigation.frame_points import PlannedImage
from lcp_catalog.photometry.laws import reflectance_model

BEFORE = Uncertainty(2000.0, float(np.radians(0.1)))
"""What is known of the camera before: 1 sigma of each axis of its place and attitude."""

DRAW = Draw(
    fov_deg=(20.0, 45.0),
    off_nadir_deg=(0.0, 20.0),
    sun_elevation_deg=(6.0, 40.0),
    pixel_cells=(0.8, 1.6),
    size_px=288,
)
REACH_M = 190e3
INSIDE_95 = 7.8147  # 95th percentile of chi-square with three degrees of freedom


@dataclass(frozen=True)
class Outcome:
    """A frame: the usable points, the expected covariance of the position, m^2, MCMF, and its error."""

    site: str
    number: int
    sun_elevation_deg: float
    pixel_m: float
    usable: int
    covariance: list[list[float]] | None
    verdict: str
    error_m: list[float] | None

    @property
    def squared(self) -> float:
        """Squared error over the stated covariance, three degrees of freedom; NaN without a position."""
        if self.covariance is None or self.error_m is None:
            return float("nan")
        off = np.array(self.error_m)
        return float(off @ np.linalg.solve(np.array(self.covariance), off))


def work(folder: Path, frames: Path, data: Path, count: int) -> list[Outcome]:
    """So many frames over all sites in turn; those in the folder are kept. The catalogues are those of the frames' section."""
    folder.mkdir(parents=True, exist_ok=True)
    frames.mkdir(parents=True, exist_ok=True)
    found: list[Outcome] = []
    for k, (name, place) in enumerate(PLACES.items()):
        own = count // len(PLACES) + (k < count % len(PLACES))
        if not own:
            continue
        dem, nodes = data / place.dem, None
        catalog = open_catalog(built(frames / f"{name}.h5", dem, place))
        for shot, camera in Site(name, dem, catalog).shots(own, SEED + 1, DRAW):
            path = folder / f"{name}-{shot.number}.json"
            if not path.exists():
                nodes = nodes or read_nodes(dem, *place.center_deg, REACH_M)
                photo = taken(catalog, nodes, place, shot, camera)
                about = (name, shot.number, shot.sun_elevation_deg, shot.pixel_m)
                path.write_text(json.dumps(asdict(outcome(catalog, photo, camera, about))))
                print(path.name, flush=True)
            found.append(Outcome(**json.loads(path.read_text())))
    return found


def outcome(
    catalog: Catalog,
    photo: Image,
    camera: Camera,
    about: tuple[str, int, float, float],
    before: Uncertainty = BEFORE,
) -> Outcome:
    """The expected and the solved position of a frame; ``about``: its site, number, Sun's elevation and pixel size."""
    query = Query(attitude_sigma_rad=before.attitude_rad)
    (answer,) = answers(catalog, [PlannedImage.lit(camera, SunChoice())], query)
    covariance = answer.position.position_covariance_m2
    offered = _offered(photo, camera, about[1], before)
    fix = locate(catalog, offered, before, reflectance_model(LAW))
    error = None
    if fix.verdict == LOCATED and fix.pose is not None:
        error = (fix.pose.position_mcmf_m - camera.position_mcmf_m).tolist()
    stated = None if covariance is None else covariance.tolist()
    return Outcome(*about, answer.usable, stated, fix.verdict, error)


def _offered(photo: Image, camera: Camera, number: int, before: Uncertainty) -> Image:
    """The image with a camera that is wrong by what is stated as known before."""
    dice = np.random.default_rng([SEED, 1, number])
    wrong = replace(
        camera,
        position_mcmf_m=camera.position_mcmf_m + dice.normal(0.0, before.position_m, 3),
        rotation_mcmf_to_camera=turned(dice.normal(0.0, before.attitude_rad, 3))
        @ camera.rotation_mcmf_to_camera,
    )
    return replace(photo, sensor=wrong)


HEAD = (
    "| | frames | with an expected position | located | squared error / 3 | within 95 % | error, m (median) | "
    "stated, m (median) |\n| --- |" + " ---: |" * 7
)


def report(outcomes: list[Outcome]) -> tuple[str, dict[str, Any]]:
    """Markdown and figures."""
    groups = {"all": outcomes}
    groups |= {site: [one for one in outcomes if one.site == site] for site in PLACES}
    for low, high in ((6.0, 15.0), (15.0, 25.0), (25.0, 40.0)):
        here = [one for one in outcomes if low <= one.sun_elevation_deg < high]
        groups[f"Sun {low:g}..{high:g} deg"] = here
    lines, figures = [HEAD], {}
    for name, some in groups.items():
        if some:
            figures[name] = _scored(some)
            cells = [f"{v:.3g}" if isinstance(v, float) else f"{v}" for v in figures[name].values()]
            lines.append("| " + " | ".join([name, *cells]) + " |")
    return "\n".join(lines) + "\n", figures


def _scored(some: list[Outcome]) -> dict[str, Any]:
    judged = [one for one in some if np.isfinite(one.squared)]
    squared = np.array([one.squared for one in judged])
    error = [float(np.linalg.norm(np.array(one.error_m))) for one in judged]
    stated = [float(np.sqrt(np.trace(np.array(one.covariance)))) for one in judged]
    nothing = float("nan")
    return {
        "frames": len(some),
        "expected": sum(one.covariance is not None for one in some),
        "located": sum(one.error_m is not None for one in some),
        "squared_error": float(squared.mean() / 3.0) if judged else nothing,
        "within_95": float((squared <= INSIDE_95).mean()) if judged else nothing,
        "error_m": float(np.median(error)) if judged else nothing,
        "stated_m": float(np.median(stated)) if judged else nothing,
    }
