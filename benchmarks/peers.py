"""Shadows, sweeps and camera rays compared with Mitsuba 3 (llvm) and Embree on the same surface, in turn in one process.

Run by `make bench-peers`. The peers are a dependency group of their own, never run-time dependencies; they install with pip
alone. Mitsuba traces with the Embree built into it, on as many threads as lcp; its llvm variant loads the system's LLVM
library, and without that library its columns are left out. The other peer is Embree 4 through embreex, which uses one thread.
The peers' meshes are split along the same diagonal as ours. They have no edge-crossing test, so their rays start one centimetre
above the nodes, and some of their masks differ from ours for that reason. Quote the ratios: the speed of a shared machine
drifts, and it drifts for all.
"""

from __future__ import annotations

import math
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

THREADS = 2
os.environ.setdefault("NUMBA_NUM_THREADS", str(THREADS))
os.environ.setdefault("OMP_NUM_THREADS", str(THREADS))

import drjit as dr
import mitsuba as mi
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from helpers.synthetic import cratered

from lcp_catalog.accuracy import TIERS
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.occlusion import occluded, occluded_sweep

HAS_MITSUBA = bool(dr.has_backend(dr.JitBackend.LLVM))
"""True if the system has the LLVM library that Mitsuba's llvm variant loads."""
if HAS_MITSUBA:
    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(THREADS)

CELL_M = 20.0
LIFT_M = 0.01
ELEVATIONS_DEG = (0.5, 2.0, 5.0, 15.0, 45.0)
SWEEP_DEG = (0.5, 1.0, 2.0, 5.0, 8.0, 12.0, 20.0, 40.0)
ROUNDS = 6
GROWTH = (1024, 2048, 4096, 8192)

CAMERAS = {
    # off nadir deg, distance to the middle of the terrain km, roll deg, radial distortion
    "100 km, 30 deg off nadir": (30.0, 100.0, 0.0, 0.0),
    "100 km, nadir": (0.0, 100.0, 0.0, 0.0),
    "5 km up, 60 deg off": (60.0, 10.0, 0.0, 0.0),
    "30 deg off, rolled by 37 deg": (30.0, 100.0, 37.0, 0.0),
    "the same, distorted": (30.0, 100.0, 37.0, -0.15),
}


def faces(rows: int, cols: int) -> np.ndarray:
    """Both triangles of every cell, uint32 (2 cells, 3)."""
    corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel().astype(np.uint32)
    upper = np.stack([corner, corner + cols + 1, corner + 1], 1)
    lower = np.stack([corner, corner + cols, corner + cols + 1], 1)
    return np.concatenate([upper, lower]).astype(np.uint32)


def nodes(z: np.ndarray, lift_m: float = 0.0) -> np.ndarray:
    """Places of the nodes, x east, y north, metres, float32 (rows, cols, 3)."""
    rows, cols = z.shape
    x, y = np.meshgrid(np.arange(cols) * CELL_M, -np.arange(rows) * CELL_M)
    return np.stack([x, y, z + lift_m], -1).astype(np.float32)


def mesh(z: np.ndarray) -> mi.Scene:
    """The triangulated heightfield as a Mitsuba scene."""
    triangles = faces(*z.shape)
    shape = mi.Mesh("terrain", z.size, len(triangles))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = nodes(z).ravel()
    parameters["faces"] = triangles.ravel()
    parameters.update()
    return mi.load_dict({"type": "scene", "terrain": shape})


class Mitsuba:
    """Answers of Mitsuba, waited for."""

    def __init__(self, z: np.ndarray) -> None:
        self.scene = mesh(z)
        self.origins = mi.Point3f(nodes(z, LIFT_M).reshape(-1, 3).T)

    def shadows(self, direction: np.ndarray) -> np.ndarray:
        hit = self.scene.ray_test(mi.Ray3f(self.origins, mi.Vector3f(*direction.tolist())))
        dr.eval(hit)
        dr.sync_thread()
        return np.array(hit).astype(bool)

    def ranges(self, rays: mi.Ray3f) -> np.ndarray:
        found = self.scene.ray_intersect_preliminary(rays).t
        dr.eval(found)
        dr.sync_thread()
        return np.array(found)


class Embree:
    """Masks by Embree 4 through embreex, on one thread."""

    def __init__(self, z: np.ndarray) -> None:
        self.scene = EmbreeScene()
        self.mesh = TriangleMesh(
            self.scene, nodes(z).reshape(-1, 3), faces(*z.shape).astype(np.int32)
        )
        self.origins = nodes(z, LIFT_M).reshape(-1, 3)
        self.rays = np.empty_like(self.origins)
        self.shadows(np.array([0.0, 0.0, 1.0]))  # the first query builds the tree

    def shadows(self, direction: np.ndarray) -> np.ndarray:
        self.rays[:] = direction
        return np.asarray(self.scene.run(self.origins, self.rays, query="OCCLUDED")) >= 0


