"""Variables of a catalogue file: dimensions, type, unit and meaning of each, for writer, reader and
checks; and the flags of its conditions.
"""

# ruff: noqa: E501 - cells of tables, one line each so that a row is read as a row

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import AnyArray, Index
from ..choices import LEVEL_RATIO

SCHEMA_VERSION = "3.0"
"""Version of the files that are written and read."""

OLD_FILE = "made by lcp 0.2; build it again"
"""What is said of a file of schema 1.x or 2.x."""

PACKED = ("detection_probability", "sigma_major", "sigma_minor", "sigma_angle")
"""Variables stored as small whole numbers; the catalogue in memory holds them unpacked."""

FIGURES = (
    "harris_response",
    "second_peak",
    "false_match_probability",
    "gsd_min",
    "gsd_max",
    "shadow_dependence",
    "occlusion_dependence",
)
"""Variables of one figure for each point over its usable conditions."""

OPTIONAL_GROUPS = (
    "promise",
    "overview_2",
    "overview_4",
    "overview_8",
    "coverage_levels",
    "coverage_map",
)
"""Groups that a file has only if the catalogue was built with them."""

OPTIONAL = ("albedo",)
"""Variables that a file has only if the catalogue was built with them."""

FLAG_MASKS = (1, 2, 4, 8, 16)
FLAG_MEANINGS = ("evaluated", "localizable", "unique", "unshadowed", "unoccluded")
EVALUATED, LOCALIZABLE, UNIQUE, UNSHADOWED, UNOCCLUDED = FLAG_MASKS
USABLE = sum(FLAG_MASKS)

UNIVERSAL_SHARE = 0.95
"""Least usable share of the evaluated conditions of a universal point."""

DETECTION_STEP = 1.0 / 250.0
"""Step of the stored detection probability."""

COVERAGE_UNKNOWN = 255
"""Value of ``coverage/usable`` in conditions that were evaluated for no point."""

COVERAGE_STATUS = {
    0: "point",
    1: "featureless",
    2: "ambiguous",
    3: "dependent",
    4: "nodata",
    5: "spare",
}


class Cause(IntEnum):
    """Why the points near a place are worth less than promised under a view and the Suns of a cell; those
    of several candidates: the last of the list.
    """

    MET = 0
    """As much as promised."""
    NODATA = 1
    """No heights there."""
    DARK = 2
    """Too dark, or without any contrast."""
    FEATURELESS = 3
    """Too little texture to localise a point, or no candidate at all."""
    AMBIGUOUS = 4
    """Similar to other terrain within the search radius."""
    DEPENDENT = 5
    """Shadowed or hidden by terrain outside the patch."""
    MARGINAL = 6
    """Usable under the Suns that were evaluated, but not surely between them."""
    FEW = 7
    """Usable candidates, but too few."""
    SIZE = 8
    """Enough usable candidates, but the number of points is limited."""
    NOT_EXAMINED = 9
    """Candidates that seem usable in the first of two passes, and were not evaluated in the rounds of the second."""


NO_CELL = 255
"""Value of ``promise/points`` and ``promise/cause`` where nothing is promised."""


class Variable(NamedTuple):
    """A variable of the file; ``dims``: names of its dimensions in order; ``dtype``: NumPy's name,
    or ``str`` for text.
    """

    dims: tuple[str, ...]
    dtype: str
    units: str
    long_name: str


_DIMS = {
    "condition": ("point", "view", "sun_elevation", "sun_azimuth"),
    "claim": ("point", "image_scale", "view", "sun_elevation", "sun_azimuth"),
    "near": ("place", "view", "sun_elevation", "sun_azimuth"),
}
"""Dimensions with a name of their own in the tables."""


def _table(text: str) -> dict[str, Variable]:
    """Variables by name, of lines with name, dimensions, type, unit and meaning."""
    rows = ([part.strip() for part in line.split("|")] for line in text.strip().splitlines())
    return {
        name: Variable(_DIMS.get(dims, tuple(dims.split())), dtype, units, long_name)
        for name, dims, dtype, units, long_name in rows
    }


COORDINATES = _table("""
point         | point         | i4 | 1      | number of the control point in this file
patch_row     | patch_row     | i4 | 1      | nodes south of the patch's centre
patch_col     | patch_col     | i4 | 1      | nodes east of the patch's centre
view          | view          | i4 | 1      | number of the viewpoint
sun_elevation | sun_elevation | f8 | degree | elevation of the Sun at the point
sun_azimuth   | sun_azimuth   | f8 | degree | azimuth of the Sun at the point, clockwise from north
image_scale   | image_scale   | f8 | 1      | pixel of the image as a multiple of the patch's cell size
mcmf_axis     | mcmf_axis     | i4 | 1      | axis of the Moon-fixed frame: x, y, z
enu_axis      | enu_axis      | i4 | 1      | axis of the point's frame: east, north, up
ellipse_axis  | ellipse_axis  | i4 | 1      | axis of the error ellipse: major, minor
""")

