"""Predicted and simulated errors of the position along the descent of docs/tutorial/descent.md: `lcp query` states a covariance for
each frame; the frame is taken by an independent renderer over clones of the DEM, offered from a place and an attitude that are a
little wrong, and located (as in `claims_positions`).
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from claims_frames import BITS, LAW, SEED
from claims_positions import INSIDE_95, Outcome, outcome
from helpers.closed_loops import embree_frame
from helpers.dem_clones import Errors, clone
from helpers.embree_camera import Ground
from helpers.embree_mesh import Nodes, mcmf, read_nodes
from lcp_cli.main import run
from markupsafe import Markup

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.hdf5 import open_catalog
from lcp_catalog.constants import ASTRONOMICAL_UNIT_M
from lcp_catalog.geometry.frames import mcmf_to_lonlat
from lcp_catalog.plots.axes import Axes, Axis, round_ticks
from lcp_catalog.sun.ephemeris import apparent_sun

ROOT = Path(__file__).resolve().parents[1]
DEM = ROOT / "sample_data" / "hadley_gld100_256ppd.tif"
SPAN = 0.62
"""Half a frame's width on the ground over the altitude, with a margin for curvature."""

_WIDTH, _HEIGHT = 640.0, 260.0
_STYLE = (
    "text{font:12px sans-serif;fill:#444}.end{text-anchor:end}.middle{text-anchor:middle}.grid{stroke:#ddd;fill:none}"
    ".axis{stroke:#444;fill:none}.stated{stroke:#1f5fbf;stroke-width:2;fill:none}.error{fill:#c0392b;opacity:.7}"
    ".rms{stroke:#c0392b;stroke-width:1.5;stroke-dasharray:4 3;fill:none}"
)


