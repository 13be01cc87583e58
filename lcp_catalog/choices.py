"""Names that the commands' options, the configuration files and the library share.

This module imports nothing, so that a command's help needs neither NumPy nor the kernels.
"""

from __future__ import annotations

REFLECTANCE_MODELS = ("lommel-seeliger", "lambert", "lunar-lambert", "minnaert", "hapke", "facet")
"""Reflectance models (laws); some take a parameter set or a file after a colon."""

DEFAULT_LAW = "lommel-seeliger"
"""Reflectance model of functions that are called without one; the cheapest."""

VALIDATION_LAW = "lunar-lambert"
"""Default reflectance model of a validation. It has a phase function, which wide images need."""

REFERENCE_LAW = "hapke"
"""Most complete reflectance model: the one that cheaper models are compared with."""

ANCHOR_SET = "rolo"
"""Parameter set of a model that has the measured brightness of the Moon's disc, at least at one geometry."""

LAWS_BY_COST = tuple(f"{law}:{ANCHOR_SET}" for law in (DEFAULT_LAW, "lunar-lambert", REFERENCE_LAW))
"""Models that `AUTO_LAW` chooses from, from the cheapest (times: `tradeoff`), all of one absolute brightness."""

AUTO_LAW = "auto"
"""Instead of a reflectance model: the cheapest of `LAWS_BY_COST` that is accurate enough for the scene."""

ENCODINGS = ("linear", "srgb")
"""Encodings of the pixel values of an albedo map or an image: proportional to brightness, or sRGB codes.
The first is the default."""

MOON_MAP, NO_MAP = "moon", "none"
"""In place of an albedo map's file: the package's own map of the whole Moon, and no map."""

SURFACES = ("auto", "heightfield", "sphere")
"""Surfaces of a render: the DEM's heights or the plain sphere; ``auto``: the sphere where relief changes
less than the accuracy admits."""

SUN_SHAPES = ("point", "disc")
"""Shapes of the Sun."""

BOUNCES = ("auto", "on", "off")
"""Light that reaches ground by way of other ground: where the scene plan says that it shows, always, or
never."""

HEIGHTFIELD_SIZE_MAX_KM = 2000.0
"""Greatest side of an area with a DEM's heights, which lie over one tangent plane."""

GSD_MAX_M = 50_000.0
"""Greatest cell size, metres: a window of coarser cells would take in the whole Moon."""

LEVEL_RATIO = 1.1
"""Greatest ratio of neighbouring cell sizes of one level of a catalogue: builds of the same level from other
products derive slightly different cells.
"""

EXPORTS = (
    ".csv",
    ".parquet",
    ".geojson",
    ".gpkg",
    ".gcp",
    ".lmk",
    ".spc",
    ".bds",
    ".lcpf",
    ".json",
)
"""Endings of the files that `lcp export` writes."""

CAMERA_EXPORTS = (".json", ".bsp", ".bc")
"""Endings of the files that `lcp camera export` writes."""

FLIGHT = ".lcpf"
"""Ending of a flight file."""

INDEX = ".lcpx"
"""Ending of an index of catalogues."""

EXPORT_FOLDERS = (".lmk", ".spc")
"""Exports that are folders."""

FRAMES = ("MOON_ME", "MOON_PA")
"""Moon-fixed frames of exports: mean Earth, in which catalogues are, and principal axes."""

SCHEMA = "$schema"
"""Key of a file that tells an editor where the file's JSON schema is; not read."""

SPELLINGS = {".tiff": ".tif", ".hdf5": ".h5", ".nc": ".h5", ".htm": ".html"}
"""Other endings of a format, and the one that messages name."""

OF_FILES = (
    *(".tif", ".tiff", ".png", ".jpg", ".jpeg", ".img", ".svg", ".pdf", ".html", ".htm", ".json"),
    *(".geojson", ".csv", ".txt", ".md", ".xlsx", ".toml", ".h5", ".hdf5", ".nc", ".lcpx", ".zip"),
)
"""Endings that no folder's name is meant to have."""


SITE_KM = 20.0
"""Default side of the square site of `windows`."""
