"""Claims against photographs: Apollo 15 Metric frames with their cameras, and the map-projected Apollo 16 series.

For each Apollo 15 frame `lcp build-catalog` builds a catalogue of the ground that it shows, under the Suns around its own (four
elevations and two azimuths), from GLD100 and the relative albedo map; for the Apollo 16 series one catalogue under 30 Suns, without
a map of albedo. The library's validation searches for the points and scores the
claims. The frames of the fit set were used to choose and to fit; those kept aside are judged once, at the end (``--set kept``).
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from claims_frames import HEAD, bins_of, line, share_near
from helpers import apollo_maps, located_frames
from helpers.apollo_frames import SERIES, series_dem, series_keys
from lcp_cli.main import run

from lcp_catalog.cameras.sensor import POSE, Uncertainty
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import EnuFrame, azimuth_elevation, mcmf_to_lonlat
from lcp_catalog.geometry.sphere_intersection import hits
from lcp_catalog.images.image import Image
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.validation.claims import Claims, Scores, score
from lcp_catalog.validation.run import ImageFiles, Validation, run_validation

FIT = ("AS15-M-0414", "AS15-M-0295")
KEPT = ("AS15-M-0299", "AS15-M-0300", "AS15-M-1134")
LAW = "lunar-lambert"
ALBEDO = "albedo/relative_albedo_11ppd.tif"
UNCERTAIN = Uncertainty(1500.0)
SUN_STEP_DEG = 10.0
ELEVATIONS_DEG = (2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 75.0)
CELLS_M = (118.0, 237.0, 474.0, 948.0)
PATCHES = (17, 25, 33, 49)
SERIES_TOML = """[errors]
sensor_noise = 0.15
height_sigma_m = 92.0
height_length_m = 1450.0
albedo_sigma = 0.095
albedo_length_m = 5000.0
position_sigma_m = 80.0
spread = 0.3
[points]
patch_nodes = 25
[model]
direction_tolerance_deg = 1.5
"""
"""Catalogues for the Apollo 16 series: the error model as fitted to every second frame with
`validation.error_fit` (its pixels are samples of finer scans, not means over their area, so that
errors of the heights are not averaged), and patches as large as 25 of its pixels.
"""
SERIES_CELL_M = 1280.0
SERIES_SPACING_KM = 15.0
SERIES_BOUNDS_DEG = (0.5, -12.5, 15.5, -5.2)
SERIES_SUNS = ("--sun-azimuths", "70,80,90", "--sun-elevations", "6:60:6")
"""Suns of the one catalogue for all frames of the series."""
SIZES_OF = ("AS15-M-0414", "AS15-M-0295")
SIZES_KM = 110.0
VIEWS = ("0:0", "40:0", "40:90", "40:180", "40:270")
"""Views of the catalogues for the Apollo 15 frames, whose camera sees 37 deg to either side."""
NAMES = ("probability", "usable", "sigma_m", "angle_deg", "tried", "found", "error_m")


@dataclass(frozen=True)
class Build:
    """Options of a catalogue. ``size_km`` None: all that the frame shows; ``gsd_m`` None: the build's own choice."""

    gsd_m: float | None = 474.0
    patch: int | None = None
    spacing_km: float = 8.0
    size_km: float | None = None
    albedo: bool = True

    @property
    def name(self) -> str:
        cell = "own" if self.gsd_m is None else f"{self.gsd_m:g}"
        return f"{cell}-{self.patch or 'own'}-{self.spacing_km:g}" + (
            "" if self.albedo else "-plain"
        )


@dataclass(frozen=True, eq=False)
class Result:
    """The claims on one frame; metres are the error of usable points that were found."""

    frame: str
    sun_elevation_deg: float
    verdict: str
    points: int
    bytes: int
    seconds: float
    claims: Claims


def chosen(data: Path, which: str) -> list[str]:
    """Names of the frames of a set: every second map of the series from the first on is for fitting."""
    series = series_keys(data)
    return [*FIT, *series[::2]] if which == "fit" else [*KEPT, *series[1::2]]


