"""The test vector of the C reference: nine patches of Hadley, a simulated frame through a lens with distortion, and what Python
finds in it. `python -m tests.helpers.flight_vector FOLDER` writes it anew.
"""

from __future__ import annotations

import copy
import json
import sys
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from lcp_cli.main import run

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.exports.export import export
from lcp_catalog.exports.flight import FlightFile, KeptConditions, stored
from lcp_catalog.geometry.frames import EnuFrame, lonlat_to_mcmf
from lcp_catalog.images.image import Image
from lcp_catalog.matching.matches import CODE
from lcp_catalog.matching.point_search import (
    Criteria,
    SearchImage,
    _judge_search,
    _judge_templates,
    _refined,
    _SearchTask,
    _sought,
)
from lcp_catalog.matching.pose import Pose, solve
from lcp_catalog.matching.templates import Templates, render_patches
from lcp_catalog.photometry.law_choice import law_of

from . import catalogs, twins_match

CENTRE = (3.6, 26.1)
GSD_M = 118.45
UNKNOWN = Uncertainty(position_m=np.inf, attitude_rad=np.inf)


@dataclass(frozen=True, eq=False)
class PythonMatch:
    """What the library finds of one point alone: the samples of a drawing follow the closest nodes of a call."""

    shown: Templates
    found: np.ndarray  # of `kernels.matching.search`
    precise: np.ndarray  # of `kernels.matching.subpixel_fit`
    shift: np.ndarray
    reason: str  # why it is not searched or not found; empty for none

    @cached_property
    def pixel(self) -> np.ndarray:
        """The place found; NaN for none."""
        return np.asarray(self.shown.predicted_px[0] + self.shift + self.precise[:2])

    @property
    def is_good(self) -> bool:
        """True for a match that the example of the reference believes."""
        return bool(self.precise[2] > 0.8 and not self.found[3] > self.precise[2] - 0.1)


def match(
    catalog: Catalog, row: int, image: SearchImage, law: str, reach: int, sigma: float = 0.5
) -> PythonMatch:
    """Render, search and fit one point (a row of the catalogue)."""
    rows, model = np.array([row]), law_of(law)
    assert model is not None
    suns = image.source.sun_directions(catalog.position_mcmf[rows])
    shown = render_patches(catalog, rows, image.source.sensor, suns, model, psf_sigma_px=sigma)
    task = _SearchTask(catalog, image, model, Criteria(psf_sigma_px=sigma), False)
    found = _sought(task, shown, shown.origin, np.array([float(reach)]), np.zeros(1, np.uint8))
    known = np.isfinite(found[:, 2])
    shift = np.where(known[:, None], found[:, :2], 0.0).astype(np.int64)
    precise = _refined(task, shown, shown.origin + shift, known, True)
    code = np.zeros(1, np.uint8)
    _judge_templates(shown, task.criteria, code)
    _judge_search(task, shown, shown.origin, found, code)
    reason = next((name for name, number in CODE.items() if number == code[0] > 0), "")
    return PythonMatch(shown, found[0], precise[0], shift[0], reason)


