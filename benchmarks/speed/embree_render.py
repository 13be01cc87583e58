"""A minimal script for one image of terrain, as `benchmarks.speed.render` runs it: Embree shadows, Lommel-Seeliger, two bands.

python benchmarks/speed/embree_render.py DEM OUT LON LAT NODES SUN_AZIMUTH SUN_ELEVATION
"""

import sys

import numpy as np
import rasterio
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from rasterio.windows import Window

RADIUS_M = 1737400.0

dem, out = sys.argv[1:3]
lon, lat, side, azimuth, elevation = np.radians(np.array(sys.argv[3:], float))
n = int(sys.argv[5])
with rasterio.open(dem) as file:
    col, row = ~file.transform * (lon * RADIUS_M, lat * RADIUS_M)
    window = Window(int(col) - n // 2, int(row) - n // 2, n, n)
    z = file.read(1, window=window).astype(np.float32)
    crs, transform, cell = file.crs, file.window_transform(window), file.res[0]
step = (np.arange(n) - n // 2) * cell
x, y = np.meshgrid(step * np.cos(lat), -step)
z = z - (x * x + y * y) / (2 * RADIUS_M)
nodes = np.stack([x, y, z], -1).reshape(-1, 3).astype(np.float32)
corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel().astype(np.int32)
upper = np.stack([corner, corner + n + 1, corner + 1], 1)
lower = np.stack([corner, corner + n, corner + n + 1], 1)
scene = EmbreeScene()
mesh = TriangleMesh(scene, nodes, np.concatenate([upper, lower]))
sun = np.array([np.sin(azimuth), np.cos(azimuth), np.tan(elevation)]) * np.cos(elevation)
rays = np.broadcast_to(sun.astype(np.float32), nodes.shape).copy()
lifted = nodes + np.array([0.0, 0.0, 0.05], np.float32)
lit = (scene.run(lifted, rays, query="OCCLUDED") < 0).reshape(n, n)
down, across = np.gradient(z, -cell, cell * np.cos(lat))
up = 1.0 / np.sqrt(1.0 + across**2 + down**2)
towards = np.maximum((sun[2] - across * sun[0] - down * sun[1]) * up, 0.0) * lit
tiles = {"tiled": True, "blockxsize": 256, "blockysize": 256, "compress": "deflate", "predictor": 3}
shape = {"width": n, "height": n, "count": 2, "dtype": "float32"}
with rasterio.open(out, "w", "GTiff", crs=crs, transform=transform, **shape, **tiles) as file:
    file.write((0.1 * towards / (towards + up)).astype(np.float32), 1)
    file.write(lit.astype(np.float32), 2)
