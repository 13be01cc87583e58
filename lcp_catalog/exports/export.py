"""`lcp export`: the format by the ending of the output."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..atomic_files import ending_of, folder_aside, write_aside
from ..catalog.catalogue import Catalog
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..choices import EXPORT_FOLDERS, EXPORTS, FLIGHT
from ..constants import FRAME
from ..errors import ConfigError, not_a
from ..geometry.bounds import Bounds
from .frames import frame_named
from .points import ExportedPoints

if TYPE_CHECKING:
    from .flight import KeptConditions

_WRITERS = {
    ".csv": ("tables", "write_csv"),
    ".parquet": ("tables", "write_parquet"),
    ".geojson": ("vectors", "write_geojson"),
    ".gpkg": ("vectors", "write_geopackage"),
    ".gcp": ("tables", "write_gcp"),
    ".lmk": ("landmarks", "write_landmark_maps"),
    ".spc": ("landmarks", "write_spc"),
    ".bds": ("dsk", "write_dsk"),
    ".lcpf": ("flight", "write_flight"),
    ".json": ("stac", "write_stac"),
}
"""Module and function of each of `choices.EXPORTS`; imported when it is used."""

_FIGURES = (".csv", ".parquet", ".gcp", ".json")
"""Exports without patches and claims: of a large catalogue those chunks alone are checked that are used."""


def export(
    catalog: CatalogOrPath,
    output: Path | str,
    *,
    frame: str = FRAME,
    bounds: tuple[float, float, float, float] | None = None,
    level: int | None = None,
    sun_azimuth_deg: float | None = None,
    sun_elevation_deg: float | None = None,
    image_scale: float | None = None,
    conditions: KeptConditions | None = None,
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
    image_scale:
        For ``.lcpf``: the claims of this image scale of the catalogue alone; None: of all.
    conditions:
        For ``.lcpf``: the points, Suns and views to keep (`navigation.descent`); None: all.
    overwrite:
        True: replace an existing output.

    Returns
    -------
    int
        Number of points written.

    Raises
    ------
    ConfigError
        For another ending, a frame that is not known, a Sun or an image scale for a format without
        one, or an image scale that the catalogue does not have.
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
    if not isinstance(output, Path | str):
        raise not_a(output, "output", "the path of the file to write")
    ending, sun_deg = ending_of(output, EXPORTS), _sun(sun_azimuth_deg, sun_elevation_deg)
    if sun_deg is not None and ending != ".lmk":
        raise ConfigError(f"{output}: a Sun lights .lmk maps only")
    if (image_scale is not None or conditions is not None) and ending != FLIGHT:
        raise ConfigError(f"{output}: image scales and conditions are chosen for .lcpf files only")
    axes, box = frame_named(frame), None
    if bounds is not None:
        west, south, east, north = bounds
        box = Bounds(west, south, east, north)
    read = catalog.path if isinstance(catalog, Catalog) else catalog
    aside = folder_aside if ending in EXPORT_FOLDERS else write_aside
    with aside(output, overwrite, [] if read is None else [read]) as path:
        opened = opened_catalog(catalog, check=ending not in _FIGURES)
        points = ExportedPoints.chosen(opened, axes, box, level)
        if conditions is not None:
            points = replace(points, rows=np.intersect1d(points.rows, conditions.rows))
        module, function = _WRITERS[ending]
        write = getattr(import_module(f"{__package__}.{module}"), function)
        if ending == FLIGHT:
            write(points, path, conditions, _scale(points.catalog, image_scale))
        elif ending == ".json":
            write(points, path, Path(output))
        else:
            write(points, path, *([] if sun_deg is None else [sun_deg]))
    return len(points)


def _scale(catalog: Catalog, wanted: float | None) -> int | None:
    """Index of an image scale of the catalogue; None for None."""
    if wanted is None:
        return None
    scales = np.asarray(catalog.image_scale, np.float64)
    near = np.flatnonzero(np.abs(scales - wanted) <= 1e-3 * wanted)
    if not len(near):
        known = ", ".join(f"{one:g}" for one in scales)
        raise ConfigError(f"`image_scale` {wanted:g} is not one of the catalogue's: {known}")
    return int(near[0])


def _sun(azimuth_deg: float | None, elevation_deg: float | None) -> tuple[float, float] | None:
    """The angles of the Sun; None if it is not stated."""
    if azimuth_deg is None and elevation_deg is None:
        return None
    if azimuth_deg is None or elevation_deg is None:
        raise ConfigError("`sun_azimuth_deg` and `sun_elevation_deg` go together")
    return azimuth_deg, elevation_deg
