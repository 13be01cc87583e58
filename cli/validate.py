"""``lcp validate``: control points found in images, the camera's position, images against renders."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lcp_catalog.choices import ENCODINGS, VALIDATION_LAW

from . import options
from .build_options import field_option, image_model
from .environment_options import EnvironmentOptions, environment_options
from .files import RASTER, FileCommand, OutputFile, depfile_option
from .messages import EXIT_NO, echo, say
from .names import in_options
from .progress import progress
from .render_options import bounce_option
from .value_types import Distance, Finite, Number
from .warm_up import compile_missing

if TYPE_CHECKING:
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.production.model_config import ModelConfig


def _written(folder: str) -> Iterator[Path]:
    from lcp_catalog.validation.output import FILES

    yield from (Path(folder, name) for name in FILES)


@click.command(
    "validate",
    cls=FileCommand,
    example="lcp validate site.h5 IMAGE.png -o check --camera CAMERA.json --dem A.tif B.tif",
)
@options.catalog_argument
@click.argument("images", metavar="IMAGE...", nargs=-1, required=True, type=RASTER)
@options.output_option("DIR", OutputFile(_written))
@options.camera_file_option(
    "Camera file: CAMERA.json, USGS ISD or .tsai; one for all images, or one per image in the same order. "
    "Default: none, for images that are georeferenced map projections.",
    "cameras",
    multiple=True,
)
@options.sun_angle_options
@options.disc_option
@bounce_option("off")
@environment_options
@options.dems_option(
    "Compare the whole image with renders of these DEMs. Default: compare with the catalogue's patches only."
)
@field_option(
    "area.gsd_m",
    "the effective resolution of --dem, estimated from its heights, or the cell size of the patches",
)
@image_model(field_option("model.reflectance", VALIDATION_LAW, default=VALIDATION_LAW))
@click.option(
    "--position-sigma",
    "position_sigma_km",
    type=Distance(),
    default=1.0,
    metavar="KM",
    help="Uncertainty of the camera's position, or of a map's georeference: 1 sigma per axis; 0: exact. In km, or "
    "with a unit: 300m, 2km.",
)
@click.option(
    "--attitude-sigma",
    "attitude_sigma_deg",
    type=Number(0.0, 90.0),
    default=0.1,
    metavar="DEG",
    help="Uncertainty of the camera's attitude: 1 sigma about each axis; 0: exact.",
)
@click.option(
    "--window",
    type=click.IntRange(3),
    default=16,
    metavar="N",
    help="Side length of the compared windows, cells.",
)
@click.option(
    "--step",
    type=click.IntRange(1),
    metavar="N",
    help="Spacing of the windows, cells; default: the window's side, so that windows adjoin.",
)
@click.option(
    "--remove-offset",
    is_flag=True,
    help="Remove the image's overall offset before windows are compared; the report states it.",
)
@click.option(
    "--encoding",
    type=click.Choice([*ENCODINGS, "auto"]),
    default=ENCODINGS[0],
    help="Encoding of the image: linear (values proportional to radiance) or srgb (codes of a display image), or auto: srgb "
    "for samples of 8 bits if the points found correlate significantly better so.",
)
@click.option(
    "--band",
    type=click.IntRange(1),
    metavar="N",
    help="Band of the image; default: the first band, or the luminance of a colour image.",
)
@click.option(
    "--nodata",
    type=Finite(),
    metavar="V",
    help="Additional nodata value, besides those that the image file declares; default: none.",
)
@click.option(
    "--faint",
    is_flag=True,
    help="For low-contrast terrain: accept weak matches and rely on their mutual agreement.",
)
@click.option(
    "--known-pose",
    is_flag=True,
    help="Take the camera file's position as the true one and report the error of the estimated position. Errors of "
    "single points are then counted from the given camera, also from its attitude.",
)
@click.option(
    "--require",
    metavar="EXPR",
    help="Condition for every image, like 'share_above_0_9>=0.85 and points_found>=20'; exit code 4 if it fails; default: none.",
)
@options.other_output_option(
    "--fit-errors",
    "ERRORS.toml",
    "Also fit the error model of image and render to the points searched for, and write it as the section [errors] of "
    "a BUILD.toml; a file for each kind of images. Simulated images: set errors.moving_share to 1 before.",
    "errors_file",
)
@options.json_option("Also print report.json on stdout.")
@options.overwrite_option
@depfile_option
def command(
    catalog: str,
    images: tuple[str, ...],
    output: str,
    cameras: tuple[str, ...],
    sun: SunChoice,
    disc: bool | None,
    bounce: str,
    light: EnvironmentOptions,
    dems: tuple[str, ...],
    gsd_m: float | None,
    model: ModelConfig,
    position_sigma_km: float,
    attitude_sigma_deg: float,
    window: int,
    step: int | None,
    remove_offset: bool,
    encoding: str,
    band: int | None,
    nodata: float | None,
    faint: bool,
    known_pose: bool,
    require: str | None,
    errors_file: str | None,
    as_json: bool,
    overwrite: bool,
    depfile: str | None,
) -> int:
    """Find a catalogue's points in images and compare the images with renders.

    The camera's position and attitude are estimated from the points that are found.

    Writes DIR/report.json, DIR/report.html (one self-contained page), DIR/points.csv and
    DIR/windows.csv.

    Exit code 4: an image does not show the place that its camera file states, or --require is
    not met.
    """
    sun.beside(light.environment, disc)
    from lcp_catalog.atomic_files import check_folder
    from lcp_catalog.photometry.albedo_map import AlbedoMap
    from lcp_catalog.validation.output import FILES, errors_files, write_validation
    from lcp_catalog.validation.public import check_light, image_files, validate
    from lcp_catalog.validation.requirement import Requirement
    from lcp_catalog.validation.result import summary_lines

    check_light(dems, disc, bounce)  # refused before kernels are compiled
    image_files(images, cameras or None)
    wanted = None if require is None else Requirement.parse(require)
    if wanted and wanted.needs_known_pose and not known_pose:
        raise click.UsageError(
            "--require: the position error is known only with --known-pose (the camera file's position is the true one); "
            "add --known-pose, or require position_sigma_m"
        )
    fitted = Path(errors_file) if errors_file else None
    check_folder(Path(output), FILES, overwrite)
    compile_missing("validate")
    with progress("images") as update:
        result = validate(
            catalog,
            images,
            cameras or None,
            position_sigma_m=1e3 * position_sigma_km,
            attitude_sigma_deg=attitude_sigma_deg,
            known_pose=known_pose,
            sun=sun,
            disc=disc,
            bounce=bounce,
            environment=light.open(),
            dem=dems,
            gsd_m=gsd_m,
            window=window,
            step=step,
            remove_offset=remove_offset,
            reflectance=model.reflectance,
            albedo=options.albedo_map(model, AlbedoMap.open),
            accuracy=model.accuracy,
            tolerance=model.tolerance,
            encoding=encoding,
            band=band,
            nodata=nodata,
            faint=faint,
            fit_errors=fitted is not None,
            progress=update,
        )
    write_validation(result, Path(output), overwrite, depfile, fitted)
    if as_json:
        echo(result.verdict.to_json(), nl=False)
    for line in summary_lines(result.verdict):
        echo(in_options(line), err=as_json)
    failures = wanted.failures(result.verdict.document()) if wanted else []
    for line in failures:
        say(f"lcp: --require: {line}")
    for path, errors in errors_files(Path(errors_file or ""), result.fitted):
        say(f"{path}: errors fitted to {errors.points} points ({errors.kind})")
    say(f"{output}/report.html: written")
    return EXIT_NO if failures or not result.located else 0
