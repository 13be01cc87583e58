"""How far shadows that cells do not resolve shift a render: made relief of 15 m (docs/examples/made_dem.py), averaged to cells of
60 and 120 m after the render, against a render of cells of 60 and 120 m, under Suns in the east and in the west.

    .venv/bin/python benchmarks/shadow_shift.py [FOLDER]

Prints a table: the shift of the best correlation, in cells, away from the Sun; it is the same in the east and in the west if
light is its cause, and changes sign if a registration is. The made DEMs are taken from FOLDER (default build/descent).
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import rasterio
from lcp_cli.main import run

from lcp_catalog.arrays import Array

PLACE = ("--center", "3.6", "26.1", "--size", "7")
HOW = (
    "--accuracy",
    "high",
    "--bounce",
    "off",
    "--sun",
    "point",
    "--reflectance",
    "lommel-seeliger",
)
FINE_M, CELLS_M = 15, (60, 120)
ELEVATIONS_DEG = (5, 10, 15, 20, 25, 30, 40)
AZIMUTHS_DEG = (100, 280)
STEPS = range(-2, 3)  # quarters of a cell
MARGIN = 4


def rendered(
    folder: Path, cell_m: int, azimuth_deg: int, elevation_deg: int
) -> tuple[Array, Array, Array]:
    """Radiance, and the easting and northing of each node, metres."""
    out = folder / "shadow_shift.tif"
    sun = ("--sun-azimuth", f"{azimuth_deg}", "--sun-elevation", f"{elevation_deg}")
    words = ["render", str(folder / "made_15m.tif"), *PLACE, "--gsd", f"{cell_m}", *sun, *HOW]
    if run([*words, "-o", str(out), "--overwrite"]):
        raise SystemExit("the render failed")
    with rasterio.open(out) as file:
        radiance, to = file.read(1).astype(np.float64), file.transform
    out.unlink()
    cols, rows = np.meshgrid(np.arange(radiance.shape[1]), np.arange(radiance.shape[0]))
    return radiance, to.c + (cols + 0.5) * to.a, to.f + (rows + 0.5) * to.e


def shift_cells(
    fine: tuple[Array, Array, Array], coarse: tuple[Array, Array, Array], cell_m: int
) -> Array:
    """Shift (2,) east and north of the averaged fine render from the coarse one, in cells: the top of a
    paraboloid through the correlations.
    """
    width = cell_m // FINE_M
    kernel = np.ones(width + 1) / width
    kernel[[0, -1]] /= 2.0
    averaged = cv2.sepFilter2D(fine[0], -1, kernel, kernel)
    x0, y0 = fine[1][0, 0], fine[2][0, 0]
    inside = np.s_[MARGIN:-MARGIN, MARGIN:-MARGIN]

    def correlation(east_m: float, north_m: float) -> float:
        cols = (coarse[1] + east_m - x0) / FINE_M
        rows = (y0 - coarse[2] - north_m) / FINE_M
        places = cols.astype(np.float32), rows.astype(np.float32)
        seen = cv2.remap(averaged, *places, cv2.INTER_CUBIC, borderValue=np.nan)[inside]
        known = np.isfinite(seen)
        return float(np.corrcoef(seen[known], coarse[0][inside][known])[0, 1])

    step_m = cell_m / 4.0
    places = np.array([(i, j) for i in STEPS for j in STEPS], np.float64)
    found = [correlation(i * step_m, j * step_m) for i, j in places]
    x, y = places.T
    terms = np.stack([np.ones_like(x), x, y, x * x, y * y, x * y], axis=1)
    _, a, b, aa, bb, ab = np.linalg.lstsq(terms, np.array(found), rcond=None)[0]
    return -np.linalg.solve([[2.0 * aa, ab], [ab, 2.0 * bb]], [a, b]) / 4.0


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/descent")
    heads = [f"{cell} m, Sun in the {side}" for cell in CELLS_M for side in ("east", "west")]
    print("| Sun, deg | " + " | ".join(heads) + " |")
    print("| ---: |" + " ---: |" * len(heads))
    for elevation in ELEVATIONS_DEG:
        cells = {}
        for azimuth in AZIMUTHS_DEG:
            away = -np.array([np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))])
            fine = rendered(folder, FINE_M, azimuth, elevation)
            for cell in CELLS_M:
                coarse = rendered(folder, cell, azimuth, elevation)
                cells[cell, azimuth] = float(shift_cells(fine, coarse, cell) @ away)
        texts = [f"{cells[cell, azimuth]:+.3f}" for cell in CELLS_M for azimuth in AZIMUTHS_DEG]
        print(f"| {elevation} | " + " | ".join(texts) + " |", flush=True)


if __name__ == "__main__":
    main()
