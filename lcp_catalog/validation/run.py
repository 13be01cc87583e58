"""Validation of a catalogue with images: from the files of each image to its result.

Output folder of a validation: the report as JSON and as a page, and CSV tables (RFC 4180) of the
points and the windows.

Public function that compares a catalogue with images.
"""

from __future__ import annotations

import logging
import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..accuracy import TIERS, Accuracy
from ..accuracy import accuracy as accuracy_of
from ..arrays import Mask
from ..atomic_files import check_folder, csv_lines, depfile_rule, write_bytes, write_folder
from ..cameras.sensor import POSE, Sensor, Uncertainty, pixel_size_m
from ..cameras.view import center_of
from ..catalog.catalogue import Catalog
from ..catalog.verification import open_catalog
from ..choices import ENCODINGS, VALIDATION_LAW
from ..dem.mosaic import DemSet
from ..dem.public import Dems, dem_paths
from ..errors import (
    CameraError,
    CatalogError,
    ConfigError,
    DemError,
    ImageError,
    LcpError,
    SunError,
)
from ..geometry.ellipses import error_ellipses
from ..geometry.frames import Direction, EnuFrame, lonlat_to_mcmf
from ..images.image import Image
from ..images.image_file import ImageOptions, decoded, open_image, refuse_heights
from ..light.environment import Environment
from ..light.sun_choice import SunChoice, SunStated
from ..matching.matches import REASONS, Matches
from ..matching.point_choice import at_one_scale, points_in_view
from ..matching.point_search import Criteria
from ..matching.pose import PositionError, position_error
from ..matching.position_fix import CANNOT_SAY, FAINT, LOCATED, SEARCHED, Fix, Options, locate
from ..matching.search_area import perhaps_in_view
from ..photometry.albedo_map import AlbedoMap
from ..photometry.laws import Reflectance, law_of, reflectance_model
from ..plots.pictures import PIXELS_MAX
from .advice import EncodingCheck, advised, albedo_advice, check_encoding
from .claims import Claims, ClaimSearch
from .error_fit import FittedErrors, Residuals, fit_errors, residuals_of
from .ground_comparison import (
    GroundComparison,
    RenderSettings,
    WindowChoice,
    against_dem,
    against_patches,
)
from .report import render
from .result import (
    DIGITS,
    ImageFacts,
    ImageVerdict,
    Pictures,
    PointFigures,
    ValidationResult,
    WindowFigures,
)

Progress = Callable[[int, int], None]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ImageFiles:
    """An image and its camera file; None for an image in a map projection."""

    image: Path
    camera: Path | None = None

    @property
    def paths(self) -> list[Path]:
        return [self.image, *([self.camera] if self.camera else [])]

    def named(self, text: str) -> str:
        """A message with file names instead of paths, because results must not contain folders."""
        for path in self.paths:
            text = text.replace(str(path), path.name)
        return text

    def require(self) -> None:
        """Raise ImageError or CameraError if a file does not exist, ImageError for a DEM."""
        if not self.image.is_file():
            raise ImageError(f"{self.image}: there is no such file")
        if self.camera is not None and not self.camera.is_file():
            raise CameraError(f"{self.camera}: there is no such file")
        refuse_heights(self.image)


