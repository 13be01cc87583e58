"""Predicted and simulated errors of the position along the descent of docs/tutorial/descent.md: `lcp query` states a covariance for
each frame; the frame is taken by an independent renderer over clones of all DEMs, offered from a place and an attitude that are a
little wrong, and located (as in `claims_positions`).
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from claims_frames import BITS, SEED
from claims_positions import INSIDE_95, Outcome, outcome
from helpers.closed_loops import embree_frame
from helpers.dem_clones import Errors, clone
from helpers.embree_camera import Ground
from helpers.embree_mesh import Nodes, mcmf, read_nodes
from lcp_cli.main import run
from markupsafe import Markup
from scipy.ndimage import map_coordinates

from lcp_catalog.arrays import Array
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.hdf5 import open_catalog
from lcp_catalog.constants import ASTRONOMICAL_UNIT_M
from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.height_errors import errors_of_file
from lcp_catalog.ephemeris.solar_position import apparent_sun
from lcp_catalog.geometry.frames import mcmf_to_lonlat
from lcp_catalog.images.image import Image
from lcp_catalog.plots.axes import Axes, Axis

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "sample_data" / "hadley_gld100_256ppd.tif"
SPAN, AROUND_M = 0.62, 3e3
"""Half the width of the ground of a frame over the altitude, and more of it on all sides: for relief, curvature and shadows."""
POSITION_SHARE, ATTITUDE_DEG = 0.02, 0.1
"""What is known before a frame, 1 sigma of each axis: the place, over the altitude; the attitude."""
FAR_M = 100e3  # beyond the made DEMs
SAMPLES_LEAST, SAMPLES_MOST = 3, 8  # of a pixel, each way: about one for the finest DEM's posting
BANDS_KM = ((60, 100), (30, 60), (15, 30), (8, 15), (5, 8))

_WIDTH, _HEIGHT = 640.0, 300.0
_STYLE = (
    "text{font:12px sans-serif;fill:#444}.end{text-anchor:end}.middle{text-anchor:middle}.grid{stroke:#ddd;fill:none}"
    ".axis{stroke:#444;fill:none}.stated{stroke:#1f5fbf;stroke-width:2;fill:none}.error{fill:#c0392b;opacity:.7}"
    ".rms{stroke:#c0392b;stroke-width:1.5;stroke-dasharray:4 3;fill:none}"
)


def _example(name: str) -> ModuleType:
    """A module of docs/examples."""
    spec = importlib.util.spec_from_file_location(name, ROOT / f"docs/examples/{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Descent:
    """The tutorial's files in a folder, made unless they are there."""

    folder: Path
    example: ModuleType
    dems: tuple[tuple[Path, float, int], ...]  # file, 1 sigma, pixels along one of the sample

    @classmethod
    def of(cls, folder: Path, relief: int | None = None) -> Descent:
        """``relief``: seed of the made relief in place of the tutorial's."""
        made = _example("made_dem")
        made.SAMPLE, made.FOLDER = str(SAMPLE), folder
        made.SEED = made.SEED if relief is None else relief
        dems = tuple((folder / f"made_{m}m.tif", sigma, times) for m, times, _, sigma in made.DEMS)
        if not all(path.exists() for path, *_ in dems):
            made.main()
        return cls(folder, _example("descent"), dems)

    def catalog(self) -> Catalog:
        """The catalogue by the tutorial's command."""
        path = self.folder / "descent.h5"
        if not path.exists():
            config = ["--config", str(ROOT / "docs/examples/descent.toml")]
            sigma = ["--dem-sigma", str(self.folder / "made_sigma.tif")]
            files = [str(dem) for dem, *_ in self.dems] + [str(SAMPLE), "-o", str(path)]
            jobs = ["--jobs", str(os.cpu_count() or 1)]
            if run(["build-catalog", *files, *config, *sigma, *jobs]):
                raise SystemExit(f"{path.name}: the build failed")
        return open_catalog(path)

    def camera(self, step: int) -> Camera:
        """The camera of a step, with the Sun of its time."""
        taken = self.example.camera(self.example.ALTITUDES_KM[step])
        time = np.datetime64(self.example.START) + np.timedelta64(self.example.STEP_S * step, "s")
        directions, distance_au = apparent_sun([str(time)])
        sun_m = ASTRONOMICAL_UNIT_M * distance_au[0] * directions[0]
        return replace(taken, sun_position_mcmf_m=sun_m, time_utc=str(time))

    def photo(self, catalog: Catalog, camera: Camera, altitude_km: float, number: int) -> Image:
        """A frame of new clones of the DEMs by the independent renderer."""
        lon, lat, _ = (float(v) for v in mcmf_to_lonlat(camera.position_mcmf_m))
        surface, brightness = self.truth(catalog, lon, lat, altitude_km, number)
        pixel_m = 1e3 * altitude_km / self.example.FOCAL_PX
        finest_m = Dem.open(SAMPLE).gsd_m / self.dems[-1][2]
        samples = min(max(SAMPLES_LEAST, math.ceil(pixel_m / finest_m)), SAMPLES_MOST)
        ground = Ground(surface, mcmf(lon, lat), brightness)
        noise = float(catalog.errors["sensor_noise"])
        return embree_frame(ground, camera, 1.0 / noise, BITS, samples=samples, seed=number)

    def truth(
        self, catalog: Catalog, lon: float, lat: float, altitude_km: float, number: int
    ) -> tuple[Nodes, Array]:
        """Clones of all DEMs in one grid around a place, as fine as the finest DEM of each row and column at any
        altitude (a coarser grid aliases the fine relief); and the brightness of its nodes.
        """
        dice = np.random.default_rng([SEED, 2, number])
        model = catalog.errors
        errors = Errors(*(float(model[k]) for k in Errors.__dataclass_fields__))
        half_m = 1e3 * altitude_km * SPAN + AROUND_M
        wide, bright = clone(read_nodes(SAMPLE, lon, lat, half_m), errors, dice)
        clones = []
        for path, sigma_m, times in self.dems:
            length_m = errors_of_file(Dem.open(path)).length_m
            own = replace(errors, height_sigma_m=sigma_m, height_length_m=length_m)
            site = self.example.LON_DEG, self.example.LAT_DEG
            fine, _ = clone(read_nodes(path, *site, FAR_M), own, dice)
            clones.append((fine, times))
        grid = _grid(wide, clones)
        heights, shade = (_at(wide, values, grid) for values in (wide.height_m, bright))
        for fine, _ in clones:
            here = _at(fine, fine.height_m, grid)
            heights = np.where(np.isfinite(here), here, heights)
        return replace(grid, height_m=heights), shade


