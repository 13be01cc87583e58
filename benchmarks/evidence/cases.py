"""The photographs: their files, cameras, Suns, DEMs and catalogues.

A case says what the validation is told. Apollo 15 frames get a camera 5 km and 0.5 deg from the one that is known, in random
directions; maps get an uncertainty larger than the displacement of their control net.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import rasterio
from pyproj import CRS, Transformer
from rasterio.windows import Window

from benchmarks.evidence.catalogues import (
    ALBEDO,
    LAW,
    SERIES_TOML,
    Build,
    built,
    by_command,
    opened,
    to_sun,
)
from benchmarks.evidence.dequantise import smooth_terraces
from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.geometry.frames import mcmf_to_lonlat
from lcp_catalog.images.image import Image
from lcp_catalog.images.image_file import open_image
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.matching.pose import Pose, position_error
from lcp_catalog.validation.run import ImageFiles
from tests.helpers import apollo_maps, located_frames, pit_pair
from tests.helpers.apollo_frames import SERIES, series_keys
from tests.helpers.twins_isd import isd_of_cube

HADLEY = "apollo15-metric-hadley"
NEEDED = (
    f"images/{HADLEY}",
    "images/apollo15-metric-farside",
    f"images/{SERIES}",
    "images/nac-tranqpit1-pair",
    "images/nac-m143947267l-spice",
    "images/kaguya-tc-marius",
    "dem/gld100",
    "dem/lola-polar",
    ALBEDO,
)
"""Folders and files of the shared lunar data that are read."""

NASA = "photograph: NASA, public domain"
APOLLO_16 = "photograph: NASA; map: PhotometryTK, NOSA 1.3, not for distribution"
FAR = Uncertainty(located_frames.OFF_M, located_frames.OFF_RAD)
PIT_TOML = """[errors]
height_sigma_m = 0.15
height_length_m = 6.0
position_sigma_m = 0.5
"""
"""Errors of the NAC DTM: its rounding to 0.467 m (rms 0.152 m of the smoothed surface), and its resolution."""
PIT_OPTIONS = ("--gsd", "2", "--sun-azimuths", "260,275", "--sun-elevations", "45,53,60", "--view", "0:0",
               "--search", "0.034", "--spacing", "0.03")  # fmt: skip
PIT_SIGMA_M = 5.0
PIT_APART_M = 2.0
"""The two files of the NAC pair agree to this (docs/measurements/evidence.md, registration)."""

MARE_OPTIONS = """--bounds -57.8 7 -56 19.2 --gsd 237 --spacing 2 --footprint 30 --located-probability 0.99
    --sun-azimuths 60,75,90,105,120 --sun-elevations 15,20,30,45"""
MARE_SIGMA_M = 500.0
MARE_NORTH_M = 350.0
"""The strips' ground lies so far north of GLD100's, and at its longitude: median of the four that single points locate (334 to
403 m). One displacement holds for all: strips of the one orbit overlap by 6 km and agree there to half a pixel, 25 m.
"""
POLAR = {
    "WAC mosaic 0 E 75.5 S": (0.0, -75.5, 301.0),
    "WAC mosaic 45 E 75.9 S": (45.0, -75.9, 345.0),
}
"""Parts of the mosaic: longitude and latitude of the middle, longitude of the subsolar point (found by hill shading)."""
POLAR_OPTIONS = """--size 240 --gsd 1600 --spacing 12 --view 0:0 --albedo none
    --sun-azimuths 280,290,300,310,320 --sun-elevations 3,5,8,11,15"""
POLAR_PX, POLAR_SIGMA_M = 500, 3000.0


@dataclass(frozen=True)
class Case:
    """A photograph: its files, what is said of it, the DEM, the catalogue (a function that builds it), and the kind under which
    its claims are scored.
    """

    name: str
    files: ImageFiles
    uncertainty: Uncertainty
    dem: Path
    catalog: Callable[[], Path | None]
    licence: str
    kind: str
    sun: SunChoice = field(default_factory=SunChoice)
    albedo: bool = True
    encoding: str = "srgb"
    off_m: Callable[[Pose], float] | None = None  # distance from the known place
    truth: str = ""  # what that place is
    known: bool = False  # claims are tried at the given place, located or not


def chosen(data: Path, folder: Path, only: Sequence[str] = ("",)) -> list[Case]:
    """Photographs whose names begin with one of the words. SystemExit if files are missing."""
    missing = [name for name in NEEDED if not (data / name).exists()]
    if missing:
        raise SystemExit(
            f"{data}: has no {', '.join(missing)}: give the folder of the lunar data by --data or LCP_SHARED_DATA"
        )
    return [case for case in cases(data, folder) if case.name.startswith(tuple(only))]


def cases(data: Path, folder: Path) -> Iterator[Case]:
    """All photographs of the data; cameras, DEMs and catalogues that are made go to the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in located_frames.FRAMES:
        yield framed(data, folder, name)
    yield from close_up(data, folder)
    yield from pit(data, folder)
    yield calibrated_crop(data, folder)
    for name in series_keys(data):
        yield mapped(data, folder, name)
    yield terminator(data, folder)
    yield from mare(data, folder)
    yield from polar(data, folder)