@dataclass(frozen=True)
class Validation:
    """Inputs and options of a validation. ``pose_is_known``: the positions in the camera files are
    the true ones. ``disc``: renders of the DEM under the extended solar disc, None: as the accuracy says.
    ``environment``: an environment map as the light; points are searched for under
    one source in the middle of its light, windows are compared with renders under all of it. ``faint``: search
    with the options `position_fix.FAINT`. ``fit_errors``: also fit the error model to the images
    (`error_fit`). ``choose_encoding``: decode an image of 8 bits, opened as linear, if it fits better so
    (`encoding_check`).
    """

    catalog_path: Path
    files: tuple[ImageFiles, ...]
    uncertainty: Uncertainty
    dem_paths: tuple[Path, ...] = ()
    windows: WindowChoice = field(default_factory=WindowChoice)
    sun: SunChoice = field(default_factory=SunChoice)
    model: Reflectance | None = None
    accuracy: Accuracy = TIERS["standard"]
    albedo: AlbedoMap | None = None
    pose_is_known: bool = False
    pixels: ImageOptions = field(default_factory=ImageOptions)
    faint: bool = False
    fit_errors: bool = False
    choose_encoding: bool = False
    environment: Environment | None = None
    disc: bool | None = None

    @property
    def stated_sun(self) -> SunChoice:
        """The Sun as stated: by the options, or by the middle of the environment map's light."""
        if self.environment is None:
            return self.sun
        middle = self.environment.middle
        return SunChoice(middle.azimuth_deg, middle.elevation_deg)

    @property
    def law(self) -> Reflectance:
        return self.model or reflectance_model(VALIDATION_LAW)

    @cached_property
    def dems(self) -> DemSet | None:
        """The DEM files as one DEM; None without files."""
        return DemSet.open(self.dem_paths) if self.dem_paths else None

    def described(self) -> dict[str, Any]:
        """The options for the report, without folders."""
        sun = {name: value for name, value in vars(self.sun).items() if value is not None}
        return {
            "cameras": [files.camera.name if files.camera else None for files in self.files],
            "dem": [path.name for path in self.dem_paths],
            "albedo": self.albedo.name if self.albedo else None,
            "reflectance": self.law.name,
            "accuracy": self.accuracy.tier,
            "encoding": "auto" if self.choose_encoding else self.pixels.encoding,
            "band": self.pixels.band,
            "nodata": self.pixels.nodata,
            "faint": self.faint,
            "sun": sun,
            "environment": self.environment.panorama.name if self.environment else None,
            "position_sigma_m": self.uncertainty.position_m,
            "attitude_sigma_deg": float(np.degrees(self.uncertainty.attitude_rad)),
            "window": self.windows.size,
            "step": self.windows.step,
            "gsd_m": self.windows.gsd_m,
            "remove_offset": self.windows.remove_offset,
            "pose_is_known": self.pose_is_known,
        }


@dataclass(frozen=True, eq=False)
class Result:
    """Result, images for the report, the files that were read, and the fitted error model; None
    unless it was asked for.
    """

    verdict: ValidationResult
    pictures: tuple[Pictures, ...]
    sources: tuple[Path, ...]
    fitted: FittedErrors | None = None

    @property
    def located(self) -> bool:
        """True if every image was located."""
        return all(image.located.verdict == LOCATED for image in self.verdict.images)


def run_validation(request: Validation, progress: Progress | None = None) -> Result:
    """Validate a catalogue with every image in turn.

    Raises the library's errors for a catalogue or DEM that cannot be read, for missing files, and
    ImageError for a DEM among the images and for a fit of errors to too few points.
    Errors in an image, its camera file or its Sun are results of that image; raised if no image could
    be opened.
    """
    for files in request.files:
        files.require()
    _ = request.dems  # a file that is no DEM ends it before any image is read
    catalog = open_catalog(request.catalog_path)
    done_with: list[_Done] = []
    refused: list[LcpError] = []
    for done, (files, name) in enumerate(
        zip(request.files, told_apart(request.files), strict=True)
    ):
        if progress:
            progress(done, len(request.files))
        try:
            image = _opened(request, files)
        except (ImageError, CameraError, SunError) as error:
            refused.append(error)
            done_with.append(_Done(_untried(files, name, str(error)), Pictures(), files.paths))
        else:
            done_with.append(_one(request, catalog, files, image, name))
    if len(refused) == len(request.files):
        raise refused[0]
    if progress:
        progress(len(request.files), len(request.files))
    facts = {"name": request.catalog_path.name, "points": len(catalog), "title": catalog.title}
    verdict = ValidationResult(tuple(one.image for one in done_with), facts, request.described())
    sources = [request.catalog_path, *(path for one in done_with for path in one.sources)]
    sources += request.environment.files if request.environment else ()
    fitted = _fitted(done_with) if request.fit_errors else None
    pictures = tuple(one.pictures for one in done_with)
    return Result(verdict, pictures, tuple(dict.fromkeys(sources)), fitted)


