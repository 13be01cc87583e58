"""The local files behind a raster: which are found, which are refused, and that GDAL opens no other."""

from __future__ import annotations

import http.server
import itertools
import os
import shutil
import signal
import subprocess
import sys
import tarfile
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers.products import EQC, geotiff
from helpers.small_rasters import SIDE, tif, vrt
from lcp_cli.main import run
from rasterio.transform import from_origin

import lcp_catalog as lcp
from lcp_catalog.dem import raster
from lcp_catalog.dem.dem import Dem, files_beside
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import AlbedoError, DemError, ImageError, OutputError
from lcp_catalog.images.pixels import read_pixels
from lcp_catalog.photometry.albedo_map import AlbedoMap

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"

pytestmark = pytest.mark.usefixtures("rasters_apart")

NO_FILE = "which is no plain file on this machine"


def two(folder: Path) -> Path:
    """A VRT of a VRT of dem.tif."""
    tif(folder / "dem.tif")
    (folder / "deep").mkdir()
    vrt(folder / "deep" / "one.vrt", "../dem.tif")
    return vrt(folder / "two.vrt", "deep/one.vrt")


def zipped(folder: Path) -> Path:
    with zipfile.ZipFile(folder / "a.zip", "w") as archive:
        archive.write(tif(folder / "dem.tif"), "in/dem.tif")
    return vrt(folder / "z.vrt", f"/vsizip/{folder}/a.zip/in/dem.tif")


def braced(folder: Path) -> Path:
    zipped(folder)
    return vrt(folder / "z.vrt", f"/vsizip/{{{folder}/a.zip}}/in/dem.tif")


def tarred_zip(folder: Path) -> Path:
    zipped(folder)
    with tarfile.open(folder / "b.tar", "w") as archive:
        archive.add(folder / "a.zip", "a.zip")
    return vrt(folder / "z.vrt", f"/vsizip/vsitar/{folder}/b.tar/a.zip/in/dem.tif")


def linked(folder: Path) -> Path:
    """A link to a VRT elsewhere, whose source lies beside the VRT."""
    two(folder)
    (folder / "link.vrt").symlink_to("deep/one.vrt")
    return folder / "link.vrt"


def warped(folder: Path) -> Path:
    """A masked file under a VRT of another kind, with the name in capitals."""
    tif(folder / "dem.tif")
    geotiff(folder / "dem.tif.msk", np.full((SIDE, SIDE), 255, np.uint8), 0.0, 8000.0, 1000.0)
    band = (
        "<ComplexSource><SOURCEFILENAME RELATIVETOVRT='1'>dem.tif</SOURCEFILENAME></ComplexSource>"
    )
    return vrt(folder / "x.tif", "", band=band)


def bare(folder: Path) -> Path:
    """Samples without a header."""
    (folder / "dem.bin").write_bytes(np.zeros((SIDE, SIDE), "<f4").tobytes())
    path = vrt(folder / "raw.vrt", "", band='<SourceFilename relativeToVRT="1">dem.bin</SourceFilename>'
               "<ImageOffset>0</ImageOffset><PixelOffset>4</PixelOffset><LineOffset>32</LineOffset>")  # fmt: skip
    path.write_text(
        path.read_text().replace("<VRTRasterBand", '<VRTRasterBand subClass="VRTRawRasterBand"')
    )
    return path


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (two, {"two.vrt", "one.vrt", "dem.tif"}),
        (zipped, {"z.vrt", "a.zip"}),
        (braced, {"z.vrt", "a.zip"}),
        (tarred_zip, {"z.vrt", "b.tar"}),
        (linked, {"link.vrt", "dem.tif"}),
        (warped, {"x.tif", "dem.tif", "dem.tif.msk"}),
        (bare, {"raw.vrt", "dem.bin"}),
    ],
    ids=lambda one: getattr(one, "__name__", None),
)
def test_every_file_behind_a_raster_is_found(
    make: Callable[[Path], Path], names: set[str], tmp_path: Path
) -> None:
    path = make(tmp_path)
    dem = Dem.open(path)
    assert {file.name for file in dem.files} == names
    assert dem.files[0] == path
    assert len(dem.files) == len(names)
    assert all(file.is_file() for file in dem.files)
    assert np.isfinite(dem.read(0, SIDE, 0, SIDE)).all()  # GDAL finds them there, too
    assert set(files_beside(path)) == set(dem.files)
    assert {one["name"] for one in DemSet((dem,)).sources()} == names


def test_an_albedo_map_and_an_image_have_the_same_list(tmp_path: Path) -> None:
    path = two(tmp_path)
    assert len(AlbedoMap.open(path).files) == 3
    assert read_pixels(path).samples[0, 1] == 101.0
    (tmp_path / "dem.tif").unlink()
    with pytest.raises(AlbedoError, match=NO_FILE):
        AlbedoMap.open(path)
    with pytest.raises(ImageError, match=NO_FILE):
        read_pixels(path)


