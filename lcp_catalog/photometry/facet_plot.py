"""Polar charts of a fit of the facet model in the plane of incidence (figure 6 of the paper).

Angles are the paper's theta, positive on the side of the source. The source is on the upper left
and the specular direction on the right.
"""

from __future__ import annotations

import numpy as np

from ..plots.polar import Curve, Panel, polar_chart
from .facet_fit import Fit
from .facet_model import FacetModel, Node, constants, lobes
from .goniometer import Measurements


def fit_chart(fit: Fit, measurements: Measurements) -> str:
    """SVG of relative intensities, one panel for each incidence: the measurements in the plane of
    incidence, the model, and its two lobes.
    """
    panels = []
    for sample, node in zip(measurements.samples, fit.model.nodes, strict=True):
        emission, values = (sample.scaled() if fit.normalized else sample).level_values()
        dots = Curve(emission, values, "dots", "measured")
        panels.append(incidence_panel(node.incidence_deg, (dots, *lobe_curves(fit.model, node))))
    return polar_chart(panels, f"{measurements.name}: relative intensity", 2)


def incidence_panel(incidence_deg: float, curves: tuple[Curve, ...]) -> Panel:
    """Panel of one incidence, with the source marked."""
    return Panel(f"incidence {incidence_deg:g}°", curves, ((incidence_deg, "source"),))


def lobe_curves(model: FacetModel, node: Node) -> tuple[Curve, ...]:
    """Relative intensities of the diffuse lobe, the directional lobe, and both."""
    theta, head = np.linspace(-89.9, 89.9, 361), constants(model.optics, model.shadowing)
    both = lobes(node, head, theta)
    diffuse = lobes(node._replace(w_b=0.0), head, theta)
    return (
        Curve(theta, diffuse, "dashed", "diffuse lobe"),
        Curve(theta, both - diffuse, "thin", "directional lobe"),
        Curve(theta, both, "solid", "model"),
    )
