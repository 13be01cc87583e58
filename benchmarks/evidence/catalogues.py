"""Catalogues for the photographs: Apollo 15 Metric frames with their cameras, and the map-projected Apollo 16 series.

For each Apollo 15 frame `lcp build-catalog` builds a catalogue of the ground that it shows, under the Suns around its own (four
elevations and two azimuths), from GLD100 and the relative albedo map; for the Apollo 16 series one catalogue under 30 Suns, with
the package's albedo map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from lcp_cli.main import run

from lcp_catalog.arrays import Array
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.map_projected import MapImage
from lcp_catalog.cameras.sensor import POSE
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import EnuFrame, azimuth_elevation, mcmf_to_lonlat
from lcp_catalog.geometry.sphere_intersection import hits
from lcp_catalog.images.image import Image
from lcp_catalog.validation.run import ImageFiles
from tests.helpers import apollo_maps, located_frames
from tests.helpers.apollo_frames import SERIES, series_dem

LAW = "lunar-lambert"
ALBEDO = "albedo/relative_albedo_11ppd.tif"
SUN_STEP_DEG = 10.0
ELEVATIONS_DEG = (2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 75.0)
SERIES_TOML = """[errors]
sensor_noise = 0.12
height_sigma_m = 87.0
height_length_m = 1420.0
albedo_sigma = 0.079
albedo_length_m = 7200.0
position_sigma_m = 150.0
spread = 0.27
detection_shift = 0.08
[points]
patch_nodes = 25
[model]
direction_tolerance_deg = 1.5
"""
"""Catalogues for the Apollo 16 series: the error model as fitted to 16 frames, 8 of them above 45 deg of Sun, with
`validation.error_fit` and the package's albedo map (its pixels are samples of finer scans, not means over their area, so that
errors of the heights are not averaged), and patches as large as 25 of its pixels. The shift was fitted to the claims on the 26
frames of even numbers.
"""
SERIES_CELL_M = 1280.0
SERIES_SPACING_KM = 15.0
SERIES_BOUNDS_DEG = (0.5, -12.5, 15.5, -5.2)
SERIES_SUNS = ("--sun-azimuths", "70,80,90", "--sun-elevations", "6:60:6")
"""Suns of the one catalogue for all frames of the series."""
VIEWS = ("0:0", "40:0", "40:90", "40:180", "40:270")
"""Views of the catalogues for the Apollo 15 frames, whose camera sees 37 deg to either side."""


@dataclass(frozen=True)
class Build:
    """Options of a catalogue."""

    gsd_m: float = 474.0
    spacing_km: float = 8.0


def opened(data: Path, name: str) -> tuple[Image, ImageFiles, Path]:
    """The frame, its files, and the DEM of its ground."""
    if name in located_frames.FRAMES:
        ground = located_frames.FRAMES[name]
        folder = data / "images" / ground.folder
        files = ImageFiles(folder / f"{name}{ground.suffix}.png", folder / f"{name}_camera.json")
        return located_frames.frame(data, name), files, folder / ground.dem
    folder = data / "images" / SERIES / "DIM_input_1280mpp_masked"
    return apollo_maps.frame(data, name), ImageFiles(folder / f"{name}.tif"), series_dem(data)


def built(path: Path, photo: Image, dem: Path, data: Path, build: Build) -> Path | None:
    """The catalogue of a photograph's ground as `by_command`."""
    azimuth, elevation = angles(photo)
    around = SUN_STEP_DEG * (math.floor(azimuth / SUN_STEP_DEG) + np.arange(2)) % 360.0
    k = int(np.clip(np.searchsorted(ELEVATIONS_DEG, elevation), 1, len(ELEVATIONS_DEG) - 1))
    suns = [
        "--sun-azimuths",
        _listed(sorted(around)),
        "--sun-elevations",
        _listed(ELEVATIONS_DEG[max(k - 2, 0) : k + 2]),
    ]
    series = photo.sensor.corrections != POSE
    if series:
        suns = list(SERIES_SUNS)
    west, south, east, north = SERIES_BOUNDS_DEG if series else _shown_deg(photo, dem)
    where = ["--bounds", *(f"{v:.4f}" for v in (west, south, east, north))]
    spacing_km = SERIES_SPACING_KM if series else build.spacing_km
    how = ["--spacing", f"{spacing_km:g}", "--reflectance", LAW]
    cell_m = SERIES_CELL_M if series else build.gsd_m
    how += ["--gsd", f"{cell_m:g}"]
    if series:
        config = path.with_suffix(".toml")
        config.write_text(SERIES_TOML, encoding="utf-8")
        how += ["--config", str(config)]
    else:
        how += ["--albedo", str(data / ALBEDO)]
    views = ("0:0",) if series else VIEWS
    how += [part for view in views for part in ("--view", view)]
    return by_command(path, dem, [*where, *suns, *how])


def by_command(path: Path, dem: Path, options: Sequence[str]) -> Path | None:
    """A catalogue, built by the command unless it is there; None without a point."""
    given = ["build-catalog", str(dem), "-o", str(path), "--jobs", "2", *options]
    return path if path.exists() or run(given) == 0 else None


def _listed(values: Sequence[float]) -> str:
    return ",".join(f"{v:g}" for v in values)


def _middle_mcmf(photo: Image) -> Array:
    rows, cols = photo.signal.shape
    return np.asarray(_ground(photo, np.array([[(cols - 1) / 2.0, (rows - 1) / 2.0]]))[0])


def _ground(photo: Image, pixels: Array) -> Array:
    """Places on the sphere that pixels (n, 2) show, (n, 3), NaN where none."""
    if isinstance(photo.sensor, Camera):
        return hits(photo.sensor.position_mcmf_m, photo.sensor.rays(pixels))[1]
    if isinstance(photo.sensor, MapImage):
        return MOON_RADIUS_M * photo.sensor.ground(pixels)
    raise TypeError(f"{photo.name}: neither a frame nor a map")


def to_sun(photo: Image) -> Array:
    """Unit MCMF direction (3,) to the Sun from the middle of the frame."""
    return np.asarray(photo.sun_directions(_middle_mcmf(photo)[None])).reshape(3)


def angles(photo: Image) -> tuple[float, float]:
    """Azimuth and elevation of the Sun in the middle of the frame, degrees."""
    lon, lat, _ = mcmf_to_lonlat(_middle_mcmf(photo))
    frame = EnuFrame(float(lon) % 360.0, float(lat))
    azimuth, elevation = azimuth_elevation(frame.direction_from_mcmf(to_sun(photo)))
    return float(azimuth) % 360.0, float(elevation)


def _shown_deg(photo: Image, dem: Path) -> tuple[float, float, float, float]:
    """West, south, east, north of what the frame shows of the DEM."""
    with rasterio.open(dem) as file:
        box, radius = file.bounds, file.crs.to_dict()["R"]
    low_lon, low_lat, high_lon, high_lat = np.degrees(np.array(box) / radius)
    rows, cols = photo.signal.shape
    grid = np.stack(np.meshgrid(np.linspace(0, cols - 1, 9), np.linspace(0, rows - 1, 9)), -1)
    lon, lat, _ = mcmf_to_lonlat(_ground(photo, grid.reshape(-1, 2)))
    lon = (lon - low_lon + 20.0) % 360.0 + low_lon - 20.0
    west, east = max(np.nanmin(lon), low_lon + 0.3), min(np.nanmax(lon), high_lon - 0.3)
    south, north = max(np.nanmin(lat), low_lat + 0.3), min(np.nanmax(lat), high_lat - 0.3)
    return float(west), float(south), float(east), float(north)