def solved(camera: Camera, places: Any, pixels: Any, covariances: Any) -> Pose:
    """The camera from matches that are all believed, without a prior; covariances (n, 3): xx, xy, yy."""
    full = np.asarray(covariances)[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    return solve(camera, places, pixels, full, UNKNOWN, np.ones(len(full), bool))


def site(side: int, step_deg: float) -> Catalog:
    """Patches of 33 x 33 nodes on a square grid around `CENTRE`, good or bad as control points, with made-up claims."""
    along = (np.arange(side) - 0.5 * (side - 1)) * step_deg
    lon, lat = (grid.ravel() for grid in np.meshgrid(CENTRE[0] + 1.1 * along, CENTRE[1] + along))
    content = catalogs.arrays(side * side)
    names = ("detection_probability", "sigma_major", "sigma_minor", "sigma_angle", "condition")
    names += ("sun_elevation_min", "sun_elevation_max")
    claims = {name: content[name] for name in names}
    return replace(twins_match.catalog_of_dem(lon, lat, 33, GSD_M), **claims)


def as_stored(catalog: Catalog, path: Path) -> tuple[Catalog, list[int]]:
    """The catalogue with the heights as the flight file of it has them, and the number there of each of its rows."""
    points = FlightFile.of(path).points
    ids = points["point_id"].tolist()
    numbers = [ids.index(int(one)) for one in catalog.point_id]
    out = copy.copy(catalog)
    vars(out)["dem"] = stored(points, "heights")[numbers].astype(np.float32)
    return out, numbers


def simulated(
    camera: Camera, sun_deg: tuple[float, float], gsd_m: float, folder: Path
) -> tuple[Camera, np.ndarray]:
    """A frame of Hadley in 8 bits, (rows, cols), under a Sun at its zenith at a longitude and a latitude; the camera with it."""
    sun = 1.5e11 * lonlat_to_mcmf(*sun_deg) / MOON_RADIUS_M
    camera = replace(camera, sun_position_mcmf_m=sun)
    frame, picture = folder / "frame.json", folder / "frame.png"
    frame.write_text(json.dumps(camera.to_json()))
    words = f"simulate {catalogs.HADLEY} --camera {frame} -o {picture} --sun point --gsd {gsd_m} --accuracy draft --overwrite"
    if code := run(words.split()):
        raise SystemExit(f"the frame cannot be simulated: exit {code}")
    return camera, np.asarray(cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE))


def searched(grey: np.ndarray, camera: Camera) -> SearchImage:
    """A frame with all pixels valid, as the matcher takes it."""
    light, weight = grey.astype(np.float32), np.ones(grey.shape, np.float32)
    return SearchImage.of(Image("frame", light, weight, camera, camera.sun_position_mcmf_m))


def write(folder: Path) -> None:
    """Write ``vector.lcpf``, ``vector.pgm``, ``vector_camera.txt`` and ``vector_expected.txt``."""
    catalog, suns = site(3, 0.17), np.zeros((8, 24), bool)
    suns[3:5, 6:9] = True
    kept = KeptConditions(np.arange(9), np.array([True, False, False]), suns)
    export(catalog, folder / "vector.lcpf", image_scale=2.0, conditions=kept, overwrite=True)
    place = EnuFrame(*CENTRE, -1500.0)
    camera = twins_match.looking_at(place, 60e3, 6.0, 250.0, 35.0, 330.0, (124, 116))
    camera = replace(camera, distortion=np.array([-0.08, 0.02, 1e-3, -5e-4, 0.0]))
    with TemporaryDirectory() as aside:
        camera, grey = simulated(camera, (CENTRE[0] + 65.0, 1.0), GSD_M, Path(aside))
    cv2.imwrite(str(folder / "vector.pgm"), grey)
    known = camera.moved([40.0, -60.0, 30.0, 2e-3, -1e-3, 1e-3])  # the example knows it so
    numbers = [
        *known.position_mcmf_m,
        *known.rotation_mcmf_to_camera.ravel(),
        known.focal_length_px,
    ]
    numbers += [*known.principal_point_px, *known.distortion, *known.sun_position_mcmf_m]
    lines = "\n".join(repr(float(one)) for one in numbers)
    (folder / "vector_camera.txt").write_text(lines + "\n")
    image = searched(grey, known)
    found = [match(catalog, k, image, "lunar-lambert", 16) for k in range(9)]
    good = [k for k, one in enumerate(found) if one.is_good]
    places, pixels = catalog.position_mcmf[good], [found[k].pixel for k in good]
    pose = solved(known, places, pixels, [found[k].precise[3:6] for k in good])
    lines = "".join(
        f"{catalog.point_id[k]} {found[k].pixel[0]:.5f} {found[k].pixel[1]:.5f}\n" for k in good
    )
    x, y, z = pose.position_mcmf_m
    lines += f"position {x:.4f} {y:.4f} {z:.4f} {pose.position_sigma_m:.4f}\n"
    (folder / "vector_expected.txt").write_text(lines)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
