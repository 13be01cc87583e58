"""Light by way of other ground, against path tracing by Mitsuba 3 on the same mesh with the same normals.

    python -m pip install mitsuba
    python benchmarks/bounced_light.py [RAYS]

Crater Hadley C of the sample's DEM, Lambert surface of albedo 0.12. Mitsuba's path integrator follows RAYS (4096) paths
from each of some nodes that the Sun does not reach: of one bounce, and of all bounces. Printed for each Sun and tier: rms
difference from one bounce of Mitsuba as a share of its mean, the share that further bounces add, the greatest
bounced radiance factor over the brightest ground's, and seconds.

Nodes to which Mitsuba gives direct light are left out: its shadow rays count in float32, and at the edge of a shadow one
of its rays may pass.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import mitsuba as mi
import numpy as np

from lcp_catalog.accuracy import TIERS
from lcp_catalog.arrays import Array
from lcp_catalog.cameras.view import nadir_view
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.light.bounced_light import bounced_at_points
from lcp_catalog.light.sources import Lighting
from lcp_catalog.photometry.laws import LAMBERT_ALBEDO, reflectance_model
from lcp_catalog.rendering.renderer import render_enu
from lcp_catalog.terrain.area import Area
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.relief_bounds import nodes_enu
from lcp_catalog.terrain.terrain import Terrain, terrain_from_area

mi.set_variant("scalar_rgb")
SAMPLE = Path(__file__).resolve().parents[1] / "sample_data" / "hadley_gld100_256ppd.tif"
CRATER = Area(2.8, 25.4, 12.0)
SUNS_DEG = (8.0, 15.0, 25.0)
LAMBERT = reflectance_model("lambert")
ABOVE_M = 1e4
NODES = 40  # at most, evenly among those that the Sun does not reach


def scene(field: Heightfield, sun: Array, folder: Path) -> mi.Scene:
    """The surface with its nodes' normals under a distant Sun of irradiance 1."""
    rows, cols = field.shape
    corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel().astype(np.uint32)
    upper = np.stack([corner, corner + cols + 1, corner + 1], 1)
    lower = np.stack([corner, corner + cols, corner + cols + 1], 1)
    triangles = np.concatenate([upper, lower])
    shape = mi.Mesh("terrain", rows * cols, len(triangles), has_vertex_normals=True)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = nodes_enu(field, field.whole).astype(np.float32).ravel()
    parameters["vertex_normals"] = field.normals().ravel()
    parameters["faces"] = triangles.ravel()
    parameters.update()
    shape.write_ply(str(folder / "terrain.ply"))
    ground = {"type": "diffuse", "reflectance": {"type": "uniform", "value": LAMBERT_ALBEDO}}
    return mi.load_dict(
        {
            "type": "scene",
            "terrain": {"type": "ply", "filename": str(folder / "terrain.ply"), "bsdf": ground},
            "sun": {"type": "directional", "direction": (-sun).tolist(), "irradiance": 1.0},
        }
    )


def traced(where: mi.Scene, points: Array, rays: int, depth: int, seed: int) -> Array:
    """Radiance factor of points under light by way of other ground, seen from above; ``depth`` as
    Mitsuba counts it (3: one bounce, -1: all).
    """
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 1000})
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    out = np.empty(len(points))
    for k, point in enumerate(points):
        eye = (point + np.array([0.0, 0.0, ABOVE_M])).tolist()
        sensor = mi.load_dict(
            {
                "type": "radiancemeter",
                "origin": eye,
                "direction": [0.0, 0.0, -1.0],
                "film": film,
                "sampler": {"type": "independent", "sample_count": rays},
            }
        )
        image = mi.render(where, sensor=sensor, integrator=integrator, spp=rays, seed=seed + k)
        out[k] = np.pi * np.array(image).ravel()[0]
    return out


def compare(terrain: Terrain, elevation_deg: float, rays: int, folder: Path) -> None:
    """Print one Sun's lines."""
    light, view = Lighting.of_sun(direction_enu(90.0, elevation_deg)), nadir_view()
    plain = render_enu(terrain, light, view, model=LAMBERT)
    dark = np.isfinite(plain.radiance) & (plain.sunlit == 0.0)
    step = max(1, int(dark.sum()) // NODES)
    points = nodes_enu(terrain.field, terrain.core)[dark][::step]
    normals = terrain.field.normals(terrain.core)[dark][::step].astype(np.float64)
    where = scene(terrain.field, light.first.direction.vector, folder)
    dark_there = traced(where, points, 1, 2, 0) == 0.0
    points, normals = points[dark_there], normals[dark_there]
    one, again, every = (
        traced(where, points, rays, depth, seed) for depth, seed in ((3, 0), (3, 10**6), (-1, 0))
    )
    noise = np.sqrt(np.mean((one - again) ** 2) / 2.0) / one.mean()
    share = one.max() / np.nanpercentile(plain.radiance, 99.5)
    print(
        f"Sun {elevation_deg:g} deg: {len(points)} dark nodes; mean radiance factor {one.mean():.3g}, "
        f"greatest {share:.2%} of the brightest ground's; further bounces add "
        f"{every.mean() / one.mean() - 1:.1%}; noise of Mitsuba {noise:.1%}"
    )
    for tier in TIERS.values():
        start = time.perf_counter()
        towards = np.array([0.0, 0.0, 1.0])
        ours = bounced_at_points(terrain, light, points, normals, towards, LAMBERT, tier)
        off = np.sqrt(np.mean((ours - one) ** 2)) / one.mean()
        print(
            f"  {tier.tier:9} rms {off:.1%}, mean {ours.mean() / one.mean() - 1:+.1%}, "
            f"{time.perf_counter() - start:.2f} s"
        )


def main() -> None:
    rays = int(sys.argv[1]) if len(sys.argv) > 1 else 4096
    dems = DemSet.open([SAMPLE])
    terrain = terrain_from_area(dems, CRATER, None)
    with tempfile.TemporaryDirectory() as folder:
        for elevation_deg in SUNS_DEG:
            compare(terrain, elevation_deg, rays, Path(folder))


if __name__ == "__main__":
    main()
