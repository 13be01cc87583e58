"""MODEL.toml: a facet model as readable text, with the data of its fit. Reading returns exactly the
values that were written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import tomli_w

from ..errors import ConfigError, InputError, plain
from ..toml_files import is_number, parse_toml
from .facet_model import DEFAULT, NAMED, FacetModel, Node, Optics, Shadowing, named_model

FORMAT = "lcp facet model 1"

_HEAD = """# A reflectance model of a measured surface, by name: facet:THIS_FILE.
# Two lobes, each with a weight, a shift (degrees) and a scale, at every angle of incidence: docs/explanation/facet-model.md.
"""
_PLAIN = ("largest_emission_deg", "albedo")


@dataclass(frozen=True)
class FacetFile:
    """A facet model, and the data of its fit (plain TOML: numbers, texts, lists, tables)."""

    model: FacetModel
    fit: Mapping[str, Any] = field(default_factory=dict)

    def to_toml(self) -> str:
        model = self.model
        document: dict[str, Any] = {"format": FORMAT, "name": model.name}
        document |= {name: float(getattr(model, name)) for name in _PLAIN}
        if model.levels is not None:
            document["levels"] = [float(level) for level in model.levels]
        groups = {"optics": asdict(model.optics), "shadowing": asdict(model.shadowing)}
        for name, group in groups.items():
            document[name] = {key: float(value) for key, value in group.items()}
        document["nodes"] = nodes_table(model.nodes)
        if self.fit:
            document["fit"] = dict(self.fit)
        return _HEAD + tomli_w.dumps(document)

    @classmethod
    def from_toml(cls, text: str) -> FacetFile:
        """Parse TOML text; ConfigError for an invalid document."""
        document = parse_toml(text)
        if document.pop("format", None) != FORMAT:
            raise ConfigError(f"not a facet model: format = {FORMAT!r} is missing")
        fit = document.pop("fit", {})
        if not isinstance(fit, dict):
            raise ConfigError("[fit] must be a table")
        return cls(_model(document), fit)


def load_model(path: Path | str) -> FacetFile:
    """Read a MODEL.toml; the ConfigError of an invalid file names it. InputError if there is none."""
    try:
        return FacetFile.from_toml(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no such file") from error
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not TOML: not a text file in UTF-8") from error
    except ConfigError as error:
        raise ConfigError(f"{path}: {plain(error)}") from error


def facet_model(which: str = "") -> FacetModel:
    """Model for the text after ``facet:``, a table of the paper or a MODEL.toml; without a text,
    table 3. ConfigError if it is neither.
    """
    path = model_path(which)
    return load_model(path).model if path else named_model(which or DEFAULT)


def model_path(which: str) -> Path | None:
    """File for the text after ``facet:``; None if the text is the name of a table."""
    if which in NAMED or not (which.lower().endswith(".toml") or Path(which).is_file()):
        return None
    return Path(which)


def law_file(spec: str) -> Path | None:
    """File of a reflectance model, if it has one: ``facet:MODEL.toml``."""
    law, _, which = spec.partition(":")
    return model_path(which) if law == "facet" and which else None


def nodes_table(nodes: tuple[Node, ...]) -> dict[str, list[float]]:
    """One list for each parameter, one value for each node."""
    return {name: [float(getattr(node, name)) for node in nodes] for name in Node._fields}


def _model(document: dict[str, Any]) -> FacetModel:
    known = {f.name for f in fields(FacetModel)}
    unknown = sorted(set(document) - known)
    if unknown:
        raise ConfigError(
            f"unknown key {', '.join(unknown)}; valid keys: {', '.join(sorted(known))}"
        )
    if not isinstance(document.get("name"), str):
        raise ConfigError("name must be a text")
    plain = {name: _number(name, document[name]) for name in _PLAIN if name in document}
    levels = document.get("levels")
    optics = Optics(**_group("optics", Optics, document))
    shadowing = Shadowing(**_group("shadowing", Shadowing, document))
    numbers = None if levels is None else _numbers("levels", levels)
    # the document's keys are the fields of the model, checked above
    return FacetModel(
        document["name"], _nodes(document), optics, shadowing, levels=numbers, **plain
    )


def _group(name: str, kind: type, document: dict[str, Any]) -> dict[str, float]:
    table = document.get(name, {})
    known = [f.name for f in fields(kind)]
    if not isinstance(table, dict):
        raise ConfigError(f"[{name}] must be a table")
    unknown = sorted(set(table) - set(known))
    if unknown:
        raise ConfigError(
            f"[{name}] has no key {', '.join(unknown)}; valid keys: {', '.join(known)}"
        )
    return {key: _number(f"{name}.{key}", value) for key, value in table.items()}


def _nodes(document: dict[str, Any]) -> tuple[Node, ...]:
    table = document.get("nodes")
    if not isinstance(table, dict) or set(table) != set(Node._fields):
        raise ConfigError(f"[nodes] must hold the lists {', '.join(Node._fields)}")
    columns = [_numbers(f"nodes.{name}", table[name]) for name in Node._fields]
    if len({len(column) for column in columns}) != 1:
        raise ConfigError("the lists of [nodes] must be of one length")
    return tuple(map(Node._make, zip(*columns, strict=True)))


def _numbers(name: str, value: object) -> tuple[float, ...]:
    if not isinstance(value, list):
        raise ConfigError(f"{name} must be a list of numbers")
    return tuple(_number(name, item) for item in value)


def _number(name: str, value: object) -> float:
    if not isinstance(value, int | float) or not is_number(value):
        raise ConfigError(f"{name} must be a number, not {value!r:.40}")
    return float(value)
