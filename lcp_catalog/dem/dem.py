"""DEM products: pixels, grid and name of one file; heights above the sphere of 1 737 400 m."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..constants import MOON_RADIUS_M
from ..errors import DemError, LabelError, LcpError
from ..pds.label import Label
from ..pds.label_files import find_image, product_label
from ..remote_files import archive_of, url_of
from .effective_resolution import Resolution, of_file
from .grid import Grid
from .products import ProductFacts, facts_of, product_name
from .raster import Gridded, Raster, grid_of, open_dataset, require_file, unit_m

_SIDE_MIN = 3
"""Heights along a side of the smallest DEM of which anything can be rendered."""


@dataclass(frozen=True)
class Dem(Gridded):
    """One product: its pixels, its grid and its name. Picklable; files are opened again in the
    other process.
    """

    path: Path
    product: str
    grid: Grid
    raster: Raster
    files: tuple[Path, ...]  # label and image

    @classmethod
    def open(cls, path: Path | str) -> Dem:
        """Open a GeoTIFF with heights in metres, or a PDS3 or PDS4 product by its label or its
        image. DemError or LabelError if that fails.
        """
        path = Path(path)
        require_file(path, "a DEM")
        if url_of(path) is not None or archive_of(path) is not None:
            return cls._from_gdal(path)
        try:
            label = product_label(path)
        except LabelError:
            if path.suffix.lower() != ".img":
                raise
            return cls._from_gdal_or(path)
        if label is None:
            return cls._from_gdal(path)
        is_label = path == label.path and label.image_name != ""
        return cls._from_pds(label, None if is_label else path)

    @classmethod
    def _from_gdal_or(cls, path: Path) -> Dem:
        """An .IMG without a label: an ERDAS Imagine file, or the error that its label is missing."""
        try:
            open_dataset(path)
        except DemError:
            product_label(path)  # raises
        return cls._from_gdal(path)

    @classmethod
    def _from_pds(cls, label: Label, image: Path | None) -> Dem:
        if image is not None and label.image_name:
            _refuse_other_kind(image, label)
        image = image or find_image(label)
        if is_geotiff(image):  # NAC DTMs: it needs no label
            _compare_size(image, label)
            return cls._from_gdal(image)
        if label.compressed or image.suffix.lower() == ".jp2":
            _compare_size(image, label)
        else:
            _compare_bytes(image, label)
        raster = Raster(
            path=image,
            width=label.line_samples,
            height=label.lines,
            scale_m=label.height_scale_m,
            missing=label.missing,
            raw_dtype=label.sample_dtype,
            raw_offset_bytes=label.image_offset_bytes,
        )
        raster = replace(raster, stated_m=_stated_m(raster, label))
        grid = grid_of_label(label)
        files = (image,) if label.path == image else (label.path, image)
        return cls(image, product_name(label.product_id), grid, raster, files)

    @classmethod
    def _from_gdal(cls, path: Path) -> Dem:
        dataset, files = open_dataset(path)
        if dataset.count != 1:
            raise DemError(f"{path}: has {dataset.count} bands; a DEM has one")
        grid = grid_of(dataset, path)
        scale, offset = _gdal_scale(dataset, path)
        raster = replace(Raster.of_band(dataset, files, path), scale_m=scale, offset_m=offset)
        return cls(path, product_name(path.stem), grid, raster, files)

    @property
    def abs_latitude_use(self) -> tuple[float, float] | None:
        """Absolute latitudes at which the method uses this product; None for other products."""
        return self.facts.abs_latitude_use

    @property
    def facts(self) -> ProductFacts:
        """Published facts about the product: uncertainty, resolution, latitudes of use."""
        return facts_of(self.product)

    @cached_property
    def effective_resolution(self) -> Resolution:
        """Effective resolution of the file, estimated once (`effective_resolution.of_file`)."""
        return of_file(self)

    @property
    def resolution_m(self) -> float | None:
        """Effective resolution, metres: measured, else the product's published figure, at least the
        posting; None if neither is known.
        """
        found, published = self.effective_resolution, self.facts.resolution_m
        if found.is_measured:
            return found.resolution_m
        return None if published is None else max(published, self.gsd_m)

    @property
    def too_small(self) -> str:
        """Why there is no ground between its heights; empty if there is."""
        rows, cols = self.grid.height, self.grid.width
        if min(rows, cols) >= _SIDE_MIN:
            return ""
        return (
            f"has {rows} x {cols} heights (rows x columns); a node of ground has heights on all sides, "
            f"which takes at least {_SIDE_MIN} x {_SIDE_MIN}: give the whole DEM"
        )

    @property
    def radius_m(self) -> float:
        """Radius of the sphere above which heights are given; files on other spheres are refused."""
        return MOON_RADIUS_M


def is_geotiff(path: Path) -> bool:
    """True for the name of a GeoTIFF."""
    return path.suffix.lower() in (".tif", ".tiff")


def grid_of_label(label: Label) -> Grid:
    """The grid that a label states. LabelError for one that contradicts itself."""
    try:
        return Grid.from_label(label)
    except LabelError as error:
        raise LabelError(f"{label.path}: {error}") from error


def extremes_step(raster: Raster, label: Label) -> float:
    """Samples by which the extremes of a label may be wrong. LDEM_4's own label is one count away from its pixels;
    a JP2 is lossy by one count more; real numbers are rounded to 1 m.
    """
    if raster.raw_dtype is not None and np.dtype(raster.raw_dtype).kind == "f":
        return 1.001 / raster.scale_m
    return 2.002 if label.compressed else 1.001


def _stated_m(raster: Raster, label: Label) -> tuple[float, float] | None:
    """Least and greatest height of a label's MINIMUM and MAXIMUM, which are samples or metres."""
    low, high = label.declared.minimum, label.declared.maximum
    if low is None or high is None:
        return None
    step_m = extremes_step(raster, label) * raster.scale_m
    return min(low, low * raster.scale_m) - step_m, max(high, high * raster.scale_m) + step_m


