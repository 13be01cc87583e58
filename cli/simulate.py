"""``lcp simulate``: a simulated camera frame."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lcp_catalog.choices import PNG, TIFF

from . import options, pointing_options, render_options
from .environment_options import check_environment, environment, environment_options
from .files import FileCommand, InputFile, raster_files
from .value_types import CELL_SIZE, LATITUDE, LONGITUDE, POSITIVE, Number

if TYPE_CHECKING:
    from lcp_catalog.simulation.detector import Detector
    from lcp_catalog.simulation.frame import Surface

BITS = ("8", "10", "12", "14", "16")


def _read_with(source: str) -> Iterator[Path]:
    from lcp_catalog.simulation.patch_surface import is_catalog

    if not is_catalog(source):
        yield from raster_files(source)


def _written(frame: str) -> Iterator[Path]:
    from lcp_catalog.simulation.output import camera_path

    yield from (Path(frame), camera_path(frame))


@click.command(
    cls=FileCommand,
    example="lcp simulate DEM.tif -o frame.png --camera CAMERA.json --sun-azimuth 96 --sun-elevation 14 --noise 0.02",
)
@click.argument(
    "source",
    nargs=-1,
    required=True,
    type=InputFile(_read_with),
    metavar="CATALOG.h5|DEM...",
)
@options.product_order_option
@options.output_option("FRAME.png|.tif", written=_written)
@click.option(
    "--camera",
    "camera_path",
    type=InputFile(),
    metavar="CAMERA.json",
    help="Camera of the frame; or one without a file: --fov.",
)
@pointing_options.pointing_options
@click.option(
    "--center",
    nargs=2,
    type=click.Tuple([LONGITUDE, LATITUDE]),
    metavar="LON LAT",
    help="With --fov: the point under the camera, degrees.",
)
@click.option(
    "--altitude",
    "altitude_km",
    type=POSITIVE,
    metavar="KM",
    help="With --fov: altitude of the camera above the reference sphere.",
)
@options.sun_options
@render_options.bounce_option("off")
@environment_options
@options.model_options
@options.albedo_options
@click.option(
    "--gsd", "gsd_m", type=CELL_SIZE, metavar="M", help="Cell size; default: the DEM's own."
)
@click.option(
    "--blur",
    "blur_px",
    type=Number(0.0, 16.0),
    default=0.0,
    show_default=True,
    metavar="PX",
    help="Point spread: standard deviation of a Gaussian, pixels.",
)
@click.option(
    "--noise",
    type=Number(0.0, 10.0),
    default=0.0,
    show_default=True,
    metavar="SHARE",
    help="1 sigma of the noise at the mean lit signal, as a share of it; 0.02: a signal-to-noise ratio of 50.",
)
@click.option(
    "--shot-share",
    type=Number(0.0, 1.0),
    default=0.5,
    show_default=True,
    metavar="SHARE",
    help="Share of that noise's variance that is photon noise, which grows with the signal.",
)
@click.option(
    "--exposure",
    "full_scale",
    type=POSITIVE,
    metavar="I/F",
    help="Radiance factor of saturation; default: the 99.5th percentile of lit pixels at 80 % of full scale.",
)
@click.option(
    "--bits",
    type=click.Choice(BITS),
    default="8",
    show_default=True,
    help="Bits of a pixel's number.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="N",
    help="Seed of the noise.",
)
@click.option(
    "--samples",
    type=click.IntRange(1, 16),
    metavar="N",
    help="N x N rays per pixel; default: one per cell, 2 to 4.",
)
@options.depfile_option
@options.overwrite_option
def command(
    source: tuple[str, ...], output: str, depfile: str | None, overwrite: bool, **flags: Any
) -> None:
    """Simulate a camera frame of a DEM, or of a catalogue's patches.

    A .png holds the detector's numbers, a .tif the radiance factor computed from them. The camera, with
    the Sun's position, is written beside the frame as FRAME_camera.json; lcp validate reads both files.
    The default accuracy tier is reference.
    """
    sun, albedo = _checked(output, flags)

    from lcp_catalog.atomic_files import check_output
    from lcp_catalog.simulation.detector import Detector
    from lcp_catalog.simulation.frame import frame
    from lcp_catalog.simulation.output import camera_path

    camera = pointing_options.camera_of(flags, plane=True)
    assert camera is not None
    lit = flags["environment_path"] is not None or any(value is not None for value in sun)
    if not lit and not camera.has_sun:
        raise click.UsageError(
            "no Sun: state --sun-azimuth and --sun-elevation, or --time, or --subsolar, or --environment"
            + (f" ({flags['camera_path']} has none)" if flags["camera_path"] else "")
        )
    chosen = ("blur_px", "noise", "shot_share", "full_scale", "seed")
    detector = Detector(bits=int(flags["bits"]), **{name: flags[name] for name in chosen})
    beside = str(camera_path(output))
    for name, replaced in ((output, overwrite), (beside, overwrite), (depfile, True)):
        if name:
            check_output(name, replaced)
    surface = _surface(source, camera, detector, sun, albedo, flags)
    taken = frame(surface, camera, detector, flags["samples"])
    read = [flags["camera_path"]] if flags["camera_path"] else []
    _write(taken, output, beside, depfile, overwrite, read)


def _checked(output: str, flags: dict[str, Any]) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Values of the Sun and albedo options; usage errors for options that exclude each other."""
    pointing_options.check_pointing(flags)
    if flags["camera_path"] is None and flags["fov_deg"] is None:
        raise click.UsageError("no camera: give --camera CAMERA.json, or --fov DEG")
    if flags["camera_path"] and (flags["center"] is not None or flags["altitude_km"] is not None):
        raise click.UsageError("--center and --altitude need --fov DEG")
    options.check_accuracy(flags["accuracy"], flags["tolerance"])
    sun = (flags["sun_azimuth"], flags["sun_elevation"], flags["time_utc"], flags["subsolar"])
    check_environment(flags, options.check_sun(*sun))
    albedo = (flags["albedo_path"], flags["albedo_encoding"], flags["albedo_reference"])
    options.check_albedo(*albedo)
    if Path(output).suffix.lower() not in PNG + TIFF:
        raise click.UsageError(f"-o {output}: the output must end in .png or .tif")
    return sun, albedo


