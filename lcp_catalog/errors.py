"""Errors of the library.

Every message is one line: what is wrong, in which file or field, and what to do. Parameters and fields
of the configuration stand in it in backticks, as in "`points.spacing_m` must be above 0"; a command puts
the names of its options there. Each class is also a builtin error, so that a caller can catch
``ValueError`` or ``OSError``.
"""

from __future__ import annotations

import re
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Collection

NAMED = re.compile(r"`([a-z][\w.]*)`")
"""A parameter or a field in a message."""


def plain(message: object) -> str:
    """A message without the marks of names: of a file's own keys."""
    return NAMED.sub(r"\1", str(message))


def printable(text: str) -> str:
    """The text with escapes in place of control characters, of characters that change the direction of a
    line, and of bytes of a file name that are not UTF-8; line breaks and tabs stay.
    """
    if all(line.isprintable() for line in text.split("\n")):
        return text
    return "".join(
        one if one.isprintable() or one in "\n\t" else one.encode("unicode_escape").decode()
        for one in text
    )


def unknown_keys(given: Collection[str], known: Collection[str]) -> str:
    """Which keys of a file are unknown, with the known one that is like each and not given; empty if none is."""
    from difflib import get_close_matches  # noqa: PLC0415  # 7 ms: only for a message

    found, left = [], [key for key in known if key not in given]
    for key in given:
        if key not in known:
            alike = get_close_matches(key[:80], left, 1) or get_close_matches(key[:80], known, 1)
            found.append(f"{key[:80]} ({alike[0]} is meant?)" if alike else key[:80])
    return f"no key {', '.join(found)}; there are {', '.join(known)}" if found else ""


class LcpError(Exception):
    """Base of all errors that the library raises on purpose; each is also a builtin error.

    Examples
    --------
    >>> try:
    ...     lcp.open_catalog(folder / "none.h5")
    ... except lcp.LcpError as error:
    ...     print(type(error).__name__)
    CatalogError
    """

    def __str__(self) -> str:
        """The message in one line of characters that a terminal only shows."""
        return " ".join(printable(super().__str__()).splitlines()).replace("\t", " ")

    @property
    def field(self) -> str | None:
        """The parameter or the field of the configuration that the message is about, the first that it
        names; None if it names none.

        >>> ConfigError("`points.spacing_m` must be above 0").field
        'points.spacing_m'
        """
        found = NAMED.search(str(self))
        return found[1] if found else None


class InputError(LcpError, FileNotFoundError):
    """An input file does not exist, or the system does not read it."""


class KindError(LcpError, TypeError):
    """A value is of another type than is wanted: `not_a`."""


def not_a(value: object, name: str, wanted: str) -> KindError:
    """The error of a parameter whose value is not what is ``wanted``."""
    return KindError(f"`{name}` must be {wanted}, not {type(value).__name__}")


def pair(value: Any, name: str, wanted: str) -> tuple[float, float]:
    """Two numbers that a parameter holds; KindError for anything else."""
    try:
        first, second = value
        return float(first), float(second)
    except (TypeError, ValueError) as error:
        raise not_a(value, name, wanted) from error


class LabelError(LcpError, ValueError):
    """A product's label is missing or contradicts itself, or its content is not supported."""


class DemError(LcpError, OSError):
    """A DEM file cannot be opened or read, or its pixels do not match its label."""


class AlbedoError(LcpError, ValueError):
    """An albedo map cannot be read, does not hold brightness, or does not cover the area."""


class AreaError(LcpError, ValueError):
    """An area is invalid, or the DEM has no heights in it."""


class SunError(LcpError, ValueError):
    """The position of the Sun is invalid, or the Sun does not light the area."""


class CameraError(LcpError, ValueError):
    """A camera file cannot be read, or the camera does not see the area."""


class ImageError(LcpError, ValueError):
    """An image file cannot be read, or is not of the expected kind."""


class PoseError(LcpError, ValueError):
    """The points do not determine the position of a sensor."""


class ConfigError(LcpError, ValueError):
    """A configuration value is unknown or out of range."""


class MeasurementError(LcpError, ValueError):
    """Measurements of a surface cannot be read, or are too few for a fit."""


class OutputExistsError(LcpError, FileExistsError):
    """The output exists, and replacing it was not allowed."""


class OutputError(LcpError, OSError):
    """The output cannot be written (disk full, no permission)."""


class CatalogError(LcpError, ValueError):
    """A file is not a catalogue, or is damaged."""


class AreaFailedError(LcpError, RuntimeError):
    """An area of a build failed; the message names the area and the cause."""


class ClusterError(LcpError, ConnectionError):
    """A scheduler cannot be reached, or a worker has another package or other files."""


class MissingPackageError(LcpError, ImportError):
    """A package is not installed that only this output needs."""


def unread(path: object, error: OSError) -> InputError:
    """The error of an input file that is not there, or that the system does not read."""
    missing = isinstance(error, FileNotFoundError)
    return InputError(f"{path}: {'there is no such file' if missing else error.strerror or error}")


def package(name: str, extra: str, wanted_for: str) -> Any:
    """The module of a package. MissingPackageError, with the command that installs it, if it is not
    installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        text = f"{wanted_for} needs the package {name.partition('.')[0]}: pip install 'lcp-catalog[{extra}]'"
        raise MissingPackageError(text) from error