VARIABLES = _table("""
view_off_nadir          | view                      | f8  | degree        | angle at the point between the vertical and the camera
view_azimuth            | view                      | f8  | degree        | azimuth of the camera seen from the point
view_altitude           | view                      | f8  | km            | altitude of the camera, inf for parallel rays
point_id                | point                     | i8  | 1             | identifier of the ground, the same in every build
longitude               | point                     | f8  | degrees_east  | planetocentric longitude, 0..360
latitude                | point                     | f8  | degrees_north | planetocentric latitude
elevation               | point                     | f8  | m             | height of the patch's centre above the reference sphere
position_mcmf           | point mcmf_axis           | f8  | m             | position of the patch's centre, Moon-fixed frame
rotation_mcmf_to_enu    | point enu_axis mcmf_axis  | f8  | 1             | rotation to the point's frame, rows east, north, up
gsd                     | point                     | f8  | m             | cell size of the patch
dem_product             | point                     | str | 1             | DEM product that the patch was cut from
elevation_sigma         | point                     | f8  | m             | 1-sigma of the DEM's heights, from a map or as published for the product, NaN for none
dem_resolution          | point                     | f8  | m             | effective ground resolution of the DEM, measured from its heights, else published, NaN for none
dem                     | point patch_row patch_col | f4  | m             | up coordinate of the patch's nodes in the point's frame, row 0 north, column 0 west
albedo                  | point patch_row patch_col | f4  | 1             | brightness of the patch's nodes relative to the map's reference, NaN outside the map
condition               | condition                 | u1  | 1             | what holds for the point under each view and Sun
sun_elevation_min       | point view sun_azimuth    | f8  | degree        | lowest usable elevation of the Sun, NaN for none
sun_elevation_max       | point view sun_azimuth    | f8  | degree        | highest usable elevation of the Sun, NaN for none
harris_response         | point                     | f8  | 1             | Harris response of the patch, median over usable conditions
localization_sigma      | point ellipse_axis        | f8  | m             | 1-sigma of the position, worst usable condition, at the stated noise
second_peak             | point                     | f8  | 1             | highest correlation with anything else in the search radius, worst usable condition
false_match_probability | point                     | f8  | 1             | probability that the highest correlation is elsewhere, worst usable condition
gsd_min                 | point                     | f8  | m             | finest image resolution at which the point works
gsd_max                 | point                     | f8  | m             | coarsest image resolution at which the point works
shadow_dependence       | point                     | f8  | 1             | share of the patch that terrain outside it darkens, worst usable condition
occlusion_dependence    | point                     | f8  | 1             | share of the patch that terrain outside it hides, worst usable condition
detection_probability   | claim                     | u1  | 1             | probability that a search finds the true place and no other
sigma_major             | claim                     | u2  | m             | 1-sigma of the matched place along the major axis of its error ellipse
sigma_minor             | claim                     | u2  | m             | 1-sigma of the matched place along the minor axis of its error ellipse
sigma_angle             | claim                     | u1  | degree        | direction of the major axis, clockwise from north
universal               | point                     | u1  | 1             | 1 for points usable in at least 95 % of the evaluated conditions
level                   | point                     | i4  | 1             | index of the cell size
""")

OVERVIEW = _table("""
height | y x | f4 | m | height above the reference sphere
x      | x   | f8 | m | east of the centre, orthographic
y      | y   | f8 | m | north of the centre, orthographic
""")

LEVEL_FACTORS = (2, 4, 8)
"""Nodes of the overview along the side of one of a level; cells of the coverage likewise."""

COVERAGE = _table("""
cell      | cell                                | i4 | 1             | number of the spacing cell
longitude | cell                                | f8 | degrees_east  | longitude of the cell's centre
latitude  | cell                                | f8 | degrees_north | latitude of the cell's centre
status    | cell                                | u1 | 1             | whether a point is within one spacing, or why not
usable    | cell view sun_elevation sun_azimuth | u1 | 1             | 1 if a usable point is within one spacing of the cell's centre
""")

COVERAGE_LEVELS = _table("""
block        | block      | i4 | 1             | number of the wider cell
code         | code       | i4 | 1             | status of a cell of the coverage
factor       | block      | i4 | 1             | width over that of the cells of the coverage
longitude    | block      | f8 | degrees_east  | longitude of the cell's centre
latitude     | block      | f8 | degrees_north | latitude of the cell's centre
cells        | block code | i4 | 1             | number of cells of the coverage by status
usable_share | block      | f4 | 1             | share of cells and conditions with a usable point near
""")

