"""``lcp validate``: a catalogue against images: are its points there, where was the camera, does the render look alike."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import options
from .value_types import LAW, POSITIVE, Finite, Number

if TYPE_CHECKING:
    from lcp_catalog.validation.run import ImageFiles, Validation

EXIT_NO = 4

DEFAULT_LAW = "lunar-lambert"
"""What a navigator should carry (docs/photographs.md): it has a phase function, which a wide image needs."""


@click.command("validate")
@click.argument("catalog", metavar="CATALOG.h5", type=click.Path(exists=True, dir_okay=False))
@click.argument("images", metavar="IMAGE...", nargs=-1, required=True)
@options.output_option("DIR")
@click.option(
    "--camera",
    "cameras",
    multiple=True,
    metavar="CAMERA.json",
    help="What took the image: CAMERA.json, USGS ISD or .tsai; one for all images, or one for each in their order. "
    "Default: the image is map-projected and says so itself.",
)
@options.sun_angle_options
@click.option(
    "--dem",
    "dems",
    multiple=True,
    metavar="DEM",
    help="Compare the whole image with renders of this DEM, too (again for more files); else the catalogue's patches alone.",
)
@click.option(
    "--gsd",
    "gsd_m",
    type=POSITIVE,
    metavar="M",
    help="Cells on which windows are compared; default: the true resolution of --dem, estimated from its heights; "
    "of patches alone their own cells.",
)
@click.option(
    "--reflectance",
    type=LAW,
    default=DEFAULT_LAW,
    show_default=True,
    help="Law of reflection of the renders.",
)
@options.albedo_options
@options.accuracy_options
@click.option(
    "--position-sigma",
    "position_km",
    type=Number(0.0),
    default=1.0,
    show_default=True,
    metavar="KM",
    help="How well the camera's position is known (a map's place), 1 sigma of each axis; 0: exactly.",
)
@click.option(
    "--attitude-sigma",
    "attitude_deg",
    type=Number(0.0, 90.0),
    default=0.1,
    show_default=True,
    metavar="DEG",
    help="How well its attitude is known, 1 sigma about each axis; 0: exactly.",
)
@click.option(
    "--window",
    type=click.IntRange(3),
    default=16,
    show_default=True,
    metavar="N",
    help="Side of the windows that are compared, cells.",
)
@click.option(
    "--step",
    type=click.IntRange(1),
    metavar="N",
    help="From window to window; default: side by side.",
)
@click.option(
    "--remove-offset",
    is_flag=True,
    help="Shift the whole image by what it is off before windows are compared (the report says by how much).",
)
@click.option(
    "--encoding",
    type=click.Choice(options.ENCODINGS),
    default=options.ENCODINGS[0],
    show_default=True,
    help="What the image's numbers are: proportional to radiance, or the codes of a display picture.",
)
@click.option(
    "--band",
    type=click.IntRange(1),
    metavar="N",
    help="Band of the image; default: the first, of colours their luminance.",
)
@click.option(
    "--nodata",
    type=Finite(),
    metavar="V",
    help="A value that means nothing here, beside those that the image states itself.",
)
@click.option(
    "--faint",
    is_flag=True,
    help="For ground that hardly shades: let matches through that are doubtful alone; what agrees decides.",
)
@click.option(
    "--known-pose",
    is_flag=True,
    help="The camera file's position is the truth: report the found one's error against it.",
)
@click.option(
    "--require",
    metavar="EXPR",
    help="Exit code 4 unless this holds for every image, like 'share_above_0_9>=0.85 and points_found>=20'.",
)
@click.option("--json", "as_json", is_flag=True, help="Print report.json on stdout, too.")
@options.overwrite_option
@options.depfile_option
def command(
    catalog: str,
    images: tuple[str, ...],
    output: str,
    cameras: tuple[str, ...],
    require: str | None,
    as_json: bool,
    overwrite: bool,
    depfile: str | None,
    **flags: Any,
) -> int:
    """Find a catalogue's points in images, and compare the images with renders.

    DIR gets report.json, report.html (one page that needs no network), points.csv and windows.csv. See docs/validation.md.

    Exit code 4: an image is not the place that its camera file says, or --require does not hold.
    """
    files = _paired(images, cameras)
    from lcp_catalog.validation.requirement import Requirement

    wanted = None if require is None else Requirement.parse(require)
    if wanted and wanted.needs_known_pose and not flags["known_pose"]:
        raise click.UsageError(
            "--require: a position's error is only known with --known-pose (the camera file's position is the truth); "
            "add it, or demand position_sigma_m"
        )
    from lcp_catalog.validation.output import check_validation_folder, write_validation
    from lcp_catalog.validation.result import summary_lines
    from lcp_catalog.validation.run import validate

    from .progress import progress

    check_validation_folder(Path(output), overwrite, depfile)
    request = _request(catalog, files, **flags)
    with progress("images") as update:
        result = validate(request, update)
    write_validation(result, Path(output), overwrite, depfile)
    if as_json:
        click.echo(result.verdict.to_json(), nl=False)
    for line in summary_lines(result.verdict):
        click.echo(line, err=as_json)
    failures = wanted.failures(result.verdict.document()) if wanted else []
    for line in failures:
        click.echo(f"lcp: --require: {line}", err=True)
    click.echo(f"{output}/report.html: written", err=True)
    return EXIT_NO if failures or not result.located else 0


def _paired(images: tuple[str, ...], cameras: tuple[str, ...]) -> list[ImageFiles]:
    """Each image with its camera; usage error where the numbers do not fit."""
    if len(cameras) not in {0, 1, len(images)}:
        raise click.UsageError(
            f"{len(cameras)} --camera for {len(images)} images: state one, or one for each in their order"
        )
    from lcp_catalog.validation.run import ImageFiles

    each = cameras * len(images) if len(cameras) == 1 else cameras or (None,) * len(images)
    return [
        ImageFiles(Path(image), Path(camera) if camera else None)
        for image, camera in zip(images, each, strict=True)
    ]


def _request(catalog: str, files: list[ImageFiles], **flags: Any) -> Validation:
    angles = flags["sun_azimuth"], flags["sun_elevation"]
    options.check_sun(*angles, flags["time_utc"], flags["subsolar"])
    options.check_accuracy(flags["accuracy"], flags["tolerance"])
    albedo = flags["albedo_path"], flags["albedo_encoding"], flags["albedo_reference"]
    options.check_albedo(*albedo)

    from lcp_catalog.accuracy import accuracy
    from lcp_catalog.cameras.sensor import Uncertainty
    from lcp_catalog.images.image_file import PhotoOptions
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.photometry.albedo_map import AlbedoMap
    from lcp_catalog.photometry.law_choice import named
    from lcp_catalog.validation.ground_comparison import WindowChoice
    from lcp_catalog.validation.run import Validation

    size = flags["window"]
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
        pose_is_known=flags["known_pose"],
        faint=flags["faint"],
        pixels=PhotoOptions(flags["band"], flags["nodata"], encoding=flags["encoding"]),
    )
