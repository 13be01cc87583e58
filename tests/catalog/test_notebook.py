"""A catalogue in a notebook: short texts, points one by one, selections, tables."""

# ruff: noqa: E501  a wrong call and its answer stand in one row

from __future__ import annotations

import csv
import datetime as dt
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from astropy.time import Time
from helpers import catalogs, navigable, posed, verdicts
from helpers.suns import light

import lcp_catalog as lcp
from lcp_catalog import errors
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CatalogError, ConfigError, KindError, MissingPackageError, SunError
from lcp_catalog.matching.fix import CANNOT_SAY, LOCATED, Fix


@pytest.fixture(scope="module", params=["memory", "file"])
def catalog(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> lcp.Catalog:
    made = catalogs.catalog(20)
    if request.param == "memory":
        return made
    path = tmp_path_factory.mktemp("notebook") / "c.h5"
    write_catalog(made, path)
    return lcp.open_catalog(path)


def test_texts_are_short(catalog: lcp.Catalog) -> None:
    for one in (catalog, catalog.coverage, catalog.overview):
        assert len(repr(one)) <= 1000
    text = catalog._repr_html_()
    assert text.startswith("<table>")
    assert text.count("<tr>") == text.count("</tr>") > 10
    assert "<td>20</td>" in text
    assert "Sun at" in text


def test_texts_of_results_are_short(catalog: lcp.Catalog) -> None:
    """With what each is, and in a notebook a picture or a table below 200 kB."""
    taken = posed.camera(size_px=40, focal_px=400.0)
    frame = lcp.simulate(catalogs.HADLEY, taken, (96.0, 14.0), accuracy="draft", gsd_m=474.0)
    shot = lcp.render(catalogs.HADLEY, center=(3.5, 26.0), size_km=10.0, sun=(96.0, 14.0))
    same = lcp.diff(catalog, catalog)
    other = lcp.diff(catalog, catalogs.catalog(30))
    results = {
        "SimulatedFrame: radiance (40, 40), numbers (40, 40), ": frame,
        "Rendering: radiance (": shot,
        "Image: name 'simulated', signal (40, 40), ": frame.image,
        "Comparison: first 20, second 20, matched 20, came 0, ": same,
        "Comparison: first 20, second 30, matched 20, came 10, ": other,
        "DemSet: 1 file (hadley_gld100_256ppd.tif)": lcp.dem_set(catalogs.HADLEY),
        "CameraInfo: camera, 0 problems": lcp.camera_info(taken),
    }
    for start, one in results.items():
        assert repr(one).startswith(f"<{start}")
        assert len(repr(one)) <= 1000
        assert "array(" not in repr(one)
    for shown in (frame, shot):
        text = shown._repr_html_()
        assert 1000 < len(text) < 200_000
        assert '<img src="data:image/png;base64,' in text
        assert "&lt;" in text
    assert "<th>came</th><td>10</td>" in other._repr_html_()


WRONG: dict[str, tuple[Callable[[lcp.Catalog], object], type[Exception], str]] = {
    "no point asked for": (lambda c: c.query(posed.camera(), (96.0, 14.0), max=0), ConfigError, "`max` must be at least 1, not 0"),
    "a catalogue as DEM": (lcp.DemSet.open, KindError, "`dem` must be the path of a DEM, several paths, or a DemSet, not Catalog"),
    "a catalogue among DEMs": (lambda c: lcp.dem_set([c]), KindError, "several paths, or a DemSet, not Catalog"),
    "a number as catalogue": (lambda c: lcp.open_catalog(5), KindError, "`path` must be the path of a catalogue, not int"),
    "a figure that is not there": (lambda c: c.plot("usable"), CatalogError, "no key usable (usable_share is meant?); there are usable_share, claims, "),
    "a variable that is not there": (lambda c: c["nonsense"], CatalogError, "the catalogue has no key nonsense; there are "),
    "a misspelt variable": (lambda c: c["detecton_probability"], CatalogError, "no key detecton_probability (detection_probability is meant?)"),
    "a point that is not there": (lambda c: c[1000], IndexError, "no point 1000: the catalogue has 20, from 0"),
    "a fraction of a point": (lambda c: c[1.5], KindError, "`which` must be a row, a slice, rows, a mask, or the name of a variable, not float"),
    "a number as Sun": (lambda c: c.plot(0, sun=90), KindError, "`sun` must be azimuth and elevation of the Sun, degrees, not int"),
    "a patch that is not there": (lambda c: c.plot(9999), IndexError, "no point 9999: the catalogue has 20, from 0"),
    "a number as place": (lambda c: c.windows(3.5, "2026-01-01", "2026-01-02"), KindError, "`center` must be longitude and latitude, degrees, not float"),
    "nothing as camera": (lambda c: lcp.read_camera(None), KindError, "`path` must be the path of a camera file, not NoneType"),
    "a number as output": (lambda c: c.export(5), KindError, "`output` must be the path of the file to write, not int"),
    "a catalogue to inspect": (lcp.inspect, KindError, "`catalog` must be the path of a catalogue's file, not Catalog"),
    "a Sun too high": (lambda c: c.sel(sun_elevation=200), CatalogError, "`sun_elevation` 200 is outside the catalogue's "),
    "a Sun below": (lambda c: c.sel(sun_elevation=-40), CatalogError, "`sun_elevation` -40 is outside the catalogue's "),
    "no Sun": (lambda c: c.query(replace(posed.camera(), sun_position_mcmf_m=None, time_utc=None)), SunError, "no Sun: give `sun`, or a camera whose file has one"),
    "a page of text": (lambda c: c.report("r.txt"), ConfigError, "r.txt: the output must end in .html"),
    "a page without an ending": (lambda c: c.report("r"), ConfigError, "r: the output must end in .html"),
    "a render as a picture": (lambda c: lcp.render(catalogs.HADLEY, "r.png", sun=(90, 20)), ConfigError, "r.png: the output must end in .tif"),
    "a Sun beside an environment map": (lambda c: lcp.render(catalogs.HADLEY, sun=(90, 20), environment="sky.hdr"), ConfigError, "`environment` replaces the Sun: it excludes `sun` and `disc`"),
    "earthlight beside an environment map": (lambda c: lcp.render(catalogs.HADLEY, earthshine=True, environment="sky.hdr"), ConfigError, "`environment` excludes `earthshine`"),
    "a solar disc beside an environment map": (lambda c: lcp.simulate(catalogs.HADLEY, posed.camera(), disc=True, environment="sky.hdr"), ConfigError, "`environment` replaces the Sun"),
    "a time beside an environment map": (lambda c: lcp.validate("c.h5", "a.png", sun="2026-01-01", environment="sky.hdr"), ConfigError, "`environment` replaces the Sun"),
    "windows of a camera that looks aside": (lambda c: lcp.windows(c, (3.5, 26.0), "2026-01-01", camera=posed.camera(), off_nadir_deg=0.0), ConfigError, "`camera` excludes `size_km`, `gsd_m`, `off_nadir_deg` and `view_azimuth_deg`"),
    "a render of a camera that looks aside": (lambda c: lcp.render(catalogs.HADLEY, camera=posed.camera(), off_nadir_deg=0.0), ConfigError, "`camera` excludes `off_nadir_deg`, `view_azimuth_deg` and `altitude_km`"),
    "a render of a camera at an altitude": (lambda c: lcp.render(catalogs.HADLEY, camera="none.json", altitude_km=100.0), ConfigError, "`camera` excludes `off_nadir_deg`, `view_azimuth_deg` and `altitude_km`"),
    "a render from aside without an azimuth": (lambda c: lcp.render(catalogs.HADLEY, sun=(90, 20), off_nadir_deg=20.0), ConfigError, "`off_nadir_deg` and `view_azimuth_deg` go together"),
    "windows from an azimuth alone": (lambda c: lcp.windows(c, (3.5, 26.0), "2026-01-01", view_azimuth_deg=20.0), ConfigError, "`off_nadir_deg` and `view_azimuth_deg` go together"),
    "a cell size without a DEM": (lambda c: lcp.sun_at((3.5, 26.0), "2026-01-01", gsd_m=100.0), ConfigError, "`gsd_m` needs `dem`: it is the cell size of the terrain"),
    "points in an unknown format": (lambda c: c.export("p.xyz"), ConfigError, "p.xyz: the output must end in .csv or .parquet or "),
    "a merge as a table": (lambda c: lcp.merge([c, c], "m.csv"), ConfigError, "m.csv: the output must end in .h5 or .lcpx"),
    "the solar disc without a DEM": (lambda c: lcp.validate("c.h5", "a.png", disc=True), ConfigError, "`disc` needs `dem`: only renders of a DEM have this light"),
    "a point as the Sun without a DEM": (lambda c: lcp.validate("c.h5", "a.png", disc=False), ConfigError, "`disc` needs `dem`: only renders of a DEM have this light"),
    "bounced light without a DEM": (lambda c: lcp.validate("c.h5", "a.png", bounce="auto"), ConfigError, "`bounce` needs `dem`: only renders of a DEM have this light"),
    "an image twice": (lambda c: lcp.validate("c.h5", ["a.png", Path("a.png")]), ConfigError, "a.png: stands twice among the images and would count twice; name each image once"),
    "a catalogue of HDF4": (lambda c: lcp.build_catalog(catalogs.HADLEY, "c.hdf"), ConfigError, "c.hdf: the output must end in .h5"),
    "a text as seed": (lambda c: lcp.simulate(catalogs.HADLEY, posed.camera(), seed="a"), KindError, "`seed` must be a whole number, not str"),
    "a number to merge": (lambda c: lcp.merge([c, 5], "none.h5"), KindError, "`catalogs` must be catalogues, or the paths of their files, not int"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_call_is_told_what_is_wanted(kind: str, catalog: lcp.Catalog) -> None:
    call, error, says = WRONG[kind]
    with pytest.raises(error, match=re.escape(says)) as raised:
        call(catalog)
    assert "\n" not in str(raised.value)


@pytest.mark.slow
def test_the_map_in_a_notebook_shows_relief_and_points(catalog: lcp.Catalog) -> None:
    """Each point has its mark where the plane of the overview has it; the whole text stays below 60 kB, also with many
    points and a large relief.
    """
    text = catalog._repr_html_()
    view = catalog.overview
    left, top = view.x[0], view.y[0]
    scale = 320.0 / (view.x[-1] - left) * (len(view.x) - 1) / len(view.x)
    half = (view.x[1] - left) / 2.0
    x, y = view.plane.places(catalog.position_mcmf)
    marks = np.array(re.findall(r'<circle cx="(-?\d+)" cy="(-?\d+)"', text), dtype=float)
    assert len(marks) == len(catalog) == 20
    np.testing.assert_allclose(marks[:, 0], (x - left + half) * scale, atol=0.51)
    np.testing.assert_allclose(marks[:, 1], (top + half - y) * scale, atol=0.51)
    assert text.count('<image href="data:image/png;base64,') == 1
    many = catalogs.catalog(900)
    rough = np.random.default_rng(1).normal(0.0, 50.0, (700, 700)).astype(np.float32)
    wide = np.arange(700.0) * 100.0 - 34_950.0
    overview = replace(many.overview, height=rough, x=wide, y=wide[::-1])
    assert len(replace(many, overview=overview)._repr_html_()) < 60_000


@pytest.mark.slow
def test_results_have_short_texts_with_plain_numbers() -> None:
    """Of a result with long arrays: its kind and what it says, in at most 300 characters."""
    ground, camera = navigable.everywhere_usable(200), posed.camera()
    answer = ground.query(camera, (90.0, 20.0))
    site = ground.windows(catalogs.CENTER, "2026-01-01", "2026-04-01", "1h")
    found, places = verdicts.matches(500)
    fix = Fix(LOCATED, "", found, verdicts.solved(found, places))
    doubtful = replace(fix, sun=replace(light(0.2), best_turn_deg=9.0, turned_by_map=True))
    assert fix.advice == replace(doubtful, pose=None).advice == ()
    assert [line[:24] for line in doubtful.advice] == ["the Sun's azimuth may be"]
    dem = lcp.dem_info(catalogs.HADLEY)
    assert "np." not in f"{dem.files}{dem.whole}"
    in_view = answer.counts["in_view"]
    for one, says in (
        (answer, f"{answer.usable} of {in_view} points in view usable"),
        (answer, f"position to {answer.position.position_sigma_m:.4g} m"),
        (answer, f"probability {answer.joint.located:.2f}"),
        (site, f"{site.points} points, 2026-01-01T00:00:00Z to 2026-04-01T00:00:00Z"),
        (site, f"2161 instants, {site.usable.min()} to {site.usable.max()} of them usable"),
        (fix, f"located, {fix.matches.found.sum()} of 500 points found, 1 sigma"),
        (doubtful, "m; its Sun may be wrong (`advice`)>"),
        (Fix(CANNOT_SAY, "no point", fix.matches.none()), "cannot say, 0 of 0 points found>"),
        (dem, "1 file (GLD100_256), 83229.8 km2, west 0, south 20, east 10, north 30"),
    ):
        text = repr(one)
        assert text.startswith(f"<{type(one).__name__}: ")
        assert says in text
        assert len(text) <= 300
        assert "np." not in text


def test_points_one_by_one(catalog: lcp.Catalog) -> None:
    every = list(catalog)
    assert len(every) == len(catalog) == 20
    for row in (0, 7, -1):
        np.testing.assert_equal(catalog[row], every[row])
        assert catalog[row]["point_id"] == catalog.point_id[row]
        assert catalog[row]["longitude"] == catalog.longitude[row]
    assert "dem" not in every[0]
    with pytest.raises(IndexError):
        catalog[20]


def test_some_of_the_points(catalog: lcp.Catalog) -> None:
    for which in (slice(3, 9), np.arange(3, 9), np.isin(np.arange(20), np.arange(3, 9))):
        some = catalog[which]
        assert isinstance(some, lcp.Catalog)
        np.testing.assert_array_equal(some.point_id, catalog.point_id[3:9])
        np.testing.assert_array_equal(some.condition, catalog.condition[3:9])


def test_points_that_work_in_a_condition(catalog: lcp.Catalog) -> None:
    """Counted by the flags: all five of them."""
    works = np.asarray(catalog.condition) == 31  # (n, v, e, a)
    e = int(np.argmin(np.abs(catalog.sun_elevation - 21.0)))
    a = catalog.sun_azimuth.tolist().index(0.0)
    found = catalog.sel(view=1, sun_elevation=21.0, sun_azimuth=359.0)
    np.testing.assert_array_equal(found.point_id, catalog.point_id[works[:, 1, e, a]])
    low = catalog.sel(sun_elevation=21.0)
    np.testing.assert_array_equal(low.point_id, catalog.point_id[works[:, :, e].any((1, 2))])
    with pytest.raises(CatalogError, match=r"^the catalogue has no view 9, but \d, from 0 on"):
        catalog.sel(view=9)


def test_tables(catalog: lcp.Catalog) -> None:
    frame = catalog.to_dataframe()
    assert frame.index.tolist() == catalog.point_id.tolist()
    assert frame["elevation"].tolist() == catalog.elevation.tolist()
    chance = catalog["detection_probability"]
    one = chance.sel(view=0, sun_elevation=catalog.sun_elevation[1], image_scale=1.0)
    np.testing.assert_array_equal(one, np.asarray(catalog.detection_probability)[:, 0, 0, 1])
    with pytest.raises(CatalogError, match="has no key colour"):
        catalog["colour"]


def test_a_missing_package_is_one_line(
    catalog: lcp.Catalog, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(errors, "import_module", missing)
    with pytest.raises(MissingPackageError, match=r"needs the package pandas: pip install"):
        catalog.to_dataframe()


def test_a_sun_at_an_instant() -> None:
    text = "2026-03-01T12:00:00"
    utc = dt.datetime(2026, 3, 1, 14, tzinfo=dt.timezone(dt.timedelta(hours=2)))
    of_day = Time(2461100.5, 0.5, format="jd", scale="utc")  # 2026-03-01 noon
    for time in (text, dt.datetime(2026, 3, 1, 12), utc, np.datetime64(text), of_day, of_day.tdb):
        assert lcp.Sun.at(time) == lcp.SunChoice(time_utc=f"{text}Z")
        assert lcp.SunChoice(time_utc=time) in (lcp.Sun.at(text), lcp.SunChoice(time_utc=text))
    assert lcp.instant_range(of_day, "2026-03-02", "6h").labels()[-1] == "2026-03-02T00:00:00Z"
    with pytest.raises(errors.KindError, match="`time` must be ISO text, a datetime"):
        lcp.Sun.at(5)  # type: ignore[arg-type]  # wrong on purpose
    assert lcp.SunChoice.of(np.datetime64(text)) == lcp.Sun.at(text)
    with pytest.raises(errors.SunError, match="invalid time: 'noon'"):
        lcp.Sun.at("noon")


def test_one_dem_is_opened_by_its_name() -> None:
    assert lcp.DemSet.open(str(catalogs.HADLEY)).products == lcp.DemSet.open([catalogs.HADLEY]).products  # fmt: skip
    assert navigable.everywhere_usable(4).path is None


def test_a_dataset_is_the_file(tmp_path: Path) -> None:
    """Judged by xarray's own reading of the file (netCDF-4); nothing is read before it is used."""
    xarray = pytest.importorskip("xarray")
    path = tmp_path / "c.h5"
    write_catalog(catalogs.catalog(20), path)
    found = lcp.open_catalog(path).to_xarray()
    lazy = found["dem"].variable._data
    assert not isinstance(lazy, np.ndarray)
    with xarray.open_dataset(path, engine="h5netcdf") as judge:
        for name in found.variables:
            packed = name.startswith("sigma_m") or name in ("sigma_angle", "detection_probability")
            assert found[name].dims == judge[name].dims, name
            ours, its = found[name].values, judge[name].values
            if packed:  # a multiplication in float32 or float64
                np.testing.assert_allclose(ours, its, rtol=1e-6)
            else:
                np.testing.assert_array_equal(ours, its, err_msg=name)
            assert name in ("point", "view") or found[name].units == judge[name].attrs.get(
                "units", "1"
            )
        assert found.attrs["config"] == judge.attrs["config"]
        some = found["dem"].isel(point=[3, 1], patch_row=slice(2, 9, 3))
        np.testing.assert_array_equal(
            some, judge["dem"].isel(point=[3, 1], patch_row=slice(2, 9, 3))
        )
    memory = catalogs.catalog(20).to_xarray()
    assert set(memory.variables) == set(found.variables)


def test_points_on_the_sphere_of_the_moon(catalog: lcp.Catalog) -> None:
    table = catalog.to_geodataframe()
    assert table.crs.to_authority() == ("IAU_2015", "30100")
    west = catalog.longitude > 180.0
    np.testing.assert_allclose(table.geometry.x, catalog.longitude - 360.0 * west)
    np.testing.assert_array_equal(table.geometry.z, catalog.elevation)


def test_drawings(catalog: lcp.Catalog, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is drawn is what the catalogue holds; a patch is the render of its heights."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    dots = catalog.plot("elevation").collections[0]
    np.testing.assert_array_equal(dots.get_array(), catalog.elevation)
    x, y = catalog.overview.plane.places(catalog.position_mcmf)
    np.testing.assert_allclose(dots.get_offsets(), np.stack([x, y], -1) / 1e3)
    flags = np.asarray(catalog.condition)[:, 1]
    with np.errstate(invalid="ignore"):
        share = (flags == 31).sum(0) / (flags % 2 == 1).sum(0)
    np.testing.assert_allclose(
        catalog.plot("claims", view=1).images[0].get_array().filled(np.nan), share
    )
    patch = catalog.plot(3, sun=(90.0, 30.0)).images[0].get_array()
    assert patch.shape == (catalog.patch_nodes, catalog.patch_nodes)
    with pytest.raises(
        CatalogError, match="a figure of each point: no key dem; there are usable_share"
    ):
        catalog.plot("dem")


@pytest.mark.slow
def test_methods_are_the_functions(tmp_path: Path) -> None:
    ground = navigable.everywhere_usable(12)
    camera = posed.camera()
    write_catalog(ground, tmp_path / "c.h5")
    sun = (90.0, 20.0)
    one, other = ground.query(camera, sun, max=4), lcp.query(tmp_path / "c.h5", camera, sun, most=4)
    np.testing.assert_array_equal(one.rows, other.rows)
    assert len(one.rows) == 4
    assert ground[:5].export(tmp_path / "five.csv") == 5
    assert len((tmp_path / "five.csv").read_text().splitlines()) == 6
    ground.report(tmp_path / "memory.html")
    assert "in memory" in (tmp_path / "memory.html").read_text()
    lcp.open_catalog(tmp_path / "c.h5").report(tmp_path / "opened.html")
    lcp.report(tmp_path / "c.h5", tmp_path / "file.html")
    assert (tmp_path / "opened.html").read_text() == (tmp_path / "file.html").read_text()


def test_differences_as_a_table(tmp_path: Path) -> None:
    made = catalogs.catalog(20)
    found = lcp.diff(made[:15], made[5:])
    found.write_table(tmp_path / "t.csv")
    table = found.to_dataframe()
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["point_id"]) for row in rows] == table.index.tolist()
    assert [row["difference"] for row in rows] == table["difference"].tolist()
    assert len(table) >= 10


def test_what_is_of_another_kind_is_told(catalog: lcp.Catalog) -> None:
    camera = posed.camera()
    for call, text in (
        (
            lambda: lcp.query(5, camera, (90, 20)),
            "`catalog` must be a Catalog or the path of its file, not int",
        ),
        (lambda: lcp.query(catalog, [1]), "`camera` must be a Camera, another sensor, or the path"),
        (
            lambda: lcp.query_trajectory(catalog, "x.csv", 3.0),
            "`camera` must be a Camera or the path",
        ),
        (lambda: lcp.locate(catalog, np.zeros(3)), "`image` must be an Image .* not ndarray"),
        (lambda: lcp.render([5.0], sun=(90, 20)), "`dem` must be the path of a DEM, several paths"),
        (lambda: lcp.dem_info(7), "`dem` must be the path of a DEM, .* not int"),
        (lambda: lcp.build_catalog("d.tif", "o.h5", config=[1]), "`config` must be a Build"),
        (lambda: lcp.merge("a.h5", "o.h5"), "`catalogs` must be a list of catalogues, .* not str"),
        (lambda: lcp.merge(catalog, "o.h5"), "`catalogs` must be a list of catalogues, .* not Cat"),
        (lambda: lcp.merge([], "o.h5"), "no catalogue was given to be merged"),
        (lambda: lcp.merge(iter(()), "o.h5"), "no catalogue was given to be merged"),
        (lambda: lcp.sun_at("2026-01-01", (3, 26)), "`center` must be longitude and latitude"),
    ):
        with pytest.raises((TypeError, errors.SunError, CatalogError), match=text):
            call()


def test_a_rendering_knows_its_place(tmp_path: Path) -> None:
    """Judged by the file that is written with it, read by rasterio."""
    path = tmp_path / "r.tif"
    image = lcp.render(catalogs.HADLEY, path, center=(3.5, 26.0), gsd_m=474.0, sun=(90.0, 20.0))
    assert image.radiance.shape == (501, 501)  # a side of 500 cells
    with rasterio.open(path) as file:
        assert file.crs == image.crs
        assert file.transform == image.transform
        assert float(file.tags()["center_lon"]) == image.frame.lon_deg == 3.5
    shown = image.plot().images[0].get_extent()
    assert shown == pytest.approx([-118.737, 118.737, -118.737, 118.737])


def test_a_seed_is_a_detector() -> None:
    camera = posed.camera()
    with pytest.raises(errors.ConfigError, match="`seed` and `detector` exclude each other"):
        lcp.simulate(catalogs.HADLEY, camera, (90, 20), seed=1, detector=lcp.Detector())


@pytest.mark.slow
def test_a_program_needs_no_guard_for_its_processes(tmp_path: Path) -> None:
    """Workers would import the program that runs and build again."""
    program = f"""
import lcp_catalog as lcp
config = lcp.BuildConfig.from_dict({{"sun": {{"elevations_deg": [15.0], "azimuths_deg": [90.0, 105.0]}},
    "model": {{"albedo": "none"}}, "view": {{"off_nadir_deg": [0.0], "azimuth_deg": [0.0], "altitude_km": [float("inf")]}},
    "points": {{"patch_nodes": 17}}}})
done = lcp.build_catalog({str(catalogs.HADLEY)!r}, "c.h5", config=config, bounds=(3, 25.6, 5, 26.4), gsd_m=474.0, jobs=2)
print("areas", done.areas)
"""
    (tmp_path / "program.py").write_text(program)
    ran = subprocess.run([sys.executable, "program.py"], check=False, cwd=tmp_path, capture_output=True, text=True)  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert int(ran.stdout.split()[1]) > 1
