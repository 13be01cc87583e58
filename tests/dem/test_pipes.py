"""Pipes behind labels, beside rasters and in VRTs: nothing waits for their writers."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.small_rasters import ISIS_OF_A_PIPE, tif, vrt
from lcp_cli.signals import stopping_signals

from lcp_catalog import child_process
from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.file_check import CheckResult, check_dem
from lcp_catalog.errors import DemError, ImageError, LabelError
from lcp_catalog.images.pixels import read_pixels

pytestmark = pytest.mark.usefixtures("rasters_apart")

NO_FILE = "which is no plain file on this machine"

PDS3 = """PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = 32
FILE_RECORDS = 8
^IMAGE = "pipe"
OBJECT = IMAGE
  LINES = 8
  LINE_SAMPLES = 8
  SAMPLE_TYPE = PC_REAL
  SAMPLE_BITS = 32
END_OBJECT = IMAGE
END
"""

PDS4 = """<?xml version="1.0"?>
<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1"><File_Area_Observational>
<File><file_name>pipe</file_name></File>
<Array_2D_Image><offset unit="byte">0</offset><axes>2</axes><axis_index_order>Last Index Fastest</axis_index_order>
<Element_Array><data_type>IEEE754LSBSingle</data_type></Element_Array>
<Axis_Array><axis_name>Line</axis_name><elements>8</elements><sequence_number>1</sequence_number></Axis_Array>
<Axis_Array><axis_name>Sample</axis_name><elements>8</elements><sequence_number>2</sequence_number></Axis_Array>
</Array_2D_Image></File_Area_Observational></Product_Observational>
"""


def _label(name: str, text: str) -> Callable[[Path], Path]:
    """A label whose data file is a pipe."""

    def make(folder: Path) -> Path:
        os.mkfifo(folder / "pipe")
        (folder / name).write_text(text)
        return folder / name

    return make


def _beside(*names: str) -> Callable[[Path], Path]:
    """A GeoTIFF with a pipe of this name beside it."""

    def make(folder: Path) -> Path:
        for name in names:
            os.mkfifo(folder / name)
        return tif(folder / "dem.tif")

    return make


def bare_image(folder: Path) -> Path:
    """Samples whose labels are pipes."""
    for name in ("x.LBL", "x.XML"):
        os.mkfifo(folder / name)
    (folder / "x.img").write_bytes(bytes(256))
    return folder / "x.img"


def named_by_vrt(folder: Path) -> Path:
    return vrt(folder / "x.vrt", _label("x.cub", ISIS_OF_A_PIPE)(folder).name)


TAKES = "opening it takes more than 1 s of processor time .* may be a pipe or a device"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "open_it", "says"),
    [
        (_label("x.cub", ISIS_OF_A_PIPE), Dem.open, TAKES),
        (_label("x.cub", ISIS_OF_A_PIPE), read_pixels, TAKES),
        (_label("x.lbl", PDS3), read_pixels, TAKES),
        (_label("x.xml", PDS4), read_pixels, TAKES),
        (named_by_vrt, Dem.open, f"x.cub: {TAKES}"),
        (_beside("dem.IMD", "dem.RPB", "dem.XML"), Dem.open, TAKES),
        (_beside("dem.tif.Aux.xml", "dem.tif.Msk"), Dem.open, TAKES),
        (_beside("dem.tif.ovr"), Dem.open, NO_FILE),
        (_beside("dem.LBL"), lambda path: _refused(check_dem(path)), "dem.LBL: is a pipe"),
        (bare_image, Dem.open, "x.XML: is a pipe or a device; only plain files are read"),
        (bare_image, read_pixels, NO_FILE),
    ],
)
def test_nothing_waits_for_the_writer_of_a_pipe(
    make: Callable[[Path], Path],
    open_it: Callable[[Path], object],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(child_process, "_WALL_FACTOR", 3.0)  # a busy machine starts it in 1 s
    path = make(tmp_path)
    timer = threading.Timer(60.0, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with (
        stopping_signals(),
        pytest.raises((DemError, ImageError, LabelError), match=says) as caught,
    ):
        open_it(path)
    timer.cancel()
    assert "\n" not in str(caught.value)


def _refused(found: CheckResult) -> None:
    if not found.sound:
        raise DemError(found.problems[0])


def test_a_pipe_that_no_file_names_is_no_hindrance(tmp_path: Path) -> None:
    """Other programs' pipes stand in the same folder, and those that GDAL does not open."""
    dem = Dem.open(_beside("other", "dem.tfw", "dem.lock")(tmp_path))
    assert dem.read(0, 1, 0, 1)[0, 0] == 100.0
