"""Public function that renders an area of the Moon.

A render as the bytes of a file: bands and tags; and the document of an explained plan.

Rendered rasters as GeoTIFF and PNG, encoded in memory; the same input gives the same bytes.

`atomic_files` writes the bytes, so that a full disk raises an error: GDAL ignores some errors when it
closes a file.
"""

from __future__ import annotations

import contextlib
import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import ArrayLike, NDArray
from rasterio import shutil
from rasterio._err import CPLE_BaseError
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import MemoryFile
from rasterio.transform import Affine

from .._version import __version__
from ..accuracy import accuracy as accuracy_of
from ..approximations import SWITCHES
from ..atomic_files import check_output, ending_of, write_bytes
from ..cameras.isd import AnySensor
from ..cameras.public import rendered_sensor
from ..constants import FRAME, MOON_RADIUS_M
from ..dem.public import Dems, dem_set
from ..geometry.frames import EnuFrame
from ..geometry.map_plane import ORTHOGRAPHIC, MapPlane
from ..light.environment import Environment
from ..light.sun_choice import SunChoice, SunStated
from ..photometry.albedo_map import AlbedoMap, ColourMap, open_map
from ..photometry.law_choice import law_of
from ..photometry.laws import Reflectance
from ..terrain.area import Area
from .costs import WITHIN, priced
from .pipeline import prepare
from .renderer import Rendering
from .request import Request, ViewAngles, ViewChoice
from .scene import Scene

TILE = 256
_GAMMA = 1.2
_WHITE_PERCENTILE = 99.5
_NODES = 500


def orthographic_crs(frame: EnuFrame) -> rasterio.CRS:
    """The CRS whose x and y are the frame's east and north, in metres, for points of the reference
    sphere.

    A point at height h has the map position of the sphere's point on the same vertical of the frame,
    not on its own vertical. At d metres from the centre, its longitude and latitude therefore differ
    by about h d / R metres.
    """
    return rasterio.CRS.from_wkt(MapPlane(ORTHOGRAPHIC, frame.lon_deg, frame.lat_deg).wkt)


def node_transform(x0_m: float, y0_m: float, gsd_m: float) -> Affine:
    """The transform of a raster whose pixel (0, 0) has its centre at the node (x0_m, y0_m)."""
    return Affine(gsd_m, 0.0, x0_m - gsd_m / 2, 0.0, -gsd_m, y0_m + gsd_m / 2)


def _name_of(crs: rasterio.CRS | None) -> str:
    """The name of a CRS, empty for none."""
    return crs.to_wkt().partition('"')[2].partition('"')[0] if crs else ""


@contextlib.contextmanager
def _only_memory_is_lacking() -> Iterator[None]:
    """MemoryError for errors of GDAL, which gives a lack of memory many names. No disk is used, so that hardly anything else can
    fail; the error of GDAL is its cause, which a traceback shows.
    """
    try:
        yield
    except (RasterioError, CPLE_BaseError, SystemError) as error:
        raise MemoryError from error


