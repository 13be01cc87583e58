"""The STAC item: fields of the core (1.1.0) and of its two extensions, and a geometry that holds every footprint."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from helpers import catalogs, twins_match

from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.exports.export import export

shapely = pytest.importorskip("shapely")


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["MOON_ME", "MOON_PA"])
def test_an_item_of_a_file(frame: str, tmp_path: Path) -> None:
    write_catalog(catalogs.catalog(12), tmp_path / "site.h5")
    assert export(tmp_path / "site.h5", tmp_path / "a.json", frame=frame) == 12
    item = json.loads((tmp_path / "a.json").read_text())
    assert {*item} == {
        *("type", "stac_version", "stac_extensions", "id", "bbox", "geometry", "properties"),
        *("links", "assets"),
    }  # fmt: skip
    assert (item["type"], item["stac_version"], item["id"]) == ("Feature", "1.1.0", "a")
    stated = item["properties"]
    assert datetime.fromisoformat(stated["datetime"]).tzinfo is not None
    assert (stated["ssys:targets"], stated["ssys:target_class"]) == (["Moon"], "satellite")
    assert frame in stated["description"]
    known = frame == "MOON_ME"
    assert stated["proj:code"] == ("IAU_2015:30100" if known else None)
    assert ("principal axes" in stated.get("proj:wkt2", "")) == (not known)
    assert [one["href"] for one in item["assets"].values()] == ["./site.h5"]
    export(tmp_path / "site.h5", tmp_path / "a.gpkg", frame=frame)
    export(tmp_path / "site.h5", tmp_path / "a.json", frame=frame, overwrite=True)
    item = json.loads((tmp_path / "a.json").read_text())
    assert item["assets"]["a.gpkg"]["type"] == "application/geopackage+sqlite3"


@pytest.mark.parametrize(
    ("lon", "lat"),
    [((3.0, 4.0), (25.0, 26.0)), ((179.5, 180.6), (0.0, 2.0)), ((0.0, 140.0), (89.9, 89.8))],
)
def test_its_geometry_holds_every_footprint(
    lon: tuple[float, float], lat: tuple[float, float], tmp_path: Path
) -> None:
    site = twins_match.catalog_of_patches(
        np.zeros((2, 9, 9)),
        [twins_match.EnuFrame(*place, 0.0) for place in zip(lon, lat, strict=True)],
        500.0,
    )
    export(site, tmp_path / "a.json")
    export(site, tmp_path / "a.geojson")
    item = json.loads((tmp_path / "a.json").read_text())
    whole = shapely.from_geojson(json.dumps(item["geometry"]))
    assert whole.is_valid
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    prints = [
        shapely.from_geojson(json.dumps(one["geometry"]))
        for one in features
        if one["properties"]["layer"] == "footprints"
    ]
    assert len(prints) == 2
    assert all(whole.buffer(1e-9).covers(one) for one in prints)
    assert whole.area < 20.0 or lat[0] > 80.0
    west, _, east, _ = item["bbox"]
    assert (west > east) == (lon[0] > 179.0)
