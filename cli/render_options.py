"""Options of ``lcp render``: the request of one image, and rules for what goes together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from lcp_catalog.choices import BOUNCES, HEIGHTFIELD_SIZE_MAX_KM, SURFACES

from . import options
from .build_options import model_options
from .environment_options import EnvironmentOptions, environment_options
from .files import RASTER
from .groups import Decorator, collected
from .pointing_options import CameraOptions, camera_options
from .value_types import POSITIVE, Finite

if TYPE_CHECKING:
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.production.config import AreaConfig
    from lcp_catalog.production.model_config import ModelConfig
    from lcp_catalog.rendering.request import AreaInView, Request, SphereArea
    from lcp_catalog.terrain.area import Area


def bounce_option(default: str) -> Decorator:
    """Option ``--bounce`` with a default of its own: a frame of N x N rays a pixel takes ten times as long with it."""
    return click.option(
        "--bounce",
        type=click.Choice(BOUNCES),
        default=default,
        help="Add light that other ground reflects (one bounce), where the first light source does not reach; auto: only if "
        "it exceeds 1/255 of the brightest ground.",
    )


@dataclass(frozen=True)
class ViewOptions:
    """The view: that of the camera, or angles at the area's centre; the image's plane; what is behind the terrain."""

    camera: CameraOptions
    off_nadir: float | None
    view_azimuth: float | None
    altitude_km: float | None
    frame: str | None
    around: str | None
    shadow_catcher: float | None
    background: str | None
    background_white: float | None

    def __post_init__(self) -> None:
        """Raise a usage error for contradictory or incomplete options."""
        if self.camera.is_pointed and {self.off_nadir, self.view_azimuth} != {None}:
            raise click.UsageError(
                "--fov excludes --off-nadir and --view-azimuth; --look AZ EL gives the direction"
            )
        if self.in_plane and not self.camera.is_given and self.altitude_km is None:
            raise click.UsageError(
                "--frame camera needs --camera, --fov, or --altitude (with --off-nadir)"
            )
        if self.has_backdrop and not self.in_plane:
            raise click.UsageError("--shadow-catcher and --background need --frame camera")
        if self.background_white is not None and self.background is None:
            raise click.UsageError("--background-white needs --background IMAGE")

    @property
    def in_plane(self) -> bool:
        """True if the image is that of the camera's plane."""
        return (self.frame or ("camera" if self.camera.is_pointed else "enu")) == "camera"

    @property
    def has_backdrop(self) -> bool:
        """True if something is drawn where the terrain is not."""
        return self.shadow_catcher is not None or self.background is not None


