"""The configuration of a build, as in a BUILD.toml and in the catalogue's attribute ``config``.

Every section is a frozen dataclass that raises ConfigError for invalid values; units are in the names.
``None`` means "derived from the DEM"; the catalogue stores the derived value.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_type_hints

import tomli_w

from ..accuracy import Accuracy, accuracy
from ..catalog.cell_levels import LEVEL_RATIO
from ..choices import ENCODINGS, GSD_MAX_M
from ..ephemeris.reachable import highest_sun_deg
from ..errors import ConfigError
from ..landmarks.error_model import ErrorModel
from ..photometry.facet_file import law_file
from ..terrain.area import Area
from ..toml_files import dataclass_of, parse_toml

_REPLACED = {
    "points.image_noise": "errors.sensor_noise",
    "points.max_sigma_px": "points.min_detection",
    "points.max_second_peak": "points.min_detection",
    "points.max_false_match": "points.min_detection",
}
"""Keys of older versions and those that replace them."""


def _require(condition: bool, text: str) -> None:
    if not condition:
        raise ConfigError(text)


LEVELS_MAX = 32
"""Most levels of a catalogue."""

LEVEL_FACTOR_MAX = 2.0
"""Greatest ratio of neighbouring levels; a greater one of up to 1 % is taken for rounding."""


def _check_levels(name: str, cells_m: tuple[float, ...]) -> None:
    """ConfigError for cell sizes, rising, that cannot be the levels of a catalogue."""
    _require(
        len(cells_m) <= LEVELS_MAX, f"{name} are {len(cells_m)} cell sizes, at most {LEVELS_MAX}"
    )
    _require(
        all(0.0 < cell <= GSD_MAX_M for cell in cells_m),
        f"{name} must be above 0 and at most {GSD_MAX_M:g} m",
    )
    for fine, coarse in itertools.pairwise(cells_m):
        _require(
            coarse > LEVEL_RATIO * fine,
            f"{name}: {fine:g} and {coarse:g} m are too close for two levels: at least a factor of {LEVEL_RATIO:g}",
        )
        missing = ", ".join(f"{cell:.4g}" for cell in _between(fine, coarse)[1:-1])
        _require(
            coarse <= 1.01 * LEVEL_FACTOR_MAX * fine,
            f"{name}: {fine:g} and {coarse:g} m are more than a factor of {LEVEL_FACTOR_MAX:g} apart; "
            f"add {missing} m",
        )


def _between(fine_m: float, coarse_m: float) -> tuple[float, ...]:
    """Both cell sizes and those between them in equal ratios of at most `LEVEL_FACTOR_MAX`. ConfigError
    for more than `LEVELS_MAX`.
    """
    octaves = math.log2(coarse_m) - math.log2(fine_m)
    steps = math.ceil(octaves / math.log2(LEVEL_FACTOR_MAX) - 1e-9)
    _require(steps < LEVELS_MAX, f"{steps + 1} levels of cells are too many: at most {LEVELS_MAX}")
    return tuple(fine_m * 2.0 ** (octaves * k / max(1, steps)) for k in range(steps + 1))


@dataclass(frozen=True)
class AreaConfig:
    """The region: a centre and a size, or bounds; the whole DEM by default. Its cell size, or several
    (levels), given or derived from the altitudes of a camera.
    """

    center_deg: tuple[float, ...] = ()
    size_km: float | None = None
    bounds_deg: tuple[float, ...] = ()
    gsd_m: float | None = None  # by the effective resolution of the DEM
    levels_m: tuple[float, ...] = ()
    """Cell sizes, kept in rising order."""
    altitudes_km: tuple[float, ...] = ()
    """Lowest and highest altitude of the camera."""
    ifov_rad: float | None = None
    """Angle of a pixel of the camera, radians."""

    def __post_init__(self) -> None:
        _require(
            len(self.center_deg) in (0, 2), "area.center_deg must be a longitude and a latitude"
        )
        _require(
            len(self.bounds_deg) in (0, 4), "area.bounds_deg must be west, south, east and north"
        )
        _require(
            not (self.center_deg and self.bounds_deg),
            "area.center_deg and area.bounds_deg exclude each other",
        )
        _require(
            bool(self.center_deg) == (self.size_km is not None),
            "area.center_deg and area.size_km go together",
        )
        _require(
            self.gsd_m is None or 0.0 < self.gsd_m <= GSD_MAX_M,
            f"area.gsd_m must be above 0 and at most {GSD_MAX_M:g} m, not {self.gsd_m}",
        )
        cells = [name for name in ("gsd_m", "levels_m", "altitudes_km") if getattr(self, name)]
        _require(
            len(cells) < 2, " and ".join(f"area.{name}" for name in cells) + " exclude each other"
        )
        _require(
            bool(self.altitudes_km) == (self.ifov_rad is not None),
            "area.altitudes_km and area.ifov_rad go together",
        )
        object.__setattr__(self, "levels_m", tuple(sorted(self.levels_m)))
        _check_levels("area.levels_m", self.levels_m)
        if self.altitudes_km:
            _check_levels("area.altitudes_km times area.ifov_rad", self.derived_levels_m)

    @property
    def derived_levels_m(self) -> tuple[float, ...]:
        """Cell sizes from `altitudes_km` times `ifov_rad`, metres, rising: both ends, and between
        them in equal ratios of at most `LEVEL_FACTOR_MAX`. ConfigError for altitudes or an angle out
        of range.
        """
        _require(
            len(self.altitudes_km) == 2 and 0.0 < self.altitudes_km[0] <= self.altitudes_km[1],
            "area.altitudes_km must be the lowest and the highest altitude, above 0",
        )
        low, high = (altitude * 1e3 * (self.ifov_rad or 0.0) for altitude in self.altitudes_km)
        _require(
            low > 0.0 and high <= GSD_MAX_M,
            f"area.altitudes_km times area.ifov_rad are cells of {low:g} to {high:g} m; they must be "
            f"above 0 and at most {GSD_MAX_M:g} m",
        )
        return _between(low, high) if high > LEVEL_RATIO * low else (high,)

    @property
    def region(self) -> Area | None:
        """The configured region; None: that of the DEM."""
        if self.center_deg:
            return Area(self.center_deg[0], self.center_deg[1], self.size_km)
        return Area.from_bounds(*self.bounds_deg) if self.bounds_deg else None


@dataclass(frozen=True)
class DemConfig:
    """Order of precedence where DEMs overlap: product names, families or file names. By default products
    made for the latitude come first, then finer pixels. Maps of what the DEM's heights are worth.
    """

    product_order: tuple[str, ...] = ()
    sigma_map: str | None = None
    """Map of the 1 sigma of heights, metres, relative to the folder of the BUILD.toml."""
    resolution_map: str | None = None
    """Map of the effective resolution, metres, relative to the folder of the BUILD.toml."""
    only_resolving: bool = False
    """True: points only where the DEM resolves the cells (`terrain.useful_cell.resolves`). So is every
    level of several.
    """

    def beside(self, folder: Path) -> DemConfig:
        """The same with file names relative to a folder resolved; absolute names stay."""
        return self._with_maps(lambda name: str(folder / name))

    @property
    def portable(self) -> DemConfig:
        """The same with file names without folders."""
        return self._with_maps(lambda name: Path(name).name)

    def _with_maps(self, renamed: Callable[[str], str]) -> DemConfig:
        sigma, resolution = (
            None if name is None else renamed(name)
            for name in (self.sigma_map, self.resolution_map)
        )
        return dataclasses.replace(self, sigma_map=sigma, resolution_map=resolution)


SUN_ELEVATIONS_DEG = (4.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 75.0)
"""Default elevations of the Sun."""

POLAR_ELEVATIONS_DEG = (0.5, 1.0, 1.5, 2.0, 3.0)
"""Elevations of the Sun that are added to the default ones for a region with a latitude at which it stays
below `POLAR_SUN_DEG`.
"""

POLAR_SUN_DEG = 10.0


@dataclass(frozen=True)
class SunConfig:
    """The grid of Sun directions, degrees in each point's own frame. Directions that never occur at a point
    are not evaluated. No elevations: those of `at`.
    """

    azimuths_deg: tuple[float, ...] = tuple(float(a) for a in range(0, 360, 15))
    elevations_deg: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        _require(len(self.azimuths_deg) > 0, "sun.azimuths_deg is empty")
        for name, values, low, high in (
            ("azimuths_deg", self.azimuths_deg, 0.0, 360.0),
            ("elevations_deg", self.elevations_deg, 0.0, 90.0001),
        ):
            if not values:
                continue
            _require(
                all(b > a for a, b in itertools.pairwise(values)),
                f"sun.{name} must rise strictly",
            )
            _require(
                low <= values[0] and values[-1] < high,
                f"sun.{name} must lie in {low:g}..{high:g} degrees",
            )

    def at(self, lat_deg: float) -> SunConfig:
        """The same with elevations, by default those for a region up to this latitude, north or south."""
        if self.elevations_deg:
            return self
        polar = highest_sun_deg(lat_deg) < POLAR_SUN_DEG
        low = POLAR_ELEVATIONS_DEG if polar else ()
        return dataclasses.replace(self, elevations_deg=(*low, *SUN_ELEVATIONS_DEG))


@dataclass(frozen=True)
class ViewConfig:
    """The views: for each the angle from the vertical at the point, the azimuth of the camera seen from the
    point, and its altitude (``inf``: parallel rays).
    """

    off_nadir_deg: tuple[float, ...] = (0.0, 30.0, 30.0, 30.0, 30.0)
    azimuth_deg: tuple[float, ...] = (0.0, 0.0, 90.0, 180.0, 270.0)
    altitude_km: tuple[float, ...] = (math.inf,) * 5

    def __post_init__(self) -> None:
        lengths = {len(self.off_nadir_deg), len(self.azimuth_deg), len(self.altitude_km)}
        _require(
            len(lengths) == 1 and lengths != {0},
            "view.off_nadir_deg, azimuth_deg and altitude_km must be of one length",
        )
        _require(
            all(0.0 <= v < 90.0 for v in self.off_nadir_deg),
            "view.off_nadir_deg must lie in 0..90 degrees",
        )
        _require(
            all(0.0 <= v < 360.0 for v in self.azimuth_deg),
            "view.azimuth_deg must lie in 0..360 degrees",
        )
        _require(
            all(v > 0.0 for v in self.altitude_km),
            "view.altitude_km must be positive (inf: parallel rays)",
        )

    def __len__(self) -> int:
        return len(self.off_nadir_deg)


SEARCH_NODES, SEARCH_MAX_M = 64, 8000.0
"""Default search radius: so many nodes, but not more than so many metres, unless half a patch is wider."""

SPACING_MIN_NODES, SEARCH_MAX_NODES = 4, 1000
"""Least spacing and greatest search radius, in nodes: the memory and the time of an area grow with the
number of points and with the square of the radius.
"""

LENGTH_MAX_M = 1e7
"""Greatest spacing and search radius: about the Moon's circumference."""

