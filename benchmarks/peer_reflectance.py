"""Hapke's model compared with the plugin `hapke` of eradiate-mitsuba, an independent implementation in C++.

    python -m venv peer && peer/bin/pip install eradiate-mitsuba==0.5.0 numpy numba
    PYTHONPATH=. peer/bin/python benchmarks/peer_reflectance.py

The plugin's c is the weight of the backward lobe, (1 + c)/2 here. It has shadow hiding and roughness, but neither coherent
backscatter nor porosity. `tests/photometry/test_hapke.py` contains some of its numbers. It is not a test dependency,
because its own package `mitsuba` conflicts with that of benchmarks/peers.py.
"""

from __future__ import annotations

import math

import mitsuba
import numpy as np

from lcp_catalog.photometry.hapke_parameters import SETS, HapkeSet
from lcp_catalog.photometry.laws import Reflectance, radiance_factor

COUNT = 20_000
MADE = (
    HapkeSet("smooth", 0.3854, 0.2375, 0.3253, 1.686, 0.0672, theta_bar_deg=0.0),
    HapkeSet("rough and bright", 0.9, 0.4, -0.2, 0.7, 0.2, theta_bar_deg=45.0),
)


def directions(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (count, 3) above the surface, half of them within 5 deg of grazing; the angles."""
    angle = np.radians(rng.uniform(0.0, 90.0, count))
    angle[::2] = np.radians(rng.uniform(85.0, 89.99, len(angle[::2])))
    around = rng.uniform(0.0, 2.0 * math.pi, count)
    sine = np.sin(angle)
    return np.stack([sine * np.cos(around), sine * np.sin(around), np.cos(angle)], axis=-1), angle


def theirs(parameters: HapkeSet, suns: np.ndarray, cameras: np.ndarray) -> np.ndarray:
    """Radiance factors by the plugin, which gives the BRDF times the cosine of its second direction."""
    plugin = {"type": "hapke", "w": parameters.w, "b": parameters.b, "c": (1 + parameters.c) / 2}
    plugin |= {"B_0": parameters.b_s0, "h": parameters.h_s, "theta": parameters.theta_bar_deg}
    law, context = mitsuba.load_dict(plugin), mitsuba.BSDFContext()
    out = np.empty(len(suns))
    for k, (sun, camera) in enumerate(zip(suns, cameras, strict=True)):
        at = mitsuba.SurfaceInteraction3f()
        at.sh_frame, at.wi, at.t = mitsuba.Frame3f([0, 0, 1]), mitsuba.Vector3f(*camera), 1.0
        out[k] = math.pi * float(np.ravel(law.eval(context, at, mitsuba.Vector3f(*sun)))[0])
    return out


def main() -> None:
    mitsuba.set_variant("scalar_mono_double")
    rng = np.random.default_rng(5)
    suns, incidence = directions(rng, COUNT)
    cameras, emission = directions(rng, COUNT)
    across = np.linalg.norm(np.cross(suns, cameras), axis=-1)
    phase = np.arctan2(across, np.sum(suns * cameras, axis=-1))
    for parameters in (*SETS.values(), *MADE):
        ours = radiance_factor(Reflectance.of_hapke(parameters), incidence, emission, phase)
        off = np.abs(theirs(parameters, suns, cameras) / ours - 1.0)
        print(f"{parameters.name}: median {np.median(off):.1e}, greatest {off.max():.1e}")


if __name__ == "__main__":
    main()
