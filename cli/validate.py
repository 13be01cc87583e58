"""``lcp validate``: control points found in images, the camera's position, images against renders."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lcp_catalog.choices import ENCODINGS, VALIDATION_LAW

from . import options
from .environment_options import check_environment, environment, environment_options
from .files import FileCommand, InputFile, OutputFile
from .messages import EXIT_NO, echo, say
from .value_types import CELL_SIZE, LAW, Distance, Finite, Number

if TYPE_CHECKING:
    from lcp_catalog.validation.run import ImageFiles, Validation


def _written(folder: str) -> Iterator[Path]:
    from lcp_catalog.validation.output import FILES

    yield from (Path(folder, name) for name in FILES)


@click.command(
    "validate",
    cls=FileCommand,
    example="lcp validate site.h5 IMAGE.png -o check --camera CAMERA.json --dem A.tif B.tif",
)
@options.catalog_argument
@click.argument("images", metavar="IMAGE...", nargs=-1, required=True, type=options.RASTER)
@options.output_option("DIR", written=_written)
@click.option(
    "--camera",
    "cameras",
    type=InputFile(),
    multiple=True,
    metavar="CAMERA.json",
    help="Camera file: CAMERA.json, USGS ISD or .tsai; one for all images, or one per image in the same order. "
    "Default: none, for images that are georeferenced map projections.",
)
@options.sun_options
@environment_options
@click.option(
    "--dem",
    "dems",
    type=options.RASTER,
    multiple=True,
    metavar="DEM...",
    help="Compare the whole image with renders of these DEMs. Default: compare with the catalogue's patches only.",
)
@click.option(
    "--gsd",
    "gsd_m",
    type=CELL_SIZE,
    metavar="M",
    help="Cell size at which windows are compared; default: the effective resolution of --dem, estimated from its "
    "heights, or the cell size of the patches.",
)
@click.option(
    "--reflectance",
    type=LAW,
    default=VALIDATION_LAW,
    show_default=True,
    help="Reflectance model (law) of the renders.",
)
@options.albedo_options
@options.accuracy_options
@click.option(
    "--position-sigma",
    "position_km",
    type=Distance(),
    default=1.0,
    show_default=True,
    metavar="KM",
    help="Uncertainty of the camera's position, or of a map's georeference: 1 sigma per axis; 0: exact. In km, or "
    "with a unit: 300m, 2km.",
)
@click.option(
    "--attitude-sigma",
    "attitude_deg",
    type=Number(0.0, 90.0),
    default=0.1,
    show_default=True,
    metavar="DEG",
    help="Uncertainty of the camera's attitude: 1 sigma about each axis; 0: exact.",
)
@click.option(
    "--window",
    type=click.IntRange(3),
    default=16,
    show_default=True,
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
    show_default=True,
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
@click.option(
    "--fit-errors",
    "errors_file",
    type=OutputFile(dir_okay=False),
    metavar="ERRORS.toml",
    help="Also fit the error model of image and render to the points searched for in all images, and write it as the "
    "section [errors] of a BUILD.toml.",
)
@click.option("--json", "as_json", is_flag=True, help="Also print report.json on stdout.")
@options.overwrite_option
@options.depfile_option
def command(
    catalog: str,
    images: tuple[str, ...],
    output: str,
    cameras: tuple[str, ...],
    require: str | None,
    errors_file: str | None,
    as_json: bool,
    overwrite: bool,
    depfile: str | None,
    **flags: Any,
) -> int:
    """Find a catalogue's points in images and compare the images with renders.

    The camera's position and attitude are estimated from the points that are found.

    Writes DIR/report.json, DIR/report.html (one self-contained page), DIR/points.csv and
    DIR/windows.csv.

    Exit code 4: an image does not show the place that its camera file states, or --require is
    not met.
    """
    files = _paired(images, cameras)
    from lcp_catalog.validation.requirement import Requirement

    wanted = None if require is None else Requirement.parse(require)
    if wanted and wanted.needs_known_pose and not flags["known_pose"]:
        raise click.UsageError(
            "--require: the position error is known only with --known-pose (the camera file's position is the true one); "
            "add --known-pose, or require position_sigma_m"
        )
    from lcp_catalog.validation.output import check_validation_folder, write_validation
    from lcp_catalog.validation.result import summary_lines
    from lcp_catalog.validation.run import run_validation

    from .progress import progress

    fitted = Path(errors_file) if errors_file else None
    check_validation_folder(Path(output), overwrite, depfile, fitted)
    request = _request(catalog, files, fit_errors=fitted is not None, **flags)
    with progress("images") as update:
        result = run_validation(request, update)
    write_validation(result, Path(output), overwrite, depfile, fitted)
    if as_json:
        click.echo(result.verdict.to_json(), nl=False)
    for line in summary_lines(result.verdict):
        echo(line, err=as_json)
    failures = wanted.failures(result.verdict.document()) if wanted else []
    for line in failures:
        say(f"lcp: --require: {line}")
    if result.fitted:
        say(f"{errors_file}: errors fitted to {result.fitted.points} points")
    say(f"{output}/report.html: written")
    return EXIT_NO if failures or not result.located else 0


def _paired(images: tuple[str, ...], cameras: tuple[str, ...]) -> list[ImageFiles]:
    """Return each image with its camera file. Usage error if their numbers do not match."""
    if len(cameras) not in {0, 1, len(images)}:
        raise click.UsageError(
            f"{len(cameras)} --camera for {len(images)} images: give one, or one per image in the same order"
        )
    from lcp_catalog.validation.run import ImageFiles

    each = cameras * len(images) if len(cameras) == 1 else cameras or (None,) * len(images)
    return [
        ImageFiles(Path(image), Path(camera) if camera else None)
        for image, camera in zip(images, each, strict=True)
    ]


def _request(catalog: str, files: list[ImageFiles], **flags: Any) -> Validation:
    angles = flags["sun_azimuth"], flags["sun_elevation"]
    check_environment(flags, options.check_sun(*angles, flags["time_utc"], flags["subsolar"]))
    disc = flags["sun_model"] and flags["sun_model"] == "disc"
    if disc is not None and not flags["dems"]:
        raise click.UsageError("--sun needs --dem: it is the Sun of the DEM's renders")
    options.check_accuracy(flags["accuracy"], flags["tolerance"])
    albedo = flags["albedo_path"], flags["albedo_encoding"], flags["albedo_reference"]
    options.check_albedo(*albedo)

    from lcp_catalog.accuracy import accuracy
    from lcp_catalog.cameras.sensor import Uncertainty
    from lcp_catalog.images.image_file import ImageOptions
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.photometry.albedo_map import AlbedoMap
    from lcp_catalog.photometry.law_choice import named
    from lcp_catalog.validation.ground_comparison import WindowChoice
    from lcp_catalog.validation.run import Validation

    size, auto = flags["window"], flags["encoding"] == "auto"
    return Validation(
        catalog_path=Path(catalog),
        files=tuple(files),
        uncertainty=Uncertainty(1e3 * flags["position_km"], math.radians(flags["attitude_deg"])),
        dem_paths=tuple(Path(path) for path in flags["dems"]),
        windows=WindowChoice(size, flags["step"] or size, flags["gsd_m"], flags["remove_offset"]),
        sun=SunChoice(*angles, flags["time_utc"], flags["subsolar"]),
        model=named(flags["reflectance"]),
        accuracy=accuracy(flags["accuracy"], flags["tolerance"]),
        albedo=AlbedoMap.open(*albedo) if albedo[0] else None,
        environment=environment(flags),
        disc=disc,
        pose_is_known=flags["known_pose"],
        faint=flags["faint"],
        fit_errors=flags["fit_errors"],
        pixels=ImageOptions(
            flags["band"], flags["nodata"], encoding=ENCODINGS[0] if auto else flags["encoding"]
        ),
        choose_encoding=auto,
    )
