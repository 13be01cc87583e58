"""A simulated frame of Hadley and patches of its terrain; made once for all modules."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.images.image import Image
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.simulation.detector import Detector
from lcp_catalog.simulation.frame import DemSurface, frame

from .catalogs import HADLEY
from .twins_match import catalog_of_dem, looking_at

LAW = reflectance_model("lunar-lambert")
GSD_M = 118.45


@cache
def hadley_catalog() -> Catalog:
    """Patches of 33 x 33 nodes on a grid of 4.5 km around Hadley, without overlap, good and bad
    points alike.
    """
    lon, lat = np.meshgrid(np.linspace(3.02, 3.98, 7), np.linspace(25.56, 26.44, 7))
    return catalog_of_dem(lon.ravel(), lat.ravel(), 33, GSD_M)


@cache
def hadley_camera() -> Camera:
    """300 km above, 15 degrees off the vertical, turned by 37 degrees; a pixel is a cell."""
    return looking_at(
        EnuFrame(3.5, 26.0, -1000.0), 300e3, 15, 60, 37, 300e3 / GSD_M, (320, 320), (159.7, 159.1)
    )


def simulated_image(request: Request, detector: Detector, samples: int | None = None) -> Image:
    """The image that a request's camera takes of its DEM."""
    surface = DemSurface.seen(request, detector.margin_px)
    assert request.view.plane is not None
    return replace(frame(surface, request.view.plane, detector, samples).image, name="simulated")


def taken(
    camera: Camera,
    azimuth: float = 100.0,
    elevation: float = 20.0,
    noise: float = 0.03,
    blur: float = 0.5,
    seed: int = 1,
) -> Image:
    request = Request(
        DemSet.open([HADLEY]),
        sun=SunChoice(azimuth, elevation),
        view=ViewChoice(camera),
        model=LAW,
        disc=False,
    )
    return simulated_image(request, Detector(blur_px=blur, noise=noise, bits=12, seed=seed))


@cache
def hadley_photo() -> Image:
    return taken(hadley_camera())
