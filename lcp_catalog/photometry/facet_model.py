"""The two-component facet model of a measured surface: its parameters, and its numbers for the
kernels.

L. V. Labunets, A. B. Borzov, I. M. Akhmetov, "Regularised parametric model of the indicatrix of the
brightness coefficient of a rough surface" (in Russian), Opticheskii Zhurnal 86 (10), 20-29, 2019,
doi 10.17586/1023-5086-2019-86-10-20-29. Angles are degrees here and radians in the kernels.

The paper's intensities are relative to the specular intensity of the same incidence, so the
variation of brightness with incidence is lost. A model's ``albedo`` (directional-hemispherical
reflectance, the same at every incidence) replaces it, or ``levels`` if absolute values were
measured.

Tables 1 to 3 of Labunets et al. 2019 (a paint coating, near infrared) as named facet models,
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
parameter. At 10, 20, 30 and 50 deg w_B is lost; the value of table 3 replaces it.
According to the printed D2, the curve of w_B grew by only 0.5 % in length.

MODEL.toml: a facet model as readable text, with the data of its fit. Reading returns exactly the
values that were written.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w
from numpy.typing import ArrayLike

from ..arrays import Array
from ..errors import ConfigError
from ..fields import require
from ..kernels.photometry import facet as kernel
from ..toml_files import is_number, parse_toml, read_toml

ALBEDO = 0.12
"""Default albedo, that of the Lambert model here, typical of the Moon."""

LARGEST_EMISSION_DEG = 80.0
"""Greatest emission angle of the paper's measurements (figure 3)."""

_QUADRATURE, _PER_SIGMA = (40, 500), 5.0
"""Least and greatest number of nodes of a quadrature over emission and over half a turn of azimuth,
and the number for a lobe of scale 1. The reflectance is within 0.5 % of the albedo (checked by a
test)."""


def _check_finite(group: Any) -> None:
    for f in fields(group):
        require(math.isfinite(getattr(group, f.name)), f"{f.name} must be a finite number")


class Node(NamedTuple):
    """The six parameters at one angle of incidence (U in the paper): weight, shift and scale of the
    directional lobe, then of the diffuse lobe. A positive shift moves the directional lobe beyond
    the specular direction, and the diffuse lobe away from the source.
    """

    incidence_deg: float
    w_b: float
    shift_b_deg: float
    sigma_b: float
    w_d: float
    shift_d_deg: float
    sigma_d: float


PARAMETERS = Node._fields[1:]

LIMITS = {
    "incidence_deg": (0.0, 89.9),
    "w_b": (0.0, 1e6),
    "shift_b_deg": (-60.0, 60.0),
    "sigma_b": (0.01, 100.0),
    "w_d": (0.0, 1e6),
    "shift_d_deg": (-40.0, 40.0),
    "sigma_d": (0.05, 20.0),
}
"""Limits of a node's values; beyond them a lobe is too narrow for the quadrature, or unlike those
of the paper."""


@dataclass(frozen=True)
class Optics:
    """Complex refractive index n + i kappa of a facet, and polarisation of the light: degree D_P,
    and angle xi of the electric vector to the plane of incidence. ConfigError for invalid values.
    """

    n: float = 1.5
    kappa: float = 0.0
    polarisation: float = 0.0
    polarisation_angle_deg: float = 0.0

    def __post_init__(self) -> None:
        _check_finite(self)
        require(0.1 <= self.n <= 100.0, f"`refractive_index` must lie in 0.1..100, not {self.n}")
        require(
            0.0 <= self.kappa <= 100.0,
            f"`refractive_index`: kappa must lie in 0..100, not {self.kappa}",
        )
        require(
            self.at_normal > 1e-9,
            "`refractive_index`: a surface of refractive index 1 reflects no light",
        )
        require(0.0 <= self.polarisation <= 1.0, "`polarisation` must lie in 0..1")

    @property
    def at_normal(self) -> float:
        """R(0), which does not depend on polarisation."""
        return ((self.n - 1.0) ** 2 + self.kappa**2) / ((self.n + 1.0) ** 2 + self.kappa**2)


@dataclass(frozen=True)
class Shadowing:
    """Constants of eq. (3). The paper does not print its constants. These are the least squares of
    P_S, P_M and P over shadows counted on Gaussian profiles of rms slope 0.25 (rms error 0.013 of a
    probability, 0.043 at most), the slope at which the paper's tables give I_rel(psi, -psi) = 1.
    The recipe is in tests/helpers/twins_facet.py.

    For another rms slope s, sigma_p = 0.127 s^2. ConfigError for invalid values.
    """

    sigma_c: float = 0.43
    sigma_p: float = 0.0080
    u_p: float = -0.80
    v_p: float = 0.45

    def __post_init__(self) -> None:
        _check_finite(self)
        require(
            self.sigma_c >= 0.0 and self.sigma_p >= 0.0, "sigma_c and sigma_p must not be negative"
        )
        require(self.u_p >= -1.0 and self.v_p > 0.0, "u_p must be at least -1 and v_p positive")