def _example() -> ModuleType:
    """docs/examples/descent.py."""
    spec = importlib.util.spec_from_file_location("descent", ROOT / "docs/examples/descent.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def built(path: Path) -> Path:
    """The catalogue of the tutorial, built by its command unless it is there."""
    if not path.exists():
        where = ["--center", "3.3", "26.1", "--size", "130", "--gsd", "474", "--spacing", "4"]
        suns = ["--sun-azimuths", "90,105,120", "--sun-elevations", "10,20,30"]
        how = ["--reflectance", LAW, "--jobs", str(os.cpu_count() or 1)]
        if run(["build-catalog", str(DEM), "-o", str(path), *where, *suns, *how]):
            raise SystemExit(f"{path.name}: the build failed")
    return path


def work(folder: Path, count: int) -> list[Outcome]:
    """So many frames, over all altitudes in turn; those in the folder are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    example, catalog = _example(), open_catalog(built(folder / "descent.h5"))
    found = []
    for number in range(count):
        step, turn = number % 16, number // 16
        altitude_km = 100 - 5 * step
        path = folder / f"{altitude_km}-{turn}.json"
        if not path.exists():
            camera = _lit(example.camera(altitude_km), example.START.isoformat(), step)
            photo = _taken(catalog, camera, altitude_km, number)
            lon, lat, _ = mcmf_to_lonlat(camera.position_mcmf_m)
            pixel_m = 1e3 * altitude_km / camera.focal_length_px
            about = (str(altitude_km), number, 20.0, pixel_m)
            path.write_text(json.dumps(asdict(outcome(catalog, photo, camera, about))))
            print(path.name, f"{lon:.2f} {lat:.2f}", flush=True)
        found.append(Outcome(**json.loads(path.read_text())))
    return found


def _lit(camera: Camera, start: str, step: int) -> Camera:
    """The camera with the Sun of its time."""
    time = np.datetime64(start) + np.timedelta64(30 * step, "s")
    directions, distance_au = apparent_sun([str(time)])
    sun_m = ASTRONOMICAL_UNIT_M * distance_au[0] * directions[0]
    return replace(camera, sun_position_mcmf_m=sun_m, time_utc=str(time))


def _taken(catalog: Catalog, camera: Camera, altitude_km: float, number: int) -> Any:
    """A frame of a new clone by the independent renderer."""
    lon, lat, _ = (float(v) for v in mcmf_to_lonlat(camera.position_mcmf_m))
    nodes: Nodes = read_nodes(DEM, lon, lat, 1e3 * altitude_km * SPAN * math.sqrt(2.0) + 10e3)
    model = catalog.errors
    errors = Errors(*(float(model[k]) for k in Errors.__dataclass_fields__))
    surface, brightness = clone(nodes, errors, np.random.default_rng([SEED, 2, number]))
    ground = Ground(surface, mcmf(lon, lat), brightness)
    return embree_frame(
        ground, camera, 1.0 / float(model["sensor_noise"]), BITS, samples=2, seed=number
    )


HEAD = (
    "| altitude, km | usable points | predicted 1 sigma, m | rms error, m | frames | located | squared error / 3 | within 95 % |\n"
    "| ---: |" + " ---: |" * 7
)


def report(found: list[Outcome], chart: Path) -> tuple[str, dict[str, Any]]:
    """Markdown, figures, and the chart."""
    rows, figures = [HEAD], {}
    groups = {f"{km}": [one for one in found if one.site == f"{km}"] for km in range(100, 24, -5)}
    for name, some in (groups | {"all": found}).items():
        if some:
            figures[name] = _scored(some)
            cells = [f"{v:.3g}" if isinstance(v, float) else f"{v}" for v in figures[name].values()]
            rows.append("| " + " | ".join([name, *cells]) + " |")
    chart.write_text(_drawn(groups, figures), encoding="utf-8")
    return "\n".join(rows) + "\n", figures


def _scored(some: list[Outcome]) -> dict[str, Any]:
    judged = [one for one in some if np.isfinite(one.squared)]
    squared = np.array([one.squared for one in judged])
    stated = [math.sqrt(np.trace(one.covariance)) for one in some if one.covariance is not None]
    errors = [float(np.linalg.norm(one.error_m)) for one in judged]
    nothing = float("nan")
    return {
        "usable": float(np.median([one.usable for one in some])),
        "stated_m": float(np.median(stated)) if stated else nothing,
        "rms_m": float(np.sqrt(np.mean(np.square(errors)))) if errors else nothing,
        "frames": len(some),
        "located": sum(one.error_m is not None for one in some),
        "squared_error": float(squared.mean() / 3.0) if judged else nothing,
        "within_95": float((squared <= INSIDE_95).mean()) if judged else nothing,
    }


def _drawn(groups: dict[str, list[Outcome]], figures: dict[str, Any]) -> str:
    """Errors of single frames, their root mean square, and the predicted sigma, against altitude."""
    heights = [float(name) for name, some in groups.items() if some]
    known = [name for name, some in groups.items() if some]
    places = [
        (float(one.site), float(np.linalg.norm(one.error_m)))
        for some in groups.values()
        for one in some
        if one.error_m is not None
    ]
    top = max([error for _, error in places] + [figures[name]["stated_m"] for name in known])
    axes = Axes(
        Axis(20.0, 105.0, round_ticks(20.0, 105.0, 8), "altitude, km", grid=True),
        Axis(0.0, 1.05 * top, round_ticks(0.0, 1.05 * top, 5), "error of the position, m", grid=True),
        _WIDTH, _HEIGHT, 70.0, 20.0, 30.0, 50.0,
    )  # fmt: skip
    x, y = axes.at([h for h, _ in places], [e for _, e in places])
    dots = "".join(
        f'<circle class="error" cx="{a:.1f}" cy="{b:.1f}" r="3"/>'
        for a, b in zip(x, y, strict=True)
    )
    stated = axes.line(heights, [figures[name]["stated_m"] for name in known], "stated")
    solved = [name for name in known if figures[name]["located"]]
    rms = axes.line([float(n) for n in solved], [figures[n]["rms_m"] for n in solved], "rms")
    note = f'<text class="end" x="{_WIDTH:g}" y="-9">line: predicted 1 sigma; dots: simulated; dashed: their rms</text>'
    inside = Markup(dots) + stated + rms + Markup(note)
    label = "predicted and simulated error of the position against altitude"
    return str(axes.draw(inside, label, style=_STYLE)) + "\n"
