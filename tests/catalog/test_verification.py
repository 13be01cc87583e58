"""The file: readable by other programs, detection of damage, equal bytes for equal data."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pyproj
import pytest
import rasterio
import xarray
from helpers import catalogs
from helpers.verified import verify

from lcp_catalog.catalog import catalogue, schema
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CatalogError, OutputExistsError
from lcp_catalog.landmarks.selection import Status

CONTRACT = {
    "point_id": ("point",),
    "longitude": ("point",),
    "latitude": ("point",),
    "elevation": ("point",),
    "position_mcmf": ("point", "mcmf_axis"),
    "rotation_mcmf_to_enu": ("point", "enu_axis", "mcmf_axis"),
    "gsd": ("point",),
    "dem_product": ("point",),
    "elevation_sigma": ("point",),
    "dem_resolution": ("point",),
    "dem": ("point", "patch_row", "patch_col"),
    "condition": ("point", "view", "sun_elevation", "sun_azimuth"),
    "sun_elevation_min": ("point", "view", "sun_azimuth"),
    "sun_elevation_max": ("point", "view", "sun_azimuth"),
    "harris_response": ("point",),
    "localization_sigma": ("point", "ellipse_axis"),
    "second_peak": ("point",),
    "false_match_probability": ("point",),
    "gsd_min": ("point",),
    "gsd_max": ("point",),
    "shadow_dependence": ("point",),
    "occlusion_dependence": ("point",),
}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("catalog") / "sound.h5"
    write_catalog(catalogs.catalog(12), path)
    return path


@pytest.fixture
def copy(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(written, tmp_path / "copy.h5"))


def test_what_was_written_is_read(written: Path) -> None:
    before, after = catalogs.catalog(12), open_catalog(written)
    read = catalogue.values(after)
    for name, array in catalogue.values(before).items():
        np.testing.assert_array_equal(read[name], array, err_msg=name)
    assert catalogue.attributes(after) == catalogue.attributes(before)
    groups = catalogue.group_attributes(after)
    assert groups.pop("coverage_map") == {"projection": "orthographic", **groups["overview"]}
    assert groups == catalogue.group_attributes(before)
    assert verify(written) == []


def test_xarray_reads_it_by_name(written: Path) -> None:
    expected = catalogs.arrays(12)
    with xarray.open_dataset(written, engine="h5netcdf") as found:
        for name, dims in CONTRACT.items():
            assert found[name].dims == dims, name
            assert found[name].attrs["long_name"], name
            assert found[name].attrs["units"], name
            np.testing.assert_allclose(
                found[name], expected[name], rtol=1e-6
            ) if name != "dem_product" else None
        assert found["dem_product"].values.tolist() == ["WAC GLD100"] * 12
        for name in ("point_id", "longitude", "latitude"):
            assert name in found.coords
            assert name in found["harris_response"].coords
        for name in ("point", "patch_row", "patch_col", "view", "sun_elevation", "sun_azimuth"):
            assert name in found.coords
        assert {"view_off_nadir", "view_azimuth", "view_altitude"} <= set(found["condition"].coords)
        assert found["view_altitude"].values.tolist() == [np.inf, 100.0, 100.0]
        flags = dict(
            zip(
                found["condition"].flag_meanings.split(),
                found["condition"].flag_masks.tolist(),
                strict=True,
            )
        )
        works = (found["condition"] == sum(flags.values())).isel(point=3, view=0)
        np.testing.assert_array_equal(works, expected["condition"][3, 0] == 31)
    assert flags == {
        "evaluated": 1,
        "localizable": 2,
        "unique": 4,
        "unshadowed": 8,
        "unoccluded": 16,
    }


def test_xarray_reads_the_groups(written: Path) -> None:
    with xarray.open_dataset(written, engine="h5netcdf", group="overview") as found:
        assert found["height"].dims == ("y", "x")
        assert (found.attrs["center_lon"], found.attrs["center_lat"]) == catalogs.CENTER
    with xarray.open_dataset(written, engine="h5netcdf", group="coverage") as found:
        assert found["status"].attrs["flag_meanings"].split() == list(
            schema.COVERAGE_STATUS.values()
        )
        assert found.attrs["spacing_m"] == 9000.0
        assert {"longitude", "latitude"} <= set(found["status"].coords)
        crs = pyproj.CRS.from_cf(found[found["status"].attrs["grid_mapping"]].attrs)
        assert crs.ellipsoid.semi_major_metre == crs.ellipsoid.semi_minor_metre == 1737400.0


PLANES = [
    ("orthographic", *catalogs.CENTER),
    ("orthographic", 200.0, -70.0),
    ("equirectangular", 190.0, 20.0),
    ("polar stereographic", 0.0, 90.0),
    ("polar stereographic", 0.0, -90.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("projection", "lon", "lat"), PLANES)
def test_gdal_places_the_overview(projection: str, lon: float, lat: float, tmp_path: Path) -> None:
    """A pixel's centre is its node: GDAL's netCDF driver and PROJ give the longitude and latitude of the
    plane's own formulas, and so do the CF numbers without the text of the CRS.
    """
    made = catalogs.arrays(3)
    overview = replace(made["overview"], projection=projection, center_lon=lon, center_lat=lat)
    write_catalog(catalogs.catalog(3, overview=overview), tmp_path / "c.h5")
    assert verify(tmp_path / "c.h5") == []
    with rasterio.open(f"netcdf:{tmp_path / 'c.h5'}:/overview/height") as found:
        np.testing.assert_array_equal(found.read(1), overview.height)
        corner, crs = found.transform @ (0.5, 0.5), pyproj.CRS.from_wkt(found.crs.to_wkt())
    assert corner == pytest.approx((overview.x[0], overview.y[0]), abs=1e-6)
    sphere = pyproj.CRS.from_dict({"proj": "longlat", "R": 1737400})
    expected = overview.plane.lonlat(*corner)
    with h5py.File(tmp_path / "c.h5") as file:
        numbers = {k: v for k, v in file["overview/crs"].attrs.items() if k != "crs_wkt"}
    planes = [crs]
    if projection != "equirectangular":  # CF has no name for it
        planes.append(pyproj.CRS.from_cf(numbers))
    for plane in planes:
        place = pyproj.Transformer.from_crs(plane, sphere, always_xy=True).transform(*corner)
        away = (np.array(place) - expected + 180.0) % 360.0 - 180.0
        assert np.abs(away).max() < 1e-9


@pytest.mark.parametrize("name", ["crs_wkt", "latitude_of_projection_origin"])
def test_a_changed_crs_is_named(copy: Path, name: str) -> None:
    with h5py.File(copy, "r+") as file:
        file["overview/crs"].attrs[name] = 7.0
    assert any(line.startswith(f"overview/crs: {name} is 7.0") for line in verify(copy))


def test_global_attributes(written: Path) -> None:
    with h5py.File(written) as file:
        found = dict(file.attrs)
    assert (found["body"], found["frame"], found["reference_radius_m"]) == (
        "MOON",
        "MOON_ME",
        1737400.0,
    )
    assert found["Conventions"] == "CF-1.11"
    wanted = (
        "title product_version schema_version software software_version config sources scene_plan "
        "errors history content_sha256"
    )
    assert set(wanted.split()) <= set(found)


def test_every_dataset_is_chunked_packed_and_checksummed(written: Path) -> None:
    with h5py.File(written) as file:

        def look(name: str, item: h5py.Dataset | h5py.Group) -> None:
            if (
                isinstance(item, h5py.Dataset) and item.shape
            ):  # HDF5 has no chunk for a single value
                if item.is_scale and item.dtype.str == ">f4":  # the table's dimensions
                    assert item.id.get_storage_size() == 0, name
                    return
                assert item.chunks, name
                assert item.fletcher32, name
                if name == "integrity/chunk_sha256":  # digests cannot be compressed
                    return
                assert (item.compression, item.compression_opts) == ("gzip", 2), name
                assert item.shuffle, name

        file.visititems(look)


@pytest.mark.parametrize(("program", "arguments"), [("h5ls", ["-r"]), ("ncdump", ["-h"])])
def test_the_usual_tools_list_it(written: Path, program: str, arguments: list[str]) -> None:
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed (hdf5-tools, netcdf-bin)")
    done = subprocess.run(
        [program, *arguments, written], capture_output=True, text=True, check=True
    )
    for name in CONTRACT:
        assert name in done.stdout
    if program == "ncdump":
        assert "ubyte condition(point, view, sun_elevation, sun_azimuth)" in done.stdout
        assert "phony" not in done.stdout


def test_equal_catalogues_are_equal_bytes(written: Path, tmp_path: Path) -> None:
    again, other = tmp_path / "again.h5", tmp_path / "other.h5"
    write_catalog(catalogs.catalog(12), again)
    write_catalog(catalogs.catalog(12, title="another"), other)
    assert again.read_bytes() == written.read_bytes() != other.read_bytes()


@pytest.mark.slow
def test_a_catalogue_without_points(tmp_path: Path) -> None:
    path = tmp_path / "empty.h5"
    write_catalog(catalogs.catalog(0), path)
    assert verify(path) == []
    assert len(open_catalog(path)) == 0
    with xarray.open_dataset(path, engine="h5netcdf") as found:
        assert found.sizes["point"] == 0
        assert found["dem"].shape == (0, 9, 9)


def test_many_points_need_many_chunks(tmp_path: Path) -> None:
    path = tmp_path / "many.h5"
    write_catalog(catalogs.catalog(300, 33), path)
    with h5py.File(path) as file:
        assert file["dem"].chunks[0] < 300
    assert verify(path) == []


def test_an_output_that_exists_is_kept(copy: Path) -> None:
    before = copy.read_bytes()
    with pytest.raises(OutputExistsError):
        write_catalog(catalogs.catalog(2), copy)
    assert copy.read_bytes() == before
    write_catalog(catalogs.catalog(2), copy, overwrite=True)
    assert len(open_catalog(copy)) == 2
    assert os.listdir(copy.parent) == ["copy.h5"]


def test_statuses_are_those_of_the_selection() -> None:
    assert {status.value: status.name.lower() for status in Status} == schema.COVERAGE_STATUS


# -- damage


def _changed(path: Path, name: str, index: object, value: object) -> None:
    with h5py.File(path, "r+") as file:
        file[name][index] = value


SPOILT = {
    "longitude": (0, 361.0, "longitude: not in 0..360"),
    "latitude": (0, -91.0, "latitude: not in -90..90"),
    "elevation": (0, np.nan, "elevation: not in"),
    "position_mcmf": ((1, 2), 0.0, "position_mcmf: is not the place"),
    "rotation_mcmf_to_enu": ((1, 0, 0), 2.0, "rotation_mcmf_to_enu: is not orthonormal"),
    "point_id": (slice(0, 2), 7, "point_id: 1 numbers occur more than once"),
    "gsd": (0, 0.0, "gsd: not a positive number"),
    "gsd_min": (0, 5000.0, "gsd_max: below gsd_min"),
    "gsd_max": (0, np.inf, "gsd_max: not a positive number"),
    "dem": ((0, 4, 4), 3.0, "dem: the centre node is not at 0"),
    "condition": ((0, 0, 0, 0), 30, "condition: has flags without 'evaluated'"),
    "sun_elevation_min": ((0, 0, 0), 44.0, "sun_elevation_min: does not agree with condition"),
    "sun_elevation_max": ((0, 0, 0), 44.0, "sun_elevation_max: does not agree with condition"),
    "second_peak": (0, np.nan, "second_peak: not in -1..1"),
    "harris_response": (0, np.inf, "harris_response: not in -inf..inf"),
    "false_match_probability": (0, 1.5, "false_match_probability: not in 0..1"),
    "shadow_dependence": (0, -0.5, "shadow_dependence: not in 0..1"),
    "occlusion_dependence": (0, np.nan, "occlusion_dependence: not in 0..1"),
    "localization_sigma": ((0, 0), 1e-6, "localization_sigma: the major axis is below the minor"),
    "dem_product": (0, b"", "dem_product: is empty"),
    "sun_azimuth": (1, 0.0, "sun_azimuth: is not strictly rising"),
    "sun_elevation": (7, 95.0, "sun_elevation: not in 0..90"),
    "view_altitude": (0, -1.0, "view_altitude: not above 0"),
    "view": (0, 4, "view: is not 0, 1, 2"),
    "patch_row": (0, 0, "patch_row: is not counted from the patch's centre"),
    "overview/y": (0, -1e9, "overview/y: is not strictly falling"),
    "coverage/status": (0, 77, "coverage/status: has no meaning"),
}


@pytest.mark.parametrize("apart", [False, True])
def test_a_spoilt_value_is_named(copy: Path, apart: bool) -> None:
    """Beside those of all other variables: by a text that none of the others brings about; so two stand apart."""
    names = {name for name in SPOILT if (name in {"position_mcmf", "gsd_min"}) == apart}
    for name in names:
        index, value, _ = SPOILT[name]
        _changed(copy, name, index, value)
    problems = verify(copy)
    told = {name for name in names if any(line.startswith(SPOILT[name][2]) for line in problems)}
    assert told == names, problems
    changed = ": 1 of 1 chunks are not what was written (damaged or edited)"
    assert sorted(line for line in problems if "chunks" in line) == sorted(
        f"{name}{changed}" for name in names
    )
    with pytest.raises(CatalogError, match=str(copy)):
        open_catalog(copy)


def test_a_frame_that_is_turned_is_named(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        file["rotation_mcmf_to_enu"][2] = np.eye(3)
    lines = [line for line in verify(copy) if "frame" in line]
    assert len(lines) == 1
    assert "is not the frame of longitude and latitude (1 of 12; the first at [2])" in lines[0]


def test_a_quiet_change_is_noticed(copy: Path) -> None:
    _changed(copy, "harris_response", 0, -0.123)  # a patch with texture in one direction alone
    assert verify(copy) == [
        "harris_response: 1 of 1 chunks are not what was written (damaged or edited)"
    ]


def test_changed_attributes_are_noticed(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        file.attrs["config"] = "[points]\npatch_nodes = 11\n"
        file["gsd"].attrs["units"] = "km"
        del file["gsd_max"].attrs["long_name"]
        del file.attrs["sources"]
    problems = verify(copy)
    assert "gsd: units is km instead of m" in problems
    assert any(line.startswith("gsd_max: long_name is None") for line in problems)
    assert "the attribute sources is missing" in problems


def test_a_changed_configuration_is_noticed(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        file.attrs["config"] = "[points]\npatch_nodes = 11\n"
    assert [line.split(":")[0] for line in verify(copy)] == ["content_sha256"]


def test_another_body_is_noticed(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        file.attrs["reference_radius_m"] = 1738000.0
    assert any("reference_radius_m" in line for line in verify(copy))


def test_structure_is_checked(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        del file["second_peak"]
        del file["coverage"]
        data = file["latitude"][()]
        del file["latitude"]
        file["latitude"] = data.astype("f4")
    problems = verify(copy)
    for text in (
        "second_peak: the variable is missing",
        "coverage: the group is missing",
        "latitude: holds f4 instead of f8",
        "latitude: has no checksums",
        "latitude: has the dimensions (?) instead of (point)",
    ):
        assert text in problems


@pytest.mark.parametrize(
    ("version", "problem"),
    [
        ("1.0", "made by lcp 0.2; build it again"),
        ("2.5", "made by lcp 0.2; build it again"),
        ("3.1", "schema version 3.1 is not understood here (3.0); use a newer lcp"),
        ("30.0", "schema version 30.0 is not understood here (3.0); use a newer lcp"),
    ],
)
def test_other_versions_are_refused(copy: Path, version: str, problem: str) -> None:
    with h5py.File(copy, "r+") as file:
        file.attrs["schema_version"] = version
    assert verify(copy) == [problem]
    with pytest.raises(CatalogError, match=f"^{copy}: {problem[:20]}"):
        open_catalog(copy, check=False)


def test_a_changed_byte_is_noticed_by_its_checksum(copy: Path) -> None:
    with h5py.File(copy) as file:
        place = file["dem"].id.get_chunk_info(0)
    whole = bytearray(copy.read_bytes())
    whole[place.byte_offset + place.size // 2] ^= 0x40
    copy.write_bytes(whole)
    problems = verify(copy)
    assert len(problems) == 1
    assert problems[0].startswith("dem: cannot be read")
    with pytest.raises(CatalogError):
        open_catalog(copy)


@pytest.mark.slow
@pytest.mark.usefixtures("checks_apart")
def test_no_damage_raises_or_passes(written: Path, tmp_path: Path) -> None:
    """One byte changed at each of many places: the change is detected, or the values read are equal
    all the same.
    """
    sound, turned = catalogue.values(open_catalog(written)), tmp_path / "turned.h5"
    assert catalogs.noticed_damage(written, sound, turned, seed=3, count=60) > 10


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.999])
def test_a_file_cut_short(copy: Path, share: float) -> None:
    whole = copy.read_bytes()
    copy.write_bytes(whole[: int(len(whole) * share)])
    (problem,) = verify(copy)
    assert problem.startswith("not an HDF5 file, or cut short")


def test_other_files(tmp_path: Path) -> None:
    text, other = tmp_path / "text.h5", tmp_path / "other.h5"
    text.write_text("no catalogue")
    with h5py.File(other, "w") as file:
        file["a"] = [1, 2, 3]
    assert verify(text)[0].startswith("not an HDF5 file")
    assert verify(other)[0].startswith("not a catalogue of control points")
    assert verify(tmp_path / "none.h5") == ["there is no such file"]
    with pytest.raises(CatalogError, match="there is no such file"):
        open_catalog(tmp_path / "none.h5")