def timed(task: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    """Seconds and the answer; the last one's threads are given time to go to sleep first."""
    time.sleep(0.02)
    start = time.perf_counter()
    answer = task(*arguments)
    return time.perf_counter() - start, answer


def terrain(n: int) -> np.ndarray:
    """A cratered square; beyond 2048 mirrored so that the parts join: the generator is slow, not the tracing."""
    if n <= 2048:
        return cratered(n, CELL_M)
    z = terrain(n // 2)
    return np.block([[z, z[:, ::-1]], [z[::-1], z[::-1, ::-1]]])


def shadows(n: int, field: Heightfield, peers: dict[str, Mitsuba | Embree]) -> None:
    """Table of the tiers and peers by the Sun's elevation: medians over the azimuths."""
    base = list(peers)[-1]
    print(
        f"\nShadows of {n} x {n} nodes: Mnode/s, ratio to {base}, share of nodes that differ from "
        "`reference`\n"
    )
    names = [*TIERS, *peers]
    print("| Sun | " + " | ".join(names) + " |\n| ---: |" + " --- |" * len(names))
    for elevation in ELEVATIONS_DEG:
        speed: dict[str, list[float]] = {name: [] for name in names}
        differ: dict[str, list[float]] = {name: [] for name in names}
        for turn in range(ROUNDS):
            direction = direction_enu(17.0 + 60.0 * turn, elevation)
            masks = {}
            for name in names:
                if name in peers:
                    seconds, masks[name] = timed(peers[name].shadows, direction)
                else:
                    seconds, masks[name] = timed(occluded, field, direction, TIERS[name])
                speed[name].append(n * n / seconds / 1e6)
            for name in names:
                differ[name].append(np.mean(masks[name].ravel() != masks["reference"].ravel()))
        cells = []
        for name in names:
            ratio = statistics.median(a / b for a, b in zip(speed[name], speed[base], strict=True))
            share = 100.0 * statistics.mean(differ[name])
            cells.append(f"{statistics.median(speed[name]):.0f}, x{ratio:.3g}, {share:.4f} %")
        print(f"| {elevation:g} deg | " + " | ".join(cells) + " |", flush=True)


def sweep(n: int, field: Heightfield, mitsuba: Mitsuba) -> None:
    """16 azimuths of 8 elevations; Mitsuba traces one azimuth in four."""
    elevations = np.radians(SWEEP_DEG)
    ours: dict[str, list[float]] = {"draft": [], "standard": []}
    theirs = []
    for step in range(16):
        azimuth = 360.0 * (step + 0.1) / 16
        for tier, seconds_of in ours.items():
            if tier == "draft" or step % 4 == 0:
                seconds_of.append(
                    timed(occluded_sweep, field, math.radians(azimuth), elevations, TIERS[tier])[0]
                )
        if step % 4 == 0:
            for elevation in SWEEP_DEG:
                theirs.append(timed(mitsuba.shadows, direction_enu(azimuth, elevation))[0])
    rate = 1.0 / (statistics.mean(theirs) / (n * n))
    print(f"\nSweep, 16 azimuths x 8 elevations, {n} x {n}: Mitsuba {rate / 1e6:.1f} M sun-cells/s")
    for tier, seconds_of in ours.items():
        own = 8 * n * n / statistics.mean(seconds_of)
        print(f"  {tier}: {own / 1e6:.0f} M sun-cells/s, x{own / rate:.3g}", flush=True)


def camera(
    n: int, off_deg: float, distance_km: float, roll_deg: float, distortion: float
) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and unit directions (n, n, 3); the axis meets the middle of the terrain, where a pixel is a cell."""
    middle = np.array([0.5 * n * CELL_M, -0.5 * n * CELL_M, 0.0])
    out = _turned(17.0, 2) @ _turned(off_deg, 0) @ _turned(roll_deg, 2)
    a = (np.arange(n) - 0.5 * (n - 1)) * CELL_M / (distance_km * 1e3)
    x, y = np.meshgrid(a, a)
    bent = 1.0 + distortion * (x * x + y * y) / (2.0 * a[-1] ** 2)
    rays = np.stack([x * bent, -y * bent, np.full(x.shape, -1.0)], -1) @ out.T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return middle + distance_km * 1e3 * out[:, 2], rays


def _turned(angle_deg: float, axis: int) -> np.ndarray:
    """Rotation matrix about an axis."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    m = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    m[i, i], m[i, j], m[j, i], m[j, j] = c, -s, s, c
    return m


def cameras(n: int, field: Heightfield, mitsuba: Mitsuba) -> None:
    """First hits of n x n rays for several cameras; rays are made before the clock starts, as each side wants them."""
    print(
        f"\nCamera rays, {n} x {n} pixels: Mray/s, ratio, share of ranges that differ by over 1 m\n"
    )
    print("| camera | lcp | Mitsuba | ratio | differ |\n| --- | ---: | ---: | ---: | ---: |")
    for name, parameters in CAMERAS.items():
        position, rays = camera(n, *parameters)
        theirs_in = mi.Ray3f(
            mi.Point3f(*position.tolist()), mi.Vector3f(rays.reshape(-1, 3).T.astype(np.float32))
        )
        ours, theirs, differ = [], [], []
        for _ in range(ROUNDS):
            seconds, mine = timed(field.first_hits, position, rays)
            ours.append(n * n / seconds / 1e6)
            seconds, other = timed(mitsuba.ranges, theirs_in)
            theirs.append(n * n / seconds / 1e6)
        mine, other = np.nan_to_num(mine.ravel(), nan=np.inf), other.astype(np.float64)
        both = np.isfinite(mine) & np.isfinite(other)
        away = (np.isfinite(mine) != np.isfinite(other)).mean()
        differ = away + np.mean(np.abs(mine[both] - other[both]) > 1.0)
        ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
        print(
            f"| {name} | {statistics.median(ours):.1f} | {statistics.median(theirs):.1f} | x{ratio:.2f} "
            f"| {100 * differ:.3f} % |",
            flush=True,
        )


def growth() -> None:
    """Nanoseconds a cell as the terrain grows: the least of five, sizes in turn."""
    fields = {n: Heightfield(np.tile(terrain(1024), (n // 1024,) * 2), CELL_M) for n in GROWTH}
    fields = {n: Heightfield(_joined(field.z_m), CELL_M) for n, field in fields.items()}
    tasks = {
        "draft": lambda f: occluded(f, direction_enu(17.0, 5.0), TIERS["draft"]),
        "standard": lambda f: occluded(f, direction_enu(17.0, 5.0), TIERS["standard"]),
        "high": lambda f: occluded(f, direction_enu(17.0, 5.0), TIERS["high"]),
        "sweep of 8, draft": lambda f: occluded_sweep(
            f, 0.3, np.radians(SWEEP_DEG), TIERS["draft"]
        ),
    }
    print("\nGrowth: ns a cell (and, for the sweep, a Sun), least of five\n")
    print(
        "| | "
        + " | ".join(map(str, GROWTH))
        + " | last / first |\n| --- |"
        + " ---: |" * (len(GROWTH) + 1)
    )
    for name, task in tasks.items():
        least = dict.fromkeys(GROWTH, math.inf)
        for _ in range(5):
            for n, field in fields.items():
                least[n] = min(least[n], timed(task, field)[0] / n**2 * 1e9)
        suns = len(SWEEP_DEG) if name.startswith("sweep") else 1
        cells = " | ".join(f"{least[n] / suns:.2f}" for n in GROWTH)
        print(f"| {name} | {cells} | {least[GROWTH[-1]] / least[GROWTH[0]]:.2f} |", flush=True)


def _joined(z: np.ndarray) -> np.ndarray:
    """Tiles of 1024 mirrored so that neighbours join."""
    out = z.copy()
    for i in range(0, len(z), 1024):
        for j in range(0, len(z), 1024):
            part = z[i : i + 1024, j : j + 1024]
            part = part[::-1] if i // 1024 % 2 else part
            out[i : i + 1024, j : j + 1024] = part[:, ::-1] if j // 1024 % 2 else part
    return out


def memory(field: Heightfield) -> None:
    """Bytes a cell that a heightfield keeps once everything has been asked of it."""
    kept = [value for value in vars(field).values() if isinstance(value, np.ndarray)]
    kept += [
        part
        for value in vars(field).values()
        if isinstance(value, tuple)
        for part in value
        if isinstance(part, np.ndarray)
    ]
    size = sum(array.nbytes for array in kept) / field.z_m.size
    print(f"\nKept of a terrain after all of this: {size:.2f} bytes a cell")


def main(sizes: list[int]) -> None:
    processor = platform.processor() or platform.machine()
    print(f"{processor}, {THREADS} threads, Mitsuba {mi.__version__}, embreex {version('embreex')}")
    if not HAS_MITSUBA:
        print("Mitsuba is left out: install the system's LLVM library to compare with it")
    for n in sizes:
        z = terrain(n)
        field, peers = Heightfield(z, CELL_M), {"Embree (1 thread)": Embree(z)}
        if HAS_MITSUBA:
            peers["Mitsuba"] = Mitsuba(z)
        for tier in TIERS.values():  # compile; make the pyramid and the transposed copy
            for azimuth in (10.0, 100.0):
                occluded(field, direction_enu(azimuth, 5.0), tier)
        occluded_sweep(field, 0.1, np.radians(SWEEP_DEG), TIERS["draft"])
        for peer in peers.values():
            peer.shadows(direction_enu(10.0, 5.0))
        shadows(n, field, peers)
        del peers["Embree (1 thread)"]
        if HAS_MITSUBA:
            sweep(n, field, peers["Mitsuba"])
            cameras(n, field, peers["Mitsuba"])
        memory(field)
        peers.clear()
    growth()


if __name__ == "__main__":
    main([int(size) for size in sys.argv[1:]] or [2048, 4096])
