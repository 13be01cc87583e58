"""``lcp export``: a catalogue's points in the files of other programs."""

from __future__ import annotations

import click

from lcp_catalog.choices import EXPORTS, FRAMES

from . import options
from .build_options import field_option
from .files import FileCommand
from .messages import say
from .value_types import AZIMUTH, Number


@click.command(
    cls=FileCommand, rule=True, example="lcp export site.h5 -o site.gpkg --frame MOON_PA"
)
@options.catalog_argument
@options.output_option(f"OUT{'|'.join(EXPORTS)}")
@click.option(
    "--frame",
    type=click.Choice(FRAMES),
    default=FRAMES[0],
    show_default=True,
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

    .parquet, .geojson and .gpkg need the extra gis, .bds the extra spice: pip install 'lcp-catalog[gis,spice]'
    """
    from lcp_catalog.exports.export import export
    from lcp_catalog.production.config import AreaConfig

    AreaConfig(bounds_deg=bounds_deg or ())  # refuses limits that are no area
    count = export(
        catalog,
        output,
        frame=frame,
        bounds=bounds_deg,
        level=level,
        sun_azimuth_deg=sun_azimuth,
        sun_elevation_deg=sun_elevation,
        image_scale=image_scale,
        overwrite=overwrite,
    )
    say(f"{output}: {count} points written, {frame}")