def test_a_dem_that_is_opened_again_has_the_new_heights_of_a_changed_source(tmp_path: Path) -> None:
    path = two(tmp_path)
    old = Dem.open(path)
    assert old.read(0, 1, 0, 1)[0, 0] == 100.0
    tif(tmp_path / "new.tif", 200.0).rename(tmp_path / "dem.tif")
    new = Dem.open(path)
    assert new.read(0, 1, 0, 1)[0, 0] == 200.0
    assert DemSet((new,)).sources() != DemSet((old,)).sources()[:2]


def fifo(folder: Path) -> Path:
    os.mkfifo(folder / "pipe")
    return vrt(folder / "x.vrt", "pipe")


def fifo_beside(folder: Path) -> Path:
    os.mkfifo(folder / "dem.tif.ovr")
    return tif(folder / "dem.tif")


def in_two(source: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        vrt(folder / "one.vrt", source)
        return vrt(folder / "two.vrt", "one.vrt")

    return make


def foreign(folder: Path) -> Path:
    """A source of a format that is not on the list, which names other files or servers."""
    (folder / "a.tif").write_text(
        "<GDAL_WMS><Service name='TMS'><ServerUrl>http://127.0.0.1:9/</ServerUrl></Service></GDAL_WMS>"
    )
    return vrt(folder / "x.vrt", "a.tif")


def packed(folder: Path) -> Path:
    """A VRT in an archive, which names files outside it."""
    with zipfile.ZipFile(folder / "a.zip", "w") as archive:
        archive.write(two(folder), "in.vrt")
    return vrt(folder / "x.vrt", f"/vsizip/{folder}/a.zip/in.vrt")


def commented(folder: Path) -> Path:
    """GDAL and other readers of XML take different names here."""
    tif(folder / "dem.tif")
    return vrt(folder / "x.vrt", "dem<!-- -->.tif")


SOURCE = "<SourceFilename relativeToVRT='{}'>dem.tif</SourceFilename><SourceBand>1</SourceBand>"


def other_form(source: str) -> Callable[[Path], Path]:
    """A source as GDAL takes it, too, but no program writes it; GDAL may read another file than its words say."""

    def make(folder: Path) -> Path:
        tif(folder / "dem.tif")
        return vrt(folder / "x.vrt", "", band=source)

    return make


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (other_form('<SimpleSource SourceFilename="dem.tif"/>'), "x.vrt: holds sourcefilename in"),
        *(
            (other_form(f"<SimpleSource>{SOURCE.format(word)}</SimpleSource>"), "relativeToVRT in")
            for word in ("true", "yes", "00", "2")
        ),
        *(
            (
                other_form(
                    f"<SimpleSource>{SOURCE.format(1)}<OpenOptions>{ooi}</OpenOptions></SimpleSource>"
                ),
                "ROOT_PATH in",
            )
            for ooi in ('<OOI key="ROOT_PATH">/</OOI>', "<OOI><key>root_path</key>/</OOI>")
        ),
        (fifo, f"x.vrt: names .*pipe, {NO_FILE}"),
        (fifo_beside, f"dem.tif: names .*dem.tif.ovr, {NO_FILE}"),
        (in_two("/dev/zero"), f"one.vrt: names /dev/zero, {NO_FILE}"),
        (in_two("none.tif"), f"one.vrt: names .*none.tif, {NO_FILE}"),
        (in_two("."), NO_FILE),
        (in_two(""), NO_FILE),
        (in_two("/vsizip/none.zip/a.tif"), f"one.vrt: names /vsizip/none.zip/a.tif, {NO_FILE}"),
        (in_two("/vsis3/bucket/a.tif"), NO_FILE),
        (in_two("&lt;VRTDataset>&lt;/VRTDataset>"), NO_FILE),
        (commented, NO_FILE),
        (packed, "a.zip/in.vrt: is a virtual raster in an archive; unpack it"),
        (foreign, "a.tif: not a raster .named by .*x.vrt. that can be read here"),
        (in_two("two.vrt"), "two.vrt: (not a DEM|cannot be read)"),
    ],
)
def test_what_cannot_be_resolved_is_refused_in_one_line(
    make: Callable[[Path], Path], says: str, tmp_path: Path
) -> None:
    path = make(tmp_path)
    with pytest.raises(DemError, match=says) as caught:
        Dem.open(path).read(0, SIDE, 0, SIDE)
    assert "\n" not in str(caught.value)


