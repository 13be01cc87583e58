"""A small build on the sample's terrain."""

from __future__ import annotations

from pathlib import Path

from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.point_config import PointConfig

DEM = Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"

CONFIG = BuildConfig(
    area=AreaConfig(center_deg=(3.5, 26.0), size_km=45.0, gsd_m=474.0),
    sun=SunConfig((60.0, 90.0, 120.0, 180.0, 240.0, 270.0), (10.0, 30.0, 60.0)),
    view=ViewConfig((0.0, 40.0), (0.0, 90.0), (float("inf"), 100.0)),
    points=PointConfig(patch_nodes=17, search_m=9000.0, per_view=0),
    model=ModelConfig(direction_tolerance_deg=1.0, ring_max_km=40.0, albedo="none"),
)
