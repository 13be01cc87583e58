"""Slow, plain twins of the matcher's parts, and catalogues of any patches to try it on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from catalogs import HADLEY, catalog

from lcp_catalog.camera import Camera
from lcp_catalog.catalog import Catalog
from lcp_catalog.demset import DemSet
from lcp_catalog.heightfield import Heightfield
from lcp_catalog.reflectance import DEFAULT_MODEL, Reflectance, photometry
from lcp_catalog.sphere import EnuFrame
from lcp_catalog.terrain import sample_patch


def catalog_of_patches(
    patches: np.ndarray, frames: Sequence[EnuFrame], gsd_m: float, **changes
) -> Catalog:
    """A catalogue that holds nothing but given patches (n, p, p), each in its own frame; other fields by name."""
    n = len(frames)
    made = {
        "dem": patches,
        "gsd": np.full(n, gsd_m),
        "position_mcmf": np.array([f.origin_mcmf_m for f in frames]).reshape(-1, 3),
        "rotation_mcmf_to_enu": np.array([f.rotation for f in frames]).reshape(-1, 3, 3),
        "longitude": np.array([f.lon_deg % 360.0 for f in frames]),
        "latitude": np.array([f.lat_deg for f in frames]),
        "elevation": np.array([f.height_m for f in frames]),
        "gsd_min": np.full(n, 0.05 * gsd_m),
        "gsd_max": np.full(n, 4.0 * gsd_m),
    }
    return catalog(n, patches.shape[1], **(made | changes))


def catalog_of_dem(
    lon: np.ndarray, lat: np.ndarray, size: int, gsd_m: float, dem: Path | str = HADLEY
) -> Catalog:
    """Patches of real terrain around given places, good or bad as control points."""
    dems = DemSet.open([dem], ())
    cut = [
        sample_patch(dems, float(o), float(a), size, gsd_m) for o, a in zip(lon, lat, strict=True)
    ]
    return catalog_of_patches(np.array([p.z_m for p in cut]), [p.frame for p in cut], gsd_m)


def looking_at(
    frame: EnuFrame,
    away_m: float,
    off_nadir_deg: float,
    azimuth_deg: float,
    roll_deg: float,
    focal_px: float,
    size: tuple[int, int],
    middle: tuple[float, float] | None = None,
) -> Camera:
    """A camera ``away_m`` from a frame's origin, which it sees at the pixel ``middle`` (default: of the image)."""
    off, azimuth, roll = np.radians([off_nadir_deg, azimuth_deg, roll_deg])
    up = np.array([np.sin(off) * np.sin(azimuth), np.sin(off) * np.cos(azimuth), np.cos(off)])
    ahead = -frame.direction_to_mcmf(up)
    right = np.cross(ahead, frame.direction_to_mcmf([0.0, 1.0, 0.0]))
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    rows = np.array(
        [
            np.cos(roll) * right + np.sin(roll) * down,
            np.cos(roll) * down - np.sin(roll) * right,
            ahead,
        ]
    )
    width, height = size
    middle = ((width - 1) / 2, (height - 1) / 2) if middle is None else middle
    return Camera(frame.to_mcmf(up * away_m), rows, focal_px, middle, size, name="made up")


def traced_image(
    heights: np.ndarray,
    gsd_m: float,
    frame: EnuFrame,
    camera: Camera,
    sun_enu: np.ndarray,
    window: tuple[int, int, int, int],
    rays: int,
    model: Reflectance = DEFAULT_MODEL,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean radiance, and the share of rays that meet the patch, of pixels (first column, first row, columns, rows), each
    ``rays`` x ``rays`` exact rays: hits, shadows and interpolated normals of `Heightfield`.
    """
    half = heights.shape[0] // 2
    field = Heightfield(heights, gsd_m, -half * gsd_m, half * gsd_m)
    col0, row0, cols, rows = window
    steps = (np.arange(rays) + 0.5) / rays - 0.5
    x = (col0 + np.arange(cols)[:, None] + steps).ravel()
    y = (row0 + np.arange(rows)[:, None] + steps).ravel()
    pixels = np.stack(np.meshgrid(x, y), axis=-1)
    origin = frame.from_mcmf(camera.position_mcmf_m)
    ahead = frame.direction_from_mcmf(camera.rays(pixels))
    away = field.first_hits(origin, ahead)
    met = np.isfinite(away)
    points = origin + np.where(met, away, 0.0)[..., None] * ahead
    light = np.full(met.shape, np.nan)
    hits = points[met]
    normals = field.normals_at(hits[:, 0], hits[:, 1])
    lit = ~field.occluded_points(hits, sun_enu)
    bands = photometry(normals, sun_enu, -ahead[met], lit, np.ones(len(hits), bool), model)
    light[met] = bands.radiance
    blocks = light.reshape(rows, rays, cols, rays)
    seen = np.isfinite(blocks)
    share = seen.mean(axis=(1, 3))
    total = np.where(seen, blocks, 0.0).sum(axis=(1, 3))
    return total / np.maximum(seen.sum(axis=(1, 3)), 1), share