def told_apart(files: Sequence[ImageFiles]) -> list[str]:
    """Unique names of images: file names, with as many of their folders as needed; repeated files
    are numbered.
    """
    names = {file.image: file.image.name for file in files}
    for depth in range(2, max(len(path.parts) for path in names) + 1):
        twice = {name for name, count in Counter(names.values()).items() if count > 1}
        tails = {path: Path(*path.parts[-depth:]).as_posix().lstrip("/") for path in names}
        names = {path: tails[path] if name in twice else name for path, name in names.items()}
    each = [names[file.image] for file in files]
    before = [each[:k].count(name) for k, name in enumerate(each)]
    return [f"{name} ({n + 1})" if n else name for name, n in zip(each, before, strict=True)]


@dataclass(frozen=True, eq=False)
class _Done:
    """Result of one image, its pictures, the files that were read, and the residuals for the fit of
    errors.
    """

    image: ImageVerdict
    pictures: Pictures
    sources: list[Path]
    residuals: Residuals | None = None


def _one(
    request: Validation, catalog: Catalog, files: ImageFiles, image: Image, name: str
) -> _Done:
    options = FAINT if request.faint else Options()
    image, catalog, located, encoding = _searched(request, catalog, files, image, options)
    best = image.with_sensor(located.pose.sensor) if located.pose else image
    log.info("%s: %s: %s", name, located.verdict, located.reason)
    ground, why = _ground(request, catalog, best)
    why = files.named(why)
    result = ImageVerdict(
        _facts(request, image, name),
        located,
        _points(catalog, located, best.sensor),
        _claims(request, catalog, located, image, options.criteria),
        windows=_windows(catalog, ground) if ground else None,
        windows_reason=why,
        error=_error(request, located, image.sensor),
        encoding=encoding,
        advice=_advice(request, located, ground),
    )
    residuals = _residuals(request, catalog, located, best) if request.fit_errors else None
    sources = [*files.paths, *(ground.sources if ground else ())]
    return _Done(result, _pictures(image, ground), sources, residuals)


class _EncodedSearch(NamedTuple):
    """An image in the encoding that was chosen, the points that may be in it, the result of the search, and the
    check of the encoding, if there was one.
    """

    image: Image
    catalog: Catalog
    located: Fix
    encoding: EncodingCheck | None = None


def _searched(
    request: Validation, whole: Catalog, files: ImageFiles, image: Image, options: Options
) -> _EncodedSearch:
    """The search in an image as it was opened and, if that is asked for and fits better, decoded."""

    def search(image: Image) -> _EncodedSearch:
        catalog = _perhaps_seen(request, whole, image, options)
        located = locate(catalog, image, request.uncertainty, request.law, options)
        sigmas = options.sigmas
        located = advised(located, catalog, image.sensor, request.uncertainty, sigmas)
        return _EncodedSearch(image, catalog, located)

    found, used = search(image), ENCODINGS[0]
    if request.pixels.encoding != used or not (found.located.pose or request.choose_encoding):
        return found
    other = decoded(image, files.image, request.pixels)
    if other is None:
        return found
    if found.located.pose is None:
        found, used = search(other), "srgb"
    if found.located.pose is None:
        return found._replace(image=image)
    check = check_encoding(
        found.catalog, (image, other), found.located, request.law, options.criteria, used
    )
    if check and request.choose_encoding and check.better != used == ENCODINGS[0]:
        again = search(other)
        if again.located.pose:
            found, check = again, replace(check, used="srgb")
    return found._replace(encoding=check)


def _advice(request: Validation, located: Fix, ground: GroundComparison | None) -> tuple[str, ...]:
    """What may improve the comparison of a located image with the DEM."""
    if located.pose is None or ground is None or request.dems is None or request.albedo:
        return ()
    text = albedo_advice(ground.windows)
    return (text,) if text else ()


