"""Areas of three terrains for the benchmark of the main job."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from rasterio.transform import from_origin

from benchmarks.places import CONFIG, DEM
from lcp_catalog.choices import NO_MAP
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import mcmf_to_lonlat
from lcp_catalog.production.area_job import AreaJob
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.production.run import Build
from tests.helpers.synthetic import cratered

REGION_KM = 60.0
"""Side of the regions, of areas of about 23 km."""

POLE_NODES, POLE_CELL_M, POLE_RELIEF = 1024, 474.0, 0.4
STEREOGRAPHIC = "+proj=stere +lat_0=90 +lon_0=0 +k=1 +x_0=0 +y_0=0 +R=1737400 +units=m +no_defs"


@dataclass(frozen=True)
class Case:
    """An area that contains a place; ``gsd_m`` None for the cell that the build chooses."""

    name: str
    place_deg: tuple[float, float]
    gsd_m: float | None = None
    elevations_deg: tuple[float, ...] = ()

    @property
    def polar(self) -> bool:
        return self.place_deg[1] > 80.0

    def dem(self, folder: Path) -> Path:
        """The sample's DEM, or one that is made in the folder."""
        return polar_dem(folder) if self.polar else DEM

    def region(self, folder: Path, **points: Any) -> Build:
        """A build of the area around the place and the parts next to it of the eight around, with other settings of ``points``."""
        own = self.jobs(folder)[0]
        config, place = own.recipe.config, (own.task.lon_deg, own.task.lat_deg)
        area = dataclasses.replace(config.area, center_deg=place, size_km=REGION_KM)
        own_points = dataclasses.replace(config.points, **points)
        config = dataclasses.replace(config, area=area, points=own_points)
        return Build.plan([self.dem(folder)], config)

    def jobs(self, folder: Path) -> tuple[AreaJob, AreaJob]:
        """The job of the area that contains the place, and another of the same build; a DEM that is made goes to the folder."""
        config = BuildConfig.from_toml(CONFIG)
        area, sun, model = config.area, config.sun, config.model
        if self.polar:
            area = dataclasses.replace(area, center_deg=self.place_deg, size_km=60.0)
            model = dataclasses.replace(
                model, albedo=NO_MAP, albedo_encoding=None, albedo_reference=None
            )
        if self.elevations_deg:
            sun = dataclasses.replace(sun, elevations_deg=self.elevations_deg)
        area = dataclasses.replace(area, gsd_m=self.gsd_m)
        config = dataclasses.replace(config, area=area, sun=sun, model=model)
        jobs = Build.plan([self.dem(folder)], config).jobs
        row, column = jobs[0].grid.owner(*(np.array([value]) for value in self.place_deg))
        wanted = (int(row[0]), int(column[0]))
        own = next(job for job in jobs if (job.task.row, job.task.column) == wanted)
        return own, next(job for job in reversed(jobs) if job is not own)


CASES = {
    case.name: case
    for case in (
        Case("mare", (1.96, 26.12)),
        Case("highland", (4.30, 26.12)),
        Case("highland-118m", (4.30, 26.12), 118.45),
        Case("pole", (31.0, 85.0), 474.0, (1.0, 2.0, 4.0, 6.0)),
    )
}


def polar_dem(folder: Path) -> Path:
    """A stereographic DEM of 485 km around the north pole: fractal terrain with craters, made once."""
    path = folder / f"pole_{POLE_NODES}_{POLE_RELIEF:g}.tif"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        z = cratered(POLE_NODES, POLE_CELL_M, seed=15, relief_m=POLE_RELIEF)
        corner = 0.5 * POLE_NODES * POLE_CELL_M
        aside = path.with_suffix(".part.tif")
        with rasterio.open(
            aside, "w", driver="GTiff", height=len(z), width=len(z), count=1, dtype="float32",
            crs=STEREOGRAPHIC, transform=from_origin(-corner, corner, POLE_CELL_M, POLE_CELL_M),
        ) as target:  # fmt: skip
            target.write(z, 1)
        aside.rename(path)
    return path


def own_nodes(job: AreaJob) -> int:
    """Number of nodes that belong to the area, by their places on the sphere."""
    window = job.task.window
    x, y = np.meshgrid(
        np.arange(window.col0, window.col1) * job.recipe.gsd_m,
        -np.arange(window.row0, window.row1) * job.recipe.gsd_m,
    )
    z = -(x**2 + y**2) / (2.0 * MOON_RADIUS_M)
    lon, lat, _ = mcmf_to_lonlat(job.task.frame.to_mcmf(np.stack([x, y, z], axis=-1)))
    row, column = job.grid.owner(lon, lat)
    mine = (
        (row == job.task.row) & (column == job.task.column) & job.recipe.region.contains(lon, lat)
    )
    return int(mine.sum())


def sample(size_km: float, output: Path, *more: str) -> list[str]:
    """Words of the build of the sample's middle."""
    place = ["--center", "3.5", "26", "--size", f"{size_km:g}"]
    build = ["build-catalog", str(DEM), "--config", str(CONFIG), *place]
    return [*build, "-o", str(output), "--overwrite", *more]