CONDITIONS_MAX = 50_000
"""Most conditions (views times Suns) of a build; a point keeps some 40 bytes for each."""

AREA_NODES_MIN = 16
"""Least number of nodes along an area's side."""

PER_VIEW, PER_VIEW_MAX = 8, 200
"""Usable points promised in a camera's footprint by default, and at most."""

FOOTPRINT_NODES = 1024
"""Default diameter of a camera's footprint: an image so many pixels wide at the scale of the cells."""

FOOTPRINT_MAX_KM = 5000.0
"""Greatest diameter of a footprint: about half the Moon."""

CORNER_BORDER = 4
"""Nodes by which the corner detector's window extends beyond the search region."""

SPACING_MAX_M = 8000.0
"""Greatest default spacing, unless half a patch is wider."""


@dataclass(frozen=True)
class PointConfig:
    """Criteria for control points; lengths without a unit in the name are in nodes of the area's grid."""

    patch_nodes: int = 33
    per_view: int | None = None  # 8; 0 if a spacing is given
    """Usable points that a camera's footprint is promised under every view and Sun; 0: points are spread
    evenly at the spacing instead."""
    footprint_km: float | None = None  # `FOOTPRINT_NODES`, at most the shorter side of the region
    """Diameter of the ground that a camera sees."""
    max_points: int | None = None
    """Most points of the catalogue."""
    max_bytes: int | None = None
    """Size of the catalogue's file that the number of points is limited to, by estimate."""
    spacing_m: float | None = None  # half a patch; without a promise two patch widths, at most 8 km
    search_m: float | None = None  # 64 nodes, at most `SEARCH_MAX_M`, at least half a patch
    candidates_per_cell: int = 2
    min_detection: float = 0.9
    """Least detection probability of a usable point."""
    min_lit_share: float = 0.3
    max_dependence: float = 0.1
    min_usable_conditions: int = 1

    def __post_init__(self) -> None:
        _require(
            self.patch_nodes % 2 == 1 and 9 <= self.patch_nodes <= 257,
            f"points.patch_nodes must be odd, 9..257, not {self.patch_nodes}",
        )
        for name in ("spacing_m", "search_m"):
            length = getattr(self, name)
            _require(
                length is None or 0.0 < length <= LENGTH_MAX_M,
                f"points.{name} must be above 0 and at most {LENGTH_MAX_M:g} m, not {length}",
            )
        _require(
            self.per_view is None or 0 <= self.per_view <= PER_VIEW_MAX,
            f"points.per_view must lie in 0..{PER_VIEW_MAX}, not {self.per_view}",
        )
        _require(
            self.footprint_km is None or 0.0 < self.footprint_km <= FOOTPRINT_MAX_KM,
            f"points.footprint_km must be above 0 and at most {FOOTPRINT_MAX_KM:g} km, not {self.footprint_km}",
        )
        for name in ("max_points", "max_bytes"):
            most = getattr(self, name)
            _require(most is None or most >= 1, f"points.{name} must be at least 1, not {most}")
            _require(
                most is None or self.promised > 0,
                f"points.{name} needs points.per_view above 0: the choice is by what it promises",
            )
        _require(
            1 <= self.candidates_per_cell <= 100, "points.candidates_per_cell must lie in 1..100"
        )
        _require(self.min_usable_conditions >= 1, "points.min_usable_conditions must be at least 1")
        for name in ("min_detection", "min_lit_share", "max_dependence"):
            _require(0.0 <= getattr(self, name) <= 1.0, f"points.{name} must lie in 0..1")

    @property
    def promised(self) -> int:
        """Usable points promised in a camera's footprint; 0: none, points are spread evenly."""
        if self.per_view is None:
            return PER_VIEW if self.spacing_m is None else 0
        return self.per_view

    @property
    def half(self) -> int:
        """Nodes from a patch's centre to its edge."""
        return self.patch_nodes // 2

    def search_nodes(self, gsd_m: float) -> int:
        """Radius, in nodes, within which a point must be unique."""
        if self.search_m is None:
            return max(self.half, min(SEARCH_NODES, round(SEARCH_MAX_M / gsd_m)))
        return max(1, round(self.search_m / gsd_m))

    def halo_nodes(self, gsd_m: float) -> int:
        """Width, in nodes, of the margin around a point that its evaluation uses."""
        return self.search_nodes(gsd_m) + self.half + CORNER_BORDER

    def check_cells(self, gsd_m: float) -> None:
        """ConfigError for a spacing of too few cells or a search radius of too many or too few: a patch
        has no rival within half its width, where its own peak of the correlation ends.
        """
        spacing, search = self.spacing_m, self.search_m
        _require(
            spacing is None or spacing >= SPACING_MIN_NODES * gsd_m,
            f"a spacing of {spacing or 0.0:g} m is too small for cells of {gsd_m:g} m: at least "
            f"{SPACING_MIN_NODES} cells, {SPACING_MIN_NODES * gsd_m:g} m",
        )
        _require(
            search is None or search <= SEARCH_MAX_NODES * gsd_m,
            f"a search radius of {search or 0.0:g} m is too large for cells of {gsd_m:g} m: at most "
            f"{SEARCH_MAX_NODES} cells, {SEARCH_MAX_NODES * gsd_m:g} m",
        )
        _require(
            self.search_nodes(gsd_m) >= self.half,
            f"a search radius of {search or 0.0:g} m is too small for patches of {self.patch_nodes} cells of "
            f"{gsd_m:g} m: nothing else would be compared; at least half a patch, {self.half * gsd_m:g} m",
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
            return max(1, round(self.spacing_m / gsd_m))
        widest = max(self.half, round(SPACING_MAX_M / gsd_m))
        return min(2 * (self.patch_nodes - 1), widest)


@dataclass(frozen=True)
class ModelConfig:
    """The model of an area: reflectance, albedo, accuracy, surroundings."""

    reflectance: str = "auto"
    """Reflectance model; ``auto``: chosen by the build's phase angles (`photometry.law_choice`)."""
    albedo: str | None = None
    """Albedo map, relative to the folder of the BUILD.toml; None for one albedo everywhere."""
    albedo_encoding: str | None = None
    """``linear`` (the default) or ``srgb`` (codes of a display image)."""
    albedo_reference: float | None = None
    """Value of the map whose factor is 1; None for the map's mean."""
    accuracy: str | None = None
    """Accuracy tier; None for the fastest within the tolerance, or without one `accuracy.DEFAULT_TIER`."""
    tolerance: float | None = None
    direction_tolerance_deg: float = 0.5
    ring_max_km: float = 400.0
    """Greatest distance from an area of terrain that is read for its shadows."""
    area_nodes_max: int = 512

    def __post_init__(self) -> None:
        _require(
            0.05 <= self.direction_tolerance_deg <= 10.0,
            "model.direction_tolerance_deg must lie in 0.05..10",
        )
        accuracy(self.accuracy, self.tolerance)  # raises ConfigError
        _require(
            self.albedo_encoding in (None, *ENCODINGS),
            f"model.albedo_encoding must be {' or '.join(ENCODINGS)}",
        )
        _require(
            self.albedo_reference is None or 0.0 < self.albedo_reference < math.inf,
            f"model.albedo_reference must be positive, not {self.albedo_reference}",
        )
        _require(
            self.albedo is not None or self.albedo_encoding is self.albedo_reference is None,
            "model.albedo_encoding and model.albedo_reference need model.albedo, a map",
        )
        _require(0.0 <= self.ring_max_km <= 3000.0, "model.ring_max_km must lie in 0..3000")
        _require(
            AREA_NODES_MIN <= self.area_nodes_max <= 4096,
            f"model.area_nodes_max must lie in {AREA_NODES_MIN}..4096",
        )

    @property
    def precision(self) -> Accuracy:
        """The accuracy of the tier or the tolerance."""
        return accuracy(self.accuracy, self.tolerance)

    @property
    def without_albedo(self) -> ModelConfig:
        """The same without an albedo map."""
        return dataclasses.replace(self, albedo=None, albedo_encoding=None, albedo_reference=None)

    def beside(self, folder: Path) -> ModelConfig:
        """The same with file names relative to a folder resolved; absolute names stay."""
        albedo = None if self.albedo is None else str(folder / self.albedo)
        law, _, which = self.reflectance.partition(":")
        if law == "facet" and which.lower().endswith(".toml"):
            law = f"{law}:{folder / which}"
            return dataclasses.replace(self, albedo=albedo, reflectance=law)
        return dataclasses.replace(self, albedo=albedo)

    @property
    def portable(self) -> ModelConfig:
        """The same with file names without folders."""
        name = None if self.albedo is None else Path(self.albedo).name
        law, colon, which = self.reflectance.partition(":")
        if law == "facet":  # a file, or a name without folders
            law = f"{law}{colon}{Path(which).name}"
            return dataclasses.replace(self, albedo=name, reflectance=law)
        return dataclasses.replace(self, albedo=name)


@dataclass(frozen=True)
class ErrorConfig:
    """The differences between images and renders (`landmarks.error_model.ErrorModel`); None: heights by
    the DEM's product and effective resolution.

    The other figures were fitted to the Apollo 15 frames AS15-M-0414 and AS15-M-0295 on GLD100 cells
    of 474 m (`validation.error_fit`). With a map of albedo of 2.7 km per pixel the fit gave the same
    figure for brightness that no map holds as without one.
    """

    sensor_noise: float = 0.07
    height_sigma_m: float | None = None
    height_length_m: float | None = None
    albedo_sigma: float = 0.09
    albedo_length_m: float = 1900.0
    position_sigma_m: float = 25.0
    spread: float = 0.25
    shadow_shift: float = 0.11

    def __post_init__(self) -> None:
        self.model(height_sigma_m=1.0, height_length_m=1.0)

    def model(self, height_sigma_m: float, height_length_m: float) -> ErrorModel:
        """The error model with the given figures where the configuration has none. ConfigError for
        invalid values.
        """
        derived = {"height_sigma_m": height_sigma_m, "height_length_m": height_length_m}
        given = {k: v for k, v in dataclasses.asdict(self).items() if v is not None}
        return ErrorModel(**(derived | given))


@dataclass(frozen=True)
class BuildConfig:
    """All that determines a catalogue's content besides the DEM.

    Examples
    --------
    >>> config = lcp.BuildConfig.from_dict({"points": {"spacing_m": 5000.0}})
    >>> config.points.spacing_m, config.area.region
    (5000.0, None)
    """

    area: AreaConfig = field(default_factory=AreaConfig)
    dem: DemConfig = field(default_factory=DemConfig)
    sun: SunConfig = field(default_factory=SunConfig)
    view: ViewConfig = field(default_factory=ViewConfig)
    points: PointConfig = field(default_factory=PointConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    errors: ErrorConfig = field(default_factory=ErrorConfig)

    def __post_init__(self) -> None:
        suns = len(self.sun.azimuths_deg) * len(self.sun.elevations_deg)
        _require(
            len(self.view) * suns <= CONDITIONS_MAX,
            f"{len(self.view)} views times {suns} Suns are {len(self.view) * suns} conditions; at most "
            f"{CONDITIONS_MAX} can be evaluated",
        )

    def at_level(self, gsd_m: float) -> BuildConfig:
        """The configuration of one level: this cell size, points only from DEMs that resolve it."""
        area = dataclasses.replace(
            self.area, gsd_m=gsd_m, levels_m=(), altitudes_km=(), ifov_rad=None
        )
        dem = dataclasses.replace(self.dem, only_resolving=True)
        return dataclasses.replace(self, area=area, dem=dem)

    @property
    def files(self) -> tuple[Path, ...]:
        """The maps and the file of the reflectance model that the configuration names."""
        law = law_file(self.model.reflectance)
        maps = (self.model.albedo, self.dem.sigma_map, self.dem.resolution_map)
        return (*(Path(name) for name in maps if name is not None), *([law] if law else ()))

    @classmethod
    def from_toml(cls, path: Path) -> BuildConfig:
        """Read a BUILD.toml. ConfigError for unknown sections or keys, and for invalid values."""
        try:
            document = parse_toml(path.read_text(encoding="utf-8"))
            config = cls.from_dict(document)
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror or error}") from error
        except UnicodeDecodeError as error:
            raise ConfigError(f"{path}: not TOML: {error}") from error
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from error
        folder = path.parent
        return dataclasses.replace(
            config, model=config.model.beside(folder), dem=config.dem.beside(folder)
        )

    @classmethod
    def from_dict(cls, document: dict[str, Any]) -> BuildConfig:
        """The configuration of nested dictionaries, as TOML gives them."""
        sections = {f.name: f for f in dataclasses.fields(cls)}
        hints = get_type_hints(cls)
        unknown = sorted(set(document) - set(sections))
        _require(
            not unknown, f"unknown section [{', '.join(unknown)}]; there are {', '.join(sections)}"
        )
        return cls(
            **{
                name: dataclass_of(hints[name], name, table, _REPLACED)
                for name, table in document.items()
            }
        )

    def to_toml(self) -> str:
        """The configuration as TOML, without values of ``None``; `from_dict` of it gives an equal one."""
        document = {
            name: {
                k: list(v) if isinstance(v, tuple) else v for k, v in table.items() if v is not None
            }
            for name, table in dataclasses.asdict(self).items()
        }
        return tomli_w.dumps(document)
