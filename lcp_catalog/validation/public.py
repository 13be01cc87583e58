"""Public function that compares a catalogue with images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..accuracy import accuracy as accuracy_of
from ..atomic_files import check_folder
from ..cameras.sensor import Uncertainty
from ..choices import BOUNCES, ENCODINGS, VALIDATION_LAW
from ..dem.public import Dems, dem_paths
from ..errors import ConfigError
from ..images.image_file import ImageOptions
from ..light.environment import Environment
from ..light.sun_choice import SunChoice, SunStated
from ..photometry.albedo_map import AlbedoMap
from ..photometry.law_choice import law_of
from ..photometry.laws import Reflectance
from ..stages import Progress, unseen
from .ground_comparison import WindowChoice
from .output import FILES, write_validation
from .run import ImageFiles, Result, Validation, run_validation


def validate(
    catalog: Path | str,
    images: Path | str | Sequence[Path | str],
    cameras: Path | str | Sequence[Path | str | None] | None = None,
    output: Path | str | None = None,
    *,
    position_sigma_m: float = 1000.0,
    attitude_sigma_deg: float = 0.1,
    known_pose: bool = False,
    sun: SunStated = None,
    disc: bool | None = None,
    bounce: str = BOUNCES[2],
    environment: Environment | Path | str | None = None,
    dem: Dems = (),
    gsd_m: float | None = None,
    window: int = 16,
    step: int | None = None,
    remove_offset: bool = False,
    reflectance: Reflectance | str = VALIDATION_LAW,
    albedo: AlbedoMap | Path | str | None = None,
    accuracy: str | None = None,
    tolerance: float | None = None,
    encoding: str = ENCODINGS[0],
    band: int | None = None,
    nodata: float | None = None,
    faint: bool = False,
    fit_errors: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Find a catalogue's points in images, solve for each camera's position, and compare the images
    with renders.

    Parameters
    ----------
    catalog:
        The catalogue's file.
    images:
        Image files, one or several.
    cameras:
        Their camera files: one for all, or one each; None for an image in a map projection.
    output:
        Also write report.json, report.html, points.csv and windows.csv into this folder.
    position_sigma_m, attitude_sigma_deg:
        Uncertainty of the cameras, 1 sigma for each axis; 0: exact.
    known_pose:
        True: the camera files' positions are the true ones; the error of the estimate is reported.
    sun:
        The Sun: its azimuth, degrees clockwise from north, and elevation at the image's centre; or an instant (ISO
        text, UTC); or a `SunChoice`. None: the Sun of the camera's file.
    disc:
        Renders of the DEM under the solar disc (True) or a point (False); None: as the accuracy says.
    bounce:
        Renders of the DEM with light that reaches ground by way of other ground: ``auto``, ``on`` or ``off``.
    environment:
        In place of the Sun: an environment map (equirectangular panorama).
    dem:
        Compare the whole image with renders of these DEMs; none: with the catalogue's patches.
    gsd_m:
        Cell size at which windows are compared; None: the DEM's effective resolution, or the cells of
        the patches.
    window, step:
        Side and spacing of the compared windows, cells; None: windows adjoin.
    remove_offset:
        True: remove the image's overall offset before windows are compared.
    reflectance:
        Reflectance law of the renders, or its name.
    albedo:
        Albedo map, or its file.
    accuracy, tolerance:
        Tier (`accuracy.TIERS`), or instead the largest error of a node's sunlit share.
    encoding:
        ``linear``, ``srgb``, or ``auto``: srgb for 8 bits if the points found correlate better so.
    band, nodata:
        Band of the images (None: the first, or luminance), and an additional value of missing pixels.
    faint:
        True: accept weak matches and rely on their mutual agreement.
    fit_errors:
        True: also fit an error model to the points searched for in each kind of images (`Result.fitted`).
    overwrite:
        True: replace existing files of the folder.
    progress:
        Called with the number of images done and of all.

    Returns
    -------
    Result
        ``verdict``, with ``document()``, the content of report.json; ``located``; ``fitted``.

    Raises
    ------
    CatalogError, DemError, ImageError, CameraError, SunError
        For files that cannot be read; errors of one image are its result, unless all fail.
    ConfigError
        For other numbers of images and cameras, for an image that stands twice with one camera, for ``disc`` or ``bounce``
        without ``dem``, and for ``sun`` or ``disc`` beside ``environment``.

    Examples
    --------
    >>> found = lcp.validate(catalog, folder / "AS15-M-0414.png", camera)
    >>> image, = found.verdict.document()["images"]
    >>> image["image"], image["points_in_view"] > 0
    ('AS15-M-0414.png', True)
    """
    check_light(dem, disc, bounce)
    folder = None if output is None else Path(output)
    if folder is not None:
        check_folder(folder, FILES, overwrite)
    auto = encoding == "auto"
    result = run_validation(
        Validation(
            catalog_path=Path(catalog),
            files=image_files(images, cameras),
            uncertainty=Uncertainty(position_sigma_m, float(np.radians(attitude_sigma_deg))),
            dem_paths=dem_paths(dem),
            windows=WindowChoice(window, step or window, gsd_m, remove_offset),
            sun=SunChoice.of(sun).beside(environment, disc),
            model=law_of(reflectance),
            accuracy=accuracy_of(accuracy, tolerance),
            albedo=AlbedoMap.open(albedo) if isinstance(albedo, Path | str) else albedo,
            pose_is_known=known_pose,
            pixels=ImageOptions(band, nodata, encoding=ENCODINGS[0] if auto else encoding),
            faint=faint,
            fit_errors=fit_errors,
            choose_encoding=auto,
            environment=Environment.opened(environment),
            disc=disc,
            bounce=bounce,
        ),
        progress or unseen,
    )
    if folder is not None:
        write_validation(result, folder, overwrite)
    return result


def check_light(dem: Dems, disc: bool | None, bounce: str) -> None:
    """ConfigError for light that only renders of DEMs have, without one; arguments as `validate`."""
    for name, is_stated in (("disc", disc is not None), ("bounce", bounce != BOUNCES[2])):
        if is_stated and not dem_paths(dem):
            raise ConfigError(f"`{name}` needs `dem`: only renders of a DEM have this light")


def image_files(
    images: Path | str | Sequence[Path | str],
    cameras: Path | str | Sequence[Path | str | None] | None,
) -> tuple[ImageFiles, ...]:
    """Each image with its camera file. ConfigError if their numbers do not match, and for an image that stands twice with
    one camera.
    """
    shown = [images] if isinstance(images, Path | str) else list(images)
    seen = [cameras] if cameras is None or isinstance(cameras, Path | str) else list(cameras)
    if len(seen) == 1:
        seen *= len(shown)
    if len(seen) != len(shown):
        raise ConfigError(
            f"{len(seen)} `cameras` for {len(shown)} images: give one, or one per image in the same order"
        )
    files = tuple(
        ImageFiles(Path(image), None if camera is None else Path(camera))
        for image, camera in zip(shown, seen, strict=True)
    )
    places = [(one.image.resolve(), one.camera and one.camera.resolve()) for one in files]
    for one, place in zip(files, places, strict=True):
        if places.count(place) > 1:
            raise ConfigError(
                f"{one.image}: stands twice among the images and would count twice; name each image once"
            )
    return files
