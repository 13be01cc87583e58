"""Shadows, sweeps and camera rays compared with Mitsuba 3 (llvm) and Embree on the same surface, in turn in one process.

Run by `make bench-peers`:

    python -m benchmarks.speed peers [2048 4096]

The peers are a dependency group of their own, never run-time dependencies; they install with pip
alone. Mitsuba traces with the Embree built into it, on as many threads as lcp; its llvm variant loads the system's LLVM
library, and without that library its columns are left out. The other peer is Embree 4 through embreex, which uses one thread.
The peers' meshes are split along the same diagonal as ours. They have no edge-crossing test, so their rays start one centimetre
above the nodes, and some of their masks differ from ours for that reason. Quote the ratios: the speed of a shared machine
drifts, and it drifts for all.
"""

from __future__ import annotations

import contextlib
import math
import platform
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from benchmarks import sections
from benchmarks.markdown import percent, table
from benchmarks.timing import median, ratio
from lcp_catalog.accuracy import TIERS
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.occlusion import occluded, occluded_sweep
from lcp_catalog.threads import thread_limit
from tests.helpers.synthetic import cratered

with contextlib.suppress(ImportError):  # `--help` works without the peers
    import drjit as dr
    import mitsuba as mi
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

THREADS = thread_limit()

HAS_PEERS = "EmbreeScene" in globals()
HAS_MITSUBA = HAS_PEERS and bool(dr.has_backend(dr.JitBackend.LLVM))
"""True if the system has the LLVM library that Mitsuba's llvm variant loads."""
if HAS_MITSUBA:
    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(THREADS)

CELL_M = 20.0
LIFT_M = 0.01
ELEVATIONS_DEG = (0.5, 2.0, 5.0, 15.0, 45.0)
SWEEP_DEG = (0.5, 1.0, 2.0, 5.0, 8.0, 12.0, 20.0, 40.0)
ROUNDS = 6

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


def shadows(n: int, field: Heightfield, peers: dict[str, Mitsuba | Embree]) -> str:
    """Table of the tiers and peers by the Sun's elevation: medians over the azimuths."""
    base = list(peers)[-1]
    names, rows = [*TIERS, *peers], []
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
                off = masks[name].ravel() != masks["reference"].ravel()
                differ[name].append(float(np.mean(off)))
        cells = [
            f"{median(speed[name]):.0f}, x{ratio(speed[base], speed[name]):.3g}, {percent(float(np.mean(differ[name])), 4)}"
            for name in names
        ]
        rows.append([f"{elevation:g} deg", *cells])
    return (
        f"Shadows of {n} x {n} nodes: Mnode/s, ratio to {base}, share of nodes that differ from `reference`\n\n"
        f"{table(['Sun', *names], rows)}\n"
    )


def sweep(n: int, field: Heightfield, mitsuba: Mitsuba) -> str:
    """16 azimuths of 8 elevations; Mitsuba traces one azimuth in four."""
    elevations = np.radians(SWEEP_DEG)
    ours: dict[str, list[float]] = {"draft": [], "standard": []}
    theirs = []
    for step in range(16):
        azimuth = 360.0 * (step + 0.1) / 16
        for tier, times in ours.items():
            if tier == "draft" or step % 4 == 0:
                turn = math.radians(azimuth)
                times.append(timed(occluded_sweep, field, turn, elevations, TIERS[tier])[0])
        if step % 4 == 0:
            for elevation in SWEEP_DEG:
                theirs.append(timed(mitsuba.shadows, direction_enu(azimuth, elevation))[0])
    rate = n * n / float(np.mean(theirs))
    rows = [["Mitsuba", f"{rate / 1e6:.1f}", "x1"]]
    for tier, times in ours.items():
        own = len(SWEEP_DEG) * n * n / float(np.mean(times))
        rows.append([tier, f"{own / 1e6:.0f}", f"x{own / rate:.3g}"])
    head = [
        f"sweep, 16 azimuths x {len(SWEEP_DEG)} elevations, {n} x {n}",
        "M sun-cells/s",
        "ratio",
    ]
    return table(head, rows) + "\n"


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


def cameras(n: int, field: Heightfield, mitsuba: Mitsuba) -> str:
    """First hits of n x n rays for several cameras; rays are made before the clock starts, as each side wants them."""
    rows = []
    for name, parameters in CAMERAS.items():
        position, rays = camera(n, *parameters)
        theirs_in = mi.Ray3f(
            mi.Point3f(*position.tolist()), mi.Vector3f(rays.reshape(-1, 3).T.astype(np.float32))
        )
        ours, theirs = [], []
        for _ in range(ROUNDS):
            seconds, mine = timed(field.first_hits, position, rays)
            ours.append(seconds)
            seconds, other = timed(mitsuba.ranges, theirs_in)
            theirs.append(seconds)
        mine, other = np.nan_to_num(mine.ravel(), nan=np.inf), other.astype(np.float64)
        both = np.isfinite(mine) & np.isfinite(other)
        away = (np.isfinite(mine) != np.isfinite(other)).mean()
        differ = float(away + np.mean(np.abs(mine[both] - other[both]) > 1.0))
        speeds = [f"{n * n / median(times) / 1e6:.1f}" for times in (ours, theirs)]
        rows.append([name, *speeds, f"x{ratio(ours, theirs):.2f}", percent(differ, 3)])
    head = [
        f"camera rays, {n} x {n} pixels",
        "lcp, Mray/s",
        "Mitsuba",
        "ratio",
        "ranges off by 1 m",
    ]
    return table(head, rows) + "\n"


def main(words: Sequence[str]) -> int:
    parser = sections.parser("speed peers", __doc__)
    parser.add_argument("sizes", nargs="*", type=int, default=[2048, 4096], metavar="NODES")
    sizes = parser.parse_args(words).sizes
    if not HAS_PEERS:
        parser.error("Mitsuba and Embree are not installed: make bench-peers")
    processor = platform.processor() or platform.machine()
    print(
        f"{processor}, {THREADS} threads, Mitsuba {mi.__version__}, embreex {version('embreex')}\n"
    )
    if not HAS_MITSUBA:
        print("Mitsuba is left out: install the system's LLVM library to compare with it\n")
    for n in sizes:
        z = terrain(n)
        field, peers = Heightfield(z, CELL_M), dict[str, Mitsuba | Embree]()
        peers["Embree (1 thread)"] = Embree(z)
        mitsuba = Mitsuba(z) if HAS_MITSUBA else None
        if mitsuba:
            peers["Mitsuba"] = mitsuba
        for tier in TIERS.values():  # compile; make the pyramid and the transposed copy
            for azimuth in (10.0, 100.0):
                occluded(field, direction_enu(azimuth, 5.0), tier)
        occluded_sweep(field, 0.1, np.radians(SWEEP_DEG), TIERS["draft"])
        for peer in peers.values():
            peer.shadows(direction_enu(10.0, 5.0))
        print(shadows(n, field, peers), flush=True)
        peers.clear()
        if mitsuba:
            print(sweep(n, field, mitsuba), flush=True)
            print(cameras(n, field, mitsuba), flush=True)
    return 0