def _check_node(node: Node) -> None:
    for name, value in node._asdict().items():
        low, high = LIMITS[name]
        where = "" if name == "incidence_deg" else f" at incidence {node.incidence_deg:g} deg"
        require(low <= value <= high, f"{name} must lie in {low:g}..{high:g}, not {value:g}{where}")
    require(
        node.w_b + node.w_d > 0.0, f"both weights are 0 at incidence {node.incidence_deg:g} deg"
    )


@dataclass(frozen=True)
class FacetModel:
    """A measured surface: nodes by increasing incidence, optics, shadowing, and brightness.
    ConfigError for invalid values.

    Between the nodes the parameters are shape-preserving cubics over cos(incidence); beyond them
    they are constant. Beyond ``largest_emission_deg`` the brightness is constant (eq. 2 falls to 0
    or rises steeply there, without measurements). ``levels``: the brightness coefficient for I_rel
    / cos(theta) = 1, one for each node; None: see ``albedo``.
    """

    name: str
    nodes: tuple[Node, ...]
    optics: Optics = field(default_factory=Optics)
    shadowing: Shadowing = field(default_factory=Shadowing)
    largest_emission_deg: float = LARGEST_EMISSION_DEG
    albedo: float = ALBEDO
    levels: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        require(len(self.nodes) > 0, "a facet model needs at least one angle of incidence")
        for node in self.nodes:
            _check_node(node)
        angles = [node.incidence_deg for node in self.nodes]
        require(
            all(b - a >= 0.01 for a, b in itertools.pairwise(angles)),
            "angles of incidence must increase",
        )
        require(5.0 <= self.largest_emission_deg <= 89.0, "largest_emission_deg must lie in 5..89")
        require(0.0 < self.albedo <= 1.0, f"albedo must lie in 0..1, not {self.albedo}")
        if self.levels is not None:
            require(len(self.levels) == len(self.nodes), "levels needs one value for each node")
            require(all(0.0 < v < 1e3 for v in self.levels), "levels must be positive")

    @cached_property
    def law(self) -> Array:
        """Numbers of the model in the order of `kernels.photometry.facet`, (n,)."""
        start = self._curved
        emissions, weights, azimuths = self._rule()
        cosines = 1.0 - np.linspace(0.0, 1.0, kernel.TABLE) ** 2
        whole = np.array(
            [kernel.hemisphere(start, c, emissions, weights, azimuths) for c in cosines]
        )
        scale = self.albedo / whole if self.levels is None else self._absolute(cosines, whole)
        mean = np.empty(kernel.TABLE)
        kernel.around_normal(start, cosines, azimuths, mean)
        return np.concatenate([start, scale, scale[0] * mean])

    def parameters(self, incidence_deg: float) -> Node:
        """The six parameters at an incidence."""
        row = kernel.parameters(self._curved, math.cos(math.radians(incidence_deg)))
        w_b, shift_b, sigma_b, w_d, shift_d, sigma_d = row
        return Node(
            incidence_deg, w_b, math.degrees(shift_b), sigma_b, w_d, math.degrees(shift_d), sigma_d
        )

    def intensity(
        self, incidence_deg: float, theta_deg: ArrayLike, phi_deg: ArrayLike = 0.0
    ) -> Array:
        """I_rel of eq. (1) in directions of one shape; theta = +incidence, phi = 0 is the direction
        to the source.
        """
        return lobes(self.parameters(incidence_deg), self._head, theta_deg, phi_deg)

    def brightness(
        self, incidence_deg: float, theta_deg: ArrayLike, phi_deg: ArrayLike = 0.0
    ) -> Array:
        """Brightness coefficient r of eq. (2), without the limit at grazing emission; infinite or
        0/0 at 90 deg.
        """
        return self.intensity(incidence_deg, theta_deg, phi_deg) / np.cos(np.radians(theta_deg))

    def reflectance(self, incidence_deg: ArrayLike) -> Array:
        """Directional-hemispherical reflectance, by quadrature."""
        mu, weights, azimuths = self._rule()
        cosines = np.cos(np.radians(np.atleast_1d(np.asarray(incidence_deg, dtype=np.float64))))
        whole = np.array(
            [kernel.hemisphere(self._curved, c, mu, weights, azimuths) for c in cosines]
        )
        return np.asarray(whole * np.array([kernel.scale(self.law, c) for c in cosines]))

    @cached_property
    def _head(self) -> Array:
        head = constants(self.optics, self.shadowing)
        head[kernel.NODES] = len(self.nodes)
        head[kernel.COS_HELD] = math.cos(math.radians(self.largest_emission_deg))
        return head

    @cached_property
    def _curved(self) -> Array:
        return np.concatenate([self._head, self._curves()])

    def _curves(self) -> Array:
        """Nodes over increasing cosine, then values and slopes of each parameter."""
        cosines, columns = curves(self.nodes)
        return np.concatenate(
            [cosines, *(np.concatenate([v, kernel.pchip_slopes(cosines, v)]) for v in columns)]
        )

    def _absolute(self, cosines: Array, whole: Array) -> Array:
        """Measured levels over the cosine, limited to a reflectance of 1."""
        assert self.levels is not None  # checked by the caller
        nodes, values = curves(self.nodes)[0], np.array(self.levels[::-1])
        slopes = kernel.pchip_slopes(nodes, values)
        level = [kernel.hermite(nodes, values, slopes, c) for c in cosines]
        return np.minimum(level, 1.0 / whole)

    def _rule(self) -> tuple[Array, Array, int]:
        """Emission cosines, weights and a number of azimuths that resolve the narrowest lobe:
        Gauss-Legendre in the angle up to the greatest measured emission, one node for the rest.
        """
        least, most = _QUADRATURE
        narrowest = min(node.sigma_b for node in self.nodes)
        count = min(max(math.ceil(_PER_SIGMA / narrowest), least), most)
        points, weights = np.polynomial.legendre.leggauss(count)
        held = math.radians(self.largest_emission_deg)
        angles = 0.5 * held * (points + 1.0)
        parts = 0.5 * held * weights * np.sin(2.0 * angles)
        rest = math.cos(held)
        return np.append(np.cos(angles), rest), np.append(parts, rest * rest), count


