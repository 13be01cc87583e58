"""`lcp export`: the format by the ending of the output."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from ..atomic_files import folder_aside, write_aside
from ..catalog.verification import open_catalog
from ..choices import EXPORT_FOLDERS, EXPORTS
from ..constants import FRAME
from ..errors import ConfigError
from ..geometry.bounds import Bounds
from .frames import frame_named
from .points import ExportedPoints


@dataclass(frozen=True)
class ExportChoice:
    """What is exported. ``box``: west, south, east, north in degrees of MOON_ME; ``level``: index of
    the cell size; ``sun_deg``: azimuth and elevation of the Sun for the reflectance of ``.lmk``.
    """

    frame: str = FRAME
    box: Bounds | None = None
    level: int | None = None
    sun_deg: tuple[float, float] | None = None


def export(
    catalog: Path | str,
    output: Path | str,
    choice: ExportChoice | None = None,
    overwrite: bool = False,
) -> int:
    """Write points of a catalogue's file in the format of the output's ending (`choices.EXPORTS`), and
    return their number.

    ConfigError for another ending, a frame that is not known, or a Sun for a format without one;
    AreaError for a choice without points; MissingPackageError for a format whose package is not
    installed. Raises CatalogError as `open_catalog`, and for the output as `atomic_files`.
    """
    choice = choice or ExportChoice()
    ending = Path(output).suffix
    if ending not in EXPORTS:
        raise ConfigError(f"{output}: the ending must be one of {' '.join(EXPORTS)}")
    if choice.sun_deg is not None and ending != ".lmk":
        raise ConfigError(f"{output}: a Sun lights .lmk maps only")
    frame = frame_named(choice.frame)
    with _aside(output, ending, overwrite) as path:
        points = ExportedPoints.chosen(open_catalog(catalog), frame, choice.box, choice.level)
        _write(points, path, ending, choice)
    return len(points)


def _aside(output: Path | str, ending: str, overwrite: bool) -> AbstractContextManager[Path]:
    if ending in EXPORT_FOLDERS:
        return folder_aside(output, EXPORT_FOLDERS[ending], overwrite)
    return write_aside(output, overwrite)


def _write(points: ExportedPoints, path: Path, ending: str, choice: ExportChoice) -> None:
    match ending:
        case ".csv":
            from .tables import write_csv

            write_csv(points, path)
        case ".parquet":
            from .tables import write_parquet

            write_parquet(points, path)
        case ".geojson":
            from .vectors import write_geojson

            write_geojson(points, path, choice.box)
        case ".gpkg":
            from .vectors import write_geopackage

            write_geopackage(points, path, choice.box)
        case ".gcp":
            from .ground_control import write_gcp

            write_gcp(points, path)
        case ".lmk":
            from .landmark_maps import write_landmark_maps

            write_landmark_maps(points, path, choice.sun_deg)
        case ".spc":
            from .spc import write_spc

            write_spc(points, path)
        case ".bds":
            from .dsk import write_dsk

            write_dsk(points, path, choice.box is not None)
