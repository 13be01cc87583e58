"""``lcp render``: one image of an area."""

from __future__ import annotations

import json

import click

from . import options
from .files import FileCommand
from .messages import echo
from .names import option as option_of
from .render_options import RenderOptions, render_options
from .warm_up import compile_missing


@click.command(
    cls=FileCommand,
    rule=True,
    example="lcp render DEM.tif -o site.tif --center 3.5 26 --size 20 --sun-azimuth 96 --sun-elevation 14 --preview site.png",
)
@render_options
@options.output_option("OUT.tif", required=False)
@options.other_output_option(
    "--preview",
    "OUT.png",
    "Also write the radiance as an 8-bit PNG, in colour under an albedo map in colour.",
)
@click.option(
    "--explain",
    is_flag=True,
    help="Print the scene plan as JSON: which effects are modelled, why, with what error bound and switch, and "
    "with -o what share of the time each takes. Without -o nothing is rendered.",
)
@options.overwrite_option
def command(
    asked: RenderOptions, output: str | None, preview: str | None, explain: bool, overwrite: bool
) -> None:
    """Render one image of an area of the Moon.

    The area is given by --center and --size or by --bounds; --size alone gives a square within what the camera sees
    (--around). Without these options the area is what the camera sees or, without a camera, the whole DEM. The Sun is
    given by --sun-azimuth and --sun-elevation, by --time or by --subsolar; without them it is the camera file's. Without
    view options the view is straight down. With --fov, --altitude and --look the image is that of a camera above
    --center.

    Bands of OUT.tif: radiance, sunlit, visible, incidence, emission, phase (degrees), and height (metres). With
    --frame camera, x, y and z (metres, MCMF) take the place of height. An albedo map in colour adds radiance_red,
    radiance_green and radiance_blue.
    """
    if output is None and not explain:
        raise click.UsageError("-o OUT.tif is missing (or --explain)")
    if output is None and preview:
        raise click.UsageError("--preview needs -o OUT.tif")

    from lcp_catalog.atomic_files import write_files
    from lcp_catalog.rendering.pipeline import prepare
    from lcp_catalog.rendering.public import encode, picture, png
    from lcp_catalog.rendering.public import explain as explained
    from lcp_catalog.stages import shares_of_time

    request = asked.request()
    compile_missing("render")
    image = None
    with shares_of_time() as costs:
        scene = prepare(request)
        if output is not None:
            image = scene.expose()
    if output is not None and image is not None:
        files = {output: encode(scene, image)}
        if preview is not None:
            seen = image.radiance if image.colour is None else image.colour
            shown = seen if image.composite is None else image.composite
            files[preview] = png(picture(shown))
        write_files(files, overwrite)
    if explain:
        found = explained(scene, None if image is None else costs)
        for one in found["decisions"]:
            one["switch"] = one["switch"] and option_of(one["switch"])
        echo(json.dumps(found, indent=2))
