"""``lcp simulate``: a simulated camera frame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from . import options, render_options
from .build_options import field_option, model_options
from .environment_options import EnvironmentOptions, environment_options
from .files import FileCommand, InputFile, OutputFile, raster_files
from .groups import collected
from .pointing_options import CameraOptions, camera_options
from .value_types import POSITIVE, Number
from .warm_up import compile_missing

if TYPE_CHECKING:
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.production.model_config import ModelConfig
    from lcp_catalog.simulation.detector import Detector

BITS = ("8", "10", "12", "14", "16")


def _read_with(source: str) -> Iterator[Path]:
    from lcp_catalog.simulation.patch_surface import is_catalog

    if not is_catalog(source):
        yield from raster_files(source)


def _written(frame: str) -> Iterator[Path]:
    from lcp_catalog.simulation.output import camera_path

    yield from (Path(frame), camera_path(frame))


def _detector(
    blur_px: float,
    noise: float,
    shot_share: float,
    full_scale: float | None,
    bits: str,
    seed: int,
) -> Detector:
    from lcp_catalog.simulation.detector import Detector

    return Detector(
        blur_px=blur_px,
        noise=noise,
        shot_share=shot_share,
        full_scale=full_scale,
        bits=int(bits),
        seed=seed,
    )


detector_options = collected(
    "detector",
    _detector,
    click.option(
        "--blur",
        "blur_px",
        type=Number(0.0, 16.0),
        default=0.0,
        metavar="PX",
        help="Point spread: standard deviation of a Gaussian, pixels.",
    ),
    click.option(
        "--noise",
        type=Number(0.0, 10.0),
        default=0.0,
        metavar="SHARE",
        help="1 sigma of the noise at the mean lit signal, as a share of it; 0.02: a signal-to-noise ratio of 50.",
    ),
    click.option(
        "--shot-share",
        type=Number(0.0, 1.0),
        default=0.5,
        metavar="SHARE",
        help="Share of that noise's variance that is photon noise, which grows with the signal.",
    ),
    click.option(
        "--exposure",
        "full_scale",
        type=POSITIVE,
        metavar="I/F",
        help="Radiance factor of saturation; default: the 99.5th percentile of lit pixels at 80 % of full scale.",
    ),
    click.option(
        "--bits",
        type=click.Choice(BITS),
        default="8",
        help="Bits of a pixel's number.",
    ),
    click.option(
        "--seed",
        type=click.IntRange(min=0),
        default=0,
        metavar="N",
        help="Seed of the noise.",
    ),
)


@click.command(
    cls=FileCommand,
    rule=True,
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
@options.output_option("FRAME.png|.tif", OutputFile(_written))
@camera_options("Camera of the frame; or one without a file: --fov.")
@options.center_option("With --fov: the point under the camera, degrees.", "center_deg")
@options.altitude_option("With --fov: altitude of the camera above the reference sphere.")
@options.sun_angle_options
@options.disc_option
@render_options.bounce_option("off")
@environment_options
@model_options
@field_option("area.gsd_m", "the DEM's own")
@detector_options
@click.option(
    "--samples",
    type=click.IntRange(1, 16),
    metavar="N",
    help="N x N rays per pixel; default: one per cell, 2 to 4.",
)
@options.overwrite_option
def command(
    source: tuple[str, ...],
    output: str,
    product_order: tuple[str, ...] | None,
    camera: CameraOptions,
    center_deg: tuple[float, float] | None,
    altitude_km: float | None,
    sun: SunChoice,
    disc: bool | None,
    bounce: str,
    light: EnvironmentOptions,
    model: ModelConfig,
    gsd_m: float | None,
    detector: Detector,
    samples: int | None,
    overwrite: bool,
) -> None:
    """Simulate a camera frame of a DEM, or of a catalogue's patches.

    A .png holds the detector's numbers, a .tif the radiance factor computed from them. The camera, with
    the Sun's position, is written beside the frame as FRAME_camera.json; lcp validate reads both files.
    The default accuracy tier is reference.
    """
    if not camera.is_given:
        raise click.UsageError("no camera: give --camera CAMERA.json, or --fov DEG")
    if not camera.is_pointed and (center_deg is not None or altitude_km is not None):
        raise click.UsageError("--center and --altitude need --fov DEG")
    camera.check_place(center_deg, altitude_km)
    sun.beside(light.environment, disc)

    from lcp_catalog.atomic_files import write_files
    from lcp_catalog.photometry.albedo_map import open_grey_map
    from lcp_catalog.simulation.output import (
        camera_path,
        encode_camera,
        encode_frame,
        lone_catalog,
        simulate,
    )

    lone_catalog(source, gsd_m, model.albedo_file, bounce == "on", product_order)

    seen = camera.open(center_deg, altitude_km, plane=True)
    assert seen is not None
    camera.check_lit(sun, light, seen)
    beside = str(camera_path(output))
    compile_missing("simulate")
    taken = simulate(
        source,
        seen,
        sun=sun,
        disc=disc,
        environment=light.open(),
        bounce=bounce,
        detector=detector,
        samples=samples,
        gsd_m=gsd_m,
        reflectance=model.reflectance,
        albedo=options.albedo_map(model, open_grey_map),
        accuracy=model.accuracy,
        tolerance=model.tolerance,
        product_order=product_order or (),
    )
    files = {output: encode_frame(taken, output), beside: encode_camera(taken, camera.camera)}
    write_files(files, overwrite)