def constants(optics: Optics, shadowing: Shadowing) -> Array:
    """First numbers of the model, without those of its nodes."""
    head = np.zeros(kernel.HEAD)
    twice = 2.0 * math.radians(optics.polarisation_angle_deg)
    head[kernel.INDEX_N], head[kernel.INDEX_K] = optics.n, optics.kappa
    head[kernel.AT_NORMAL] = optics.at_normal
    head[kernel.POLAR_COS] = optics.polarisation * math.cos(twice)
    head[kernel.POLAR_SIN] = optics.polarisation * math.sin(twice)
    head[kernel.SIGMA_C : kernel.V_P + 1] = [getattr(shadowing, f.name) for f in fields(shadowing)]
    return head


def lobes(node: Node, head: Array, theta_deg: ArrayLike, phi_deg: ArrayLike = 0.0) -> Array:
    """I_rel of eq. (1) for a node's own incidence and parameters, in directions of one shape."""
    theta, phi = np.broadcast_arrays(np.radians(theta_deg), np.radians(phi_deg))
    out = np.empty(theta.size)
    psi, *row = node_radians(node)
    kernel.intensities(head, tuple(row), psi, theta.ravel(), phi.ravel(), out)
    return out.reshape(theta.shape)


def node_radians(node: Node) -> tuple[float, ...]:
    """A node with its angles in radians, in the kernels' order."""
    psi, w_b, shift_b, sigma_b, w_d, shift_d, sigma_d = (float(v) for v in node)
    return (
        math.radians(psi),
        w_b,
        math.radians(shift_b),
        sigma_b,
        w_d,
        math.radians(shift_d),
        sigma_d,
    )


def curves(nodes: Sequence[Node]) -> tuple[Array, Array]:
    """Cosines of incidence, increasing (n,), and the parameters at them in radians (6, n)."""
    rows = np.array([node_radians(node) for node in reversed(nodes)])
    return np.cos(rows[:, 0]), np.ascontiguousarray(rows[:, 1:].T)


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


FORMAT = "lcp facet model 1"

_HEAD = """# A reflectance model of a measured surface, by name: facet:THIS_FILE.
# Two lobes, each with a weight, a shift (degrees) and a scale, at every angle of incidence: docs/explanation/facet-model.md.
"""
_PLAIN = ("largest_emission_deg", "albedo")


