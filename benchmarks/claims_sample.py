"""The sample's catalogue: share of its conditions that are usable, by the Sun's elevation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from lcp_cli.main import run

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.hdf5 import open_catalog
from lcp_catalog.catalog.schema import EVALUATED, USABLE

ROOT = Path(__file__).resolve().parents[1]
DEM = ROOT / "sample_data" / "hadley_gld100_256ppd.tif"
CONFIG = ROOT / "sample_data" / "hadley.toml"


def work(folder: Path, before: Path | None) -> dict[str, Catalog]:
    """The catalogue as the command builds it, and an older one of the same area where given."""
    path = folder / "sample.h5"
    if not path.exists() and run(
        ["build-catalog", str(DEM), "-o", str(path), "--config", str(CONFIG)]
    ):
        raise SystemExit("the sample's build failed")
    older = {} if before is None else {"before": open_catalog(before)}
    return older | {"now": open_catalog(path)}


def shares(catalog: Catalog) -> dict[float, tuple[int, int, int]]:
    """By elevation: conditions of points that were evaluated, those usable, and points usable in any of them."""
    out = {}
    for k, elevation in enumerate(catalog.sun_elevation):
        flags = catalog.condition[:, :, k]
        usable = (flags & USABLE) == USABLE
        out[float(elevation)] = (
            int(((flags & EVALUATED) > 0).sum()),
            int(usable.sum()),
            int(usable.any(axis=(1, 2)).sum()),
        )
    return out


def report(catalogs: dict[str, Catalog]) -> tuple[str, dict[str, object]]:
    """Markdown and figures."""
    found = {name: shares(catalog) for name, catalog in catalogs.items()}
    heads = [f"{name}: conditions | usable, % | points usable" for name in found]
    lines = ["| Sun, deg | " + " | ".join(heads) + " |", "| ---: |" + " ---: |" * 3 * len(found)]
    for elevation in sorted(set().union(*found.values())):
        cells = []
        for name, of in found.items():
            tried, usable, points = of.get(elevation, (0, 0, 0))
            share = f"{100.0 * usable / tried:.1f}" if tried else "-"
            cells.append(f"{tried} | {share} | {points} of {len(catalogs[name])}")
        lines.append(f"| {elevation:g} | " + " | ".join(cells) + " |")
    universal = catalogs["now"].universal
    if universal is not None:
        lines += ["", f"Universal points: {int(np.sum(universal))} of {len(universal)}."]
    return "\n".join(lines) + "\n", {
        name: {str(e): v for e, v in of.items()} for name, of in found.items()
    }
