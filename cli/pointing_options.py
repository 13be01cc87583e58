"""The camera of an image that is computed: of a file, or without one by field of view, height and direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from .environment_options import EnvironmentOptions
from .groups import Decorator, collected
from .options import camera_file_option
from .value_types import AZIMUTH, Number

if TYPE_CHECKING:
    from lcp_catalog.cameras.isd import AnySensor
    from lcp_catalog.light.sun_choice import SunChoice

IMAGE_SIZE = (1024, 1024)
_SIDE = click.IntRange(1, 10_000)


@dataclass(frozen=True)
class CameraOptions:
    """A camera's file, or ``fov_deg`` and what goes with it. Usage error for both, and for options without it."""

    camera: str | None
    fov_deg: float | None
    look_deg: tuple[float, float] | None
    image_size_px: tuple[int, int] | None

    def __post_init__(self) -> None:
        for option, value in (("--look", self.look_deg), ("--image-size", self.image_size_px)):
            if self.fov_deg is None and value is not None:
                raise click.UsageError(f"{option} needs --fov DEG")
        if self.fov_deg is not None and self.camera:
            raise click.UsageError("--fov and --camera exclude each other")

    @property
    def is_given(self) -> bool:
        """True for a file or a field of view."""
        return self.camera is not None or self.is_pointed

    @property
    def is_pointed(self) -> bool:
        """True for a camera without a file."""
        return self.fov_deg is not None

    def check_place(
        self, center_deg: tuple[float, float] | None, altitude_km: float | None
    ) -> None:
        """Raise a usage error for a camera without a file that has no place."""
        if self.is_pointed and (center_deg is None or altitude_km is None):
            raise click.UsageError(
                "--fov needs --center LON LAT (under the camera) and --altitude KM"
            )

    def open(
        self,
        center_deg: tuple[float, float] | None,
        altitude_km: float | None,
        plane: bool,
    ) -> AnySensor | None:
        """The camera; None without one. CameraError if it is invalid, or too large to be rendered: a framing
        camera, and a scanner whose ``plane`` is rendered.
        """
        if self.camera is not None:
            from lcp_catalog.cameras.camera_file import read_sensor, require_pixels
            from lcp_catalog.cameras.frame_camera import Camera

            camera = read_sensor(self.camera)
            if plane or isinstance(camera, Camera):
                require_pixels(camera)
            return camera
        if self.fov_deg is None or center_deg is None or altitude_km is None:
            return None
        from lcp_catalog.cameras.view import pointed_camera

        look, size = self.look_deg or (0.0, -90.0), self.image_size_px or IMAGE_SIZE
        return pointed_camera(center_deg, 1e3 * altitude_km, look, self.fov_deg, size)

    def check_lit(
        self, sun: SunChoice, light: EnvironmentOptions, camera: AnySensor | None
    ) -> None:
        """Raise a usage error for an image without a Sun."""
        dark = camera is None or not camera.has_sun
        if dark and not sun.is_stated and light.environment is None:
            raise click.UsageError(
                "no Sun: give --sun-azimuth and --sun-elevation, or --time, or --subsolar, or --environment"
                + (f" ({self.camera} has none)" if self.camera else "")
            )


def camera_options(camera_help: str) -> Decorator:
    """The camera, which a command gets as ``camera``."""
    return collected(
        "camera",
        CameraOptions,
        camera_file_option(camera_help),
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
            type=click.Tuple([AZIMUTH, Number(-90, 90)]),
            metavar="AZ EL",
            help="Direction of that camera's optical axis: azimuth, clockwise from north, and elevation above the "
            "camera's horizontal, degrees. Rows of the image are level; straight down (elevation -90), AZ is the direction of "
            "its upper edge. Default: 0 -90 (straight down, north up).",
        ),
        click.option(
            "--image-size",
            "image_size_px",
            type=click.Tuple([_SIDE, _SIDE]),
            metavar="W H",
            help=f"Width and height of that camera's image, pixels; default: {IMAGE_SIZE[0]} {IMAGE_SIZE[1]}.",
        ),
    )
