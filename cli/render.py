"""``lcp render``: one image of an area."""

from __future__ import annotations

import json
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import click

from . import options, pointing_options, render_options
from .environment_options import check_environment, environment, environment_options
from .files import FileCommand, OutputFile

if TYPE_CHECKING:
    from lcp_catalog.rendering.request import Request


@click.command(
    cls=FileCommand,
    example="lcp render DEM.tif -o site.tif --center 3.5 26 --size 20 --sun-azimuth 96 --sun-elevation 14 --preview site.png",
)
@options.dem_argument_or_none
@options.product_order_option
@options.output_option("OUT.tif", required=False)
@options.area_options
@options.sun_options
@render_options.earthshine_option
@environment_options
@render_options.bounce_option("auto")
@render_options.view_options
@render_options.around_option
@pointing_options.pointing_options
@render_options.surface_option
@options.model_options
@options.albedo_options
@render_options.composite_options
@click.option(
    "--preview",
    type=OutputFile(),
    metavar="OUT.png",
    help="Also write the radiance as an 8-bit PNG, in colour under an albedo map in colour.",
)
@click.option(
    "--explain",
    is_flag=True,
    help="Print the scene plan as JSON: which effects are modelled, why, and with what error bound. "
    "Without -o nothing is rendered.",
)
@options.depfile_option
@options.overwrite_option
def command(
    dem: tuple[str, ...],
    output: str | None,
    preview: str | None,
    explain: bool,
    depfile: str | None,
    overwrite: bool,
    **flags: Any,
) -> None:
    """Render one image of an area of the Moon.

    The area is taken from --center and --size or from --bounds; --size alone cuts it out of what the camera sees
    (--around). Without them it is what the camera sees, else
    the whole DEM. The Sun is given by --sun-azimuth and --sun-elevation, by --time or by --subsolar; without
    them it is the camera file's. Without view options the view is straight down. With --fov, --altitude and
    --look the image is that of a camera above --center.

    Bands of OUT.tif: radiance, sunlit, visible, incidence, emission, phase (degrees), and height (metres). With
    --frame camera, x, y and z (metres, MCMF) take the place of height. An albedo map in colour adds radiance_red,
    radiance_green and radiance_blue.
    """
    if output is None and not explain:
        raise click.UsageError("-o OUT.tif is missing (or --explain)")
    if output is None and (preview or depfile):
        raise click.UsageError("--preview and --depfile need -o OUT.tif")
    request = _request(dem, **flags)

    from lcp_catalog.atomic_files import check_output
    from lcp_catalog.rendering.output import explain as explained
    from lcp_catalog.rendering.pipeline import prepare

    for name, replaced in ((output, overwrite), (preview, overwrite), (depfile, True)):
        if name:
            check_output(name, replaced)
    scene = prepare(request)
    if output is not None:
        _write(scene, output, preview, depfile, overwrite, _camera_of(flags))
    if explain:
        click.echo(json.dumps(explained(scene), indent=2))


