"""Small inputs, and one or more runs of every command of `lcp` on them: for tests of damaged inputs, and for system
calls that fail (`benchmarks/faults/calls.py`).
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lcp_cli.main import run

from lcp_catalog.cameras.sensor import POSE
from lcp_catalog.cameras.spice import SpiceCamera, loaded
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.choices import EXPORTS
from lcp_catalog.exports.export import export
from lcp_catalog.geometry.frames import EnuFrame, lonlat_to_mcmf

from . import (
    archive_files,
    catalogs,
    ccsds_files,
    merges,
    navigable,
    posed,
    products,
    real_heights,
    spice_kernels,
    twins_match,
)

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
DEM = catalogs.HADLEY

BUILD = """\
area = { center_deg = [3.5, 26.0], size_km = 25.0, gsd_m = 474.0 }
sun = { azimuths_deg = [90.0, 270.0], elevations_deg = [10.0, 30.0] }
view = { off_nadir_deg = [0.0], azimuth_deg = [0.0], altitude_km = [inf] }
points = { patch_nodes = 17, search_m = 5000.0 }
model = { accuracy = "draft", direction_tolerance_deg = 1.0, ring_max_km = 20.0 }
"""


@dataclass(frozen=True)
class Words:
    """Words of a command, inputs that they do not name, and the words that a next try has besides. ``together``: its
    files appear together or not at all. ``verdict``: it says with exit code 4 that a file is damaged.
    """

    line: str
    others: tuple[str, ...] = ()
    again: str = "--overwrite"
    together: bool = False
    verdict: bool = False

    def inputs(self, folder: Path) -> dict[str, bytes]:
        """Its input files by name."""
        names = [*self.line.split(), *self.others]
        return {name: (folder / name).read_bytes() for name in names if (folder / name).is_file()}


SUN = "--sun-azimuth 100 --sun-elevation 17"
_BUILD = "build-catalog dem.tif --config build.toml -o x.h5"
_KERNELS = (*spice_kernels.TEXTS, "orbiter.bsp", "orbiter.bc")
_MISSION = "--kernels META.tm --observer MY_ORBITER --instrument MY_CAMERA"
_RENDER = f"render dem.tif -o r.tif --center 3.5 26 --size 8 --gsd 474 {SUN}"
COMMANDS = {
    "sample": Words("sample folder"),
    "dem info": Words("dem info dem.tif LDEM_64.LBL --json", ("LDEM_64.IMG",), ""),
    "dem info --map": Words("dem info dem.tif --map map.png"),
    "dem check": Words("dem check dem.tif LDEM_64.IMG", ("LDEM_64.LBL",), "", verdict=True),
    "camera info": Words("camera info camera.json --catalog usable.h5 --dem dem.tif --plot c.svg"),
    "camera from-spice": Words(f"camera from-spice {_MISSION} --time 2026-03-01T00:07:33 -o cam.json", _KERNELS),
    "camera from-ccsds": Words(
        "camera from-ccsds --oem o.oem --aem a.aem --camera posed.json --kernels moon.tpc moon.tf "
        "--time 2026-03-01T00:00:33 -o cam.json"
    ),
    "camera export .json": Words("camera export posed.json --report located.json -o out.json"),
    **{
        f"camera export {ending}": Words(f"camera export posed.json --report located.json {_MISSION} -o out{ending}", _KERNELS)
        for ending in (".bsp", ".bc")
    },
    "render": Words(f"{_RENDER} --preview p.png --depfile r.d"),
    "sun": Words("sun --center 3.5 26 --dem dem.tif --gsd 474 --time 2026-01-27T02:00:00", again=""),
    "build-catalog": Words(f"{_BUILD} --jobs 1", again="--resume --overwrite"),
    "build-catalog --jobs 2": Words(f"{_BUILD} --jobs 2", again="--resume --overwrite"),
    "inspect": Words("inspect full.h5", again="", verdict=True),
    "inspect .lcpf": Words("inspect site.lcpf", again="", verdict=True),
    "report": Words("report full.h5 -o r.html"),
    "report --dossier": Words(f"report usable.h5 -o r.html --dossier --camera camera.json {SUN}"),
    "diff": Words("diff west.h5 east.h5 -o d.csv"),
    **{f"export {ending}": Words(f"export plain.h5 -o out{ending}", together=True) for ending in EXPORTS},
    "export .csv": Words("export full.h5 -o out.csv", together=True),
    "help": Words("help export", again=""),
    "flight-source": Words("flight-source -o src"),
    "merge": Words("merge west.h5 east.h5 -o m.h5"),
    "validate": Words("validate patches.h5 frame.png --camera frame.json --dem dem.tif --attitude-sigma 0 -o v"),
    "fit-reflectance": Words("fit-reflectance paint.csv -o paint.toml --chart paint.svg"),
    "query": Words(f"query usable.h5 --camera camera.json -o q.csv {SUN}"),
    "query --trajectory": Words(f"query usable.h5 --trajectory way.csv --camera camera.json --plot q.svg --json {SUN}"),
    "windows": Words("windows usable.h5 --center 3.5 26 --range 2026-01-27 2026-01-29 12h", again=""),
    "simulate": Words("simulate dem.tif --camera frame.json --sun point --gsd 474 -o f.png"),
    "trade": Words("trade dem.tif --config build.toml -o t --areas 1 --rounds 1 --time-limit 0"),
}  # fmt: skip
"""By name: the command, and what it is about where there are several of it."""


def prepare(folder: Path, names: Iterable[str] = COMMANDS) -> None:
    """Write the inputs of the commands with these names, and some more."""
    products.cylinder(folder / "dem.tif", 2.25, 27.25, (160, 160), 64, real_heights.hadley)
    frame = archive_files.cylinder_frame(2.25, 27.25, 160, 160, 64, 180.0)
    scale = {"MAP_RESOLUTION": 64, "MAP_SCALE": f"{frame.pixel_m:.6g}"}
    text = archive_files.archive_text("LDEM_128.LBL").replace("LDEM_128", "LDEM_64")
    archive_files.img_product(
        folder, "LDEM_64", "LDEM_64", text, frame, real_heights.hadley, False, **scale
    )
    (folder / "build.toml").write_text(BUILD)
    write_catalog(catalogs.full(2), folder / "full.h5")
    write_catalog(catalogs.catalog(2), folder / "plain.h5")
    export(folder / "full.h5", folder / "site.lcpf")
    every = merges.whole(9)
    for name, (west, east) in {"west": (2.1, 3.7), "east": (3.3, 4.9)}.items():
        write_catalog(merges.part(every, west, east), folder / f"{name}.h5")
    write_catalog(navigable.everywhere_usable(9), folder / "usable.h5")
    words = {word for name in names for word in COMMANDS[name].line.split()}
    if words & {"camera.json", "frame.json", "way.csv"}:
        _frames(folder)
    if words & {"META.tm", "posed.json"}:
        _mission(folder)
    shutil.copy(SAMPLE / "goniometer_synthetic.csv", folder / "paint.csv")


def _mission(folder: Path) -> None:
    """SPICE kernels, CCSDS messages, a camera of them, and the report of an image that it took."""
    meta = spice_kernels.mission(folder)
    camera = SpiceCamera("MY_ORBITER", "MY_CAMERA", meta).at(spice_kernels.TIME)
    with loaded(meta):
        ccsds_files.oem(folder / "o.oem")
        ccsds_files.aem(folder / "a.aem", "MY_CAMERA")
    spice_kernels.meta_kernel(folder, ".")
    (folder / "posed.json").write_text(json.dumps(camera.to_json()))
    report = {"images": [{"pose": {"correction": dict.fromkeys(POSE, 0.0)}}]}
    (folder / "located.json").write_text(json.dumps(report))


def _frames(folder: Path) -> None:
    """A camera, a trajectory, and a simulated frame with its camera and the catalogue of its points."""
    above = [posed.camera(EnuFrame(lon, 26.0)) for lon in (3.0, 4.0)]
    (folder / "camera.json").write_text(json.dumps(above[0].to_json()))
    lines = ["time_utc,x_m,y_m,z_m,r11,r12,r13,r21,r22,r23,r31,r32,r33"]
    for k, one in enumerate(above):
        numbers = [*one.position_mcmf_m, *one.rotation_mcmf_to_camera.ravel()]
        lines.append(f"2026-01-27T02:00:0{k}," + ",".join(map(repr, map(float, numbers))))
    (folder / "way.csv").write_text("\n".join(lines) + "\n")
    centre, along = (3.6, 26.1), np.linspace(-0.3, 0.3, 4)
    lon, lat = (grid.ravel() for grid in np.meshgrid(centre[0] + 1.1 * along, centre[1] + along))
    write_catalog(twins_match.catalog_of_dem(lon, lat, 33, 118.45, DEM), folder / "patches.h5")
    camera = twins_match.looking_at(
        EnuFrame(*centre, -1500.0), 60e3, 12.0, 250.0, 35.0, 300.0, (120, 110)
    )
    sun = 1.5e11 * lonlat_to_mcmf(centre[0] + 65.0, 1.0) / 1737400.0
    (folder / "frame.json").write_text(
        json.dumps(camera.to_json() | {"sun_position_mcmf_m": sun.tolist()})
    )
    words = f"simulate {DEM} --camera {folder / 'frame.json'} -o {folder / 'frame.png'} --sun point --gsd 237 --accuracy draft"
    if code := run(words.split()):
        raise SystemExit(f"the frame cannot be simulated: exit {code}")