def geotiff(
    bands: Mapping[str, ArrayLike],
    dtype: str,
    tags: Mapping[str, str],
    crs: rasterio.CRS | None = None,
    transform: Affine | None = None,
    units: Sequence[str] | None = None,
    colours: Mapping[str, str] | None = None,
) -> bytes:
    """A cloud-optimised GeoTIFF, compressed with deflate, with named bands of one shape; nodata is NaN.
    Overviews are means; the bands have their statistics as metadata. ``colours``: the colour (red,
    green, blue) of bands that are shown in one. MemoryError where memory is lacking.
    """
    rows, columns = np.shape(next(iter(bands.values())))
    with (
        _only_memory_is_lacking(),
        warnings.catch_warnings(),
        MemoryFile() as plain,
        MemoryFile(ext=".tif") as memory,
    ):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)  # a camera's plane has no CRS
        with plain.open(
            driver="GTiff",
            width=columns,
            height=rows,
            count=len(bands),
            dtype=dtype,
            nodata=np.nan,
            crs=crs,
            transform=transform,
        ) as file:
            for index, (name, band) in enumerate(bands.items(), start=1):
                file.write(np.asarray(band).astype(dtype, copy=False), index)
                file.set_band_description(index, name)
            if units is not None:
                file.units = tuple(units)
            if colours:
                shown = [colours.get(name, "undefined") for name in bands]
                file.colorinterp = tuple(ColorInterp[name] for name in shown)
            file.update_tags(**tags)
        # GDAL would compress overviews twice, first for itself
        with rasterio.Env.from_defaults(COG_TMP_COMPRESSION="NONE"):
            shutil.copy(  # other threads run meanwhile, which say that the command does
                plain.name,
                memory.name,
                driver="COG",
                blocksize=TILE,
                compress="deflate",
                level=1,  # smaller files of floats than the default's, in 0.7 of its time
                predictor="floating_point",
                bigtiff="if_safer",
                overview_resampling="average",
                statistics="yes",
            )
        # GDAL goes on without a text, a number, a CRS, pixels or an overview that lacks memory
        content = bytes(memory.getbuffer())
        with MemoryFile(content) as copy, copy.open() as written:
            kept = [
                dict(tags).items() <= written.tags().items(),
                written.descriptions == tuple(bands),
                crs is None
                or (_name_of(written.crs) == _name_of(crs) and not written.transform.is_identity),
                units is None or written.units == tuple(units),
                bool(written.overviews(1)) == (max(rows, columns) > TILE),
                *(
                    _same_bits(written.read(index), band)
                    for index, band in enumerate(bands.values(), start=1)
                ),
                *(
                    written.tags(index).keys() >= _STATISTICS or bool(np.isnan(band).all())
                    for index, band in enumerate(bands.values(), start=1)
                ),
            ]
        if not all(kept):
            raise MemoryError
        return content


def _same_bits(read: NDArray[Any], band: ArrayLike) -> bool:
    """Whether a band that was read is the one that was written."""
    given = np.ascontiguousarray(band, read.dtype)
    return np.array_equal(read.view(np.uint8), given.view(np.uint8))


_STATISTICS = {
    f"STATISTICS_{name}" for name in ("MAXIMUM", "MEAN", "MINIMUM", "STDDEV", "VALID_PERCENT")
}


def picture(radiance: ArrayLike) -> NDArray[np.uint8]:
    """Values of a radiance for display, in its shape (with a first axis of three: in colour): 0 is
    black, the 99.5th percentile of all lit values is white, gamma 1.2.
    """
    values = np.nan_to_num(np.asarray(radiance, dtype=np.float64), nan=0.0)
    lit = values[values > 0]
    white = np.percentile(lit, _WHITE_PERCENTILE) if lit.size else 1.0
    grey = np.clip(values / white, 0.0, 1.0) ** (1 / _GAMMA)
    return np.round(255 * grey).astype(np.uint8)