@dataclass(frozen=True)
class FacetFile:
    """A facet model, and the data of its fit (plain TOML: numbers, texts, lists, tables)."""

    model: FacetModel
    fit: Mapping[str, Any] = field(default_factory=dict)

    def to_toml(self) -> str:
        model = self.model
        document: dict[str, Any] = {"format": FORMAT, "name": model.name}
        document |= {name: float(getattr(model, name)) for name in _PLAIN}
        if model.levels is not None:
            document["levels"] = [float(level) for level in model.levels]
        groups = {"optics": asdict(model.optics), "shadowing": asdict(model.shadowing)}
        for name, group in groups.items():
            document[name] = {key: float(value) for key, value in group.items()}
        document["nodes"] = nodes_table(model.nodes)
        if self.fit:
            document["fit"] = dict(self.fit)
        return _HEAD + tomli_w.dumps(document)

    @classmethod
    def from_toml(cls, text: str) -> FacetFile:
        """Parse TOML text; ConfigError for an invalid document."""
        document = parse_toml(text)
        if document.pop("format", None) != FORMAT:
            raise ConfigError(f"not a facet model: format = {FORMAT!r} is missing")
        fit = document.pop("fit", {})
        if not isinstance(fit, dict):
            raise ConfigError("[fit] must be a table")
        return cls(_model_of_document(document), fit)


def load_model(path: Path | str) -> FacetFile:
    """Read a MODEL.toml; the ConfigError of an invalid file names it. InputError if it cannot be read."""
    return read_toml(path, FacetFile.from_toml)


def facet_model(which: str = "") -> FacetModel:
    """Model for the text after ``facet:``, a table of the paper or a MODEL.toml; without a text,
    table 3. ConfigError if it is neither.
    """
    path = model_path(which)
    return load_model(path).model if path else named_model(which or DEFAULT)


def model_path(which: str) -> Path | None:
    """File for the text after ``facet:``; None if the text is the name of a table."""
    if which in NAMED or not (which.lower().endswith(".toml") or Path(which).is_file()):
        return None
    return Path(which)


def law_file(spec: str) -> Path | None:
    """File of a reflectance model, if it has one: ``facet:MODEL.toml``."""
    law, _, which = spec.partition(":")
    return model_path(which) if law == "facet" and which else None


def nodes_table(nodes: tuple[Node, ...]) -> dict[str, list[float]]:
    """One list for each parameter, one value for each node."""
    return {name: [float(getattr(node, name)) for node in nodes] for name in Node._fields}


def _model_of_document(document: dict[str, Any]) -> FacetModel:
    known = {f.name for f in fields(FacetModel)}
    unknown = sorted(set(document) - known)
    if unknown:
        raise ConfigError(
            f"unknown key {', '.join(unknown)}; valid keys: {', '.join(sorted(known))}"
        )
    if not isinstance(document.get("name"), str):
        raise ConfigError("name must be a text")
    plain = {name: _number(name, document[name]) for name in _PLAIN if name in document}
    levels = document.get("levels")
    optics = Optics(**_group("optics", Optics, document))
    shadowing = Shadowing(**_group("shadowing", Shadowing, document))
    numbers = None if levels is None else _numbers("levels", levels)
    # the document's keys are the fields of the model, checked above
    return FacetModel(
        document["name"], _nodes(document), optics, shadowing, levels=numbers, **plain
    )


def _group(name: str, kind: type, document: dict[str, Any]) -> dict[str, float]:
    table = document.get(name, {})
    known = [f.name for f in fields(kind)]
    if not isinstance(table, dict):
        raise ConfigError(f"[{name}] must be a table")
    unknown = sorted(set(table) - set(known))
    if unknown:
        raise ConfigError(
            f"[{name}] has no key {', '.join(unknown)}; valid keys: {', '.join(known)}"
        )
    return {key: _number(f"{name}.{key}", value) for key, value in table.items()}


def _nodes(document: dict[str, Any]) -> tuple[Node, ...]:
    table = document.get("nodes")
    if not isinstance(table, dict) or set(table) != set(Node._fields):
        raise ConfigError(f"[nodes] must hold the lists {', '.join(Node._fields)}")
    columns = [_numbers(f"nodes.{name}", table[name]) for name in Node._fields]
    if len({len(column) for column in columns}) != 1:
        raise ConfigError("the lists of [nodes] must be of one length")
    return tuple(map(Node._make, zip(*columns, strict=True)))


def _numbers(name: str, value: object) -> tuple[float, ...]:
    if not isinstance(value, list):
        raise ConfigError(f"{name} must be a list of numbers")
    return tuple(_number(name, item) for item in value)


def _number(name: str, value: object) -> float:
    if not isinstance(value, int | float) or not is_number(value):
        raise ConfigError(f"{name} must be a number, not {value!r:.40}")
    return float(value)
