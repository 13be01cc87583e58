"""A synthetic catalogue of many points on a spiral over the Moon, with small patches."""

from __future__ import annotations

import numpy as np

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.model import Coverage, Overview
from lcp_catalog.catalog.schema import summarise_usable
from lcp_catalog.geometry.frames import enu_rotation, lonlat_to_mcmf

NODES = 5
GOLDEN_DEG = 137.50776405003785


def catalog(
    count: int, seed: int = 1, nodes: int = NODES, views: int = 2, sun_azimuths: int = 12
) -> Catalog:
    """A sound catalogue with claims; the points are evenly spread between 60 S and 60 N."""
    rng = np.random.default_rng(seed)
    number = np.arange(count)
    lat = np.degrees(np.arcsin((2.0 * (number + 0.5) / max(count, 1) - 1.0) * 0.866))
    lon = number * GOLDEN_DEG % 360.0
    elevation = np.round(rng.normal(0.0, 1000.0, count), 1)
    suns, azimuths = np.linspace(5.0, 75.0, 5), np.arange(sun_azimuths) * 360.0 / sun_azimuths
    condition = np.where(rng.random((count, views, 5, sun_azimuths)) < 0.7, 31, 29).astype(np.uint8)
    condition[:, :, :, 0] = 0
    detection = np.where(condition == 31, 0.95, np.where(condition == 0, np.nan, 0.4))
    detection = np.stack([detection, detection], axis=1).astype(np.float32)
    major = np.where(np.isnan(detection), np.nan, np.float32(12.0))
    lowest, highest = summarise_usable(condition, suns)
    dem = rng.integers(-50, 50, (count, nodes, nodes)).astype(np.float32)
    dem[:, nodes // 2, nodes // 2] = 0.0
    axis = np.linspace(-5e6, 5e6, 100)
    ones = np.ones(count)
    return Catalog(
        sun_elevation=suns, sun_azimuth=azimuths, view_off_nadir=np.array([0.0, *[30.0] * (views - 1)]),
        view_azimuth=np.array([0.0, *90.0 * np.arange(1, views)]), view_altitude=np.array([np.inf, *[100.0] * (views - 1)]),
        point_id=number, longitude=lon, latitude=lat, elevation=elevation,
        position_mcmf=lonlat_to_mcmf(lon, lat, elevation),
        rotation_mcmf_to_enu=enu_rotation(lon, lat), gsd=118.0 * ones, level=np.zeros(count, np.int32),
        elevation_sigma=np.nan * ones, dem_resolution=np.nan * ones,
        dem_product=np.array(["SLDEM2015"] * count, dtype=object), dem=dem, condition=condition,
        sun_elevation_min=lowest, sun_elevation_max=highest, harris_response=0.1 * ones,
        localization_sigma=np.stack([12.0 * ones, 9.0 * ones], axis=1),
        second_peak=rng.uniform(0.3, 0.8, count), false_match_probability=1e-3 * ones,
        gsd_min=118.0 * ones, gsd_max=236.0 * ones, shadow_dependence=0.0 * ones,
        occlusion_dependence=0.0 * ones, config="", scene_plan={"decisions": []},
        sources=[{"name": "a.img", "size": 1, "sha256": "0" * 64}],
        overview=Overview(np.zeros((100, 100), np.float32), axis, axis[::-1], 0.0, 0.0),
        coverage=Coverage(lon[::50], lat[::50], np.zeros(len(lon[::50]), np.uint8), 30_000.0),
        image_scale=np.array([1.0, 2.0]), detection_probability=detection, sigma_major=major,
        sigma_minor=0.75 * major, sigma_angle=np.where(np.isnan(major), np.nan, 30.0),
        errors={"min_detection": 0.9},
    )  # fmt: skip