def files_beside(path: Path) -> tuple[Path, ...]:
    """Files that are read together with a raster or its label: the label, its image, and what GDAL reads
    with it (sidecar files, the sources of a virtual raster). Empty for a file that cannot be read.
    """
    found: list[Path] = []
    with contextlib.suppress(LcpError, OSError):
        label = product_label(path)
        if label is not None:
            found += [label.path, find_image(label)]
    with contextlib.suppress(LcpError, OSError):
        found += open_dataset(path, "a raster")[1]
    return tuple(found)


def _refuse_other_kind(image: Path, label: Label) -> None:
    """Refuse a label that describes a .TIF or .JP2 for an .IMG."""
    if Path(label.image_name).suffix.lower() != image.suffix.lower():
        raise DemError(
            f"{image}: the label beside it, {label.path.name}, describes {label.image_name}; "
            "put this image's own label beside it"
        )


def _compare_bytes(image: Path, label: Label) -> None:
    """Refuse an image that is shorter or longer than its label states, including the other objects
    that the label counts in the file's size.
    """
    size, allowed = image.stat().st_size, max(label.image_bytes, label.declared.file_bytes or 0)
    if size < label.image_bytes:
        raise DemError(
            f"{image}: has {size} bytes where its label {label.path.name} states {label.image_bytes}: "
            "cut short; fetch it again"
        )
    if size > allowed:
        raise DemError(
            f"{image}: has {size} bytes, {size - allowed} more than its label {label.path.name} states: "
            "one of them belongs to another product; fetch both again"
        )


def _compare_size(image: Path, label: Label) -> None:
    dataset, _ = open_dataset(image)
    if (dataset.height, dataset.width) != (label.lines, label.line_samples):
        raise DemError(
            f"{image}: has {dataset.height} x {dataset.width} pixels where its label "
            f"{label.path.name} states "
            f"{label.lines} x {label.line_samples}; one of them belongs to another product"
        )


def _gdal_scale(dataset: Any, path: Path) -> tuple[float, float]:
    """Factor and offset that give metres above the sphere; an offset equal to the radius of the
    sphere is no term of height.
    """
    scale, offset = float(dataset.scales[0]), float(dataset.offsets[0])
    metres = unit_m(dataset)
    if abs(offset * 1000.0 - MOON_RADIUS_M) < 0.5:
        metres, offset = 1000.0, 0.0
    elif abs(offset * metres - MOON_RADIUS_M) < 0.5:
        offset = 0.0
    if dataset.dtypes[0] == "uint8" and scale == 1.0 and offset == 0.0:
        raise DemError(f"{path}: 8-bit samples are an image, not heights")
    if dataset.dtypes[0].startswith("complex"):
        raise DemError(f"{path}: complex samples are not heights")
    return scale * metres, offset * metres
