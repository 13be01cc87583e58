"""Public functions about catalogues: what one holds, how two differ, a report as a page."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeAlias

from .catalogue import Catalog
from .comparison import Comparison, compare, compare_catalogs
from .report import write_report
from .summary import describe
from .verification import open_catalog

CatalogOrPath: TypeAlias = Catalog | Path | str


def opened_catalog(catalog: CatalogOrPath, check: bool = True) -> Catalog:
    """A catalogue, opened if its file is given (`open_catalog`)."""
    return catalog if isinstance(catalog, Catalog) else open_catalog(catalog, check)


def inspect(catalog: Path | str) -> dict[str, Any]:
    """What a catalogue file holds, and whether it is intact. Every variable and checksum is read.

    Parameters
    ----------
    catalog:
        The file.

    Returns
    -------
    dict
        The document of ``lcp inspect``: ``points``, ``usable_share`` (of all evaluated
        conditions), ``intact``, ``problems`` (one line each), ``schema_version``, ``sources``,
        ``bounds`` (degrees; west above east if they cross the prime meridian) and others; None for
        what cannot be read. A damaged file is no error: ``intact`` is False.

    Examples
    --------
    >>> found = lcp.inspect(catalog)
    >>> found["intact"], found["problems"]
    (True, [])
    """
    return describe(catalog)


def diff(first: CatalogOrPath, second: CatalogOrPath) -> Comparison:
    """Differences of two catalogues: points of the second that came, went, moved or changed since the
    first.

    Points are matched by their ids and compared in every variable. A point without partner has moved
    if the nearest one without partner of the same level lies within the spacing. The version of the
    software and the order of the points do not count.

    Parameters
    ----------
    first, second:
        Two catalogues, or their files.

    Returns
    -------
    Comparison
        ``differs``; ``counts()`` of points by kind; ``moves()`` and ``changes()`` point by point;
        ``summary()``, a document.

    Raises
    ------
    CatalogError
        For a file that is no catalogue or is damaged.

    Examples
    --------
    >>> found = lcp.diff(catalog, catalog)
    >>> found.differs, found.counts()["changed"]
    (False, 0)
    """
    if isinstance(first, Catalog) or isinstance(second, Catalog):
        return compare_catalogs(opened_catalog(first), opened_catalog(second))
    return compare(first, second)


def report(catalog: Path | str, output: Path | str, *, overwrite: bool = False) -> None:
    """Write the report of a catalogue, one HTML page without external references: map of the points,
    the points under a chosen Sun, their patches, what the catalogue promises.

    Parameters
    ----------
    catalog:
        The file.
    output:
        The page, .html.
    overwrite:
        True: replace an existing page.

    Raises
    ------
    CatalogError
        For a file that is no catalogue or is damaged.
    OutputExistsError, OutputError
        For the page.

    Examples
    --------
    >>> lcp.report(catalog, folder / "small.html")
    >>> (folder / "small.html").read_text()[:15]
    '<!DOCTYPE html>'
    """
    write_report(catalog, output, overwrite)