def _request(dem: tuple[str, ...], **flags: Any) -> Request:
    """The library's request for the options; usage errors for options that exclude each other."""
    pointing_options.check_pointing(flags)
    pointed = flags["fov_deg"] is not None
    center = None if pointed else flags["center"]
    where = center, flags["bounds"]
    seen = bool(flags["camera_path"]) or pointed
    in_view = render_options.check_around(flags["around"], seen, flags["size_km"], *where)
    options.check_area(center, None if in_view else flags["size_km"], flags["bounds"])
    angles = (flags["sun_azimuth"], flags["sun_elevation"])
    sun_stated = options.check_sun(*angles, flags["time_utc"], flags["subsolar"])
    altitude_km = None if pointed else flags["altitude_km"]
    oblique = (flags["off_nadir"], flags["view_azimuth"], altitude_km)
    frame = flags["frame"] or ("camera" if pointed else "enu")
    render_options.check_view(seen, *oblique, frame)
    options.check_accuracy(flags["accuracy"], flags["tolerance"])
    albedo = (flags["albedo_path"], flags["albedo_encoding"], flags["albedo_reference"])
    options.check_albedo(*albedo)
    render_options.check_surface(flags["surface"], dem, flags["size_km"])
    panorama = flags["environment_path"]
    check_environment(flags, sun_stated)
    if panorama is not None and flags["earthshine"]:
        raise click.UsageError("--environment excludes --earthshine")
    behind = (flags["catcher_m"], flags["background_path"], flags["background_white"])
    render_options.check_composite(*behind, panorama, frame)

    from lcp_catalog.accuracy import accuracy
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.photometry.colour_map import open_map
    from lcp_catalog.photometry.law_choice import named
    from lcp_catalog.rendering.compositing import Backdrop
    from lcp_catalog.rendering.request import AreaInView, Request, ViewChoice
    from lcp_catalog.rendering.sphere_extent import SphereArea
    from lcp_catalog.terrain.area import Area

    camera = pointing_options.camera_of(flags, frame == "camera")
    if not sun_stated and panorama is None and (camera is None or not camera.has_sun):
        raise click.UsageError(
            "no Sun: give --sun-azimuth and --sun-elevation, or --time, or --subsolar, or --environment"
            + (f" ({flags['camera_path']} has none)" if flags["camera_path"] else "")
        )
    area: Area | SphereArea | AreaInView | None = None
    if in_view:
        area = AreaInView(flags["size_km"], flags["around"] == "axis")
    elif center:
        size_km = flags["size_km"]
        sphere = flags["surface"] == "sphere"
        area = SphereArea(*center, (size_km, size_km)) if sphere else Area(*center, size_km)
    elif flags["bounds"]:
        area = Area.from_bounds(*flags["bounds"])
    return Request(
        dem_paths=dem,
        area=area,
        gsd_m=flags["gsd_m"],
        sun=SunChoice(*angles, flags["time_utc"], flags["subsolar"]),
        view=ViewChoice.of(camera)
        if camera
        else ViewChoice(None, oblique[0] or 0.0, oblique[1] or 0.0, oblique[2]),
        in_camera_plane=frame == "camera",
        model=named(flags["reflectance"] or "auto"),
        accuracy=accuracy(flags["accuracy"], flags["tolerance"]),
        disc=None if flags["sun_model"] is None else flags["sun_model"] == "disc",
        product_order=flags["product_order"] or (),
        albedo=open_map(*albedo) if albedo[0] else None,
        surface=flags["surface"],
        environment=environment(flags),
        bounce=flags["bounce"],
        earthshine=flags["earthshine"],
        backdrop=Backdrop.open(*behind) if behind != (None, None, None) else None,
    )


def _write(
    scene: Any,
    output: str,
    preview: str | None,
    depfile: str | None,
    overwrite: bool,
    camera: list[str],
) -> None:
    """Render and write the files; OUT.tif appears last, after the others are complete."""
    from lcp_catalog.atomic_files import depfile_rule, write_aside
    from lcp_catalog.rendering.output import encode
    from lcp_catalog.rendering.rasters import picture, png

    result = scene.expose()
    with ExitStack() as stack:
        stack.enter_context(write_aside(output, overwrite)).write_bytes(encode(scene, result))
        if preview:
            seen = result.radiance if result.colour is None else result.colour
            shown = seen if result.composite is None else result.composite
            image = png(picture(shown))
            stack.enter_context(write_aside(preview, overwrite)).write_bytes(image)
        if depfile:
            rule = depfile_rule(output, [*scene.sources, *camera])
            stack.enter_context(write_aside(depfile, True)).write_bytes(rule)


def _camera_of(flags: dict[str, Any]) -> list[str]:
    return [flags["camera_path"]] if flags["camera_path"] else []
