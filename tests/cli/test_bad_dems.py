"""Bad DEM input through the commands: one clear line that names the file, exit code 1, nothing written."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers import archive_products, products
from helpers.archive_files import Product
from helpers.products import cut, geotiff
from lcp_cli.main import run
from rasterio.transform import Affine


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Product]:
    folder = tmp_path_factory.mktemp("products")
    found = [
        *archive_products.cylindrical_products(folder),
        *archive_products.polar_products(folder),
        *archive_products.nac_products(folder),
    ]
    return {product.image.name: product for product in found}


def label_with(image: str, **changes: object) -> Callable[[dict[str, Product], Path], Path]:
    """A product whose label says something else."""

    def make(made: dict[str, Product], folder: Path) -> Path:
        copies = [Path(shutil.copy(path, folder)) for path in made[image].opened_by]
        text = copies[0].read_bytes().decode("latin-1")
        copies[0].write_bytes(cut(text, **changes).encode("latin-1"))
        return copies[0]

    return make


def label_without(image: str, *patterns: str) -> Callable[[dict[str, Product], Path], Path]:
    """A product from whose label some text is taken away."""

    def make(made: dict[str, Product], folder: Path) -> Path:
        copies = [Path(shutil.copy(path, folder)) for path in made[image].opened_by]
        text = copies[0].read_bytes().decode("latin-1")
        for pattern in patterns:
            text, count = re.subn(pattern, "", text, flags=re.M)
            assert count
        copies[0].write_bytes(text.encode("latin-1"))
        return copies[0]

    return make


def with_file(
    image: str, ending: str, change: Callable[[bytes], bytes | None]
) -> Callable[[dict[str, Product], Path], Path]:
    """A product one of whose files is changed, or taken away; the other one is given."""

    def make(made: dict[str, Product], folder: Path) -> Path:
        copies = [Path(shutil.copy(path, folder)) for path in made[image].opened_by]
        (path,) = [path for path in copies if path.suffix == ending]
        data = change(path.read_bytes())
        if data is None:
            path.unlink()
        else:
            path.write_bytes(data)
        return next(other for other in copies if other != path)

    return make


def file_of(name: str, data: bytes | None) -> Callable[[dict[str, Product], Path], Path]:
    def make(made: dict[str, Product], folder: Path) -> Path:
        path = folder / name
        path.mkdir() if data is None else path.write_bytes(data)
        return path

    return make


def _pipe(made: dict[str, Product], folder: Path) -> Path:
    path = folder / "dem.tif"
    os.mkfifo(path)
    return path


def tif(
    crs: str | None = products.EQC,
    affine: Affine | None = None,
    bands: int = 1,
    dtype: str = "int16",
) -> Callable[..., Path]:
    def make(made: dict[str, Product], folder: Path) -> Path:
        path = folder / "x.tif"
        profile = {"driver": "GTiff", "count": bands, "dtype": dtype, "width": 40, "height": 40}
        where = affine or Affine(100.0, 0, 0, 0, -100.0, 4000.0)
        with rasterio.open(path, "w", **profile, crs=crs, transform=where) as dataset:
            dataset.write(np.ones((bands, 40, 40), dtype))
        return path

    return make


CASES: dict[str, tuple[Callable[[dict[str, Product], Path], Path], str]] = {
    "label-of-another-size": (label_with("LDEM_64.IMG", LINES=61, LINE_LAST_PIXEL=61), "cut short; fetch it again"),
    "label-of-fewer-lines": (
        label_with("LDEM_64.IMG", LINES=59, LINE_LAST_PIXEL=59, FILE_RECORDS=59),
        "144 more than its label LDEM_64.LBL states",
    ),
    "jp2-of-another-size": (label_with("LDEM_64.JP2", LINES=61), "60 x 72 pixels where its label"),
    "tif-of-another-size": (label_with("NAC_DTM_APOLLO15.TIF", LINES=61), "60 x 72 pixels where its label"),
    "truncated-img": (with_file("LDEM_64.IMG", ".IMG", lambda data: data[:-1]), "cut short; fetch it again"),
    "truncated-jp2": (with_file("LDEM_64.JP2", ".JP2", lambda data: data[:-50]), "truncated"),
    "image-missing": (with_file("LDEM_64.IMG", ".IMG", lambda data: None), "LDEM_64.IMG, is not beside it; put it there"),
    "label-missing": (with_file("LDEM_64.IMG", ".LBL", lambda data: None), "its label LDEM_64.LBL is missing"),
    "jp2-label-missing": (with_file("LDEM_64.JP2", ".LBL", lambda data: None), "its label LDEM_64_JP2.LBL is missing"),
    "map-scale-without-unit": (
        label_without("LDEM_80S_20M.IMG", r"^ MAP_RESOLUTION.*\n", " <m/pix>"),
        "MAP_SCALE has no unit and there is no MAP_RESOLUTION: metres or kilometres",
    ),
    "scaling-factor-without-unit": (
        label_without("LDEM_64.IMG", r"^ +UNIT .*\n", r"^ +OFFSET .*\n"),
        "SCALING_FACTOR has no UNIT, and no OFFSET shows it: metres or kilometres",
    ),
    "neither-scale-nor-resolution": (
        label_without("LDEM_64.IMG", r"^ MAP_RESOLUTION.*\n", r"^ MAP_SCALE.*\n"),
        "neither MAP_RESOLUTION nor MAP_SCALE",
    ),
    "unknown-unit": (label_with("LDEM_64.IMG", UNIT="FEET"), "unit <FEET>"),
    "rotated-label": (label_with("LDEM_80S_20M.IMG", MAP_PROJECTION_ROTATION="45.0"), "rotated by 45 deg"),
    "oblique-label": (label_with("LDEM_80S_20M.IMG", CENTER_LATITUDE="-85"), "oblique stereographic"),
    "another-projection": (label_with("LDEM_64.IMG", MAP_PROJECTION_TYPE='"MERCATOR"'), "MERCATOR is not supported"),
    "mars-label": (label_with("LDEM_64.IMG", TARGET_NAME="MARS"), "target is MARS"),
    "radius-of-mars": (label_with("LDEM_64.IMG", A_AXIS_RADIUS="3396.19"), "3396190 m"),
    "radius-in-offset": (label_with("LDEM_64.IMG", OFFSET="1738000."), "OFFSET is 1738000 m"),
    "no-body": (
        label_without("LDEM_64.IMG", r"^TARGET_NAME.*\n", r"^ [ABC]_AXIS_RADIUS.*\n"),
        "neither TARGET_NAME nor A_AXIS_RADIUS",
    ),
    "west-positive": (label_with("LDEM_64.IMG", POSITIVE_LONGITUDE_DIRECTION='"WEST"'), "west-positive longitudes"),
    "offsets-against-bounds": (label_with("LDEM_64.IMG", LINE_PROJECTION_OFFSET=0), "puts the north edge at"),
    "folder": (file_of("folder", None), "is a folder, not a DEM"),
    "pipe": (_pipe, "is not a plain file"),
    "nothing": (lambda made, folder: folder / "none.tif", "there is no such file"),
    "empty-file": (file_of("empty.tif", b""), "not a DEM that can be read"),
    "empty-label": (file_of("empty.LBL", b""), "not a PDS3 label"),
    "empty-img": (file_of("empty.IMG", b""), "its label empty.LBL is missing"),
    "empty-xml": (file_of("empty.xml", b""), "not a DEM that can be read"),
    "text-file": (file_of("notes.txt", b"some notes\n"), "not a DEM that can be read"),
    "label-of-no-map": (file_of("x.LBL", b"PDS_VERSION_ID = PDS3\r\nTARGET_NAME = MOON\r\nEND\r\n"), "IMAGE_MAP_PROJECTION"),
    "binary-label": (file_of("x.LBL", bytes(range(256)) * 9), "not a PDS3 label"),
    "three-bands": (tif(bands=3), "has 3 bands; a DEM has one"),
    "picture": (tif(dtype="uint8"), "8-bit samples are an image, not heights"),
    "no-crs": (tif(crs=None), "no map projection"),
    "rotated-tif": (tif(affine=Affine(70, 70, 0, 70, -70, 4000)), "rotated or sheared"),
    "south-up-tif": (tif(affine=Affine(100, 0, 0, 0, 100, 0)), "north up"),
    "oblong-pixels": (tif(affine=Affine(100, 0, 0, 0, -50, 0)), "square pixels"),
    "earth": (tif(crs="EPSG:32633"), "radii 6378137"),
    "mars-tif": (tif(crs="+proj=eqc +R=3396190"), "radii 3396190"),
    "tilted-map": (tif(crs="+proj=stere +lat_0=45 +R=1737400"), "oblique"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("command", ["info", "render"])
@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_refused_in_one_line(
    case: str,
    command: str,
    made: dict[str, Product],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    make, says = CASES[case]
    inputs, outputs = tmp_path / "in", tmp_path / "out"
    inputs.mkdir()
    outputs.mkdir()
    path = make(made, inputs)
    before = sorted(inputs.iterdir())
    arguments = ["dem", "info", str(path)]
    if command == "render":
        arguments = [
            "render",
            str(path),
            "-o",
            str(outputs / "x.tif"),
            "--preview",
            str(outputs / "x.png"),
        ]
        arguments += ["--sun-azimuth", "90", "--sun-elevation", "20"]
    assert run(arguments) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert err.startswith("lcp: ")
    assert str(inputs) in err
    assert err.count("\n") == 1
    assert "Traceback" not in err
    assert "unexpected" not in err
    assert sorted(inputs.iterdir()) == before
    assert list(outputs.iterdir()) == []


def test_a_good_file_beside_a_bad_one_does_not_help(
    made: dict[str, Product], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = geotiff(tmp_path / "good.tif", np.ones((8, 8), np.int16), 0.0, 800.0, 100.0)
    bad = label_with("LDEM_64.IMG", TARGET_NAME="MARS")(made, tmp_path)
    assert run(["dem", "info", str(good), str(bad)]) == 1
    assert (
        run(["render", str(good), str(bad), "-o", str(tmp_path / "x.tif"), "--time", "2024-01-01"])
        == 1
    )
    assert "target is MARS" in capsys.readouterr().err
    assert not (tmp_path / "x.tif").exists()
