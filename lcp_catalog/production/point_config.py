"""The section ``[points]`` of a build's configuration (`config`): what a control point is, and what the points promise together."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..fields import check_fields, meant, require

SEARCH_NODES, SEARCH_MAX_M = 64, 8000.0
"""Default search radius: so many nodes, but not more than so many metres, unless half a patch is wider."""

SPACING_MIN_NODES, SEARCH_MAX_NODES = 4, 1000
"""Least spacing and greatest search radius, in nodes: the memory and the time of an area grow with the
number of points and with the square of the radius.
"""

LENGTH_MAX_M = 1e7
"""Greatest spacing and search radius: about the Moon's circumference."""

LOCATED, LOCATED_MIN, LOCATED_MAX = 0.99, 0.5, 0.999
PER_VIEW_MAX = 200
"""Usable points promised in a camera's footprint by default, and at most."""

FOOTPRINT_NODES = 1024
"""Default diameter of a camera's footprint: an image so many pixels wide at the scale of the cells."""

FOOTPRINT_PATCHES = 3
"""Patches across the default footprint, at least."""

FOOTPRINT_MAX_KM = 5000.0
"""Greatest diameter of a footprint: about half the Moon."""

CORNER_BORDER = 4
"""Nodes by which the corner detector's window extends beyond the search region."""

SPACING_MAX_M = 8000.0
"""Greatest default spacing, unless half a patch is wider."""

SEARCH_DOUBT = 0.035, 0.09
"""Detection probabilities so far below and above the limit are computed again with a search at full
resolution. The first search can miss places; it then states too much: in 2891 conditions (24 grounds, patches of 17 and 33
nodes) up to 0.074 more where the flag is another, and up to 0.004 less."""

SMALLEST_PX = 7
"""Fewest pixels a side of a patch in a coarser image."""


