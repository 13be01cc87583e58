"""Validation of a catalogue with images: from the files of each image to its result."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..accuracy import TIERS, Accuracy
from ..cameras.sensor import POSE, Sensor, Uncertainty, pixel_size_m
from ..cameras.view import center_of
from ..catalog.catalogue import Catalog
from ..catalog.verification import open_catalog
from ..choices import ENCODINGS, VALIDATION_LAW
from ..dem.mosaic import DemSet
from ..errors import (
    CameraError,
    CatalogError,
    DemError,
    ImageError,
    LcpError,
    SunError,
)
from ..file_kinds import no_file
from ..geometry.frames import Direction, EnuFrame, lonlat_to_mcmf
from ..images.image import Image
from ..images.image_file import ImageOptions, decoded, open_image, refuse_heights
from ..landmarks.error_model import ErrorModel
from ..light.environment import Environment
from ..light.sun_choice import SunChoice
from ..matching.fix import CANNOT_SAY, LOCATED, Fix
from ..matching.fix_advice import advised
from ..matching.matches import SEARCHED, Matches
from ..matching.options import FAINT, Options
from ..matching.point_choice import points_in_view, searched_in, shows_points
from ..matching.point_search import Criteria
from ..matching.pose import PositionError, position_error
from ..matching.position_fix import fix_in_area
from ..matching.search_area import perhaps_in_view
from ..navigation.better_catalog import better_catalog
from ..navigation.frame_points import PlannedImage
from ..photometry.albedo_map import AlbedoMap
from ..photometry.laws import Reflectance, reflectance_model
from ..plots.pictures import PIXELS_MAX
from ..stages import Progress, unseen
from .advice import (
    EncodingCheck,
    albedo_advice,
    check_encoding,
    opposite_advice,
    turned_or_unlit,
)
from .claims import Claims, ClaimSearch
from .error_fit import FittedErrors, Residuals, fitted_by_kind, residuals_of
from .ground_comparison import (
    GroundComparison,
    RenderSettings,
    WindowChoice,
    against_dem,
    against_patches,
)
from .map_distortion import distortion_advice
from .result import (
    ImageFacts,
    ImageVerdict,
    Pictures,
    PointFigures,
    ValidationResult,
    WindowFigures,
)

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
            raise ImageError(f"{self.image}: {no_file(self.image, 'an image')}")
        if self.camera is not None and not self.camera.is_file():
            raise CameraError(f"{self.camera}: {no_file(self.camera, 'a camera')}")
        refuse_heights(self.image)


@dataclass(frozen=True)
class Validation:
    """Inputs and options of a validation. ``pose_is_known``: the positions in the camera files are
    the true ones. ``disc``: renders of the DEM under the extended solar disc, None: as the accuracy says;
    ``bounce``: with light by way of other ground.
    ``environment``: an environment map as the light; points are searched for under
    one source in the middle of its light, windows are compared with renders under all of it. ``faint``: search
    with the options `options.FAINT`. ``fit_errors``: also fit the error model to the images
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
    bounce: str = "off"

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
    """Result, images for the report, the files that were read, and the fitted error models, one for each kind of images,
    that of the most points first; none unless they were asked for.
    """

    verdict: ValidationResult
    pictures: tuple[Pictures, ...]
    sources: tuple[Path, ...]
    fitted: tuple[FittedErrors, ...] = ()

    @property
    def located(self) -> bool:
        """True if every image was located."""
        return all(image.located.verdict == LOCATED for image in self.verdict.images)


