"""Options of ``lcp render`` besides the shared ones: light, view, surface, background; and checks of their
combinations.
"""

from __future__ import annotations

from collections.abc import Callable

import click

from lcp_catalog.choices import BOUNCES, HEIGHTFIELD_SIZE_MAX_KM, SURFACES

from .files import InputFile
from .options import RASTER, Command, option_group
from .value_types import AZIMUTH, POSITIVE, Finite, Number

earthshine_option = click.option(
    "--earthshine",
    is_flag=True,
    help="Add earthlight. The Earth's position is that at --time (or the camera's time), else at the zenith of "
    "longitude 0, latitude 0.",
)


def bounce_option(default: str) -> Callable[[Command], Command]:
    """Option ``--bounce`` with a default of its own: a frame of N x N rays a pixel takes ten times as long with it."""
    return click.option(
        "--bounce",
        type=click.Choice(BOUNCES),
        default=default,
        show_default=True,
        help="Light that reaches ground by way of other ground (one bounce), where the first source does not reach; "
        "auto: if it exceeds 1/255 of the brightest ground.",
    )


composite_options = option_group(
    click.option(
        "--shadow-catcher",
        "catcher_m",
        type=Finite(),
        metavar="M",
        help="Height of a horizontal plane, metres (ENU z). Where the camera misses the terrain, shadows on this plane "
        "darken the background.",
    ),
    click.option(
        "--background",
        "background_path",
        type=RASTER,
        metavar="IMAGE",
        help="Background image of the camera's plane; default: the environment map, if there is one.",
    ),
    click.option(
        "--background-white",
        type=POSITIVE,
        metavar="V",
        help="Radiance factor of the background's value 1 (in 8 and 16 bits: of white); default: 1, in 8 and 16 bits "
        "the white of the preview.",
    ),
)

view_options = option_group(
    click.option(
        "--camera",
        "camera_path",
        type=InputFile(),
        metavar="CAMERA.json",
        help="Camera file: CAMERA.json, a USGS ISD (framing camera, line scanner, push-frame camera) or a .tsai file.",
    ),
    click.option(
        "--off-nadir",
        type=Number(0, 90, max_open=True),
        metavar="DEG",
        help="Angle between the vertical and the direction to the camera at the area's centre, degrees; default: 0.",
    ),
    click.option(
        "--view-azimuth",
        type=AZIMUTH,
        metavar="DEG",
        help="Azimuth of the camera, seen from the area's centre, degrees clockwise from north; needed with --off-nadir.",
    ),
    click.option(
        "--altitude",
        "altitude_km",
        type=POSITIVE,
        metavar="KM",
        help="Altitude of the camera above the reference sphere; default: infinity (parallel rays).",
    ),
    click.option(
        "--frame",
        type=click.Choice(["enu", "camera"]),
        default=None,
        help="Output raster: nodes of the area's ENU plane, or pixels of the camera; default: enu, with --fov camera.",
    ),
)

around_option = click.option(
    "--around",
    type=click.Choice(["axis", "footprint"]),
    default=None,
    help="Centre of an area of --size in the view of --camera or --fov: where its optical axis meets the surface (of a scanner: "
    "the ray of the image's middle), or the middle of its footprint; default with --size and without --center: "
    "footprint.",
)


def check_around(around: str | None, camera: bool, size_km: float | None, *others: object) -> bool:
    """True if the area lies around the camera's view. ``camera``: True if one is given, by a file or by
    ``--fov``; ``others``: other statements of the area's place.
    """
    stated = any(other is not None for other in others)
    if around is not None and not (camera and size_km is not None):
        raise click.UsageError(f"--around {around} needs --camera (or --fov) and --size")
    if around is not None and stated:
        raise click.UsageError("--around excludes --center and --bounds")
    return camera and size_km is not None and not stated


surface_option = click.option(
    "--surface",
    type=click.Choice(SURFACES),
    default=SURFACES[0],
    show_default=True,
    help="Surface: heights of the DEM, or a sphere of 1737.4 km (needs no DEM). auto: the heights, or "
    "the sphere if relief changes the image by less than the accuracy permits.",
)


def check_composite(
    catcher_m: float | None,
    background: str | None,
    white: float | None,
    environment: str | None,
    frame: str,
) -> None:
    """Raise a usage error for a background or shadow catcher without a camera or without an image."""
    if (catcher_m is not None or background is not None) and frame != "camera":
        raise click.UsageError("--shadow-catcher and --background need --frame camera")
    if catcher_m is not None and background is None and environment is None:
        raise click.UsageError(
            "--shadow-catcher needs --background IMAGE or --environment PANORAMA"
        )
    if white is not None and background is None:
        raise click.UsageError("--background-white needs --background IMAGE")


def check_view(
    camera: bool,
    off_nadir: float | None,
    view_azimuth: float | None,
    altitude_km: float | None,
    frame: str,
) -> None:
    """Raise a usage error for contradictory or incomplete view options. ``camera``: True if one is given,
    by a file or by ``--fov``.
    """
    oblique = any(value is not None for value in (off_nadir, view_azimuth, altitude_km))
    if camera and oblique:
        raise click.UsageError("--camera excludes --off-nadir, --view-azimuth and --altitude")
    if off_nadir and view_azimuth is None:
        raise click.UsageError("--off-nadir needs --view-azimuth")
    if view_azimuth is not None and off_nadir is None:
        raise click.UsageError("--view-azimuth needs --off-nadir")
    if frame == "camera" and not camera and altitude_km is None:
        raise click.UsageError(
            "--frame camera needs --camera, --fov, or --altitude (with --off-nadir)"
        )


def check_surface(surface: str, dems: tuple[str, ...], size_km: float | None) -> None:
    """Raise a usage error for a heightfield without a DEM or wider than one plane can be."""
    if surface != "sphere" and not dems:
        raise click.UsageError("no DEM: give one or more, or --surface sphere")
    if surface != "sphere" and size_km is not None and size_km > HEIGHTFIELD_SIZE_MAX_KM:
        raise click.UsageError(
            f"--size {size_km:g}: a DEM is rendered up to {HEIGHTFIELD_SIZE_MAX_KM:g} km wide; for "
            "wider areas: --surface sphere"
        )
