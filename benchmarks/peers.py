"""Exact shadows against Mitsuba 3 (llvm: Embree inside) on the same surface, the two in turn in one process.

Run by `make bench-peers`; Mitsuba is in the dependency group `peers`, never a run-time dependency. Mitsuba's mesh is split along
the same diagonal and its rays are lifted by a centimetre off the nodes, as it has no edge-crossing test; so some masks differ. The
figures to quote are the ratios: the machine's speed drifts, and drifts for both.
"""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import drjit as dr
import mitsuba as mi
from synthetic import cratered

from lcp_catalog.heightfield import Heightfield
from lcp_catalog.sphere import direction_enu

mi.set_variant("llvm_ad_rgb")

CELL_M = 20.0
LIFT_M = 0.01
ELEVATIONS_DEG = (0.5, 2.0, 5.0, 15.0, 45.0)
ROUNDS = 6


def mesh(z: np.ndarray) -> mi.Scene:
    """The triangulated heightfield as a Mitsuba scene, x east, y north, metres."""
    rows, cols = z.shape
    x, y = np.meshgrid(np.arange(cols) * CELL_M, -np.arange(rows) * CELL_M)
    corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + cols + 1, corner + 1], 1),
            np.stack([corner, corner + cols, corner + cols + 1], 1),
        ]
    )
    shape = mi.Mesh("terrain", z.size, len(faces))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = np.stack([x, y, z], -1).astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mi.load_dict({"type": "scene", "terrain": shape})


def mitsuba_shadows(scene: mi.Scene, origins: mi.Point3f, direction: np.ndarray) -> np.ndarray:
    """Mask of occluded nodes."""
    hit = scene.ray_test(mi.Ray3f(origins, mi.Vector3f(*direction.tolist())))
    dr.eval(hit)
    dr.sync_thread()
    return np.array(hit)


def main(sizes: list[int]) -> None:
    print(f"{'n':>5} {'el deg':>7} {'lcp Mray/s':>11} {'Mitsuba':>8} {'ratio':>6} {'differ %':>9}")
    for n in sizes:
        z = cratered(n, CELL_M)
        field, scene = Heightfield(z, CELL_M), mesh(z)
        x, y = np.meshgrid(np.arange(n) * CELL_M, -np.arange(n) * CELL_M)
        origins = mi.Point3f(np.stack([x, y, z + LIFT_M]).reshape(3, -1).astype(np.float32))
        for elevation in ELEVATIONS_DEG:
            ours, theirs, ratios, differ = [], [], [], []
            for turn in range(ROUNDS):
                direction = direction_enu(17.0 + 60.0 * turn, elevation)
                start = time.perf_counter()
                mine = field.occluded_nodes(direction)
                middle = time.perf_counter()
                other = mitsuba_shadows(scene, origins, direction)
                end = time.perf_counter()
                ours.append(n * n / (middle - start) / 1e6)
                theirs.append(n * n / (end - middle) / 1e6)
                ratios.append(ours[-1] / theirs[-1])
                differ.append(100.0 * float(np.mean(mine.ravel() != other.astype(bool))))
            figures = (statistics.median(values) for values in (ours, theirs, ratios, differ))
            print(
                "{:5d} {:7.1f} {:11.1f} {:8.1f} {:6.2f} {:9.3f}".format(n, elevation, *figures),
                flush=True,
            )


if __name__ == "__main__":
    main([int(size) for size in sys.argv[1:]] or [1024, 2048])