def _surface(
    source: tuple[str, ...],
    camera: Any,
    detector: Detector,
    sun: tuple[Any, ...],
    albedo: tuple[Any, ...],
    flags: dict[str, Any],
) -> Surface:
    """The surface of a DEM, or of a catalogue's patches."""
    from lcp_catalog.accuracy import accuracy
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.photometry.colour_map import open_grey_map
    from lcp_catalog.photometry.law_choice import named
    from lcp_catalog.rendering.request import Request, ViewChoice
    from lcp_catalog.simulation.frame import DemSurface
    from lcp_catalog.simulation.patch_surface import PatchSurface, is_catalog

    tier = flags["accuracy"] or (None if flags["tolerance"] is not None else "reference")
    how: dict[str, Any] = {
        "model": named(flags["reflectance"] or "auto"),
        "accuracy": accuracy(tier, flags["tolerance"]),
        "disc": None if flags["sun_model"] is None else flags["sun_model"] == "disc",
    }
    choice = SunChoice(*sun)
    how["environment"] = environment(flags)
    if is_catalog(source[0]):
        of_dems = albedo[0], flags["gsd_m"], flags["product_order"], flags["bounce"] == "on"
        if len(source) > 1 or any(of_dems):
            raise click.UsageError(
                f"{source[0]} is a catalogue: give it alone, without --gsd, --albedo, --bounce and --product-order"
            )
        return PatchSurface.lit(Path(source[0]), choice, camera, **how)
    request = Request(
        dem_paths=source,
        gsd_m=flags["gsd_m"],
        sun=choice,
        view=ViewChoice.of(camera),
        product_order=flags["product_order"] or (),
        albedo=open_grey_map(*albedo) if albedo[0] else None,
        bounce=flags["bounce"],
        **how,
    )
    return DemSurface.seen(request, detector.margin_px)


def _write(
    taken: Any, output: str, beside: str, depfile: str | None, overwrite: bool, camera: list[str]
) -> None:
    """Write all outputs; FRAME appears last, after all others are complete."""
    from lcp_catalog.atomic_files import depfile_rule, write_aside
    from lcp_catalog.simulation.output import encode_camera, encode_frame

    with ExitStack() as stack:
        stack.enter_context(write_aside(output, overwrite)).write_bytes(encode_frame(taken, output))
        stack.enter_context(write_aside(beside, overwrite)).write_bytes(
            encode_camera(taken, *camera)
        )
        if depfile:
            rule = depfile_rule(output, [*taken.sources, *camera])
            stack.enter_context(write_aside(depfile, True)).write_bytes(rule)
