"""A STAC item of a catalogue (version 1.1.0; extensions ssys 1.1.0 and projection 2.0.0), so that archives find it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..catalog.summary import bounds
from ..choices import INDEX
from ..constants import FRAME, MOON_RADIUS_M
from ..geometry.bounds import wrapped_deg
from .points import ExportedPoints
from .vectors import FIXED_TIME

_EXTENSIONS = ("ssys/v1.1.0", "projection/v2.0.0")
_TYPES = {
    ".h5": "application/x-hdf5",
    INDEX: "application/x-hdf5",
    ".gpkg": "application/geopackage+sqlite3",
}


def write_stac(points: ExportedPoints, path: Path, output: Path) -> None:
    """The item as JSON, into ``path``; ``output``: its own name. Its assets are files by their names: the catalogue, and a
    GeoPackage of the item's name that lies beside it. The ground has no time: the item's is that of a GeoPackage.
    """
    box = _box(points)
    files = [] if points.catalog.path is None else [Path(points.catalog.path).name]
    if (beside := output.with_suffix(".gpkg")).exists():
        files.append(beside.name)
    code = points.frame.name == FRAME
    item = {
        "type": "Feature",
        "stac_version": "1.1.0",
        "stac_extensions": [f"https://stac-extensions.github.io/{one}/schema.json" for one in _EXTENSIONS],
        "id": output.stem,
        "bbox": box,
        "geometry": _geometry(box),
        "properties": {
            "title": points.catalog.title,
            "description": f"{len(points)} control points of the Moon, {points.frame.name}: {points.frame.meaning}",
            "datetime": FIXED_TIME,
            "gsd": float(points.gsd_m.min()),
            "ssys:targets": ["Moon"],
            "ssys:target_class": "satellite",
            "proj:code": points.frame.crs if code else None,
            **({} if code else {"proj:wkt2": points.frame.crs}),
        },
        "links": [],
        "assets": {
            name: {
                "href": f"./{name}",
                "type": _TYPES.get(Path(name).suffix, "application/octet-stream"),
                "roles": ["data"],
            }
            for name in files
        },
    }  # fmt: skip
    path.write_text(json.dumps(item, indent=2) + "\n", encoding="utf-8")


def _box(points: ExportedPoints) -> list[float]:
    """West, south, east, north of the patches, degrees -180..180; west is above east across the antimeridian."""
    lon, lat = points.lonlat_deg
    found = bounds(lon % 360.0, lat)
    assert found is not None
    margin = np.degrees(np.hypot(1.0, 1.0) * points.half * points.gsd_m.max() / MOON_RADIUS_M)
    south, north = max(found["south"] - margin, -90.0), min(found["north"] + margin, 90.0)
    across = margin / max(np.cos(np.radians(max(-south, north))), 1e-9)
    if (found["east"] - found["west"]) % 360.0 + 2.0 * across >= 360.0:
        return [-180.0, south, 180.0, north]
    west, east = wrapped_deg(np.array([found["west"] - across, found["east"] + across]))
    return [float(one) for one in (west, south, east, north)]


def _geometry(box: list[float]) -> dict[str, Any]:
    """The box as a polygon, or as two that meet at the antimeridian."""
    west, south, east, north = box
    parts = [(west, east)] if west <= east else [(west, 180.0), (-180.0, east)]
    rings = [[[[a, south], [b, south], [b, north], [a, north], [a, south]]] for a, b in parts]
    if len(rings) == 1:
        return {"type": "Polygon", "coordinates": rings[0]}
    return {"type": "MultiPolygon", "coordinates": rings}
