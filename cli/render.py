"""``lcp render``: an area under one Sun and one view."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import options

if TYPE_CHECKING:
    from lcp_catalog.exposure import Request


@click.command()
@options.dem_argument
@options.product_order_option
@options.output_option("OUT.tif", required=False)
@options.area_options
@options.sun_options
@options.view_options
@options.model_options
@click.option("--preview", metavar="OUT.png", help="Also write a picture for the eye.")
@click.option(
    "--explain", is_flag=True, help="Say as JSON what is modelled and why; without -o only that."
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
    """Render an area of the Moon under one Sun and one view.

    The bands of OUT.tif are radiance, sunlit, visible, incidence, emission, phase and height
    (in the camera's plane x, y, z instead of height). See docs/render.md.
    """
    if output is None and not explain:
        raise click.UsageError("say where to write with -o OUT.tif, or --explain")
    if output is None and (preview or depfile):
        raise click.UsageError("--preview and --depfile need -o OUT.tif")
    named = [name for name in (output, preview, depfile) if name]
    if len({str(Path(name).resolve()) for name in named}) < len(named):
        raise click.UsageError("-o, --preview and --depfile must name different files")
    request = _request(dem, **flags)

    from lcp_catalog.exposure import prepare
    from lcp_catalog.files import check_output

    for name, replaced in ((output, overwrite), (preview, overwrite), (depfile, True)):
        if name:
            check_output(name, replaced)
    scene = prepare(request)
    if output is not None:
        _write(scene, output, preview, depfile, overwrite, _camera_of(flags))
    if explain:
        click.echo(json.dumps(scene.plan.to_json(), indent=2))


def _request(dem: tuple[str, ...], **flags: Any) -> Request:
    """The library's request of the flags; usage errors for flags that do not go together."""
    options.check_area(flags["center"], flags["size_km"], flags["bounds"])
    angles = (flags["sun_azimuth"], flags["sun_elevation"])
    sun_stated = options.check_sun(*angles, flags["time_utc"], flags["subsolar"])
    oblique = (flags["off_nadir"], flags["view_azimuth"], flags["altitude_km"])
    options.check_view(flags["camera_path"], *oblique, flags["frame"])
    options.check_accuracy(flags["accuracy"], flags["tolerance"])

    from lcp_catalog.accuracy import accuracy
    from lcp_catalog.camera import read_camera
    from lcp_catalog.exposure import Request, SunChoice, ViewChoice
    from lcp_catalog.reflectance import reflectance_model
    from lcp_catalog.terrain import Area

    camera = read_camera(flags["camera_path"]) if flags["camera_path"] else None
    if not sun_stated and (camera is None or not camera.has_sun):
        raise click.UsageError(
            "no Sun: state --sun-azimuth and --sun-elevation, or --time, or --subsolar"
            + (f" ({flags['camera_path']} has none)" if camera else "")
        )
    area = None
    if flags["center"]:
        area = Area(*flags["center"], flags["size_km"])
    elif flags["bounds"]:
        area = Area.from_bounds(*flags["bounds"])
    return Request(
        dem_paths=dem,
        area=area,
        gsd_m=flags["gsd_m"],
        sun=SunChoice(*angles, flags["time_utc"], flags["subsolar"]),
        view=ViewChoice(camera, oblique[0] or 0.0, oblique[1] or 0.0, oblique[2]),
        in_camera_plane=flags["frame"] == "camera",
        model=reflectance_model(flags["reflectance"] or options.REFLECTANCES[0]),
        accuracy=accuracy(flags["accuracy"], flags["tolerance"]),
        disc=None if flags["sun_model"] is None else flags["sun_model"] == "disc",
        product_order=flags["product_order"] or (),
    )


def _write(
    scene: Any,
    output: str,
    preview: str | None,
    depfile: str | None,
    overwrite: bool,
    camera: list[str],
) -> None:
    """Render and write; OUT.tif appears last, when everything else is whole."""
    from lcp_catalog.exposure import encode, expose
    from lcp_catalog.files import depfile_text, write_aside
    from lcp_catalog.raster_out import picture, png

    result = expose(scene)
    with ExitStack() as stack:
        stack.enter_context(write_aside(output, overwrite)).write_bytes(encode(scene, result))
        if preview:
            image = png(picture(result.radiance))
            stack.enter_context(write_aside(preview, overwrite)).write_bytes(image)
        if depfile:
            text = depfile_text(output, [*scene.sources, *camera])
            stack.enter_context(write_aside(depfile, True)).write_text(text, encoding="utf-8")


def _camera_of(flags: dict[str, Any]) -> list[str]:
    return [flags["camera_path"]] if flags["camera_path"] else []
