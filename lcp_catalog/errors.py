"""What can go wrong, by name.

Every error is one line that says what is wrong, where, and what to do. Each is also a builtin, so that a caller who does
not know this library can still catch ``ValueError`` or ``OSError``.
"""


class LcpError(Exception):
    """Base of every error this library raises on purpose."""


class LabelError(LcpError, ValueError):
    """A product's label is missing, or says something that cannot be."""


class DemError(LcpError, OSError):
    """A DEM file cannot be opened or read, or its pixels do not match its label."""


class AlbedoError(LcpError, ValueError):
    """An albedo map that cannot be read, is none, or does not cover the area."""


class AreaError(LcpError, ValueError):
    """An area is malformed, or has no heights in the DEM that was given."""


class SunError(LcpError, ValueError):
    """A Sun that is malformed or cannot light the area."""


class CameraError(LcpError, ValueError):
    """A camera file that cannot be read, or a camera that cannot see the area."""


class ImageError(LcpError, ValueError):
    """A picture that cannot be read, or is not what it is given for."""


class PoseError(LcpError, ValueError):
    """Points that do not decide where a sensor stood."""


class ConfigError(LcpError, ValueError):
    """A configuration value that is unknown or out of range."""


class MeasurementError(LcpError, ValueError):
    """Measurements of a surface that cannot be read, or do not say enough for a fit."""


class OutputExistsError(LcpError, FileExistsError):
    """The output exists and nobody said that it may be replaced."""


class OutputError(LcpError, OSError):
    """The output cannot be written (disk full, no permission)."""


class CatalogError(LcpError, ValueError):
    """A catalogue that is not one, or is damaged."""


class AreaFailedError(LcpError, RuntimeError):
    """An area of a build failed; the message carries the area and the cause."""
