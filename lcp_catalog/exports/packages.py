"""Packages that only some exports need, and that only an extra installs."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ..errors import MissingPackageError


def package(name: str, extra: str, wanted_for: str) -> Any:
    """The module of a package. MissingPackageError, with the command that installs it, if it is not
    installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        text = f"{wanted_for} needs the package {name.partition('.')[0]}: pip install 'lcp-catalog[{extra}]'"
        raise MissingPackageError(text) from error
