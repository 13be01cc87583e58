"""Requirements and merged configurations: valid texts, and what reads them, for the tests with damaged ones."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from lcp_catalog._package_files import sample_folder
from lcp_catalog.catalog.origins import Origin, merged_config, origins
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.toml_files import parse_toml
from lcp_catalog.validation.requirement import Requirement


def read_requirement(path: Path) -> None:
    terms = Requirement.parse(path.read_bytes().decode("utf-8", "surrogateescape")).terms
    assert all(math.isfinite(term.value) for term in terms if not isinstance(term.value, str))


def read_merged(path: Path) -> None:
    text = path.read_bytes().decode("utf-8", "replace")
    parse_toml(text)  # as the checks of a catalogue do
    found = origins(text)
    for one in found:
        config = BuildConfig.from_dict(one.config)
        for gsd_m in (config.area.gsd_m or 100.0, 100.0):
            config.points.check_cells(gsd_m)
            lengths = config.points.least_distance_m(gsd_m), config.points.search_nodes(gsd_m)
            assert all(map(math.isfinite, lengths))
    assert origins(merged_config(found)) == found or len(found) == 1


def requirements(folder: Path) -> Iterator[Path]:
    texts = (
        "share_above_0_9>=0.85 and points_found>=20",
        "windows.median > 0.5, pose.position_error<=1e3,images.claims.brier<0.1",
        "verdict==located AND verdict != 'not located'",
    )
    for number, text in enumerate(texts):
        (folder / f"{number}.txt").write_text(text)
        yield folder / f"{number}.txt"


def merged(folder: Path) -> Iterator[Path]:
    whole = parse_toml((sample_folder() / "hadley.toml").read_text())
    coarse = whole | {"area": whole["area"] | {"gsd_m": 480.0}}
    builds = [Origin("a.h5", "0" * 64, 7, whole), Origin("b.h5", "1" * 64, 8, coarse)]
    (folder / "merged.toml").write_text(merged_config(builds))
    yield folder / "merged.toml"