def test_a_vrt_that_is_no_xml_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.vrt").write_text("<VRTDataset rasterXSize='2'><SourceFilename>a</VRTDataset>")
    with pytest.raises(DemError, match="not a virtual raster that can be read"):
        Dem.open(tmp_path / "x.vrt")


@pytest.fixture
def server() -> Iterator[tuple[str, list[str]]]:
    """Address of a server, and the requests that it got."""
    requests: list[str] = []

    class Counted(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            requests.append(self.path)
            self.send_error(404)

        def do_HEAD(self) -> None:
            self.do_GET()

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Counted) as found:
        threading.Thread(target=found.serve_forever, args=(0.01,), daemon=True).start()
        yield f"/vsicurl/http://127.0.0.1:{found.server_port}", requests
        found.shutdown()


def _overview(folder: Path, url: str) -> Path:
    (folder / "dem.tif.aux.xml").write_text(
        f'<PAMDataset><Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">{url}/o.ovr</MDI></Metadata></PAMDataset>'
    )
    return tif(folder / "dem.tif")


def _mask(folder: Path, url: str) -> Path:
    vrt(folder / "dem.tif.msk", f"{url}/mask.tif")
    return tif(folder / "dem.tif")


def _odd_case(folder: Path, url: str) -> Path:
    """A sidecar file that is not looked for by this name, but found by GDAL."""
    vrt(folder / "dem.tif.Ovr", f"{url}/case.tif")
    return tif(folder / "dem.tif")


