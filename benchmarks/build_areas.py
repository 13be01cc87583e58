"""Areas of three terrains for the benchmark of the main job, and the package that computes them: that
of the working tree, or that of another commit beside it in the same process.
"""

from __future__ import annotations

import dataclasses
import importlib
import io
import subprocess
import sys
import tarfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from helpers.synthetic import cratered
from rasterio.transform import from_origin

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "sample_data" / "hadley_gld100_256ppd.tif"
CONFIG = ROOT / "sample_data" / "hadley.toml"
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


@dataclass(frozen=True)
class Package:
    """The library under a name: ``lcp_catalog``, or another commit's (`of_commit`)."""

    name: str

    @classmethod
    def of_commit(cls, revision: str, folder: Path) -> Package:
        """The package of a commit, extracted under another name; its compiled kernels stay there.
        CalledProcessError for an unknown revision.
        """
        commit = _git("rev-parse", "--verify", f"{revision}^{{commit}}").decode().strip()
        name = f"lcp_catalog_{commit[:12]}"
        if not (folder / name).exists():
            folder.mkdir(parents=True, exist_ok=True)
            with tarfile.open(fileobj=io.BytesIO(_git("archive", commit, "lcp_catalog"))) as tar:
                tar.extractall(folder / f"{name}.part", filter="data")
            (folder / f"{name}.part" / "lcp_catalog").rename(folder / name)
            (folder / f"{name}.part").rmdir()
        if str(folder) not in sys.path:
            sys.path.append(str(folder))
        return cls(name)

    def module(self, path: str) -> Any:
        """A module by its path inside the package."""
        return importlib.import_module(f"{self.name}.{path}")

    def modules(self) -> list[Any]:
        """All modules of the package that are imported."""
        begins = f"{self.name}."
        return [module for key, module in list(sys.modules.items()) if key.startswith(begins)]

    def plan(self, case: Case, folder: Path) -> Any:
        """The planned build to which a case's area belongs."""
        config = self.module("production.config").BuildConfig.from_toml(CONFIG)
        area, sun, model = config.area, config.sun, config.model
        if case.polar:
            area = dataclasses.replace(area, center_deg=case.place_deg, size_km=60.0)
            model = model.without_albedo
        if case.elevations_deg:
            sun = dataclasses.replace(sun, elevations_deg=case.elevations_deg)
        area = dataclasses.replace(area, gsd_m=case.gsd_m)
        config = dataclasses.replace(config, area=area, sun=sun, model=model)
        dem = polar_dem(folder) if case.polar else SAMPLE
        return self.module("production.run").Build.plan([dem], config)

    def job(self, case: Case, folder: Path) -> Any:
        """The job of the area that contains the case's place."""
        build = self.plan(case, folder)
        lon, lat = (np.array([value]) for value in case.place_deg)
        row, column = build.jobs[0].grid.owner(lon, lat)
        wanted = (int(row[0]), int(column[0]))
        return next(job for job in build.jobs if (job.task.row, job.task.column) == wanted)

    def run(self, job: Any) -> Any:
        """The area's result."""
        return self.module("production.area_job").run_area(job)

    def forget(self) -> None:
        """Drop the DEM windows kept from the last area: in a build that was another area. Blocks of
        far terrain, which neighbours share, stay.
        """
        getattr(self.module("dem.block_cache"), "_windows", {}).clear()


def own_nodes(package: Package, job: Any) -> int:
    """Number of nodes that belong to the area, by their places on the sphere."""
    window, frames = job.task.window, package.module("geometry.frames")
    x, y = np.meshgrid(
        np.arange(window.col0, window.col1) * job.gsd_m,
        -np.arange(window.row0, window.row1) * job.gsd_m,
    )
    z = -(x**2 + y**2) / (2.0 * package.module("constants").MOON_RADIUS_M)
    lon, lat, _ = frames.mcmf_to_lonlat(job.task.frame.to_mcmf(np.stack([x, y, z], axis=-1)))
    row, column = job.grid.owner(lon, lat)
    mine = (row == job.task.row) & (column == job.task.column) & job.region.contains(lon, lat)
    return int(mine.sum())


def conditions_of(package: Package, job: Any) -> int:
    """Number of conditions that can occur in the area."""
    return package.module("production.sweep").Conditions.at(job.task.lat_deg, job.config).count


def _git(*arguments: str) -> bytes:
    return subprocess.run(["git", "-C", ROOT, *arguments], capture_output=True, check=True).stdout
