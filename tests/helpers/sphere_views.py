"""Lights, windows and cameras for tests of the plain sphere."""

from lcp_catalog.cameras.view import looking_camera
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.light.sources import Lighting
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.terrain.area import NodeWindow

R = MOON_RADIUS_M
LAMBERT, SEELIGER = reflectance_model("lambert"), reflectance_model("lommel-seeliger")
WHOLE = NodeWindow(-40, 41, -40, 41)


def lit_from(azimuth, elevation, disc=False):
    return Lighting.of_sun(direction_enu(azimuth, elevation), disc)


def window_of(size_m, gsd):
    half = 0.5 * size_m
    return NodeWindow.covering((-half, half, -half, half), gsd)


def far_camera(frame, distance=3e8, pixels=64, across=1.1):
    """The whole disc, north up, from over the frame's origin."""
    size = 2 * R * across
    return looking_camera(frame, [0.0, 0.0, distance], size / pixels, (size, size))