@pytest.mark.parametrize(
    "make",
    [
        lambda folder, url: vrt(folder / "dem.tif", f"{url}/a.tif"),
        lambda folder, url: in_two(f"{url}/b.tif")(folder),
        lambda folder, url: vrt(
            folder / "w.vrt", "", more=f"<GDALWarpOptions><SourceDataset>{url}/c.tif</SourceDataset></GDALWarpOptions>"
        ),
        _overview,
        _mask,
        _odd_case,
    ],
    ids=["renamed", "of-a-vrt", "warped", "overview", "mask", "odd-case"],
)  # fmt: skip
def test_no_file_makes_a_request(
    make: Callable[[Path, str], Path],
    server: tuple[str, list[str]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    url, requests = server
    path = make(tmp_path, url)
    code = run(["dem", "info", str(path)])
    assert requests == []
    if make is not _odd_case:
        assert code == 1
        assert f"names {url}" in capsys.readouterr().err


TILES = {"tiled": True, "blockxsize": 4096, "blockysize": 4096, "compress": "deflate"}


def _sparse(path: Path, width: int, height: int, blocks: dict[str, object]) -> Path:
    """A GeoTIFF around the Moon of which no block is written."""
    pixel_m = 2.0 * np.pi * 1_737_400.0 / width
    where = from_origin(0.0, 0.5 * height * pixel_m, pixel_m, pixel_m)
    kind = {"driver": "GTiff", "crs": EQC, "transform": where, "count": 1, "dtype": "int16"}
    shape = {"width": width, "height": height, "SPARSE_OK": True, "BIGTIFF": "YES"}
    with rasterio.open(path, "w", **kind, **shape, **blocks):
        pass
    assert path.stat().st_size < 1_500_000
    return path


def test_a_file_of_too_many_pixels_is_refused_before_they_are_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(_sparse(tmp_path / "sparse.tif", 1_000_000, 500_000, TILES))
    assert run(["dem", "info", path]) == 1
    assert "1000000 x 500000 pixels are too many to read them all" in capsys.readouterr().err
    assert run(["dem", "check", path]) == 4
    assert "too many to read them all" in capsys.readouterr().out
    assert run(["dem", "info", "--quick", path]) == 0


@pytest.mark.parametrize(
    ("blocks", "says"),
    [
        (TILES, "nearly none of its 200000 x 100000 pixels was ever written"),
        ({}, "nearly none of its 200000 x 100000 pixels was ever written"),
        (
            TILES | {"blockxsize": 16384, "blockysize": 16384},
            "is stored in blocks of 16384 x 16384",
        ),
    ],
    ids=["tiles", "strips", "large tiles"],
)
def test_a_sparse_file_is_refused_before_it_is_read(
    blocks: dict[str, object], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file of 2 kB to 1.2 MB kept these commands busy for many minutes."""
    path = str(_sparse(tmp_path / "sparse.tif", 200_000, 100_000, blocks))
    began = time.monotonic()
    assert run(["dem", "info", path]) == 1
    assert says in capsys.readouterr().err
    assert run(["dem", "check", path]) == 4
    assert says in capsys.readouterr().out
    with pytest.raises((DemError, AlbedoError), match=says):
        AlbedoMap.open(path)
    assert time.monotonic() - began < 30.0


def test_windows_go_through_large_blocks_one_after_the_other(tmp_path: Path) -> None:
    path = _sparse(tmp_path / "x.tif", 10_000, 5_000, TILES)
    seen, blocks = np.zeros((5_000, 10_000), np.uint8), list[tuple[int, int]]()
    for row0, row1, col0, col1 in Dem.open(path).raster.windows():
        seen[row0:row1, col0:col1] += 1
        blocks += [(row0 // 4096, col0 // 4096)]
        assert (row1 - row0) * (col1 - col0) <= 4_000_000
        assert (row1 - 1) // 4096 == row0 // 4096
        assert (col1 - 1) // 4096 == col0 // 4096
    assert (seen == 1).all()
    assert sum(one != other for one, other in itertools.pairwise(blocks)) == 5


@pytest.mark.slow
@pytest.mark.parametrize(("sent", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_long_reading_ends_with_a_signal(
    sent: signal.Signals,
    code: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(raster, "_PACKED", 1e12)
    path = _sparse(tmp_path / "sparse.tif", 240_000, 120_000, TILES)
    timer = threading.Timer(1.0, os.kill, (os.getpid(), sent))
    timer.start()
    began = time.monotonic()
    assert run(["dem", "check", str(path)]) == code
    timer.join()
    assert time.monotonic() - began < 30.0  # all of it takes many minutes
    assert capsys.readouterr().err.strip().count("\n") == 0


def test_a_block_that_no_memory_holds_is_refused(tmp_path: Path) -> None:
    path = _sparse(
        tmp_path / "x.tif", 30_000, 20_000, TILES | {"blockxsize": 30_000, "blockysize": 20_000}
    )
    with pytest.raises(DemError, match="blocks of 30000 x 20000 pixels"):
        Dem.open(vrt(tmp_path / "x.vrt", "x.tif"))
    with pytest.raises(DemError, match="blocks of 30000 x 20000 pixels"):
        Dem.open(path)


@pytest.mark.parametrize("link", [None, os.link, os.symlink])
def test_an_output_is_none_of_the_files_behind_an_input(
    link: Callable[[Path, Path], None] | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, output = two(tmp_path), tmp_path / "dem.tif"
    if link is not None:
        output = tmp_path / "other.tif"
        link(tmp_path / "dem.tif", output)
    before = (tmp_path / "dem.tif").read_bytes()
    sun = ["--sun-azimuth", "90", "--sun-elevation", "20", "--overwrite"]
    assert run(["render", str(path), "-o", str(output), *sun]) == 2
    assert "is the same file as" in capsys.readouterr().err
    assert (tmp_path / "dem.tif").read_bytes() == before


def test_names_in_the_working_folder_are_followed_to_the_last_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GDAL lists the files behind two virtual rasters, not those behind three; `./two.vrt` was taken for an archive."""
    monkeypatch.chdir(tmp_path)
    tif(Path("dem.tif"))
    for name, source in (("one", "dem.tif"), ("two", "one.vrt"), ("three", "two.vrt")):
        vrt(Path(f"{name}.vrt"), source)
    found = files_beside(Path("three.vrt"))
    assert {path.name for path in found} == {"three.vrt", "two.vrt", "one.vrt", "dem.tif"}
    before = Path("dem.tif").read_bytes()
    words = "render three.vrt -o dem.tif --overwrite --sun-azimuth 90 --sun-elevation 30"
    assert run(words.split()) == 2
    assert Path("dem.tif").read_bytes() == before


def test_an_output_from_python_is_none_of_the_files_behind_an_input(tmp_path: Path) -> None:
    path, output = two(tmp_path), tmp_path / "dem.tif"
    before = output.read_bytes()
    with pytest.raises(OutputError, match="is read, too"):
        lcp.render(path, sun=(90, 20), output=output, overwrite=True)
    assert output.read_bytes() == before


def test_a_map_behind_a_map_of_the_configuration_is_no_output(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    two(tmp_path)
    dem = shutil.copy(tmp_path / "dem.tif", tmp_path / "other.tif")
    (tmp_path / "build.toml").write_text('[model]\nalbedo = "two.vrt"\n')
    command = ["build-catalog", str(dem), "--config", str(tmp_path / "build.toml"), "--overwrite"]
    before = (tmp_path / "dem.tif").read_bytes()
    assert run([*command, "-o", str(tmp_path / "dem.tif")]) == 2
    assert "build.toml" in capsys.readouterr().err
    assert (tmp_path / "dem.tif").read_bytes() == before


def test_a_fresh_process_opens_a_file_first() -> None:
    """A worker opens the files that its parent judged: nothing else has registered GDAL's drivers there."""
    code = f"from lcp_catalog.dem.raster_files import opened; print(opened({str(SAMPLE)!r}, 'a DEM').count)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == ("1\n", 0), done.stderr