COVERAGE_MAP = _table("""
status       | y_cell x_cell | u1 | 1 | status of the nearest cell of the coverage
usable_share | y_cell x_cell | f4 | 1 | share of its conditions with a usable point near
x_cell       | x_cell        | f8 | m | east of the centre, orthographic
y_cell       | y_cell        | f8 | m | north of the centre, orthographic
""")

PROMISE = _table("""
place               | place     | i4 | 1             | number of the place
longitude           | place     | f8 | degrees_east  | longitude of the place
latitude            | place     | f8 | degrees_north | latitude of the place
demand              | place     | u1 | 1             | units promised to a camera above the place
points              | near      | u1 | 1             | units of the points near the place, under all Suns from this elevation and azimuth to the next
cause               | near      | u1 | 1             | why there are fewer units than promised
step                | step      | i4 | 1             | number of the step of the choice
size                | step      | i4 | 1             | number of points chosen up to the step
met                 | step      | f8 | 1             | share of the places and conditions with as many units as possible
served              | step      | f8 | 1             | share of all units that places and conditions ask for
part                | part      | i4 | 1             | number of the promise of one cell size and region
places              | part      | i4 | 1             | number of its places; those of the first promise come first
gsd                 | part      | f8 | m             | cell size of the points that it counts
located_probability | part      | f8 | 1             | promised probability that a frame is located; 0: usable points are promised
per_view            | part      | i4 | 1             | usable points promised in a footprint
units               | part      | i4 | 1             | units of a point that is as good as certain
unit                | unit      | i4 | 1             | number of units
located             | part unit | f8 | 1             | probability, at least, that a frame is located by so many units
footprint           | part      | f8 | m             | diameter of the ground that a camera sees
radius              | part      | f8 | m             | around a place that every camera sees whose nearest place it is
lower_bound         | part      | f8 | 1             | points that every choice with the same promise has at least
""")


def usable(condition: ArrayLike) -> NDArray[np.bool_]:
    """True for conditions with all five flags; any shape."""
    return np.asarray((np.asarray(condition) & USABLE) == USABLE)


def evaluated(condition: ArrayLike) -> NDArray[np.bool_]:
    """True for conditions that were evaluated, because the Sun reaches them; any shape."""
    return np.asarray((np.asarray(condition) & EVALUATED) > 0)


def reaches(detection_probability: ArrayLike, least: float) -> NDArray[np.bool_]:
    """True where a probability, as stored in steps of `DETECTION_STEP`, is at least ``least``;
    False for NaN.
    """
    return np.asarray(np.asarray(detection_probability) >= least - DETECTION_STEP / 2.0)


def universal(condition: ArrayLike) -> NDArray[np.bool_]:
    """True for points that are usable in at least `UNIVERSAL_SHARE` of their evaluated conditions,
    (point,).

    ``condition``: uint8 (point, view, sun_elevation, sun_azimuth). False for a point without an
    evaluated condition.
    """
    axes = (1, 2, 3)
    known = evaluated(condition).sum(axis=axes)
    good = usable(condition).sum(axis=axes)
    return np.asarray((known > 0) & (good >= UNIVERSAL_SHARE * known))


def summarise_usable(condition: ArrayLike, sun_elevation: ArrayLike) -> tuple[AnyArray, AnyArray]:
    """Lowest and highest usable Sun elevation, each (point, view, sun_azimuth), degrees; NaN
    without a usable one.

    ``condition``: uint8 (point, view, sun_elevation, sun_azimuth).
    """
    works = usable(condition)
    elevation = np.asarray(sun_elevation, dtype=np.float64)[None, None, :, None]
    none = ~works.any(axis=2)
    lowest = np.where(works, elevation, np.inf).min(axis=2, initial=np.inf)
    highest = np.where(works, elevation, -np.inf).max(axis=2, initial=-np.inf)
    lowest[none] = highest[none] = np.nan
    return lowest, highest


def levels(gsd_m: ArrayLike) -> Index:
    """Level of each cell size (n,), metres: 0 for the finest, one more wherever the next larger size
    exceeds the one before by more than `LEVEL_RATIO`.
    """
    sizes, back = np.unique(np.asarray(gsd_m, np.float64), return_inverse=True)
    steps = np.concatenate(
        [np.zeros(min(1, len(sizes)), bool), sizes[1:] > LEVEL_RATIO * sizes[:-1]]
    )
    return np.asarray(np.cumsum(steps)[back.reshape(-1)], np.int64)