def _perhaps_seen(request: Validation, catalog: Catalog, image: Image, options: Options) -> Catalog:
    """The points that may be in the image, with twice the reach of the largest correction, and of several
    levels those that work at its scale, in memory; the catalogue as it is if there is none.
    """
    reach = 2.0 * options.most_sigmas
    rows = perhaps_in_view(catalog, image.sensor, request.uncertainty, reach).points
    rows = at_one_scale(catalog, rows, image.sensor)
    return catalog.take(rows, cells=np.zeros(0, np.int64)) if len(rows) else catalog


def _opened(request: Validation, files: ImageFiles) -> Image:
    return open_image(files.image, files.camera, request.stated_sun, request.pixels)


def _untried(files: ImageFiles, name: str, reason: str) -> ImageVerdict:
    """Result of an image that could not be searched: empty, without geometry, or without a Sun."""
    reason = files.named(reason).removeprefix(f"{files.image.name}: ")
    nothing = Fix(CANNOT_SAY, reason, Matches.none())
    claims = Claims.none(reason="the image was not searched")
    return ImageVerdict(ImageFacts(name), nothing, PointFigures.none(), claims)


def _ground(
    request: Validation, catalog: Catalog, image: Image
) -> tuple[GroundComparison | None, str]:
    """Comparison of the image with renders, or the reason why there is none."""
    settings = RenderSettings(
        request.law, request.accuracy, request.albedo, request.environment, request.disc
    )
    try:
        if request.dems:
            return against_dem(image, request.dems, settings, request.windows), ""
        points = points_in_view(catalog, image.sensor)
        return against_patches(image, catalog, points, settings, request.windows), ""
    except (DemError, CatalogError):  # a damaged file
        raise
    except LcpError as error:
        log.info("%s: windows: %s", image.name, error)
        return None, str(error)


def _error(request: Validation, located: Fix, given: Sensor) -> PositionError | None:
    if not request.pose_is_known or located.pose is None or given.corrections != POSE:
        return None
    return position_error(located.pose, given)


def _claims(
    request: Validation, catalog: Catalog, located: Fix, image: Image, criteria: Criteria
) -> Claims:
    """Claims on the points, tried in the located image, or with a known camera."""
    known = request.pose_is_known and image.sensor.corrections == POSE
    best = image.with_sensor(located.pose.sensor) if located.pose else image
    true = image.sensor if known else None
    search = ClaimSearch(catalog, best, request.law, criteria, true)
    return search.claims(located.matches.point, searched=known or located.pose is not None)


def _residuals(
    request: Validation, catalog: Catalog, located: Fix, image: Image
) -> Residuals | None:
    """Residuals of the points that were searched for; None without any."""
    if located.pose is None:
        return None
    searched = np.isin(located.matches.code, SEARCHED)
    found = located.matches.found[searched, None]
    rows = located.matches.point[searched]
    pixels = np.where(found, located.matches.found_px[searched], np.nan)
    try:
        return residuals_of(catalog, image, rows, pixels, request.law)
    except ImageError as error:
        log.info("%s: no residuals: %s", image.name, error)
        return None


def _fitted(images: Sequence[_Done]) -> FittedErrors:
    """The error model of all images together; ImageError for too few points."""
    used = {one.image.facts.name: one.residuals for one in images if one.residuals is not None}
    model = fit_errors(list(used.values()))
    return FittedErrors(model, sum(len(sample) for sample in used.values()), tuple(used))


def _windows(catalog: Catalog, ground: GroundComparison) -> WindowFigures:
    return WindowFigures(
        ground.windows,
        ground.resolution,
        ground.against,
        ground.longitude_deg,
        ground.latitude_deg,
        None if ground.point is None else catalog.point_id[ground.point],
    )


def _points(catalog: Catalog, located: Fix, sensor: Sensor) -> PointFigures:
    rows = located.matches.point
    places = catalog.position_mcmf[rows]
    corrected = sensor.project(places) if located.pose else np.full((len(rows), 2), np.nan)
    size_m = pixel_size_m(sensor, places) if len(rows) else np.empty(0)
    return PointFigures(
        catalog.point_id[rows], catalog.longitude[rows], catalog.latitude[rows], size_m, corrected
    )


