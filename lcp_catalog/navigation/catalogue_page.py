"""The report of a catalogue as a page: what the file states, and what follows from it for frames."""

from __future__ import annotations

from pathlib import Path

from ..atomic_files import ending_of
from ..catalog.comparison import CatalogOrPath
from ..catalog.report import write_report
from .located_by_sun import located_by_sun


def report(catalog: CatalogOrPath, output: Path | str, *, overwrite: bool = False) -> None:
    """Write the report of a catalogue, one HTML page without external references: map of the points,
    the points under a chosen Sun, their patches, what the catalogue promises, and how probably frames of the promised
    footprint are located.

    Parameters
    ----------
    catalog:
        A catalogue, or its file.
    output:
        The page, .html.
    overwrite:
        True: replace an existing page.

    Raises
    ------
    CatalogError
        For a file that is no catalogue or is damaged.
    ConfigError
        For an output that does not end in .html.
    OutputExistsError, OutputError
        For the page.

    Examples
    --------
    >>> lcp.report(catalog, folder / "small.html")
    >>> (folder / "small.html").read_text()[:15]
    '<!DOCTYPE html>'
    """
    ending_of(output, (".html",))
    write_report(catalog, output, overwrite, located_by_sun)