def work(folder: Path, data: Path, names: Sequence[str], build: Build) -> list[Result]:
    """All frames; finished ones from the folder."""
    return [_one(folder, data, name, build) for name in names]


def _one(folder: Path, data: Path, name: str, build: Build) -> Result:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}-{build.name}.npz"
    if not path.exists():
        photo, files, dem = opened(data, name)
        stem = name if files.camera else "series"
        catalog, seconds = built(folder / f"{stem}-{build.name}.h5", photo, dem, data, build)
        figures: dict[str, Any] = {"frame": name, "seconds": seconds, "bytes": 0, "points": 0}
        figures["sun_elevation_deg"] = angles(photo)[1]
        claims = Claims.none(reason="no point was built")
        figures["verdict"] = "no catalogue"
        if catalog is not None:
            verdict = _validated(catalog, data, photo, files, build)
            claims, figures["verdict"] = verdict.claims, verdict.located.verdict
            figures |= {"bytes": catalog.stat().st_size, "points": len(claims)}
        arrays = {n: getattr(claims, n) for n in NAMES}
        beside = path.with_suffix(".part.npz")
        np.savez(beside, figures=json.dumps(figures), **arrays)
        beside.rename(path)
        print(path.name, figures["verdict"], flush=True)
    with np.load(path) as saved:
        return Result(
            **json.loads(str(saved["figures"])), claims=Claims(**{n: saved[n] for n in NAMES})
        )


def opened(data: Path, name: str) -> tuple[Image, ImageFiles, Path]:
    """The frame, its files, and the DEM of its ground."""
    if name in located_frames.FRAMES:
        ground = located_frames.FRAMES[name]
        folder = data / "images" / ground.folder
        files = ImageFiles(folder / f"{name}{ground.suffix}.png", folder / f"{name}_camera.json")
        return located_frames.frame(data, name), files, folder / ground.dem
    folder = data / "images" / SERIES / "DIM_input_1280mpp_masked"
    return apollo_maps.frame(data, name), ImageFiles(folder / f"{name}.tif"), series_dem(data)


def _validated(catalog: Path, data: Path, photo: Image, files: ImageFiles, build: Build) -> Any:
    lon, lat, _ = mcmf_to_lonlat(to_sun(photo))
    request = Validation(
        catalog,
        (files,),
        UNCERTAIN,
        sun=SunChoice() if files.camera else SunChoice(subsolar_deg=(float(lon), float(lat))),
        model=reflectance_model(LAW),
        albedo=AlbedoMap.open(data / ALBEDO) if build.albedo else None,
    )
    return run_validation(request).verdict.images[0]


def built(
    path: Path, photo: Image, dem: Path, data: Path, build: Build
) -> tuple[Path | None, float]:
    """The catalogue, built by the command unless it is there, and the seconds that this took; None without a point."""
    if path.exists():
        return path, math.nan
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
    if build.size_km is not None:
        centre = [f"{(west + east) / 2.0:.4f}", f"{(south + north) / 2.0:.4f}"]
        where = ["--center", *centre, "--size", f"{build.size_km:g}"]
    spacing_km = SERIES_SPACING_KM if series else build.spacing_km
    how = ["--spacing", f"{spacing_km:g}", "--reflectance", LAW, "--jobs", "2"]
    cell_m = SERIES_CELL_M if series else build.gsd_m
    how += [] if cell_m is None else ["--gsd", f"{cell_m:g}"]
    if series or build.patch is not None:
        config = path.with_suffix(".toml")
        text = SERIES_TOML if series else f"[points]\npatch_nodes = {build.patch}\n"
        config.write_text(text, encoding="utf-8")
        how += ["--config", str(config)]
    how += ["--albedo", str(data / ALBEDO)] if build.albedo and not series else []
    views = ("0:0",) if series else VIEWS
    how += [part for view in views for part in ("--view", view)]
    start = time.perf_counter()
    code = run(["build-catalog", str(dem), "-o", str(path), *where, *suns, *how])
    return (path if code == 0 else None), time.perf_counter() - start


def _listed(values: Sequence[float]) -> str:
    return ",".join(f"{v:g}" for v in values)


