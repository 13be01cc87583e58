"""Tables 1 to 3 of Labunets et al. 2019 (a paint coating, near infrared) as named facet models,
with reconstructed values where the available text of the paper has lost them. Source: see
`facet_model`.

Three choices are not from the paper. *The weights*: as factors of R(gamma)/R(0), as in eq. (1), the
tables miss the paper's normalisation I_rel(psi, -psi) = 1 by factors of 1.4 to 25; as factors of
R(gamma) they meet it to 0.09. So w_B of the tables is multiplied by R(0). *The refractive index*,
which the paper does not print: 1.46, the least squares of that normalisation over all twelve rows
(1 sigma 0.02). *The shadowing*: the defaults of `facet_model.Shadowing`.

The available text of table 2 lacks the columns psi, dpsi and w_B. The angles follow from the ends
of the damaged rows: they are those of table 3. At 0, 40, 60, 70 deg w_B is that of table 3, because
the regularisation changes neither the error there (5.63, 2.21, 3.76, 4.49 %) nor any other
parameter. At 10, 20, 30 and 50 deg (`TABLE_2_LOST`) w_B is lost; the value of table 3 replaces it.
According to the printed D2, the curve of w_B grew by only 0.5 % in length.
"""

from __future__ import annotations

from functools import cache

from ..errors import ConfigError
from .facet_model import FacetModel, Node, Optics

PAPER = "Labunets, Borzov, Akhmetov 2019, Opticheskii Zhurnal 86 (10) 20-29"
OPTICS = Optics(n=1.46)

TABLE_1 = {
    # wavelength, um: psi, w_B, dpsi, sigma_B, w_D, dtheta, sigma_D
    "0.91": ((60, 1.76, 5.5, 0.22, 1.59, 0, 0.85), (70, 1.5, 5, 0.1, 0.55, 2.6, 1.0)),
    "1.04": ((60, 1.8, 5.5, 0.2, 1.59, 0.8, 0.85), (70, 1.27, 5, 0.096, 0.52, 2.6, 1.0)),
}
TABLE_2 = (
    (0, 2.439, 50, 0.250, 1.050, -9, 0.820),
    (10, 0.963, 29, 0.100, 1.019, 0, 0.950),
    (20, 0.852, 20, 0.175, 1.068, 0, 0.925),
    (30, 0.713, 17, 0.120, 1.203, -1, 0.900),
    (40, 0.574, 15, 0.120, 1.390, 0, 0.900),
    (50, 0.668, 12, 0.082, 1.644, 1, 0.920),
    (60, 1.054, 9, 0.100, 1.596, 5, 0.900),
    (70, 1.427, 5, 0.095, 0.501, 3, 0.950),
)
TABLE_2_LOST = (10, 20, 30, 50)
"""Incidences at which w_B of `TABLE_2` is replaced by that of table 3."""

TABLE_3 = (
    (0, 2.439, 50, 0.250, 1.050, -9, 0.820),
    (10, 0.963, 29, 0.213, 1.059, -3, 0.875),
    (20, 0.852, 20, 0.175, 1.068, -2, 0.925),
    (30, 0.713, 17, 0.120, 1.203, -1, 0.913),
    (40, 0.574, 15, 0.120, 1.390, 0, 0.900),
    (50, 0.668, 12, 0.082, 1.644, 1, 0.900),
    (60, 1.054, 9, 0.100, 1.596, 5, 0.900),
    (70, 1.427, 5, 0.095, 0.501, 3, 0.950),
)

DEFAULT = "labunets-2019-table-3"


def _model(name: str, rows: tuple[tuple[float, ...], ...]) -> FacetModel:
    """A table as a model; w_B of the tables multiplies R, that of the model R / R(0)."""
    nodes = tuple(node._replace(w_b=node.w_b * OPTICS.at_normal) for node in map(Node._make, rows))
    return FacetModel(name, nodes, OPTICS)


NAMED = {
    DEFAULT: TABLE_3,
    "labunets-2019-table-2": TABLE_2,
    "labunets-2019-table-1-0.91um": TABLE_1["0.91"],
    "labunets-2019-table-1-1.04um": TABLE_1["1.04"],
}


@cache
def named_model(name: str) -> FacetModel:
    """Model of a table; ConfigError for an unknown name."""
    if name not in NAMED:
        raise ConfigError(
            f"no facet model {name!r}; valid names: {', '.join(NAMED)}, or a MODEL.toml"
        )
    return _model(name, NAMED[name])
