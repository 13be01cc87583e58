"""One terrain in two DEMs: coarse pixels everywhere, fine ones at a site."""

from __future__ import annotations

from pathlib import Path

from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.point_config import PointConfig

from . import products, synthetic

FINE_M, COARSE_M = 240.0, 480.0
SITE_KM = 16.8

CONFIG = BuildConfig(
    area=AreaConfig(center_deg=(1.0, 9.0), size_km=36.0, levels_m=(FINE_M, COARSE_M)),
    sun=SunConfig((90.0, 270.0), (10.0,)),
    view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
    points=PointConfig(patch_nodes=17, search_m=4000.0, spacing_m=2500.0),
    model=ModelConfig(
        direction_tolerance_deg=1.0, ring_max_km=5.0, area_nodes_max=64, albedo="none"
    ),
)


def two_dems(folder: Path) -> tuple[Path, Path]:
    """``wide.tif``, 53 km around 1 E 9 N, and ``site.tif``, `SITE_KM` in its middle."""
    fine = synthetic.cratered(220, FINE_M, seed=3)
    coarse = fine.reshape(110, 2, 110, 2).mean(axis=(1, 3))
    nodes = round(SITE_KM * 1e3 / FINE_M)
    cut = (len(fine) - nodes) // 2
    west, north = (
        products.DEGREE_M * 1.0 - 110 * FINE_M,
        products.DEGREE_M * 9.0 + 110 * FINE_M,
    )
    inset = cut * FINE_M
    return (
        products.geotiff(folder / "wide.tif", coarse, west, north, COARSE_M),
        products.geotiff(
            folder / "site.tif",
            fine[cut : cut + nodes, cut : cut + nodes],
            west + inset,
            north - inset,
            FINE_M,
        ),
    )
