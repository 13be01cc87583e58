"""The builds that a catalogue has points of, with their configurations: itself, or those it was merged from."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import reduce
from typing import Any

import tomli_w

from ..errors import CatalogError

MERGED = "merged"
"""Table of a merged catalogue's configuration with an entry for each build."""


@dataclass(frozen=True)
class Origin:
    """A build: its file's name, the digest of its content, its number of points, and its configuration."""

    name: str
    content_sha256: str
    points: int
    config: dict[str, Any]


def origins(config: str, itself: Origin | None = None) -> list[Origin]:
    """The builds of a catalogue with this attribute ``config``; ``itself``: what is known of one that was not
    merged. CatalogError for a table `MERGED` that does not hold them.
    """
    document = tomllib.loads(config)
    if MERGED not in document:
        return [replace(itself or Origin("", "", 0, {}), config=document)]
    try:
        common = {name: value for name, value in document.items() if name != MERGED}
        found = [
            Origin(
                str(one["name"]), str(one["content_sha256"]), _count(one["points"]), one["config"]
            )
            for one in document[MERGED]
        ]
        return [replace(one, config=_joined(common, one.config)) for one in found]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise CatalogError("its configuration does not say what it was merged from") from error


def _count(value: object) -> int:
    if type(value) is not int:
        raise TypeError
    return value


def united(groups: Iterable[Sequence[Origin]]) -> list[Origin]:
    """All builds, each once, in the order of their digests."""
    every = [one for group in groups for one in group]
    every.sort(key=lambda one: (one.content_sha256, one.name))
    return [
        a for k, a in enumerate(every) if a.content_sha256 != every[k - 1].content_sha256 or not k
    ]


def merged_config(builds: Sequence[Origin]) -> str:
    """The attribute ``config`` of a catalogue merged from builds: what all their configurations share, and
    under `MERGED` for each build the rest of its own.
    """
    common = reduce(_common, (one.config for one in builds))
    entries = [asdict(one) | {"config": _rest(one.config, common)} for one in builds]
    return tomli_w.dumps(common | {MERGED: entries})


def _common(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    """The entries that two documents share."""
    found = {}
    for name in first.keys() & second.keys():
        a, b = first[name], second[name]
        if isinstance(a, dict) and isinstance(b, dict):
            found[name] = _common(a, b)
        elif a == b:
            found[name] = a
    return {name: found[name] for name in first if name in found}


def _rest(document: dict[str, Any], common: dict[str, Any]) -> dict[str, Any]:
    """The entries of a document that are not common."""
    found = {}
    for name, value in document.items():
        if name not in common:
            found[name] = value
        elif isinstance(value, dict) and (own := _rest(value, common[name])):
            found[name] = own
    return found


def _joined(common: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """The document whose common entries and rest these are."""
    found = dict(common)
    for name, value in own.items():
        both = isinstance(value, dict) and isinstance(found.get(name), dict)
        found[name] = _joined(found[name], value) if both else value
    return found