def _middle_mcmf(photo: Image) -> np.ndarray:
    rows, cols = photo.signal.shape
    return _ground(photo, np.array([[(cols - 1) / 2.0, (rows - 1) / 2.0]]))[0]


def _ground(photo: Image, pixels: np.ndarray) -> np.ndarray:
    """Places on the sphere that pixels (n, 2) show, (n, 3), NaN where none."""
    if hasattr(photo.sensor, "rays"):
        return hits(photo.sensor.position_mcmf_m, photo.sensor.rays(pixels))[1]
    return MOON_RADIUS_M * photo.sensor.ground(pixels)


def to_sun(photo: Image) -> np.ndarray:
    """Unit MCMF direction (3,) to the Sun from the middle of the frame."""
    return photo.sun_directions(_middle_mcmf(photo)[None]).reshape(-1, 3)[0]


def angles(photo: Image) -> tuple[float, float]:
    """Azimuth and elevation of the Sun in the middle of the frame, degrees."""
    lon, lat, _ = mcmf_to_lonlat(_middle_mcmf(photo))
    frame = EnuFrame(float(lon) % 360.0, float(lat))
    azimuth, elevation = azimuth_elevation(frame.direction_from_mcmf(to_sun(photo)))
    return float(azimuth) % 360.0, float(elevation)


def _shown_deg(photo: Image, dem: Path) -> tuple[float, float, float, float]:
    """West, south, east, north of what the frame shows of the DEM."""
    import rasterio

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


# Tables


def report(results: list[Result]) -> tuple[str, dict[str, object], dict[str, Scores]]:
    """Markdown, figures for the JSON, and the scores for a diagram."""
    groups = {"all": results}
    groups["Apollo 15"] = [r for r in results if r.frame.startswith("AS15")]
    groups["Apollo 16"] = [r for r in results if r.frame.startswith("AS16")]
    groups |= {f"{r.frame}, Sun {r.sun_elevation_deg:.0f} deg, {r.verdict}": [r] for r in results}
    lines, figures, scored = [HEAD], {}, {}
    for name, some in groups.items():
        pooled = Claims.pooled([r.claims for r in some])
        if not (pooled.tried & pooled.claimed).any():
            if len(some) == 1:
                lines.append(f"| {name} | 1 | 0 |" + " - |" * 9)
            continue
        lines.append(line(name, len(some), pooled))
        of = score(pooled)
        figures[name] = of.figures() | {"frames": len(some), "near": share_near(pooled)}
        if not name.startswith("AS1"):
            scored[name] = of
    lines += ["", bins_of(scored)]
    return "\n".join(lines) + "\n", figures, scored


def sizes(folder: Path, data: Path) -> tuple[str, dict[str, object]]:
    """Cells and patches compared on two frames of the fit set: points, metres, bytes and seconds."""
    lines = [
        "| frame | cell, m | patch | points | usable | found of usable | usable of found | median error, m | rms error / sigma | "
        "bytes | build, s |",
        "| --- |" + " ---: |" * 10,
    ]
    figures: dict[str, object] = {}
    for name in SIZES_OF:
        for cell in CELLS_M:
            for patch in PATCHES:
                result = _one(folder, data, name, Build(cell, patch, size_km=SIZES_KM))
                of, claims = score(result.claims), result.claims
                good = claims.usable & claims.found
                off = np.linalg.norm(claims.error_m[good], axis=-1)
                median = float(np.nanmedian(off)) if len(off) else math.nan
                cells = [
                    name,
                    f"{cell:g}",
                    f"{patch}",
                    f"{of.count}",
                    f"{of.usable}",
                    f"{of.found_of_usable:.3f}",
                ]
                cells += [
                    f"{of.usable_of_found:.3f}",
                    f"{median:.0f}",
                    f"{math.sqrt(of.normalised_squared_error):.2f}",
                ]
                cells += [f"{result.bytes}", f"{result.seconds:.0f}"]
                lines.append("| " + " | ".join(cells) + " |")
                figures[f"{name} {cell:g} {patch}"] = of.figures() | {
                    "median_m": median, "bytes": result.bytes, "seconds": result.seconds,
                }  # fmt: skip
    return "\n".join(lines) + "\n", figures