def _grid(wide: Nodes, inside: list[tuple[Nodes, int]]) -> Nodes:
    """The grid of the pixels of a DEM, those in the rows and columns of others, from coarse to fine, in as many
    parts as stated; without heights.
    """
    axes = []
    for pick in (lambda nodes: nodes.lat_deg[:, 0], lambda nodes: nodes.lon_deg[0]):
        own = pick(wide)
        parts = np.ones(len(own), int)
        for fine, times in inside:
            low, high = np.sort(pick(fine)[[0, -1]])
            parts[(own > low) & (own < high)] = times
        places = [k + (np.arange(n) + 0.5) / n - 0.5 for k, n in enumerate(parts)]
        axes.append(own[0] + np.concatenate(places) * (own[1] - own[0]))
    lon, lat = np.meshgrid(axes[1], axes[0])
    return Nodes(lon, lat, np.full(lon.shape, np.nan), is_ring=False, pole=0)


def _at(nodes: Nodes, values: Array, grid: Nodes) -> Array:
    """Values of nodes at those of another grid, bilinear; NaN outside."""
    lat, lon = nodes.lat_deg[:, 0], nodes.lon_deg[0]
    rows = (grid.lat_deg - lat[0]) / (lat[1] - lat[0])
    cols = (grid.lon_deg - lon[0]) / (lon[1] - lon[0])
    return np.asarray(map_coordinates(values, [rows, cols], order=1, cval=np.nan))