# -- Apollo 15 with a camera


def framed(data: Path, folder: Path, name: str) -> Case:
    photo, files, dem = opened(data, name)
    return _displaced(data, folder, name, photo, files, dem, Build())


def close_up(data: Path, folder: Path) -> Iterator[Case]:
    """A part of AS15-M-1134 in pixels of 40 m, a third of the DEM's posting: displaced as the frames, and with its own camera
    known to 300 m.
    """
    place = data / "images" / HADLEY
    known = place / "AS15-M-1134_sub4crop_256ppd_camera.json"
    files = ImageFiles(place / "sub4-AS15-M-1134_crop.png", known)
    photo = open_image(files.image, read_camera(known))
    dem = place / located_frames.HADLEY.dem
    build = Build(237.0, 4.0)
    far = _displaced(data, folder, "AS15-M-1134 crop (5 km)", photo, files, dem, build)
    yield far
    yield replace(
        far, name="AS15-M-1134 crop (0.3 km)", files=files, uncertainty=Uncertainty(300.0)
    )


def _displaced(
    data: Path, folder: Path, name: str, photo: Image, files: ImageFiles, dem: Path, build: Build
) -> Case:
    known, other = photo.sensor, located_frames.displaced(photo, 0).sensor
    if not (isinstance(known, Camera) and isinstance(other, Camera)):
        raise TypeError(f"{name}: not the frame of a camera")
    camera = folder / f"{files.image.stem}_displaced_camera.json"
    told = replace(other, sun_position_mcmf_m=known.sun_position_mcmf_m)
    camera.write_text(json.dumps(told.to_json()), encoding="utf-8")
    path = folder / f"{files.image.stem}.h5"
    return Case(
        name,
        ImageFiles(files.image, camera),
        FAR,
        dem,
        lambda: built(path, photo, dem, data, build),
        NASA,
        "Apollo 15 frames",
        off_m=lambda pose: position_error(pose, known).error.whole_m,
        truth="position of NASA's table",
    )


# -- maps


def mapped(data: Path, folder: Path, name: str) -> Case:
    photo, files, dem = opened(data, name)
    net = np.array(apollo_maps.NET_M)
    return Case(
        name,
        files,
        apollo_maps.UNCERTAIN,
        dem,
        lambda: built(folder / "series.h5", photo, dem, data, Build()),
        APOLLO_16,
        "Apollo 16 maps",
        SunChoice(subsolar_deg=_subsolar(photo)),
        off_m=lambda pose: float(np.linalg.norm(pose.correction - net)),
        truth="median of the series, whose own spread is 300 m",
    )


def terminator(data: Path, folder: Path) -> Case:
    """AS15-M-0073: the Sun 4 deg high, 71 % masked, and a DEM of 1.9 km only."""
    name = "AS15-M-0073"
    image = data / "images" / SERIES / "DIM_input_1280mpp_masked" / f"{name}.tif"
    photo = apollo_maps.frame(data, name)
    dem = data / "dem" / "gld100" / "gld100_016ppd_global.tif"
    config = folder / "terminator.toml"
    config.write_text(SERIES_TOML, encoding="utf-8")
    with rasterio.open(image) as file:
        bounds = [f"{value:.3f}" for value in file.bounds]
    options = ["--bounds", *bounds, "--gsd", "1895", "--spacing", "15", "--config", str(config)]
    options += ["--sun-azimuths", "80,90,100", "--sun-elevations", "2,5,8", "--view", "0:0"]
    return Case(
        name,
        ImageFiles(image),
        apollo_maps.UNCERTAIN,
        dem,
        partial(by_command, folder / f"{name}.h5", dem, options),
        APOLLO_16,
        "Apollo 16 maps",
        SunChoice(subsolar_deg=_subsolar(photo)),
    )


def _subsolar(photo: Image) -> tuple[float, float]:
    lon, lat, _ = (float(value) for value in mcmf_to_lonlat(to_sun(photo)))
    return lon, lat


def mare(data: Path, folder: Path) -> Iterator[Case]:
    """Kaguya's strips over Marius: orthophotos of another DEM, moved to GLD100's ground; only their claims are tried, at that
    place. The catalogue keeps weak points, too.
    """
    place = data / "images" / "kaguya-tc-marius"
    geometry = json.loads((place / "geometry.json").read_text(encoding="utf-8"))
    (dem,) = place.glob("gld100_*.tif")
    for image in sorted(place.glob("TC1*.tif")):
        yield Case(
            f"{image.stem} (TC)",
            ImageFiles(_moved_south(image, folder / image.name)),
            Uncertainty(MARE_SIGMA_M),
            dem,
            partial(by_command, folder / "mare.h5", dem, MARE_OPTIONS.split()),
            "JAXA; file: lunadem, CC0",
            "Kaguya mare",
            SunChoice(subsolar_deg=tuple(geometry[image.stem]["subsolar_lon_lat_deg"])),
            albedo=False,
            encoding="linear",
            known=True,
        )


