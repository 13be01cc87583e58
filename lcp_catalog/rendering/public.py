"""Public function that renders an area of the Moon."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..accuracy import accuracy as accuracy_of
from ..atomic_files import check_output, write_bytes
from ..cameras.isd import AnySensor
from ..cameras.public import rendered_sensor
from ..dem.public import Dems, dem_set
from ..light.environment import Environment
from ..light.sun_choice import SunChoice, SunStated
from ..photometry.albedo_map import AlbedoMap, ColourMap, open_map
from ..photometry.law_choice import law_of
from ..photometry.laws import Reflectance
from ..terrain.area import Area
from .output import encode
from .pipeline import prepare
from .renderer import Rendering
from .request import Request, ViewAngles, ViewChoice


def render(
    dem: Dems,
    output: Path | str | None = None,
    *,
    center_deg: tuple[float, float] | None = None,
    size_km: float | None = None,
    bounds_deg: tuple[float, float, float, float] | None = None,
    gsd_m: float | None = None,
    sun: SunStated = None,
    disc: bool | None = None,
    environment: Environment | Path | str | None = None,
    earthshine: bool = False,
    bounce: str = "off",
    camera: AnySensor | Path | str | None = None,
    camera_plane: bool = False,
    off_nadir_deg: float = 0.0,
    view_azimuth_deg: float = 0.0,
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
    center_deg, size_km:
        Longitude and latitude of the area's centre, degrees, and its side. Without an area: what the
        camera sees, else the whole DEM.
    bounds_deg:
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
        Without a camera: direction of the view at the area's centre, degrees, and altitude above it;
        None: parallel rays.
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
        ``position_mcmf_m``.

    Raises
    ------
    LcpError
        `AreaError`, `SunError`, `CameraError`, `DemError` ... for what cannot be rendered.

    Examples
    --------
    >>> image = lcp.render(
    ...     folder / "hadley_gld100_256ppd.tif",
    ...     center_deg=(3.63, 26.13), size_km=10, sun=(96.5, 14),
    ... )
    >>> image.radiance.shape, bool(image.sunlit.mean() > 0.5)
    ((87, 87), True)
    """
    if output is not None:
        check_output(output, overwrite)
    seen = None if camera is None else rendered_sensor(camera)
    angles = ViewAngles(off_nadir_deg, view_azimuth_deg, altitude_km)
    scene = prepare(
        Request(
            dems=dem_set(dem, product_order) if dem else None,
            area=Area.chosen(center_deg, size_km, bounds_deg),
            gsd_m=gsd_m,
            sun=SunChoice.of(sun),
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
    image = scene.expose()
    if output is not None:
        write_bytes(output, encode(scene, image), overwrite)
    return image
