"""``lcp export``: a catalogue's points in the files of other programs."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import click

from lcp_catalog.choices import EXPORTS, FRAMES

from . import options
from .build_options import field_option
from .files import FileCommand, InputFile
from .messages import say
from .query import FrameOptions
from .value_types import AZIMUTH, Number

if TYPE_CHECKING:
    from lcp_catalog.navigation.descent import Descent


@click.command(
    cls=FileCommand, rule=True, example="lcp export site.h5 -o site.gpkg --frame MOON_PA"
)
@options.catalog_argument
@options.output_option(f"OUT{'|'.join(EXPORTS)}")
@click.option(
    "--frame",
    type=click.Choice(FRAMES),
    default=FRAMES[0],
    help="Moon-fixed frame of the output: mean Earth (DE421), or principal axes (DE440).",
)
@field_option(
    "area.bounds_deg",
    help="Only points within these limits, degrees (MOON_ME); may cross the antimeridian; default: all.",
)
@click.option(
    "--level",
    type=click.IntRange(0),
    metavar="K",
    help="Only points of this level of cell size; default: all.",
)
@click.option(
    "--sun-azimuth",
    type=AZIMUTH,
    metavar="DEG",
    help="For .lmk: azimuth of the Sun at every point, clockwise from north.",
)
@click.option(
    "--sun-elevation",
    type=Number(0, 90, min_open=True),
    metavar="DEG",
    help="For .lmk: elevation of the Sun at every point.",
)
@click.option(
    "--image-scale",
    type=Number(1, 1000),
    metavar="X",
    help="For .lcpf: only the claims of this image scale, pixel over cell; default: all.",
)
@click.option(
    "--for-trajectory",
    "trajectory",
    type=InputFile(),
    metavar="FILE",
    help="For .lcpf: only the points, Suns and views that the frames of a trajectory can use (lcp query --trajectory).",
)
@options.camera_file_option("With --for-trajectory FILE.csv: the camera without its place.")
@options.overwrite_option
def command(
    catalog: str,
    output: str,
    frame: str,
    bounds_deg: tuple[float, float, float, float] | None,
    level: int | None,
    sun_azimuth: float | None,
    sun_elevation: float | None,
    image_scale: float | None,
    trajectory: str | None,
    camera: str | None,
    overwrite: bool,
) -> None:
    """Write a catalogue's points in the format of the output's ending.

    \b
    .csv .parquet   table of the points
    .geojson .gpkg  points, footprints of the patches and coverage, with a lunar CRS
    .gcp            ground control points of the Ames Stereo Pipeline
    .lmk            folder of landmark maps of JPL's landmark_tools, version 3
    .spc            folder of landmarks and maplets of stereophotoclinometry
    .bds            SPICE digital shape kernel (DSK), type 2, of a site
    .lcpf           flight file: fixed layout, for a matcher on board (lcp flight-source)
    .json           STAC item of the catalogue, and of the .gpkg of its name

    .parquet, .geojson and .gpkg need the extra gis, .bds the extra spice: pip install 'lcp-catalog[gis,spice]'
    """
    from lcp_catalog.exports.export import export
    from lcp_catalog.production.config import AreaConfig

    AreaConfig(bounds_deg=bounds_deg or ())  # refuses limits that are no area
    if camera is not None and trajectory is None:
        raise click.UsageError("--camera needs --for-trajectory")
    found = None
    if trajectory is not None:
        found = _descent(catalog, camera, trajectory)
    count = export(
        catalog,
        output,
        frame=frame,
        bounds=bounds_deg,
        level=level,
        sun_azimuth_deg=sun_azimuth,
        sun_elevation_deg=sun_elevation,
        image_scale=image_scale,
        conditions=None if found is None else found.kept,
        overwrite=overwrite,
    )
    say(f"{output}: {count} points written, {frame}")
    if found is not None:
        say(_smaller(catalog, output, found))


def _descent(catalog: str, camera: str | None, trajectory: str) -> Descent:
    from lcp_catalog.catalog.verification import open_catalog
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.navigation.descent import descent

    frames = FrameOptions(camera, trajectory).read(SunChoice(), catalog)
    return descent(open_catalog(catalog, check=False), frames)


def _smaller(catalog: str, output: str, found: Descent) -> str:
    """How much smaller the flight file of a descent is, and how probably its frames are located."""
    from lcp_catalog.catalog.verification import open_catalog
    from lcp_catalog.exports.flight import FlightFile, whole_bytes

    size, scales = os.path.getsize(output), int(FlightFile.of(output).header["scales"])
    share = size / whole_bytes(open_catalog(catalog, check=False), scales)
    low, middle, high = (sorted(found.located)[k] for k in (0, len(found.located) // 2, -1))
    return (
        f"{output}: {size} bytes, {100 * (1 - share):.1f} % less than without the trajectory; probability that one of its "
        f"{len(found.located)} frames is located: {low:.3f} to {high:.3f}, median {middle:.3f}, at least 0.99 in "
        f"{sum(value >= 0.99 for value in found.located)}"
    )
