"""Small random scenes, and their renders by the plan and with everything modelled: what the tests of the scene plan share."""

import math
from dataclasses import replace

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import CameraView
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.rendering.plan import is_vertical, plan_scene
from lcp_catalog.rendering.renderer import Method, render_enu
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.terrain import Terrain

GSD = 20.0


BANDS = ("radiance", "sunlit", "visible", "incidence_deg", "emission_deg", "phase_deg")
REFERENCE, STANDARD, DRAFT = TIERS["reference"], TIERS["standard"], TIERS["draft"]


def make(z, core=None, gsd=GSD):
    z = np.asarray(z, dtype=np.float32)
    rows, cols = z.shape
    field = Heightfield(z, gsd, -(cols // 2) * gsd, (rows // 2) * gsd)
    window = NodeWindow(-(rows // 2), rows - rows // 2, -(cols // 2), cols - cols // 2)
    core = core or (0, rows, 0, cols)
    return Terrain(
        field, EnuFrame(12.0, 34.0), core, window, np.zeros(z.shape, np.int16), ("made",)
    )


def ground(seed: int, nodes: int = 81, length: float = 3.0, sigma: float = 6.0) -> np.ndarray:
    """Heights with the autocorrelation exp(-r^2 / 2 l^2), l in nodes."""
    k = 2.0 * np.pi * np.fft.fftfreq(nodes)
    shape = np.exp(-0.25 * length**2 * (k[:, None] ** 2 + k**2))
    white = np.fft.fft2(np.random.default_rng(seed).normal(size=(nodes, nodes)))
    z = np.fft.ifft2(shape * white).real
    return sigma * z / z.std()


@st.composite
def terrains(draw, smallest=1, holes=False):
    """Random nodes, rough or smooth, sometimes with a core inside, one row wide, or with holes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows, cols = draw(st.tuples(st.integers(smallest, 12), st.integers(smallest, 12)))
    z = rng.normal(size=(rows, cols)) * draw(st.sampled_from([0.05, 3.0, 40.0]))
    if draw(st.booleans()):
        z = np.cumsum(np.cumsum(z, 0), 1) / max(rows, cols)
    if holes:
        z[rng.random(z.shape) < 0.15] = np.nan
    core = None
    if rows > 5 and cols > 5 and draw(st.booleans()):
        core = (2, rows - 1, 1, cols - 2)
    return make(z, core)


def same(a, b, bands=BANDS):
    for band in bands:
        np.testing.assert_array_equal(getattr(a, band), getattr(b, band), err_msg=band)


def everything(plan, view, disc):
    """The plan with all effects modelled, the disc only if it is asked for. A view straight down from infinity hides nothing, and
    has no perspective.
    """
    modelled = {"cast_shadows", *(["solar_disc"] if disc else [])}
    if isinstance(view, CameraView):
        modelled |= {"occlusion", "perspective"}
    elif not is_vertical(view.direction):
        modelled |= {"occlusion"}
    return replace(plan, **{n: replace(getattr(plan, n), modelled=True) for n in modelled})


def without_shadows(terrain, sun, view):
    """The plan of a point Sun that casts no shadow."""
    plan = plan_scene(terrain, sun, view)
    return replace(plan, cast_shadows=replace(plan.cast_shadows, modelled=False))


def both(terrain, sun, view, accuracy=REFERENCE, disc=False, **how):
    """The plan, the render by it, and the render of everything."""
    plan = plan_scene(terrain, sun, view, accuracy=accuracy, disc=disc)
    full = everything(plan, view, disc)
    renders = (
        render_enu(terrain, sun, view, Method(accuracy=accuracy, disc=disc, plan=p, **how))
        for p in (plan, full)
    )
    return plan, *renders


def towards(azimuth_deg, tangent):
    return direction_enu(azimuth_deg, math.degrees(math.atan(tangent)))


AZIMUTHS = st.sampled_from([0.0, 45.0, 90.0, 135.0, 270.0]) | st.floats(0.0, 360.0)
JUST_ABOVE = st.sampled_from([2e-6, 1e-4, 1e-2])
QUICK = settings(deadline=None, max_examples=60)