def work(folder: Path, count: int, relief: int | None = None, first: int = 0) -> list[Outcome]:
    """So many frames, over all altitudes in turn, from a number on; those in the folder are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    descent = Descent.of(folder, relief)
    catalog = descent.catalog()
    return [_frame(descent, catalog, folder, number) for number in range(first, first + count)]


def _frame(descent: Descent, catalog: Catalog, folder: Path, number: int) -> Outcome:
    """A frame: taken and located, or read from the folder."""
    heights = descent.example.ALTITUDES_KM
    step, turn = number % len(heights), number // len(heights)
    altitude_km = float(heights[step])
    path = folder / f"{altitude_km:g}-{turn}.json"
    if not path.exists():
        camera = descent.camera(step)
        photo = descent.photo(catalog, camera, altitude_km, number)
        pixel_m = 1e3 * altitude_km / camera.focal_length_px
        before = Uncertainty(1e3 * altitude_km * POSITION_SHARE, math.radians(ATTITUDE_DEG))
        about = (f"{altitude_km:g}", number, 20.0, pixel_m)
        path.write_text(json.dumps(asdict(outcome(catalog, photo, camera, about, before))))
        print(path.name, flush=True)
    return Outcome(**json.loads(path.read_text()))


HEAD = (
    "| altitude, km | usable points | predicted 1 sigma, m (rms) | rms error, m | frames | located | squared error / 3 | "
    "within 95 % |\n"
    "| ---: |" + " ---: |" * 7
)


def report(found: list[Outcome], chart: Path) -> tuple[str, dict[str, Any]]:
    """Markdown, figures, and the chart."""
    rows, figures = [HEAD], {}
    found = sorted(found, key=lambda one: -float(one.site))
    heights = {one.site: float(one.site) for one in found}
    single = {name: [one for one in found if one.site == name] for name in heights}
    bands = {
        f"{high:g} to {low:g}": [one for one in found if low <= heights[one.site] <= high]
        for low, high in BANDS_KM
    }
    for name, some in (single | bands | {"all": found}).items():
        if some:
            figures[name] = _scored(some)
            cells = [f"{v:.3g}" if isinstance(v, float) else f"{v}" for v in figures[name].values()]
            rows.append("| " + " | ".join([name, *cells]) + " |")
    chart.write_text(_drawn(single, figures), encoding="utf-8")
    return "\n".join(rows) + "\n", figures


def _scored(some: list[Outcome]) -> dict[str, Any]:
    judged = [one for one in some if np.isfinite(one.squared)]
    squared = np.array([one.squared for one in judged])
    stated = [np.trace(one.covariance) for one in some if one.covariance is not None]
    errors = [float(np.linalg.norm(one.error_m)) for one in judged]
    nothing = float("nan")
    return {
        "usable": float(np.median([one.usable for one in some])),
        "stated_m": math.sqrt(np.mean(stated)) if stated else nothing,
        "rms_m": float(np.sqrt(np.mean(np.square(errors)))) if errors else nothing,
        "frames": len(some),
        "located": sum(one.error_m is not None for one in some),
        "squared_error": float(squared.mean() / 3.0) if judged else nothing,
        "within_95": float((squared <= INSIDE_95).mean()) if judged else nothing,
    }


def _drawn(groups: dict[str, list[Outcome]], figures: dict[str, Any]) -> str:
    """Errors of single frames, their root mean square, and the predicted sigma, against altitude."""
    known = [name for name, some in groups.items() if some]
    places = [
        (float(one.site), float(np.linalg.norm(one.error_m)))
        for some in groups.values()
        for one in some
        if one.error_m is not None
    ]
    shown = [error for _, error in places] + [figures[name]["stated_m"] for name in known]
    axes = Axes(
        Axis(110.0, 4.5, _ticks(4.5, 110.0), "altitude, km", log=True, grid=True),
        Axis(
            low := 0.8 * min(shown), top := 1.25 * max(shown), _ticks(low, top),
            "error of the position, m", log=True, grid=True,
        ),
        _WIDTH, _HEIGHT, 70.0, 20.0, 30.0, 50.0,
    )  # fmt: skip
    x, y = axes.at([h for h, _ in places], [e for _, e in places])
    dots = "".join(
        f'<circle class="error" cx="{a:.1f}" cy="{b:.1f}" r="3"/>'
        for a, b in zip(x, y, strict=True)
    )
    heights = [float(name) for name in known]
    stated = axes.line(heights, [figures[name]["stated_m"] for name in known], "stated")
    solved = [name for name in known if figures[name]["located"]]
    rms = axes.line([float(n) for n in solved], [figures[n]["rms_m"] for n in solved], "rms")
    note = f'<text class="end" x="{_WIDTH:g}" y="-9">line: predicted 1 sigma; dots: simulated; dashed: their rms</text>'
    inside = Markup(dots) + stated + rms + Markup(note)
    label = "predicted and simulated error of the position against altitude"
    return str(axes.draw(inside, label, style=_STYLE)) + "\n"


def _ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Ticks of a logarithmic axis at 1, 2 and 5 times powers of 10."""
    values = [step * 10.0**power for power in range(-1, 4) for step in (1, 2, 5)]
    return [(value, f"{value:g}") for value in values if low <= value <= high]