def _moved_south(image: Path, out: Path) -> Path:
    """A copy of a map whose ground is that of GLD100."""
    if not out.exists():
        with rasterio.open(image) as file:
            moved = rasterio.Affine.translation(0.0, -MARE_NORTH_M) @ file.transform
            profile, values = file.profile | {"transform": moved}, file.read()
        with rasterio.open(out, "w", **profile) as file:
            file.write(values)
    return out


def polar(data: Path, folder: Path) -> Iterator[Case]:
    """Two parts of the WAC's mosaic of the south, each of a time of its own, on LOLA's heights of 1600 m."""
    place = data / "dem" / "lola-polar"
    dem = place / "lola_dem_south.tif"
    for name, (lon, lat, subsolar) in POLAR.items():
        image = folder / f"{name}.tif"
        if not image.exists():
            _cut(place / "wac_mosaic_south_400m.tif", image, (lon, lat))
        options = [*POLAR_OPTIONS.split(), "--center", f"{lon:g}", f"{lat:g}", "--reflectance", LAW]
        yield Case(
            name,
            ImageFiles(image),
            Uncertainty(POLAR_SIGMA_M),
            dem,
            partial(by_command, folder / f"{name}.h5", dem, options),
            "NASA/GSFC/Arizona State University; file: lunar-toolkit, BSD-3",
            "polar LOLA",
            SunChoice(subsolar_deg=(subsolar, -0.5)),
            albedo=False,
        )


def _cut(mosaic: Path, out: Path, place_deg: tuple[float, float]) -> None:
    """A square of a mosaic around a place."""
    with rasterio.open(mosaic) as file:
        sphere = CRS.from_user_input(file.crs).geodetic_crs
        x, y = Transformer.from_crs(sphere, file.crs, always_xy=True).transform(*place_deg)
        row, col = file.index(x, y)
        window = Window(col - POLAR_PX // 2, row - POLAR_PX // 2, POLAR_PX, POLAR_PX)
        profile = file.profile | {"driver": "GTiff", "height": POLAR_PX, "width": POLAR_PX}
        profile |= {"transform": file.window_transform(window)}
        values = file.read(window=window)
    with rasterio.open(out, "w", **profile) as file:
        file.write(values)


# -- LROC NAC


def pit(data: Path, folder: Path) -> Iterator[Case]:
    """The pair of the pit in Mare Tranquillitatis, with the default uncertainty and with one of 5 m."""
    place = data / pit_pair.PAIR
    dem = folder / "pit_dtm.tif"
    if not dem.exists():
        heights, crs, transform = pit_pair.dtm(place)
        smooth = smooth_terraces(heights, pit_pair.STEP_M).heights_m
        pit_pair.write_dem(dem, smooth, (crs, transform))
    config = folder / "pit.toml"
    config.write_text(PIT_TOML, encoding="utf-8")
    options = [*PIT_OPTIONS, "--config", str(config)]
    plain = Case(
        "M152662021 (NAC, 1 km)",
        ImageFiles(place / "tranqpit1_ortho_M152662021_0p5m.tif"),
        Uncertainty(1000.0),
        dem,
        partial(by_command, folder / "pit.h5", dem, options),
        "NASA/GSFC/Arizona State University; files: gazebo_models, CC BY 3.0",
        "NAC",
        pit_pair.pit_sun(place),
        albedo=False,
        encoding="linear",
        off_m=lambda pose: float(np.linalg.norm(pose.correction)),
        truth=f"the files agree to {PIT_APART_M:g} m",
    )
    yield replace(
        plain, name=f"M152662021 (NAC, {PIT_SIGMA_M:g} m)", uncertainty=Uncertainty(PIT_SIGMA_M)
    )
    yield plain


def calibrated_crop(data: Path, folder: Path) -> Case:
    """M143947267L: 230 m of ground, two cells of the only DEM."""
    place = data / "images" / "nac-m143947267l-spice"
    cube = place / "M143947267L.cal.echo.crop.cub"
    with rasterio.open(cube) as file:
        ((key, value),) = file.tags(ns="json:ISIS3").items()
        lines, samples = file.shape
    camera = folder / "M143947267L_isd.json"
    isd = isd_of_cube(cube, json.loads(f"{key}:{value}"), lines, samples)
    camera.write_text(json.dumps(isd), encoding="utf-8")
    dem = data / "dem" / "gld100" / "gld100_256ppd_giordano-bruno_lat33-39_lon099-107.tif"
    options = ["--center", "102.6154", "35.98025", "--size", "30", "--spacing", "4"]
    options += ["--sun-azimuths", "120,130", "--sun-elevations", "30,37,45", "--view", "0:0"]
    return Case(
        "M143947267L (NAC)",
        ImageFiles(cube, camera),
        Uncertainty(1000.0),
        dem,
        partial(by_command, folder / "bruno.h5", dem, options),
        "NASA/GSFC/Arizona State University; file: USGS ISIS, CC0",
        "NAC",
        SunChoice(time_utc="2010-11-09T13:06:46"),
        albedo=False,
        encoding="linear",
    )
