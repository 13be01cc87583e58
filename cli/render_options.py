"""What decides one render beside the shared options: its light, its view, its surface and what stands behind it; and which of
these flags contradict each other.
"""

from __future__ import annotations

from typing import Any

import click

from lcp_catalog.choices import HEIGHTFIELD_SIZE_MAX_KM, SURFACES

from .options import option_group
from .value_types import AZIMUTH, POSITIVE, Finite, Number

light_options = option_group(
    click.option(
        "--earthshine",
        is_flag=True,
        help="The Earth lights the scene, too; where it stands is by --time (or the camera's), else over longitude 0, "
        "latitude 0.",
    ),
    click.option(
        "--environment",
        "environment_path",
        metavar="PANORAMA",
        help="Instead of a Sun: a panorama of all directions (Radiance .hdr, or .pfm, .tif, .png), twice as wide as "
        "high, its middle looking north.",
    ),
    click.option(
        "--environment-azimuth",
        type=AZIMUTH,
        metavar="DEG",
        help="Where the panorama's middle looks, clockwise from north; default: 0.",
    ),
    click.option(
        "--environment-sources",
        nargs=3,
        type=click.Tuple([POSITIVE] * 3),
        metavar="T R M",
        help="A bright source: its peak over T times the mean of 45 x 45 deg, its pixels within R deg and over M times "
        "that mean; default: 6 5 2.",
    ),
    click.option(
        "--sun-sky-ratio",
        type=POSITIVE,
        metavar="RATIO",
        help="Scale the strongest source until it lights a horizontal plane so many times as the rest of the sky "
        "(CIE clear sky: 4).",
    ),
)

composite_options = option_group(
    click.option(
        "--shadow-catcher",
        "catcher_m",
        type=Finite(),
        metavar="M",
        help="Where a camera misses the terrain, the background under the shadows on a horizontal plane at this ENU "
        "height.",
    ),
    click.option(
        "--background",
        "background_path",
        metavar="IMAGE",
        help="What stands behind the terrain in the camera's plane; default with --environment: the panorama.",
    ),
    click.option(
        "--background-white",
        type=POSITIVE,
        metavar="V",
        help="Radiance of the background's 1 (of 8 and 16 bits: white); default: 1, and the render's own white for "
        "8 and 16 bits.",
    ),
)

view_options = option_group(
    click.option(
        "--camera",
        "camera_path",
        metavar="CAMERA.json",
        help="Camera that looks: CAMERA.json, or USGS ISD or .tsai of a framing camera.",
    ),
    click.option(
        "--off-nadir",
        type=Number(0, 90, max_open=True),
        metavar="DEG",
        help="Angle between the vertical and the camera at the area's centre.",
    ),
    click.option(
        "--view-azimuth",
        type=AZIMUTH,
        metavar="DEG",
        help="Azimuth of the camera, seen from the area's centre.",
    ),
    click.option(
        "--altitude",
        "altitude_km",
        type=POSITIVE,
        metavar="KM",
        help="Altitude of the camera above the sphere; default: at infinity.",
    ),
    click.option(
        "--frame",
        type=click.Choice(["enu", "camera"]),
        default="enu",
        show_default=True,
        help="Render at the ground's nodes, or in the camera's plane.",
    ),
)

surface_option = click.option(
    "--surface",
    type=click.Choice(SURFACES),
    default=SURFACES[0],
    show_default=True,
    help="The DEM's heights, or the plain sphere of 1737.4 km, which needs no DEM; auto: the sphere "
    "where relief changes less than the accuracy admits.",
)


def check_light(
    sun_stated: bool,
    sun_model: str | None,
    earthshine: bool,
    environment: str | None,
    **how: Any,
) -> None:
    """Usage error for lights that exclude each other, and for what says how (by name) without a
    panorama.
    """
    if environment is not None and (sun_stated or sun_model is not None):
        raise click.UsageError(
            "--environment is all the light there is: it excludes --sun-azimuth, --sun-elevation, --time, --subsolar "
            "and --sun"
        )
    if environment is not None and earthshine:
        raise click.UsageError("--environment excludes --earthshine: the panorama holds all light")
    for name, value in how.items():
        if environment is None and value is not None:
            raise click.UsageError(f"--{name.replace('_', '-')} needs --environment PANORAMA")


def check_composite(
    catcher_m: float | None,
    background: str | None,
    white: float | None,
    environment: str | None,
    frame: str,
) -> None:
    """Usage error for a background or a shadow catcher that has no camera, or nothing to darken."""
    if (catcher_m is not None or background is not None) and frame != "camera":
        raise click.UsageError("--shadow-catcher and --background need --frame camera")
    if catcher_m is not None and background is None and environment is None:
        raise click.UsageError(
            "--shadow-catcher needs --background IMAGE or --environment PANORAMA"
        )
    if white is not None and background is None:
        raise click.UsageError("--background-white needs --background IMAGE")


def check_view(
    camera_path: str | None,
    off_nadir: float | None,
    view_azimuth: float | None,
    altitude_km: float | None,
    frame: str,
) -> None:
    """Usage error for view flags that contradict each other or say half."""
    oblique = any(value is not None for value in (off_nadir, view_azimuth, altitude_km))
    if camera_path and oblique:
        raise click.UsageError(
            "--camera excludes --off-nadir, --view-azimuth and --altitude: it is the view"
        )
    if off_nadir and view_azimuth is None:
        raise click.UsageError("--off-nadir needs --view-azimuth")
    if view_azimuth is not None and off_nadir is None:
        raise click.UsageError("--view-azimuth needs --off-nadir")
    if frame == "camera" and not camera_path and altitude_km is None:
        raise click.UsageError("--frame camera needs --camera, or --altitude (with --off-nadir)")


def check_surface(surface: str, dems: tuple[str, ...], size_km: float | None) -> None:
    """Usage error for heights without a DEM, and for more of them than fit into one plane."""
    if surface != "sphere" and not dems:
        raise click.UsageError("no DEM: name one or more, or --surface sphere to render without")
    if surface != "sphere" and size_km is not None and size_km > HEIGHTFIELD_SIZE_MAX_KM:
        raise click.UsageError(
            f"--size {size_km:g}: a DEM is rendered up to {HEIGHTFIELD_SIZE_MAX_KM:g} km wide; the plain "
            "sphere as wide as the Moon: --surface sphere"
        )
