"""The configuration of a build, as in a BUILD.toml and in the catalogue's attribute ``config``.

Every section is a frozen dataclass that raises ConfigError for invalid values; units are in the names,
and each field has its `fields.Meaning`. ``None`` means "derived from the DEM"; the catalogue stores the
derived value. The module imports no array library: the help of a command is made from it.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from ..choices import (
    GSD_MAX_M,
    LEVEL_RATIO,
    SCHEMA,
)
from ..errors import ConfigError
from ..fields import check_fields, meanings, meant, require
from ..remote_files import beside
from ..toml_files import dataclass_of, parse_toml, read_toml
from .error_config import ErrorConfig
from .model_config import ModelConfig
from .point_config import PointConfig

if TYPE_CHECKING:
    from ..terrain.area import Area

LEVELS_MAX = 32
"""Most levels of a catalogue."""

LEVEL_FACTOR_MAX = 2.0
"""Greatest ratio of neighbouring levels; a greater one of up to 1 % is taken for rounding."""


def _check_levels(name: str, cells_m: tuple[float, ...]) -> None:
    """ConfigError for cell sizes, rising, that cannot be the levels of a catalogue."""
    require(
        len(cells_m) <= LEVELS_MAX, f"{name} are {len(cells_m)} cell sizes, at most {LEVELS_MAX}"
    )
    for fine, coarse in itertools.pairwise(cells_m):
        require(
            coarse > LEVEL_RATIO * fine,
            f"{name}: {fine:g} and {coarse:g} m are too close for two levels: at least a factor of {LEVEL_RATIO:g}",
        )
        missing = ", ".join(f"{cell:.4g}" for cell in between(fine, coarse)[1:-1])
        require(
            coarse <= 1.01 * LEVEL_FACTOR_MAX * fine,
            f"{name}: {fine:g} and {coarse:g} m are more than a factor of {LEVEL_FACTOR_MAX:g} apart; "
            f"add {missing} m",
        )


def between(fine_m: float, coarse_m: float) -> tuple[float, ...]:
    """Both cell sizes and those between them in equal ratios of at most `LEVEL_FACTOR_MAX`. ConfigError
    for more than `LEVELS_MAX`.
    """
    octaves = math.log2(coarse_m) - math.log2(fine_m)
    steps = math.ceil(octaves / math.log2(LEVEL_FACTOR_MAX) - 1e-9)
    require(steps < LEVELS_MAX, f"{steps + 1} levels of cells are too many: at most {LEVELS_MAX}")
    return tuple(fine_m * 2.0 ** (octaves * k / max(1, steps)) for k in range(steps + 1))


@dataclass(frozen=True)
class AreaConfig:
    """The region: a centre and a size, or bounds; the whole DEM by default. Its cell size, or several
    (levels), given or derived from the altitudes of a camera.
    """

    center_deg: tuple[float, ...] = meant(
        (),
        "Longitude and latitude of the area's centre, degrees; needs `area.size_km`.",
        default="the whole DEM",
        replaces=("bounds_deg",),
    )
    size_km: float | None = meant(None, "Side length of the square area.", above=0.0)
    bounds_deg: tuple[float, ...] = meant(
        (),
        "Western, southern, eastern and northern limit of the area, degrees; may cross the antimeridian. Instead of "
        "`area.center_deg`.",
        replaces=("center_deg", "size_km"),
    )
    gsd_m: float | None = meant(
        None,
        "Cell size.",
        default="about half of what the DEM resolves, at least its own",
        above=0.0,
        most=GSD_MAX_M,
        replaces=("levels_m", "altitudes_km", "ifov_rad"),
    )
    levels_m: tuple[float, ...] = meant(
        (),
        "Several cell sizes in one catalogue, metres, at most a factor of 2 apart. Each has points only where a DEM "
        "resolves it.",
        default="one cell size, `area.gsd_m`",
        above=0.0,
        most=GSD_MAX_M,
        replaces=("gsd_m", "altitudes_km", "ifov_rad"),
    )
    altitudes_km: tuple[float, ...] = meant(
        (),
        "Cell sizes for a camera between these two altitudes, the lowest and the highest: the size of its pixel "
        "(`area.ifov_rad`) on the ground, without those that no DEM resolves.",
        above=0.0,
        replaces=("gsd_m", "levels_m"),
    )
    ifov_rad: float | None = meant(
        None,
        "With `area.altitudes_km`: angle of a pixel of the camera, radians.",
        above=0.0,
        most=1.0,
    )

    def __post_init__(self) -> None:
        check_fields(self, "area")
        require(
            len(self.center_deg) in (0, 2), "`area.center_deg` must be a longitude and a latitude"
        )
        require(
            len(self.bounds_deg) in (0, 4), "`area.bounds_deg` must be west, south, east and north"
        )
        require(
            not (self.center_deg and self.bounds_deg),
            "`area.center_deg` and `area.bounds_deg` exclude each other",
        )
        require(
            not self.center_deg or self.size_km is not None,
            "`area.center_deg` needs `area.size_km`",
        )
        require(
            self.size_km is None or bool(self.center_deg), "`area.size_km` needs `area.center_deg`"
        )
        if self.bounds_deg:
            west, south, east, north = self.bounds_deg
            require(south < north, "`area.bounds_deg` W S E N: the south must be below the north")
            require(west != east, "`area.bounds_deg` W S E N: west and east are the same")
        cells = [name for name in ("gsd_m", "levels_m", "altitudes_km") if getattr(self, name)]
        require(
            len(cells) < 2, " and ".join(f"`area.{name}`" for name in cells) + " exclude each other"
        )
        require(
            bool(self.altitudes_km) == (self.ifov_rad is not None),
            "`area.altitudes_km` and `area.ifov_rad` go together",
        )
        object.__setattr__(self, "levels_m", tuple(sorted(self.levels_m)))
        _check_levels("`area.levels_m`", self.levels_m)
        if self.altitudes_km:
            _check_levels("`area.altitudes_km` times `area.ifov_rad`", self.derived_levels_m)

    @property
    def derived_levels_m(self) -> tuple[float, ...]:
        """Cell sizes from `altitudes_km` times `ifov_rad`, metres, rising: both ends, and between
        them in equal ratios of at most `LEVEL_FACTOR_MAX`. ConfigError for altitudes or an angle out
        of range.
        """
        require(
            len(self.altitudes_km) == 2 and self.altitudes_km[0] <= self.altitudes_km[1],
            "`area.altitudes_km` must be the lowest and the highest altitude",
        )
        low, high = (altitude * 1e3 * (self.ifov_rad or 0.0) for altitude in self.altitudes_km)
        require(
            low > 0.0 and high <= GSD_MAX_M,
            f"`area.altitudes_km` times `area.ifov_rad` are cells of {low:g} to {high:g} m; they must be "
            f"above 0 and at most {GSD_MAX_M:g} m",
        )
        return between(low, high) if high > LEVEL_RATIO * low else (high,)

    @property
    def region(self) -> Area | None:
        """The configured region; None: that of the DEM."""
        from ..terrain.area import Area

        if self.center_deg:
            return Area(self.center_deg[0], self.center_deg[1], self.size_km)
        return Area.from_bounds(*self.bounds_deg) if self.bounds_deg else None


@dataclass(frozen=True)
class DemConfig:
    """Order of precedence where DEMs overlap: product names, families or file names. By default products
    made for the latitude come first, then finer pixels. Maps of what the DEM's heights are worth: names
    in a BUILD.toml are relative to its folder.
    """

    product_order: tuple[str, ...] = meant(
        (),
        "Order of precedence where DEMs overlap: product names, product families or file names.",
        default="products made for the latitude first, then finer pixels, then the order of the files",
    )
    sigma_map: str | None = meant(
        None,
        "Map of the 1 sigma of the DEM's heights, metres: a raster in a lunar CRS (an _ERR layer). Without it, and "
        "where it has no value: the figure of the DEM's product.",
    )
    resolution_map: str | None = meant(
        None,
        "Map of the DEM's effective resolution, metres: a raster in a lunar CRS (an _EFFRES layer). Without it, and "
        "where it has no value: estimated from the heights of each DEM.",
    )
    only_resolving: bool = meant(
        False,  # `terrain.terrain.resolves`
        "Points only where the DEM resolves the cells; so is every level of several.",
    )

    def beside(self, folder: Path) -> DemConfig:
        """The same with file names relative to a folder resolved; absolute names stay."""
        return self._with_maps(lambda name: beside(folder, name))

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


SUN_ELEVATIONS_DEG = (4.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 52.0, 60.0, 65.0, 70.0, 75.0)
"""Default elevations of the Sun, alike at every latitude, so that catalogues of neighbouring regions can be merged. Above
60 deg they are near enough that none which is evaluated at a place is more than 2.5 deg above the highest Sun there
(`ephemeris.solar_position.reachable_suns`).
"""

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

    azimuths_deg: tuple[float, ...] = meant(
        tuple(float(a) for a in range(0, 360, 15)),
        "Azimuths of the Sun, degrees clockwise from north.",
        default="every 15 degrees",
        least=0.0,
        below=360.0,
    )
    elevations_deg: tuple[float, ...] = meant(
        (),
        "Elevations of the Sun above the horizontal, degrees.",
        default="4, 5, 10, 15, 20, 30, 45, 52, 60, 65, 70, 75, and 0.5, 1, 1.5, 2, 3 for a region that reaches beyond 81.9 degrees "
        "of latitude, where the Sun stays below 10",
        least=0.0,
        most=90.0,
    )

    def __post_init__(self) -> None:
        check_fields(self, "sun")
        require(len(self.azimuths_deg) > 0, "`sun.azimuths_deg` is empty")
        for name in ("azimuths_deg", "elevations_deg"):
            require(
                all(b > a for a, b in itertools.pairwise(getattr(self, name))),
                f"`sun.{name}` must rise strictly",
            )

    def at(self, lat_deg: float) -> SunConfig:
        """The same with elevations, by default those for a region up to this latitude, north or south."""
        from ..ephemeris.solar_position import highest_sun_deg

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

    off_nadir_deg: tuple[float, ...] = meant(
        (0.0, 50.0, 50.0, 50.0, 50.0),
        "Angle of each view from the vertical at the point, degrees.",
        least=0.0,
        below=90.0,
    )
    azimuth_deg: tuple[float, ...] = meant(
        (0.0, 0.0, 90.0, 180.0, 270.0),
        "Azimuth of the camera, seen from the point, degrees clockwise from north.",
        least=0.0,
        below=360.0,
    )
    altitude_km: tuple[float, ...] = meant(
        (math.inf,) * 5,
        "Altitude of the camera above the reference sphere, km; inf: parallel rays.",
        above=0.0,
    )

    def __post_init__(self) -> None:
        check_fields(self, "view")
        lengths = [len(self.off_nadir_deg), len(self.azimuth_deg), len(self.altitude_km)]
        require(
            len(set(lengths)) == 1 and lengths[0] > 0,
            "`view.off_nadir_deg`, azimuth_deg and altitude_km must be of one length, a value of each for a view, not of "
            f"{lengths[0]}, {lengths[1]} and {lengths[2]} values",
        )

    def __len__(self) -> int:
        return len(self.off_nadir_deg)


CONDITIONS_MAX = 50_000
"""Most conditions (views times Suns) of a build; a point keeps some 40 bytes for each."""


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
        require(
            len(self.view) * suns <= CONDITIONS_MAX,
            f"{len(self.view)} views times {suns} Suns are {len(self.view) * suns} conditions; at most "
            f"{CONDITIONS_MAX} can be evaluated",
        )

    def replaced(self, values: Mapping[str, object]) -> BuildConfig:
        """The configuration with other values of fields, by names such as ``points.spacing_m``. The fields
        that these replace (`fields.Meaning`) get their defaults.

        >>> BuildConfig().replaced({"model.tolerance": 0.01}).model.precision.tier
        'draft'
        """
        sections: dict[str, dict[str, object]] = {}
        for name, value in values.items():
            section, _, key = name.partition(".")
            sections.setdefault(section, {})[key] = value
        changed = {}
        for section, given in sections.items():
            old = getattr(self, section)
            known = meanings(old)
            gone = {other for key in given for other in known[key].replaces}
            defaults = {f.name: f.default for f in dataclasses.fields(old) if f.name in gone}
            changed[section] = dataclasses.replace(old, **(defaults | given))
        return dataclasses.replace(self, **changed)

    @property
    def gsd_m(self) -> float:
        """Cell size, metres. ConfigError for a configuration that leaves it to the DEM or has several."""
        if self.area.gsd_m is None:
            raise ConfigError("the configuration does not state one cell size")
        return self.area.gsd_m

    def at_cell(self, gsd_m: float) -> BuildConfig:
        """The configuration with this cell size; instead of several, with points only from DEMs that
        resolve it.
        """
        several = bool(self.area.levels_m or self.area.altitudes_km)
        area = dataclasses.replace(
            self.area, gsd_m=gsd_m, levels_m=(), altitudes_km=(), ifov_rad=None
        )
        only = self.dem.only_resolving or several
        dem = dataclasses.replace(self.dem, only_resolving=only)
        return dataclasses.replace(self, area=area, dem=dem)

    @property
    def files(self) -> tuple[Path, ...]:
        """The maps and the file of the reflectance model that the configuration names."""
        from ..photometry.facet_model import law_file

        law = law_file(self.model.reflectance)
        maps = (self.model.albedo_file, self.dem.sigma_map, self.dem.resolution_map)
        return (*(Path(name) for name in maps if name is not None), *([law] if law else ()))

    @classmethod
    def from_toml(cls, path: Path) -> BuildConfig:
        """Read a BUILD.toml. ConfigError for unknown sections or keys, and for invalid values; InputError if it
        cannot be read.
        """
        config = read_toml(path, lambda text: cls.from_dict(parse_toml(text)))
        folder = path.parent
        return dataclasses.replace(
            config, model=config.model.beside(folder), dem=config.dem.beside(folder)
        )

    @classmethod
    def from_dict(cls, document: dict[str, Any]) -> BuildConfig:
        """The configuration of nested dictionaries, as TOML gives them."""
        sections = {f.name: f for f in dataclasses.fields(cls)}
        hints = get_type_hints(cls)
        document = {name: table for name, table in document.items() if name != SCHEMA}
        unknown = sorted(set(document) - set(sections))
        require(
            not unknown, f"unknown section [{', '.join(unknown)}]; there are {', '.join(sections)}"
        )
        return cls(
            **{name: dataclass_of(hints[name], name, table) for name, table in document.items()}
        )

    def in_one_line(self) -> str:
        """The keys with other values than by default, and these as JSON: ``area.gsd_m = 236.0; ...``."""
        usual = dataclasses.asdict(BuildConfig())
        return "; ".join(
            f"{section}.{key} = {json.dumps(value)}"
            for section, table in dataclasses.asdict(self).items()
            for key, value in table.items()
            if value is not None and value != usual[section][key]
        )

    def to_toml(self) -> str:
        """The configuration as TOML, without values of ``None``; `from_dict` of it gives an equal one."""
        document = {
            name: {
                k: list(v) if isinstance(v, tuple) else v for k, v in table.items() if v is not None
            }
            for name, table in dataclasses.asdict(self).items()
        }
        import tomli_w

        return tomli_w.dumps(document)
