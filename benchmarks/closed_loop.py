"""Closed loop: random frames over real terrain, a start position that is wrong by 2 km, the position found.

    .venv/bin/python benchmarks/closed_loop.py [-o build/closed_loop] [--frames 25] [--renderer product|embree] [--sites hadley ...]

The shared lunar data are needed (see `tests/conftest.py`). `lcp build-catalog` builds the catalogue of each site once. Rows are
appended to `RENDERER-SITE.jsonl`; a run that was interrupted continues after them. The tables of the page "Closed loop" are
printed and written to `tables.md`. `--renderer embree` takes the frames from a mesh of the DEM's nodes with an independent
camera (`tests/helpers/embree_camera.py`). `--renderer hapke` takes them from lcp with Hapke's model, while the search keeps its
own model.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
os.environ.setdefault("NUMBA_NUM_THREADS", "2")

import numpy as np
from helpers.closed_loops import (
    BITS,
    BLUR_PX,
    POSITION_SIGMA_M,
    SNR,
    Draw,
    Renderer,
    Shot,
    Site,
    by_embree,
    by_product,
    fly,
)
from lcp_cli.main import run

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.hdf5 import open_catalog
from lcp_catalog.images.image import Image
from lcp_catalog.photometry.laws import DEFAULT_MODEL, reflectance_model


@dataclass(frozen=True)
class Place:
    """The DEM of a site and the options of its catalogue."""

    dem: str  # in the shared data
    center_deg: tuple[float, float]
    size_km: float
    gsd_m: float
    spacing_km: float


PLACES = {
    # near side north, far side south, far side north, near side south
    "hadley": Place(
        "images/apollo15-metric-hadley/gld100_256ppd_lat20-30_lon000-010.tif", (5, 25), 240, 237, 7.6
    ),
    "farside": Place(
        "images/apollo15-metric-farside/gld100_064ppd_lat-28_-13_lon132-155.tif",
        (143.5, -20.5), 400, 474, 15.2,
    ),
    "bruno": Place(
        "dem/gld100/gld100_256ppd_giordano-bruno_lat33-39_lon099-107.tif", (103, 36), 110, 237, 7.6
    ),
    "descartes": Place(
        "images/apollo16-metric-series/gld100_064ppd_lat-16_-02_lon-01_020.tif",
        (9.5, -9), 260, 474, 15.2,
    ),
}  # fmt: skip
SUNS = ["--sun-azimuths", "0:330:30", "--sun-elevations", "6,12,20,30,45,60"]
MESH_REACH_M = 400e3


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build" / "closed_loop")
    parser.add_argument("--frames", type=int, default=25, help="for each site")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--renderer", choices=("product", "hapke", "embree"), default="product")
    parser.add_argument("--sites", nargs="+", choices=list(PLACES), default=list(PLACES))
    parser.add_argument("--data", type=Path, default=shared_data())
    asked = parser.parse_args(argv)
    asked.output.mkdir(parents=True, exist_ok=True)
    for name in asked.sites:
        loop(name, asked)
    rows = [row for path in sorted(asked.output.glob("*.jsonl")) for row in read_rows(path)]
    text = report(rows)
    (asked.output / "tables.md").write_text(text, encoding="utf-8")
    print(text)


def shared_data() -> Path:
    beside = [ROOT / "shared" / "data", ROOT.parent / "shared" / "data"]
    places = [Path(p) for p in [os.environ.get("LCP_SHARED_DATA", "")] if p] + beside
    return next((place for place in places if place.is_dir()), places[0])


def loop(name: str, asked: argparse.Namespace) -> None:
    """The frames of a site that are not in its file yet."""
    path = asked.output / f"{asked.renderer}-{name}.jsonl"
    done = {row["shot"]["number"] for row in read_rows(path)} if path.exists() else set()
    place = PLACES[name]
    dem = asked.data / place.dem
    site = Site(name, dem, open_catalog(built(name, place, dem, asked.output)))
    take = renderer(asked.renderer, place, dem)
    for shot, camera in site.shots(asked.frames, asked.seed, Draw()):
        if shot.number in done:
            continue
        photo = kept(asked.output / "frames" / f"{path.stem}-{shot.number}.npz", camera, shot, take)
        rows = [fly(site, shot, camera, photo, solve, not solve) for solve in (False, True)]
        with path.open("a", encoding="utf-8") as file:
            file.writelines(
                json.dumps(asdict(row) | {"renderer": asked.renderer}) + "\n" for row in rows
            )
        print(
            f"{name} {shot.number}: {rows[1].verdict}, {rows[1].across_px:.3f} px", file=sys.stderr
        )


def kept(path: Path, camera: Camera, shot: Shot, take: Renderer) -> Image:
    """A frame that is rendered once and can be searched again."""
    if not path.exists():
        photo = take(camera, shot)
        path.parent.mkdir(exist_ok=True)
        np.savez_compressed(path, signal=photo.signal, weight=photo.weight)
        return photo
    with np.load(path) as saved:
        pixels = saved["signal"], saved["weight"]
    return Image(camera.name, *pixels, camera, sun_position_mcmf_m=camera.sun_position_mcmf_m)


def built(name: str, place: Place, dem: Path, folder: Path) -> Path:
    """Build the catalogue of a site with the command line."""
    path = folder / f"{name}.h5"
    if not path.exists():
        centre = [str(v) for v in place.center_deg]
        where = ["--center", *centre, "--size", str(place.size_km), "--gsd", str(place.gsd_m)]
        points = ["--spacing", str(place.spacing_km), *SUNS, "--jobs", "2"]
        code = run(["build-catalog", str(dem), "-o", str(path), *where, *points])
        if code:
            raise SystemExit(f"{name}: lcp build-catalog ended with {code}")
    return path


def renderer(kind: str, place: Place, dem: Path) -> Renderer:
    if kind == "embree":
        return by_embree(dem, place.center_deg, MESH_REACH_M)
    return by_product(dem, DEFAULT_MODEL if kind == "product" else reflectance_model("hapke"))


def read_rows(path: Path) -> list[dict]:
    with path.open(encoding="utf-8") as file:
        return [json.loads(line) for line in file]


# Tables


def report(rows: list[dict]) -> str:
    """The limits of the issue, and the errors by Sun elevation, field of view and obliquity."""
    parts = [
        f"Position known to {POSITION_SIGMA_M / 1e3:g} km (1 sigma, each axis), attitude exact or known to 20 arcsec, signal to "
        f"noise {SNR:g}, {BITS} bits, blur {BLUR_PX:g} px.\n",
        table("renderer, site", rows, lambda r: f"{r['renderer']}, {r['site']}"),
        table("renderer", rows, lambda r: r["renderer"]),
        table("Sun's elevation", rows, binned("sun_elevation_deg", (5, 15, 25, 35, 45, 60))),
        table("phase", rows, binned("phase_deg", (0, 10, 20, 30, 50, 100, 180))),
        table("field of view", rows, binned("fov_deg", (10, 20, 30, 40, 50, 60))),
        table("off nadir", rows, binned("off_nadir_deg", (0, 10, 20, 30, 40))),
        biases(rows),
        failures(rows),
    ]
    return "\n".join(parts)


def binned(field: str, edges: tuple[float, ...]) -> Callable[[dict], str]:
    def name(row: dict) -> str:
        value = row["shot"][field]
        low = max((edge for edge in edges[:-1] if edge <= value), default=edges[0])
        return f"{low:g}..{edges[edges.index(low) + 1]:g}"

    return name


def table(title: str, rows: list[dict], group: Callable[[dict], str]) -> str:
    lines = [
        f"| {title} | frames | points | attitude | solved | false | across, px, median | 95 % | squared error / unknowns | "
        "position / 3 | s a frame | ms a point |",
        "| --- " * 12 + "|",
    ]
    for name in sorted({group(row) for row in rows}, key=_by_number):
        for solve in (False, True):
            some = [r for r in rows if group(r) == name and r["attitude"] == solve]
            if some:
                lines.append(f"| {name} | {line(some, solve)}")
    return "\n".join(lines) + "\n"


def _by_number(name: str) -> tuple[float, str]:
    first = name.split("..", maxsplit=1)[0]
    return (float(first) if first.replace(".", "").isdigit() else 0.0, name)


def line(rows: list[dict], solve: bool) -> str:
    good = [r for r in rows if r["verdict"] == "located"]
    wrong = sum(not r["off_px"] <= 3.0 for r in good)
    across = of(good, "across_px") or [np.nan]
    seconds = np.median(of(rows, "seconds"))
    points = np.median(of(rows, "points"))
    squared = [r["squared"] / r["unknowns"] for r in good]
    place = [r["squared_position"] / 3.0 for r in good]
    share = f"{len(good)} ({100 * len(good) / len(rows):.0f} %)"
    return (
        f"{len(rows)} | {points:.0f} | {'solved' if solve else 'exact'} | {share} | {wrong} | "
        f"{np.median(across):.3f} | {np.percentile(across, 95):.3f} | {_mean(squared):.2f} | {_mean(place):.2f} | {seconds:.2f} | "
        f"{1e3 * seconds / max(points, 1):.1f} |"
    )


def of(rows: Iterable[dict], name: str) -> list[float]:
    return [row[name] for row in rows]


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else np.nan


def biases(rows: list[dict]) -> str:
    """Mean residual of the matches at the true camera over the frames, with the sigma of that mean."""
    lines = [
        "| frames | mean residual, column px | row px | scatter of a frame's, px |",
        "| --- " * 4 + "|",
    ]
    for name in sorted(
        {f"{r['renderer']}, {r['site']}" for r in rows} | {r["renderer"] for r in rows}
    ):
        some = [
            r["bias_px"]
            for r in rows
            if np.isfinite(r["bias_px"][0])
            and name in (r["renderer"], f"{r['renderer']}, {r['site']}")
        ]
        if some:
            mean, spread = np.mean(some, axis=0), np.std(some, axis=0)
            error = spread / np.sqrt(len(some))
            column, row = (f"{m:+.4f} ± {e:.4f}" for m, e in zip(mean, error, strict=True))
            lines.append(f"| {name}: {len(some)} | {column} | {row} | {spread.max():.3f} |")
    return "\n".join(lines) + "\n"


def failures(rows: list[dict]) -> str:
    lines = ["Not located:", ""]
    for r in rows:
        if r["verdict"] != "located":
            s = r["shot"]
            lines.append(
                f"- {r['renderer']}, {r['site']} {s['number']}, attitude {'solved' if r['attitude'] else 'exact'}: Sun "
                f"{s['sun_elevation_deg']:.0f} deg, field {s['fov_deg']:.0f} deg, off nadir {s['off_nadir_deg']:.0f} deg, pixel "
                f"{s['pixel_m']:.0f} m, {r['points']} points: {r['verdict']}: {r['reason']}"
            )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