def run_validation(request: Validation, progress: Progress = unseen) -> Result:
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
    progress(len(request.files), len(request.files))
    facts = {"name": request.catalog_path.name, "points": len(catalog), "title": catalog.title}
    verdict = ValidationResult(tuple(one.image for one in done_with), facts, request.described())
    sources = [request.catalog_path, *(path for one in done_with for path in one.sources)]
    sources += request.environment.files if request.environment else ()
    fitted = _fitted(done_with, catalog) if request.fit_errors else ()
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
    options = replace(FAINT if request.faint else Options(), whole_sun_check=True)
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
        advice=_advice(request, catalog, image, located, ground),
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
    """The search in an image as it was opened and, if that is asked for and fits better, decoded. An image that is
    located neither way keeps the search of its samples as they were opened.
    """

    def place(catalog: Catalog, image: Image) -> Fix:
        known = request.uncertainty
        area = perhaps_in_view(catalog, image.sensor, known, options.sigmas)
        return fix_in_area(catalog, image, known, request.law, options, area)

    def search(image: Image) -> _EncodedSearch:
        catalog = _perhaps_seen(request, whole, image, options)
        located = place(catalog, image)
        located = advised(located, catalog, image.sensor, request.uncertainty, options.sigmas)
        if located.pose is None:
            more = turned_or_unlit(located, catalog, image, partial(place, catalog))
            more = more or better_catalog(catalog, PlannedImage.of(image))
            located = replace(located, reason=located.reason + more)
        return _EncodedSearch(image, catalog, located)

    found, used = search(image), ENCODINGS[0]
    if request.pixels.encoding != used or not (found.located.pose or request.choose_encoding):
        return found
    other = decoded(image, files.image, request.pixels)
    if other is None:
        return found
    if found.located.pose is None:
        again = search(other)
        if again.located.pose is None:
            return found
        found, used = again, "srgb"
    check = check_encoding(
        found.catalog, (image, other), found.located, request.law, options.criteria, used
    )
    if check and request.choose_encoding and check.better != used == ENCODINGS[0]:
        again = search(other)
        if again.located.pose:
            found, check = again, replace(check, used="srgb")
    return found._replace(encoding=check)


def _advice(
    request: Validation,
    catalog: Catalog,
    image: Image,
    located: Fix,
    ground: GroundComparison | None,
) -> tuple[str, ...]:
    """What may be wrong with a located image, and what may improve its comparison with the DEM."""
    if ground is not None and (opposite := opposite_advice(ground.windows)):
        return (opposite,)
    if located.pose is None:
        return ()
    distortion = distortion_advice(located, catalog, image)
    albedo = ""
    if ground is not None and request.dems is not None and not request.albedo:
        albedo = albedo_advice(ground.windows)
    return tuple(text for text in (*located.advice, distortion, albedo) if text)


def _perhaps_seen(request: Validation, catalog: Catalog, image: Image, options: Options) -> Catalog:
    """The points that may be in the image, with twice the reach of the largest correction, and of several
    levels those that work at its scale, in memory; the catalogue as it is if there is none.
    """
    reach = 2.0 * options.most_sigmas
    rows = perhaps_in_view(catalog, image.sensor, request.uncertainty, reach).points
    rows = searched_in(catalog, rows, image)
    return catalog.take(rows, cells=np.zeros(0, np.int64)) if len(rows) else catalog


def _opened(request: Validation, files: ImageFiles) -> Image:
    sees = shows_points(request.catalog_path)
    return open_image(files.image, files.camera, request.stated_sun, request.pixels, sees)


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
        request.law,
        request.accuracy,
        request.albedo,
        request.environment,
        request.disc,
        request.bounce,
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
    known = request.pose_is_known
    best = image.with_sensor(located.pose.sensor) if located.pose else image
    true = image.sensor if known else None
    search = ClaimSearch(catalog, best, request.law, criteria, true)
    return search.claims(located.matches.point, searched=known or located.pose is not None)


def _residuals(
    request: Validation, catalog: Catalog, located: Fix, image: Image
) -> Residuals | None:
    """Residuals of the points that were searched for; None without any. An image of known pose that was not located counts, too:
    its points were found at no place that is believed.
    """
    if located.pose is None and not request.pose_is_known:
        return None
    if located.pose is None:
        log.warning(
            "%s is not located and counts in the fit: if its pose is wrong, leave it out",
            image.name,
        )
    searched = np.isin(located.matches.code, SEARCHED)
    found = located.matches.found[searched, None] & (located.pose is not None)
    pixels = np.where(found, located.matches.found_px[searched], np.nan)
    try:
        return residuals_of(catalog, image, located.matches.point[searched], pixels, request.law)
    except ImageError as error:
        log.info("%s: no residuals: %s", image.name, error)
        return None


def _fitted(images: Sequence[_Done], catalog: Catalog) -> tuple[FittedErrors, ...]:
    """The error models of the kinds of images; ImageError for too few points."""
    used = [
        (one.image.facts.sensor, one.image.facts.name, one.residuals, one.image.claims)
        for one in images
        if one.residuals is not None
    ]
    return fitted_by_kind(used, ErrorModel.from_dict(catalog.errors))


def _windows(catalog: Catalog, ground: GroundComparison) -> WindowFigures:
    return WindowFigures(
        ground.windows,
        ground.plain,
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
