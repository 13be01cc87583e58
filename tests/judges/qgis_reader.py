"""QGIS's libraries read files: for each the layers that they find, as JSON on the last line. Run by a Python that has `qgis`."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from typing import Any

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from osgeo import ogr
from qgis.core import Qgis, QgsApplication, QgsRasterLayer, QgsVectorLayer

_TABLE = "?delimiter=,&xField=longitude_deg&yField=latitude_deg"


def _vectors(path: str) -> Iterator[Any]:
    if path.endswith(".csv"):
        yield QgsVectorLayer(f"file://{path}{_TABLE}", "table", "delimitedtext")
        return
    whole = QgsVectorLayer(path, "whole", "ogr")
    parts = whole.dataProvider().subLayers() if whole.isValid() else []
    for part in parts:
        _, name, _, kind, *_ = part.split("!!::!!")
        yield QgsVectorLayer(
            f"{path}|layername={name}|geometrytype={kind}", f"{name} {kind}", "ogr"
        )
    if not parts:
        yield whole


def _told(layer: Any) -> dict[str, Any]:
    box = layer.extent()
    told = {
        "name": layer.name(),
        "valid": layer.isValid(),
        "crs": layer.crs().toWkt(),
        "code": layer.crs().authid() if layer.crs().isValid() else None,
        "extent": [box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum()],
    }
    if isinstance(layer, QgsVectorLayer):
        features = list(layer.getFeatures()) if layer.isValid() else []
        fields = [field.name() for field in layer.fields()]
        centres = [feature.geometry().centroid().asPoint() for feature in features]
        return told | {
            "count": len(features),
            "fields": fields,
            "points": [[point.x(), point.y()] for point in centres],
            "ids": [str(f["point_id"]) for f in features] if "point_id" in fields else [],
        }
    value, known = layer.dataProvider().sample(box.center(), 1)
    return told | {"size": [layer.width(), layer.height()], "middle": value if known else None}


def _layers(path: str) -> list[dict[str, Any]]:
    if path.endswith(".tif") or path.startswith("NETCDF:"):
        return [_told(QgsRasterLayer(path, "raster"))]
    return [_told(layer) for layer in _vectors(path)]


def main(paths: list[str]) -> None:
    """Print the layers of each file."""
    QgsApplication.setPrefixPath(os.environ.get("QGIS_PREFIX_PATH", "/usr"), True)
    app = QgsApplication([], False)
    app.initQgis()
    drivers = [ogr.GetDriver(k).GetName() for k in range(ogr.GetDriverCount())]
    print(
        json.dumps(
            {
                "version": Qgis.QGIS_VERSION,
                "drivers": drivers,
                "files": [_layers(path) for path in paths],
            }
        )
    )
    app.exitQgis()


if __name__ == "__main__":
    main(sys.argv[1:])