@dataclass(frozen=True)
class RenderOptions:
    """All that determines an image."""

    dem: tuple[str, ...]
    product_order: tuple[str, ...] | None
    center_deg: tuple[float, float] | None
    size_km: float | None
    bounds_deg: tuple[float, float, float, float] | None
    gsd_m: float | None
    sun: SunChoice
    disc: bool | None
    earthshine: bool
    light: EnvironmentOptions
    bounce: str
    view: ViewOptions
    surface: str
    model: ModelConfig

    def __post_init__(self) -> None:
        """Raise a usage error for contradictory or incomplete options."""
        self.view.camera.check_place(self.center_deg, self.view.altitude_km)
        self._check_around()
        self._area_config()
        if self.surface != "sphere" and not self.dem:
            raise click.UsageError("no DEM: give one or more, or --surface sphere")
        if self.surface != "sphere" and (self.size_km or 0.0) > HEIGHTFIELD_SIZE_MAX_KM:
            raise click.UsageError(
                f"--size {self.size_km:g}: a DEM is rendered up to {HEIGHTFIELD_SIZE_MAX_KM:g} km wide; for wider "
                "areas: --surface sphere"
            )
        self.sun.beside(self.light.environment, self.disc, self.earthshine)
        behind = self.view.background or self.light.environment
        if self.view.shadow_catcher is not None and behind is None:
            raise click.UsageError(
                "--shadow-catcher needs --background IMAGE or --environment PANORAMA"
            )

    def _check_around(self) -> None:
        """Raise a usage error for an area around the camera's view that has no size, or a place of its own."""
        if self.view.around is None:
            return
        if not self.view.camera.is_given or self.size_km is None:
            raise click.UsageError(
                f"--around {self.view.around} needs --camera (or --fov) and --size"
            )
        if self._center() or self.bounds_deg:
            raise click.UsageError("--around excludes --center and --bounds")

    def _center(self) -> tuple[float, float] | None:
        """Centre of the area; with a camera without a file that is the place under the camera."""
        return None if self.view.camera.is_pointed else self.center_deg

    @property
    def _is_in_view(self) -> bool:
        """True if the area lies around the camera's view."""
        placed = self._center() or self.bounds_deg
        return self.view.camera.is_given and self.size_km is not None and not placed

    def _area_config(self) -> AreaConfig:
        """The area that is stated. ConfigError if it is stated twice or in part."""
        from lcp_catalog.production.config import AreaConfig

        size_km = None if self._is_in_view else self.size_km
        return AreaConfig(self._center() or (), size_km, self.bounds_deg or ())

    def _area(self) -> Area | SphereArea | AreaInView | None:
        """The area; None for what the camera sees, else the whole DEM."""
        from lcp_catalog.rendering.request import AreaInView, SphereArea

        center, size_km = self._center(), self.size_km
        if self._is_in_view and size_km is not None:
            return AreaInView(size_km, self.view.around == "axis")
        if self.surface == "sphere" and center is not None and size_km is not None:
            return SphereArea(center[0], center[1], (size_km, size_km))
        return self._area_config().region

    def request(self) -> Request:
        """The library's request. Raises the library's errors for files that cannot be read."""
        from lcp_catalog.dem.public import dem_set
        from lcp_catalog.photometry.albedo_map import open_map
        from lcp_catalog.photometry.law_choice import named
        from lcp_catalog.rendering.request import Backdrop, Request, ViewAngles, ViewChoice

        shown = self.view
        angles = ViewAngles.stated(
            shown.camera.camera, shown.off_nadir, shown.view_azimuth, shown.altitude_km
        )
        camera = shown.camera.open(self.center_deg, shown.altitude_km, shown.in_plane)
        shown.camera.check_lit(self.sun, self.light, camera)
        behind = None
        if shown.has_backdrop:
            behind = Backdrop.open(shown.shadow_catcher, shown.background, shown.background_white)
        return Request(
            dems=dem_set(self.dem, self.product_order or ()) if self.dem else None,
            area=self._area(),
            gsd_m=self.gsd_m,
            sun=self.sun,
            view=ViewChoice(camera or angles),
            in_camera_plane=shown.in_plane,
            model=named(self.model.reflectance),
            accuracy=self.model.precision,
            disc=self.disc,
            albedo=options.albedo_map(self.model, open_map),
            surface=self.surface,
            environment=self.light.open(),
            bounce=self.bounce,
            earthshine=self.earthshine,
            backdrop=behind,
        )


view_options = collected(
    "view",
    ViewOptions,
    camera_options(
        "Camera file: CAMERA.json, a USGS ISD (framing camera, line scanner, push-frame camera) or a .tsai file."
    ),
    options.view_angle_options,
    options.altitude_option(
        "Altitude of the camera above the reference sphere; default: infinity (parallel rays)."
    ),
    click.option(
        "--frame",
        type=click.Choice(["enu", "camera"]),
        help="Output raster: nodes of the area's ENU plane, or pixels of the camera; default: enu, with --fov camera.",
    ),
    click.option(
        "--around",
        type=click.Choice(["axis", "footprint"]),
        help="Centre of an area of --size in the view of --camera or --fov: where its optical axis meets the surface (of "
        "a scanner: the ray of the image's middle), or the middle of its footprint; default with --size and without "
        "--center: footprint.",
    ),
    click.option(
        "--shadow-catcher",
        type=Finite(),
        metavar="M",
        help="Height of a horizontal plane, metres (ENU z). Where the camera misses the terrain, shadows on this plane "
        "darken the background.",
    ),
    click.option(
        "--background",
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

render_options = collected(
    "asked",
    RenderOptions,
    options.dem_argument_or_none,
    options.product_order_option,
    options.area_options,
    options.sun_angle_options,
    options.disc_option,
    click.option(
        "--earthshine",
        is_flag=True,
        help="Add earthlight. The Earth's position is that at --time (or the camera's time), else at the zenith of "
        "longitude 0, latitude 0.",
    ),
    environment_options,
    bounce_option("auto"),
    view_options,
    click.option(
        "--surface",
        type=click.Choice(SURFACES),
        default=SURFACES[0],
        help="Surface: heights of the DEM, or a sphere of 1737.4 km (needs no DEM). auto: the heights, or "
        "the sphere if relief changes the image by less than the accuracy permits.",
    ),
    model_options,
)
"""What is rendered, which a command gets as ``asked``."""