def image_scales(patch_nodes: int, most: int | None = None) -> tuple[int, ...]:
    """Cell sizes of the images that are simulated, as multiples of the patch's own: powers of 2 as
    long as a patch has `SMALLEST_PX` pixels a side, ``most`` of them at most.
    """
    scales = [1]
    while 2 * (patch_nodes // 2 // (2 * scales[-1])) + 1 >= SMALLEST_PX:
        scales.append(2 * scales[-1])
    return tuple(scales[:most])


@dataclass(frozen=True)
class PointConfig:
    """Criteria for control points; lengths without a unit in the name are in nodes of the area's grid."""

    patch_nodes: int = meant(33, "Nodes along a patch's side, an odd number.", least=9, most=257)
    located_probability: float | None = meant(
        None,
        "Probability that a frame is located, which the catalogue promises for a camera's footprint anywhere in the region, "
        "under every Sun and view that can occur; as few points as possible are kept for it. Points that are not usable "
        "count with their probability.",
        default=f"{LOCATED}, unless `points.per_view` or `points.spacing_m` is given",
        least=LOCATED_MIN,
        most=LOCATED_MAX,
    )
    per_view: int | None = meant(
        None,
        "Instead of `points.located_probability`: number of usable points that are promised. 0: no promise; points are "
        "spread evenly, at the spacing.",
        default="none; 0 if `points.spacing_m` is given",
        least=0,
        most=PER_VIEW_MAX,
    )
    footprint_km: float | None = meant(
        None,
        "Diameter of the ground that a camera sees.",
        default=f"{FOOTPRINT_NODES} cells, at most the shorter side of the region, at least three patches",
        above=0.0,
        most=FOOTPRINT_MAX_KM,
    )
    max_points: int | None = meant(
        None,
        "Greatest number of points; those are kept that do most for the promise.",
        default="no limit",
        least=1,
    )
    max_bytes: int | None = meant(
        None,
        "Greatest size of the file by estimate, bytes; it limits the points as `points.max_points` does.",
        default="no limit",
        least=1,
    )
    spacing_m: float | None = meant(
        None,
        "Least distance between two points, which are then spread evenly (unless a promise is asked for, too).",
        default="half a patch; with `points.per_view` 0 two patches, at most 8 km",
        above=0.0,
        most=LENGTH_MAX_M,
    )
    search_m: float | None = meant(
        None,
        "Radius within which a point must be unique, at least half a patch.",
        default=f"{SEARCH_NODES} cells, at most 8 km",
        above=0.0,
        most=LENGTH_MAX_M,
    )
    candidates_per_cell: int = meant(
        2,
        "Candidates in a cell of the spacing, of all Suns; up to two more that stand out under some.",
        least=1,
        most=100,
    )
    min_detection: float = meant(
        0.9,
        "Least detection probability of a usable point: that the search finds the place and nothing else.",
        least=0.0,
        most=1.0,
    )
    min_lit_share: float = meant(
        0.1,
        "Least share of a patch that is lit, for a place that can be localised.",
        least=0.0,
        most=1.0,
    )
    max_dependence: float = meant(
        0.1,
        "Greatest share of a patch that terrain outside it darkens or hides.",
        least=0.0,
        most=1.0,
    )
    min_usable_conditions: int = meant(
        1, "Least number of Suns and views under which a point is usable.", least=1
    )

    passes: int | None = meant(
        None,
        "2: a first pass looks at all candidates in few conditions, points are chosen by it, and the chosen alone are "
        "evaluated in all; what fails is replaced. It saves a third of the time of even points, nothing to a quarter of a promise; "
        "a point that the first pass misjudges is missed.",
        default="1: all candidates are evaluated in all conditions",
        least=1,
        most=2,
    )
    image_scales: int | None = meant(
        None,
        "Greatest number of image scales: the cells, twice as large, four times ...",
        default=f"as long as a patch has {SMALLEST_PX} pixels a side",
        least=1,
    )
    rivals: int | None = meant(
        None,
        "Greatest number of places that resemble a point and count in its detection probability.",
        default="64",  # `landmarks.uniqueness.RIVALS`
        least=2,
        most=1024,
    )
    search_doubt: tuple[float, ...] | None = meant(
        None,
        "How far below and above `points.min_detection` a probability is computed again with a search at full resolution.",
        default=f"{SEARCH_DOUBT[0]}, {SEARCH_DOUBT[1]}",
        least=0.0,
        most=1.0,
    )
    least_correlation: float | None = meant(
        None,
        "Least correlation of a match.",
        default="0.3, that of a search",  # `landmarks.detection.LEAST_CORRELATION`
        least=0.0,
        most=1.0,
    )
    point_spread_px: float | None = meant(
        None,
        "1 sigma of an image's point spread, pixels.",
        default="0.5",  # `landmarks.point_spread.POINT_SPREAD_PX`
        least=0.0,
        most=0.9,
    )

    spread_nodes: int | None = meant(
        None,
        "Nodes of the quadrature of a probability over places with other noise (`errors.spread`).",
        default="5",  # `landmarks.detection.SPREAD_NODES`
        least=1,
        most=64,
    )
    error_step: float | None = meant(
        None,
        "Step of the logarithm to which the height errors of places are rounded, so that points share error models.",
        default="0.05",  # `production.evaluation.STEP`
        above=0.0,
        most=2.0,
    )

    def __post_init__(self) -> None:
        check_fields(self, "points")
        require(
            self.search_doubt is None or len(self.search_doubt) == 2,
            "`points.search_doubt` must be a margin below and one above",
        )
        require(
            self.patch_nodes % 2 == 1, f"`points.patch_nodes` must be odd, not {self.patch_nodes}"
        )
        for name in ("max_points", "max_bytes"):
            require(
                getattr(self, name) is None or self.promised,
                f"`points.{name}` needs `points.located_probability`, or `points.per_view` above 0: the choice "
                "is by what is promised",
            )
        require(
            self.located_probability is None or self.per_view is None,
            "`points.located_probability` and `points.per_view` exclude each other",
        )

    @property
    def located(self) -> float | None:
        """Probability of being located that is promised; None for a number of points, or no promise."""
        if self.per_view is None and self.spacing_m is None:
            return LOCATED if self.located_probability is None else self.located_probability
        return self.located_probability

    @property
    def two_passes(self) -> bool:
        """True if candidates are looked at before the chosen ones are evaluated."""
        return self.passes == 2

    @property
    def promised(self) -> bool:
        """False if nothing is promised, and points are spread evenly."""
        return self.located is not None or bool(self.per_view)

    @property
    def scales(self) -> tuple[int, ...]:
        """The `image_scales` of the patches."""
        return image_scales(self.patch_nodes, self.image_scales)

    @property
    def half(self) -> int:
        """Nodes from a patch's centre to its edge."""
        return self.patch_nodes // 2

    def diagonal_m(self, gsd_m: float) -> float:
        """Diagonal of a patch, metres: a footprint shows a patch whole, however turned, if its centre is half of it inside."""
        return math.sqrt(2.0) * (self.patch_nodes - 1) * gsd_m

    def footprint_m(self, gsd_m: float, side_m: float, least_m: float = 0.0) -> float:
        """Diameter of the footprint, metres; by default at least ``least_m``, at most the region's shorter side, ``side_m``."""
        if self.footprint_km is not None:
            return 1e3 * self.footprint_km
        usual_m = min(max(FOOTPRINT_NODES * gsd_m, least_m), side_m)
        return max(usual_m, FOOTPRINT_PATCHES * self.patch_nodes * gsd_m)

    def search_nodes(self, gsd_m: float) -> int:
        """Radius, in nodes, within which a point must be unique."""
        if self.search_m is None:
            return max(self.half, round(min(SEARCH_NODES, SEARCH_MAX_M / gsd_m)))
        return max(1, round(min(self.search_m / gsd_m, 2.0**31)))  # of a cell of 1e-320 m, too

    def halo_nodes(self, gsd_m: float) -> int:
        """Width, in nodes, of the margin around a point that its evaluation uses."""
        return self.search_nodes(gsd_m) + self.half + CORNER_BORDER

    def check_cells(self, gsd_m: float) -> None:
        """ConfigError for a spacing of too few cells or a search radius of too many or too few: a patch
        has no rival within half its width, where its own peak of the correlation ends.
        """
        spacing, search = self.spacing_m, self.search_m
        require(
            spacing is None or spacing >= SPACING_MIN_NODES * gsd_m,
            f"`points.spacing_m`: {spacing or 0.0:g} m is too small for cells of {gsd_m:g} m: at least "
            f"{SPACING_MIN_NODES} cells, {SPACING_MIN_NODES * gsd_m:g} m",
        )
        require(
            search is None or search <= SEARCH_MAX_NODES * gsd_m,
            f"`points.search_m`: a radius of {search or 0.0:g} m is too large for cells of {gsd_m:g} m: at most "
            f"{SEARCH_MAX_NODES} cells, {SEARCH_MAX_NODES * gsd_m:g} m",
        )
        require(
            self.search_nodes(gsd_m) >= self.half,
            f"`points.search_m`: a radius of {search or 0.0:g} m is too small for patches of {self.patch_nodes} cells of "
            f"{gsd_m:g} m: nothing else would be compared; at least half a patch, {self.half * gsd_m:g} m",
        )

    def check_size(self, side_m: float) -> None:
        """ConfigError for a spacing greater than the longer side of the region, metres: one point would be kept."""
        spacing_m = self.spacing_m or 0.0
        require(
            spacing_m <= side_m,
            f"`points.spacing_m`: {spacing_m / 1e3:.5g} km is more than the longer side of the area, {side_m / 1e3:.5g} km; "
            "give a smaller spacing (in km as an option, in metres in a BUILD.toml)",
        )

    def least_distance_m(self, gsd_m: float) -> float:
        """Least distance between two points, metres: the spacing, but half a patch if only a promise
        is given.
        """
        nodes = self.half if self.promised and self.spacing_m is None else self.spacing_nodes(gsd_m)
        return nodes * gsd_m

    def spacing_nodes(self, gsd_m: float) -> int:
        """Side of the cells in which candidates are looked for, in nodes; by default two patch widths,
        at most `SPACING_MAX_M`, but not less than half a patch.
        """
        if self.spacing_m is not None:
            return max(1, round(min(self.spacing_m / gsd_m, 2.0**31)))
        widest = max(self.half, round(min(SPACING_MAX_M / gsd_m, 2.0**31)))
        return min(2 * (self.patch_nodes - 1), widest)
