"""DEMs and maps on a server (a loopback one that gives parts of files) and in archives, named by the user."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.range_server import Served, range_server
from rasterio.shutil import copy

import lcp_catalog as lcp
from lcp_catalog.atomic_files import file_facts, state_of
from lcp_catalog.errors import DemError
from lcp_catalog.remote_files import absolute, archive_of, beside, gdal_name, url_of

SAMPLE = Path(lcp.__file__).parent.parent / "sample_data"
NAME = "hadley_gld100_256ppd.tif"
MAP = "hadley_albedo_643nm_11ppd.tif"
AREA = {"center": (3.63, 26.13), "size_km": 6.0, "sun": (96.5, 14.0)}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    (tmp_path / "bucket").mkdir()
    copy(SAMPLE / NAME, tmp_path / "bucket" / NAME, driver="COG", blocksize=256, compress="none")
    (tmp_path / "bucket" / MAP).write_bytes((SAMPLE / MAP).read_bytes())
    return tmp_path


@pytest.fixture
def served(folder: Path) -> Iterator[Served]:
    with range_server(folder) as found:
        yield found


def radiance(dem: str, albedo: str | Path | None = None) -> np.ndarray:
    return np.asarray(lcp.render(dem, **AREA, albedo=albedo).radiance)


@pytest.mark.slow
@pytest.mark.parametrize(
    "start", ["{url}/bucket/", "/vsicurl/{url}/bucket/", "s3://bucket/", "/vsis3/bucket/"]
)
def test_windows_of_a_file_on_a_server(
    start: str, served: Served, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", served.url)
    dem, albedo = (start.format(url=served.url) + name for name in (NAME, MAP))
    np.testing.assert_array_equal(radiance(dem, albedo), radiance(str(SAMPLE / NAME), SAMPLE / MAP))
    whole = folder / "bucket" / NAME
    given = sum(count for _, path, count in served.asked if path.endswith(NAME))
    assert 0 < given < 0.5 * whole.stat().st_size


def test_a_file_in_an_archive(tmp_path: Path) -> None:
    archive = tmp_path / "dems.zip"
    with zipfile.ZipFile(archive, "w") as file:
        file.write(SAMPLE / NAME, f"in/{NAME}")
    here = radiance(str(SAMPLE / NAME))
    for name in (f"/vsizip/{archive}/in/{NAME}", f"/vsizip/{{{archive}}}/in/{NAME}"):
        np.testing.assert_array_equal(radiance(name), here)
        assert [one.files for one in lcp.dem_set(name).dems] == [(archive,)]
        assert state_of(Path(name)) == state_of(archive)


def test_provenance_is_size_and_etag_and_another_content_shows(
    served: Served, folder: Path
) -> None:
    path = Path(f"{served.url}/bucket/{NAME}")
    (facts,), state = file_facts([path]), state_of(path)
    assert facts.keys() == {"name", "size", "etag"}
    assert (facts["name"], facts["size"]) == (NAME, (folder / "bucket" / NAME).stat().st_size)
    changed = folder / "bucket" / NAME
    changed.write_bytes(changed.read_bytes()[:-1] + b"\0")
    assert file_facts([path]) != [facts]
    assert state_of(path) != state


@pytest.mark.slow
def test_what_cannot_be_watched_or_read_is_refused(folder: Path, served: Served) -> None:
    with range_server(folder, tags=False) as silent, pytest.raises(DemError, match="download"):
        lcp.dem_set(f"{silent.url}/bucket/{NAME}")
    with pytest.raises(DemError, match="404"):
        lcp.dem_set(f"{served.url}/none.tif")
    with pytest.raises(DemError, match="does not answer"):
        lcp.dem_set("http://127.0.0.1:9/a.tif")
    with pytest.raises(DemError, match="key or a password") as error:
        lcp.dem_set(f"{served.url}/bucket/{NAME}?Signature=secret")
    assert "secret" not in str(error.value)
    (folder / "bucket" / "far.vrt").write_text("<VRTDataset rasterXSize='1' rasterYSize='1'/>")
    with pytest.raises(DemError, match="not a DEM that can be read"):
        lcp.dem_set(f"{served.url}/bucket/far.vrt")


def test_a_local_file_that_names_a_server_still_asks_none(served: Served, tmp_path: Path) -> None:
    vrt = tmp_path / "near.vrt"
    source = f"<SourceFilename>/vsicurl/{served.url}/bucket/{NAME}</SourceFilename>"
    vrt.write_text(
        "<VRTDataset rasterXSize='9' rasterYSize='9'><VRTRasterBand dataType='Float32' band='1'><SimpleSource>"
        f"{source}</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    with pytest.raises(DemError, match="no plain file on this machine"):
        lcp.dem_set(vrt)
    assert not served.asked


def test_names() -> None:
    for text in ("https://a.b/c/d.tif", "/vsicurl/https://a.b/c/d.tif"):
        for path in (text, Path(text)):
            assert url_of(path) == "https://a.b/c/d.tif"
            assert gdal_name(path) == "/vsicurl/https://a.b/c/d.tif"
            assert absolute(path) == str(path)
    assert url_of("s3://bucket/k/d.tif") == "https://bucket.s3.amazonaws.com/k/d.tif"
    assert beside(Path("f"), "https://a/b.tif") == "https://a/b.tif"
    assert beside(Path("f"), "b.tif") == "f/b.tif"
    assert archive_of("/vsizip/{/a/b.zip}/c.tif") == Path("/a/b.zip")
    for plain in ("d.tif", "/a/d.tif", "C:/d.tif", "http.tif"):
        assert url_of(plain) is None
        assert archive_of(plain) is None
        assert gdal_name(plain) == plain