def _pictures(image: Image, ground: GroundComparison | None) -> Pictures:
    rows, cols = image.signal.shape
    factor = max(1, int(np.ceil(np.sqrt(rows * cols / PIXELS_MAX))))
    if factor > min(rows, cols):
        factor = 1
    shown = (
        np.where(image.valid, image.signal, np.nan) if factor == 1 else image.reduced(factor).signal
    )
    return Pictures(
        shown, factor, ground.image if ground else None, ground.render if ground else None
    )


# -- facts of an image


def _facts(request: Validation, image: Image, name: str) -> ImageFacts:
    rows, cols = image.signal.shape
    facts = ImageFacts(
        name,
        cols,
        rows,
        image.sensor.kind,
        sun_from=_sun_from(request, image.sensor),
        saturated_share=image.saturated_share,
        missing_share=image.missing_share,
    )
    try:
        lon_deg, lat_deg = center_of(image.sensor)
    except LcpError:
        return facts  # the image centre shows the sky: its angles are unknown
    frame = EnuFrame(lon_deg, lat_deg)
    place = lonlat_to_mcmf(lon_deg, lat_deg)
    sun = Direction.from_mcmf(image.sun_directions(place), frame)
    up = float(frame.rotation[2] @ image.sensor.towards(place))
    return replace(
        facts,
        pixel_m=float(pixel_size_m(image.sensor, place)),
        sun_azimuth_deg=sun.azimuth_deg,
        sun_elevation_deg=sun.elevation_deg,
        off_nadir_deg=float(np.degrees(np.arccos(np.clip(up, -1.0, 1.0)))),
    )


def _sun_from(request: Validation, sensor: Sensor) -> str:
    """Source of the Sun's position, in the order of `image_file.open_image`."""
    if request.environment is not None:
        return "the middle of the panorama's light"
    if request.sun != SunChoice():
        return "as stated"
    known = sensor.sun_position_mcmf_m is not None or sensor.time_utc is not None
    return "the camera file" if known else "the image's label"


FILES = ("report.json", "report.html", "windows.csv", "points.csv")
"""Files of a report. The first, the target of the make rule, appears last."""


def write_validation(
    result: Result,
    folder: Path,
    overwrite: bool = False,
    depfile: Path | str | None = None,
    errors_file: Path | None = None,
) -> None:
    """Write `FILES` into a folder, which is created if missing. ``depfile``: also the list of input
    files, as a rule for make. ``errors_file``: also the fitted error model.
    """
    images = result.verdict.images
    texts = (
        result.verdict.to_json(),
        render(result.verdict, result.pictures),
        windows_csv_text(images),
        csv_text(images),
    )
    files = dict(zip(FILES, texts, strict=True))
    if errors_file and result.fitted:
        files[os.path.abspath(errors_file)] = result.fitted.to_toml()  # elsewhere: `folder / name`
    write_folder(folder, files, overwrite)
    if depfile:
        rule = depfile_rule(folder / FILES[0], result.sources)
        write_bytes(depfile, rule, overwrite=True)


POINT_COLUMNS = (
    "image", "point_id", "longitude_deg", "latitude_deg",
    "predicted_column_px", "predicted_row_px", "found_column_px", "found_row_px",
    "sigma_major_px", "sigma_minor_px", "major_axis_deg",
    "correlation", "second_correlation", "back_px", "reason",
    "residual_column_px", "residual_row_px", "pixel_m",
    "detection_probability", "usable", "sigma_major_m", "sigma_minor_m", "sigma_angle_deg",
    "found", "error_east_m", "error_north_m", "prior", "posterior",
)  # fmt: skip
"""One row per point. ``major_axis_deg`` is from the column direction (right) towards the row
direction (down), 0..180. Residuals are the position found minus the prediction of the corrected
sensor. From ``detection_probability`` on: what the catalogue claims, and the trial of the claims
(`claim_trials`); ``usable`` and ``found`` are 0 or 1, empty without a claim and without a trial.
``prior`` and ``posterior`` are those of the match (`matching.matches`).
"""

