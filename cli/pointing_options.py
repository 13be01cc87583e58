"""Options for a camera without a file, given by field of view, height and direction: ``lcp render`` and
``lcp simulate``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from .options import option_group
from .value_types import AZIMUTH, Number

if TYPE_CHECKING:
    from lcp_catalog.cameras.isd import AnySensor

IMAGE_SIZE = (1024, 1024)
_SIDE = click.IntRange(1, 10_000)

pointing_options = option_group(
    click.option(
        "--fov",
        "fov_deg",
        type=Number(0, 180, min_open=True, max_open=True),
        metavar="DEG",
        help="Field of view across the image's width, degrees: a camera without a file, --altitude above the point "
        "--center, which here is the point under the camera.",
    ),
    click.option(
        "--look",
        "look_deg",
        nargs=2,
        type=click.Tuple([AZIMUTH, Number(-90, 90)]),
        metavar="AZ EL",
        help="Direction of that camera's optical axis: azimuth, clockwise from north, and elevation above the camera's "
        "horizontal, degrees. Rows of the image are level; straight down (elevation -90), AZ is the direction of its upper "
        "edge. Default: 0 -90 (straight down, north up).",
    ),
    click.option(
        "--image-size",
        "image_size_px",
        nargs=2,
        type=click.Tuple([_SIDE, _SIDE]),
        metavar="W H",
        help=f"Width and height of that camera's image, pixels; default: {IMAGE_SIZE[0]} {IMAGE_SIZE[1]}.",
    ),
)


def check_pointing(flags: dict[str, Any]) -> None:
    """Raise a usage error for a camera that is given twice, in part, or beside other views."""
    if flags["fov_deg"] is None:
        for option, name in (("--look", "look_deg"), ("--image-size", "image_size_px")):
            if flags[name] is not None:
                raise click.UsageError(f"{option} needs --fov DEG")
        return
    if flags["camera_path"]:
        raise click.UsageError("--fov and --camera exclude each other")
    if flags["center"] is None or flags["altitude_km"] is None:
        raise click.UsageError("--fov needs --center LON LAT (under the camera) and --altitude KM")
    if flags.get("off_nadir") is not None or flags.get("view_azimuth") is not None:
        raise click.UsageError(
            "--fov excludes --off-nadir and --view-azimuth; --look AZ EL gives the direction"
        )


def camera_of(flags: dict[str, Any], plane: bool) -> AnySensor | None:
    """The camera of ``--camera`` or ``--fov``; None without either. CameraError if it is invalid, or too
    large to be rendered: a framing camera, and a scanner whose ``plane`` is rendered.
    """
    if flags["camera_path"]:
        from lcp_catalog.cameras.camera_file import read_sensor, require_pixels
        from lcp_catalog.cameras.frame_camera import Camera

        camera = read_sensor(flags["camera_path"])
        if plane or isinstance(camera, Camera):
            require_pixels(camera)
        return camera
    if flags["fov_deg"] is None:
        return None
    from lcp_catalog.cameras.view import pointed_camera

    return pointed_camera(
        flags["center"],
        1e3 * flags["altitude_km"],
        flags["look_deg"] or (0.0, -90.0),
        flags["fov_deg"],
        flags["image_size_px"] or IMAGE_SIZE,
    )
