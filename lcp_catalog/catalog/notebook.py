"""A catalogue for notebooks: as a dataset of xarray, as a table of geopandas, and drawn with matplotlib. What these
need is in the extra ``notebook``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..arrays import AnyArray
from ..cameras.view import ParallelView
from ..errors import CatalogError, package, pair, unknown_keys
from ..geometry.bounds import wrapped_deg
from ..geometry.frames import direction_enu
from ..plots.pictures import data_uri, new_axis, shrunk
from ..rendering.renderer import render_enu
from .catalogue import Catalog, attributes
from .charts import hillshade
from .layout import GROUPS
from .model import StoredArray, held
from .patch_terrain import patch_terrain
from .summary import Statistics

_CRS = "IAU_2015:30100"
"""Longitude and latitude on the sphere of the Moon."""


def dataset(catalog: Catalog) -> Any:
    """See `Catalog.to_xarray`."""
    xarray = package("xarray", "notebook", "a dataset")
    indexing = package("xarray.core.indexing", "notebook", "a dataset")

    class Lazy(xarray.backends.BackendArray):  # type: ignore[name-defined,misc]  # a class of a value
        """A variable of the file: what is selected is read, and its digests are checked."""

        def __init__(self, stored: StoredArray) -> None:
            self.stored, self.shape, self.dtype = stored, stored.shape, stored[0:0].dtype

        def __getitem__(self, key: Any) -> Any:
            kind = indexing.IndexingSupport.BASIC
            return indexing.explicit_indexing_adapter(key, self.shape, kind, self._read)

        def _read(self, index: tuple[Any, ...]) -> AnyArray:
            return np.asarray(self.stored[index])

    numbers = {"point": len(catalog), "view": len(catalog.view_azimuth)}
    found: dict[str, Any] = {name: (name, np.arange(count)) for name, count in numbers.items()}
    ids = held(catalog, "point_id")
    stored = isinstance(ids, StoredArray)
    universal = replace(ids, path="universal", row_bytes=1) if stored else catalog.universal
    for name, variable in GROUPS[""].items():
        value = universal if name == "universal" else catalog.__dict__.get(name)
        if name in numbers or value is None:
            continue
        if isinstance(value, StoredArray):
            value = indexing.LazilyIndexedArray(Lazy(value))
        about = {"units": variable.units, "long_name": variable.long_name}
        found[name] = (variable.dims, value, about)
    return xarray.Dataset(found, attrs=attributes(catalog))


def geodataframe(catalog: Catalog) -> Any:
    """See `Catalog.to_geodataframe`."""
    geopandas = package("geopandas", "notebook", "a geographic table")
    table = catalog.to_dataframe()
    places = geopandas.points_from_xy(
        wrapped_deg(table["longitude"]), table["latitude"], table["elevation"]
    )
    return geopandas.GeoDataFrame(table, geometry=places, crs=_CRS)


def plot(
    catalog: Catalog, what: str | int, ax: Any, sun: tuple[float, float] | None, view: int
) -> Any:
    """See `Catalog.plot`."""
    ax = ax or new_axis()
    if not isinstance(what, str):
        return _patch(catalog, catalog.row(what), ax, sun, view)
    if what == "claims":
        return _claims(catalog, ax, view)
    if unknown := unknown_keys([what], ("usable_share", "claims", *catalog.column_names)):
        raise CatalogError(f"what is drawn is a row or a figure of each point: {unknown}")
    values = Statistics.of(catalog).by_point if what == "usable_share" else catalog.part(what)
    relief = catalog.overview
    x, y = relief.plane.places(catalog.position_mcmf)
    cell_m = float(abs(relief.x[1] - relief.x[0]))
    edges = np.array([relief.x[0], relief.x[-1], relief.y[-1], relief.y[0]])
    extent = (edges + cell_m * np.array([-0.5, 0.5, -0.5, 0.5])) / 1e3
    ax.imshow(hillshade(relief.height, cell_m)[..., 0], cmap="gray", extent=extent)
    dots = ax.scatter(x / 1e3, y / 1e3, 12, values, edgecolors="black", linewidths=0.3)
    ax.figure.colorbar(dots, ax=ax, label=what)
    ax.set(xlabel="km", ylabel="km", title=catalog.title)
    return ax


def _claims(catalog: Catalog, ax: Any, view: int) -> Any:
    """Share of the points that are usable, by the Sun."""
    share = Statistics.of(catalog).by_view_and_sun[view]
    azimuth, elevation = catalog.sun_azimuth, catalog.sun_elevation
    ax.imshow(share, vmin=0.0, vmax=1.0, origin="lower", aspect="auto")
    ax.set_xticks(range(len(azimuth)), [f"{angle:g}" for angle in azimuth], rotation=90)
    ax.set_yticks(range(len(elevation)), [f"{angle:g}" for angle in elevation])
    ax.figure.colorbar(ax.images[-1], ax=ax, label="usable share of the points")
    ax.set(xlabel="azimuth of the Sun, deg", ylabel="elevation of the Sun, deg")
    return ax


def _patch(catalog: Catalog, row: int, ax: Any, sun: tuple[float, float] | None, view: int) -> Any:
    """A point's patch, rendered from its own heights alone."""
    wanted = "azimuth and elevation of the Sun, degrees"
    azimuth, elevation = (90.0, 20.0) if sun is None else pair(sun, "sun", wanted)
    off, around = (float(getattr(catalog, f"view_{n}")[view]) for n in ("off_nadir", "azimuth"))
    seen = ParallelView(direction_enu(around, 90.0 - off))
    shot = render_enu(patch_terrain(catalog, row), direction_enu(azimuth, elevation), seen)
    shot.plot(ax)
    ax.set(title=f"{catalog.point_id[row]}, Sun at {azimuth:g}, {elevation:g} deg")
    return ax


_MAP_NODES, _MAP_POINTS, _MAP_PX = 25_000, 400, 320
"""Nodes and points of a small map, at most, and its width."""


def small_map(catalog: Catalog) -> str:
    """The overview's relief, lit from the north-west, with the points (an even choice of many), as an SVG."""
    view = catalog.overview
    rows, columns = np.shape(view.height)
    if min(rows, columns) < 2:
        return ""
    x, y = np.asarray(view.x), np.asarray(view.y)
    step = np.array([x[-1] - x[0], y[0] - y[-1]]) / (columns - 1, rows - 1)
    width, high = step * (columns, rows)
    height = shrunk(view.height, _MAP_NODES)
    scale = _MAP_PX / width
    chosen = np.unique(np.linspace(0, len(catalog) - 1, min(len(catalog), _MAP_POINTS)).astype(int))
    east, north = view.plane.places(catalog.part("position_mcmf", chosen))
    marks = "".join(
        f'<circle cx="{px:.0f}" cy="{py:.0f}" r="3"/>'
        for px, py in zip(
            (east - x[0] + step[0] / 2) * scale,
            (y[0] + step[1] / 2 - north) * scale,
            strict=True,
        )
    )
    size = f'width="{_MAP_PX}" height="{high * scale:.0f}"'
    picture = data_uri(hillshade(height, width / height.shape[1]))
    return (
        f'<svg {size} role="img" aria-label="map of {len(catalog)} points"><image href="{picture}" {size} '
        f'preserveAspectRatio="none"/><g fill="#e66101" stroke="#000">{marks}</g></svg>'
    )