WINDOW_COLUMNS = (
    "image", "point_id", "row", "column", "longitude_deg", "latitude_deg",
    "correlation", "contrast", "offset_column_cells", "offset_row_cells",
)  # fmt: skip
"""One row per window: the point of its patch if patches were compared, its first cell on the grid,
its centre, the contrast of the render, and the offset of the image from the render in cells.
"""


def csv_text(images: Iterable[ImageVerdict]) -> str:
    """Table of all points of all images; missing figures are empty cells."""
    return _text(POINT_COLUMNS, (row for image in images for row in point_rows(image)))


def windows_csv_text(images: Iterable[ImageVerdict]) -> str:
    """Table of all windows of all images."""
    return _text(WINDOW_COLUMNS, (row for image in images for row in _window_rows(image)))


def point_rows(image: ImageVerdict) -> list[tuple[Any, ...]]:
    """The points of an image in the order of `POINT_COLUMNS`."""
    matches, points = image.matches, image.points
    claims = image.claims
    sigma, angle = error_ellipses(matches.covariance_px2)
    columns = (
        [image.facts.name] * len(matches),
        points.point_id,
        points.longitude_deg,
        points.latitude_deg,
        *matches.predicted_px.T,
        *matches.found_px.T,
        *sigma.T,
        angle,
        matches.correlation,
        matches.second,
        matches.back_px,
        [REASONS[code] for code in matches.code],
        *image.residual_px.T,
        points.pixel_m,
        claims.probability,
        _bits(claims.usable, claims.claimed),
        *claims.sigma_m.T,
        claims.angle_deg,
        _bits(claims.found, claims.tried),
        *claims.error_m.T,
        matches.prior,
        matches.posterior,
    )
    return list(zip(*columns, strict=True))


def _window_rows(image: ImageVerdict) -> list[tuple[Any, ...]]:
    if image.windows is None:
        return []
    w = image.windows.compared
    unknown = np.full((w.count, 2), np.nan)
    columns = (
        [image.facts.name] * w.count,
        [""] * w.count if image.windows.point_id is None else image.windows.point_id,
        w.row,
        w.col,
        image.windows.longitude_deg,
        image.windows.latitude_deg,
        w.correlation,
        w.contrast,
        *(unknown if w.offset_px is None else w.offset_px).T,
    )
    return list(zip(*columns, strict=True))


def _bits(values: Mask, known: Mask) -> list[int | str]:
    """0 or 1; empty where the value is unknown."""
    return [int(value) if sure else "" for value, sure in zip(values, known, strict=True)]


def _text(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    return "".join(csv_lines([columns, *(map(_cell, row) for row in rows)]))


def _cell(value: Any) -> Any:
    if isinstance(value, float | np.floating):
        return f"{float(value) + 0.0:.{DIGITS}g}" if math.isfinite(value) else ""
    return value


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
        True: also fit the error model to the points searched for (`Result.fitted`).
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
        For other numbers of images and cameras.

    Examples
    --------
    >>> found = lcp.validate(catalog, folder / "AS15-M-0414.png", camera)
    >>> image, = found.verdict.document()["images"]
    >>> image["image"], image["points_in_view"] > 0
    ('AS15-M-0414.png', True)
    """
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
            sun=SunChoice.of(sun),
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
        ),
        progress,
    )
    if folder is not None:
        write_validation(result, folder, overwrite)
    return result


def image_files(
    images: Path | str | Sequence[Path | str],
    cameras: Path | str | Sequence[Path | str | None] | None,
) -> tuple[ImageFiles, ...]:
    """Each image with its camera file. ConfigError if their numbers do not match."""
    shown = [images] if isinstance(images, Path | str) else list(images)
    seen = [cameras] if cameras is None or isinstance(cameras, Path | str) else list(cameras)
    if len(seen) == 1:
        seen *= len(shown)
    if len(seen) != len(shown):
        raise ConfigError(
            f"{len(seen)} cameras for {len(shown)} images: give one, or one per image in the same order"
        )
    return tuple(
        ImageFiles(Path(image), None if camera is None else Path(camera))
        for image, camera in zip(shown, seen, strict=True)
    )