def png(values: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """A PNG of 8 or 16 bits: grey (rows, cols), or red, green and blue (3, rows, cols)."""
    planes = values.reshape(-1, *values.shape[-2:])
    count, rows, columns = planes.shape
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        dtype = values.dtype.name
        with memory.open(
            driver="PNG", width=columns, height=rows, count=count, dtype=dtype
        ) as file:
            file.write(planes)
        return bytes(memory.getbuffer())


COLOURS = ("red", "green", "blue")


def encode(scene: Scene, result: Rendering) -> bytes:
    """The GeoTIFF of ``lcp render``."""
    bands: dict[str, ArrayLike] = {
        "radiance": result.radiance,
        "sunlit": result.sunlit,
        "visible": result.visible,
        "incidence": result.incidence_deg,
        "emission": result.emission_deg,
        "phase": result.phase_deg,
    }
    units = ["1", "1", "1", "degree", "degree", "degree"]
    if result.position_mcmf_m is not None:
        bands |= dict(zip("xyz", np.moveaxis(result.position_mcmf_m, -1, 0), strict=True))
        units += ["metre"] * 3
        if result.composite is not None:
            bands["composite"] = result.composite
            units.append("1")
        colours = _add_colours(bands, units, result)
        return geotiff(bands, "float64", tags(scene), units=units, colours=colours)
    assert result.height_m is not None
    placed = georeferenced(scene, result)
    bands["height"] = result.height_m
    units.append("metre")
    colours = _add_colours(bands, units, result)
    return geotiff(bands, "float32", tags(scene), placed.crs, placed.transform, units, colours)


def georeferenced(scene: Scene, result: Rendering) -> Rendering:
    """The result with its frame and, for nodes, transform and CRS."""
    if result.height_m is None or scene.gsd_m is None:
        return replace(result, frame=scene.frame)
    transform = node_transform(*scene.corner_m, scene.gsd_m)
    return replace(
        result, frame=scene.frame, transform=transform, crs=orthographic_crs(scene.frame)
    )


def _add_colours(
    bands: dict[str, ArrayLike], units: list[str], result: Rendering
) -> dict[str, str]:
    """Add the radiance in red, green and blue, if there is one; return the colours of these bands."""
    if result.colour is None:
        return {}
    colours = {f"radiance_{colour}": colour for colour in COLOURS}
    bands |= dict(zip(colours, result.colour, strict=True))
    units += ["1"] * len(colours)
    return colours


def tags(scene: Scene) -> dict[str, str]:
    """The tags of a result; they have no paths and no clock time."""
    frame = scene.frame
    gsd = {} if scene.gsd_m is None else {"gsd_m": repr(float(scene.gsd_m))}
    dems = scene.request.dems
    found = {
        "body": "MOON",
        "frame": FRAME,
        "software": f"lcp {__version__}",
        "center_lon": repr(float(frame.lon_deg)),
        "center_lat": repr(float(frame.lat_deg)),
        "reference_radius_m": repr(MOON_RADIUS_M),
        **gsd,
        "sun_azimuth": repr(scene.sun.azimuth_deg),
        "sun_elevation": repr(scene.sun.elevation_deg),
        "sun_direction_mcmf": json.dumps(frame.direction_to_mcmf(scene.sun).tolist()),
        "camera": json.dumps(scene.view.describe(), sort_keys=True),
        "sun_model": "disc" if scene.light.first.disc is not None else "point",
        "light": json.dumps(scene.light.describe(), sort_keys=True),
        "reflectance": scene.model.name,
        "radiance": scene.model.level,
        "accuracy": scene.request.accuracy.tier,
        "surface": "heightfield" if scene.plan.relief.modelled else "sphere",
        "dem": json.dumps([dem.path.name for dem in dems.dems] if dems is not None else []),
        "scene_plan": str(scene.plan),
    }
    if scene.request.environment is not None:
        found["environment"] = json.dumps(scene.request.environment.report, sort_keys=True)
    return found | ({"albedo": str(scene.request.albedo)} if scene.request.albedo else {})


_SWITCHES = SWITCHES | {"relief": "surface", "float width": "model.accuracy"}
"""The switches of a render, which has more than a build."""


def explain(scene: Scene, costs: Mapping[str, float] | None = None) -> dict[str, Any]:
    """The document of an explained plan: the plan's decisions, each with the parameter or the field of a configuration
    that switches it and its ``cost`` (`costs.priced`); and the light. ``costs``: `stages.shares_of_time` of the scene and its
    image; None: not measured.
    """
    light = scene.light.describe()
    if scene.request.environment is not None:
        light["environment"] = scene.request.environment.report
    within, spent = WITHIN, None if costs is None else dict(costs)
    if spent and scene.plan.solar_disc.modelled and "cast shadows" in spent:
        spent["solar disc"] = spent.pop("cast shadows")
        within = WITHIN | {"cast shadows": "in solar disc"}
    decisions = scene.plan.to_json()["decisions"]
    return {
        "decisions": [priced(one, spent, _SWITCHES, within) for one in decisions],
        "light": light,
    }


def render(
    dem: Dems,
    output: Path | str | None = None,
    *,
    center: tuple[float, float] | None = None,
    size_km: float | None = None,
    bounds: tuple[float, float, float, float] | None = None,
    gsd_m: float | None = None,
    sun: SunStated = None,
    disc: bool | None = None,
    environment: Environment | Path | str | None = None,
    earthshine: bool = False,
    bounce: str = "auto",
    camera: AnySensor | Path | str | None = None,
    camera_plane: bool = False,
    off_nadir_deg: float | None = None,
    view_azimuth_deg: float | None = None,
    altitude_km: float | None = None,
    reflectance: Reflectance | str = "auto",
    albedo: AlbedoMap | ColourMap | Path | str | None = None,
    accuracy: str | None = None,
    tolerance: float | None = None,
    surface: str = "auto",
    product_order: Sequence[str] = (),
    overwrite: bool = False,
) -> Rendering:
    """Render one image of an area of the Moon: radiance factor, sunlit share, visibility and angles,
    for the nodes of the area or the pixels of a camera.

    Parameters
    ----------
    dem:
        DEM files, or an opened set.
    output:
        Also write the image as GeoTIFF, .tif, with the bands of ``lcp render``.
    center, size_km:
        Longitude and latitude of the area's centre, degrees, and its side; None: 500 cells. Without an area:
        what the camera sees, else the whole DEM.
    bounds:
        In their place: west, south, east, north, degrees.
    gsd_m:
        Cell size; None: the DEM's own.
    sun:
        The Sun: its azimuth, degrees clockwise from north, and elevation at the area's centre; or an instant (ISO
        text, UTC); or a `SunChoice`. None: the Sun of the camera's file.
    disc:
        True for the solar disc, False for a point; None: as the accuracy says.
    environment:
        In place of the Sun: an environment map (equirectangular panorama).
    earthshine:
        True: add the Earth's light.
    bounce:
        Light that reaches ground by way of other ground: one of `choices.BOUNCES`.
    camera:
        Camera, or its file. None: the view of the angles below.
    camera_plane:
        True: the image is the camera's; False: its nodes are those of the area.
    off_nadir_deg, view_azimuth_deg, altitude_km:
        Without a camera: direction to it at the area's centre, from the vertical and clockwise from north, degrees (None:
        straight down), and its altitude above the sphere (None: parallel rays).
    reflectance:
        Reflectance law, or its name (`choices.REFLECTANCE_MODELS`, or ``auto``).
    albedo:
        Albedo map, or its file.
    accuracy, tolerance:
        Tier (`accuracy.TIERS`), or instead the largest error of a node's sunlit share.
    surface:
        ``auto``, ``heightfield`` or ``sphere``.
    product_order:
        Order of precedence where DEMs overlap.
    overwrite:
        True: replace an existing output.

    Returns
    -------
    Rendering
        Bands, each (rows, cols), row 0 north: ``radiance`` (I/F; NaN where nothing is seen),
        ``sunlit``, ``visible``, ``incidence_deg``, ``emission_deg``, ``phase_deg``, ``height_m`` or
        ``position_mcmf_m``; the area's ``frame`` with ``transform`` and ``crs``; ``plot()``.

    Raises
    ------
    LcpError
        `AreaError`, `SunError`, `CameraError`, `DemError` ... for what cannot be rendered; `ConfigError` for a
        direction or an altitude beside a camera, and for half of a direction.

    Examples
    --------
    >>> image = lcp.render(
    ...     folder / "hadley_gld100_256ppd.tif",
    ...     center=(3.63, 26.13), size_km=10, sun=(96.5, 14),
    ... )
    >>> image.radiance.shape, bool(image.sunlit.mean() > 0.5)
    ((87, 87), True)
    """
    if output is not None:
        ending_of(output, (".tif",))
        check_output(output, overwrite)
    angles = ViewAngles.stated(camera, off_nadir_deg, view_azimuth_deg, altitude_km)
    seen = None if camera is None else rendered_sensor(camera)
    dems = dem_set(dem, product_order) if dem else None
    if center is not None and size_km is None and dems is not None:
        size_km = 1e-3 * _NODES * (gsd_m or dems.native_gsd_m(center[0], center[1]))
    scene = prepare(
        Request(
            dems=dems,
            area=Area.chosen(center, size_km, bounds),
            gsd_m=gsd_m,
            sun=SunChoice.of(sun).beside(environment, disc, earthshine),
            view=ViewChoice(seen or angles),
            in_camera_plane=camera_plane,
            model=law_of(reflectance),
            accuracy=accuracy_of(accuracy, tolerance),
            disc=disc,
            albedo=open_map(albedo) if isinstance(albedo, Path | str) else albedo,
            surface=surface,
            environment=Environment.opened(environment),
            earthshine=earthshine,
            bounce=bounce,
        )
    )
    if output is not None:
        check_output(output, overwrite, scene.sources)
    image = georeferenced(scene, scene.expose())
    if output is not None:
        write_bytes(output, encode(scene, image), overwrite)
    return image
