"""`lcp export`: the format by the ending of the output."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

from ..atomic_files import folder_aside, write_aside
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..choices import EXPORT_FOLDERS, EXPORTS
from ..constants import FRAME
from ..errors import ConfigError
from ..geometry.bounds import Bounds
from .frames import frame_named
from .points import ExportedPoints


def export(
    catalog: CatalogOrPath,
    output: Path | str,
    *,
    frame: str = FRAME,
    bounds: tuple[float, float, float, float] | None = None,
    level: int | None = None,
    sun_azimuth_deg: float | None = None,
    sun_elevation_deg: float | None = None,
    overwrite: bool = False,
) -> int:
    """Write points of a catalogue in the format of the output's ending.

    Parameters
    ----------
    catalog:
        A catalogue, or its file.
    output:
        The file, or folder, to write; its ending is one of `choices.EXPORTS`.
    frame:
        Moon-fixed frame of the output: ``MOON_ME`` (mean Earth, DE421) or ``MOON_PA`` (principal
        axes, DE440).
    bounds:
        West, south, east, north, degrees of MOON_ME; may cross the antimeridian. None: all points.
    level:
        Index of the cell size; None: all.
    sun_azimuth_deg, sun_elevation_deg:
        For ``.lmk``: the Sun at every point, degrees clockwise from north and above the horizontal
        plane.
    overwrite:
        True: replace an existing output.

    Returns
    -------
    int
        Number of points written.

    Raises
    ------
    ConfigError
        For another ending, a frame that is not known, or a Sun for a format without one.
    AreaError
        For a choice without points.
    MissingPackageError
        For a format whose package is not installed.
    CatalogError
        For a file that is no catalogue or is damaged.
    OutputExistsError, OutputError
        For the output.

    Examples
    --------
    >>> count = lcp.export(catalog, folder / "small.csv")
    >>> count == len(lcp.open_catalog(catalog))
    True
    """
    ending, sun_deg = Path(output).suffix, _sun(sun_azimuth_deg, sun_elevation_deg)
    if ending not in EXPORTS:
        raise ConfigError(f"{output}: the ending must be one of {' '.join(EXPORTS)}")
    if sun_deg is not None and ending != ".lmk":
        raise ConfigError(f"{output}: a Sun lights .lmk maps only")
    axes, box = frame_named(frame), None
    if bounds is not None:
        west, south, east, north = bounds
        box = Bounds(west, south, east, north)
    with _aside(output, ending, overwrite) as path:
        points = ExportedPoints.chosen(opened_catalog(catalog), axes, box, level)
        _write(points, path, ending, box, sun_deg)
    return len(points)


def _sun(azimuth_deg: float | None, elevation_deg: float | None) -> tuple[float, float] | None:
    """The angles of the Sun; None if it is not stated."""
    if azimuth_deg is None and elevation_deg is None:
        return None
    if azimuth_deg is None or elevation_deg is None:
        raise ConfigError("`sun_azimuth_deg` and `sun_elevation_deg` go together")
    return azimuth_deg, elevation_deg


def _aside(output: Path | str, ending: str, overwrite: bool) -> AbstractContextManager[Path]:
    if ending in EXPORT_FOLDERS:
        return folder_aside(output, EXPORT_FOLDERS[ending], overwrite)
    return write_aside(output, overwrite)


def _write(
    points: ExportedPoints,
    path: Path,
    ending: str,
    box: Bounds | None,
    sun_deg: tuple[float, float] | None,
) -> None:
    match ending:
        case ".csv":
            from .tables import write_csv

            write_csv(points, path)
        case ".parquet":
            from .tables import write_parquet

            write_parquet(points, path)
        case ".geojson":
            from .vectors import write_geojson

            write_geojson(points, path, box)
        case ".gpkg":
            from .vectors import write_geopackage

            write_geopackage(points, path, box)
        case ".gcp":
            from .tables import write_gcp

            write_gcp(points, path)
        case ".lmk":
            from .landmarks import write_landmark_maps

            write_landmark_maps(points, path, sun_deg)
        case ".spc":
            from .landmarks import write_spc

            write_spc(points, path)
        case ".bds":
            from .dsk import write_dsk

            write_dsk(points, path, box is not None)
