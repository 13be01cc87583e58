"""Every figure of the page "Claims": simulated searches, simulated frames, photographs, navigation, sizes of cells and patches.

    .venv/bin/python benchmarks/claims.py [simulated frames photographs navigation sizes sample] [-o build/claims]

Without a section: all. The shared lunar data are needed (see `tests/conftest.py`). Each section writes `SECTION.md`,
`SECTION.json` and its diagrams; finished parts of an interrupted run are kept and used. `--cases`, `--draws` and `--frames` make
a shorter run.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]
for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

Section = tuple[str, dict[str, object]]


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=", ".join(SECTIONS))
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build" / "claims")
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument(
        "--cases", type=int, default=33, help="simulated: places under each of 30 Suns"
    )
    parser.add_argument(
        "--draws", type=int, default=25, help="simulated: draws of the noise of a case"
    )
    parser.add_argument(
        "--frames", type=int, default=200, help="frames and navigation: number of frames"
    )
    parser.add_argument(
        "--set", choices=("fit", "kept"), default="fit", help="photographs: which ones"
    )
    asked = parser.parse_args(argv)
    for name in asked.sections:
        if name not in SECTIONS:
            parser.error(f"no section {name!r}; there are {', '.join(SECTIONS)}")
    asked.output.mkdir(parents=True, exist_ok=True)
    for name in asked.sections or SECTIONS:
        text, figures = SECTIONS[name](asked)
        stem = f"{name}-{asked.set}" if name == "photographs" else name
        (asked.output / f"{stem}.md").write_text(text, encoding="utf-8")
        written = json.dumps(figures, indent=1, allow_nan=True)
        (asked.output / f"{stem}.json").write_text(written, encoding="utf-8")
        print(f"## {stem}\n\n{text}")


def shared_data() -> Path:
    """The folder of `LCP_SHARED_DATA`, else beside or in the checkout."""
    beside = [ROOT / "shared" / "data", ROOT.parent / "shared" / "data"]
    places = [Path(p) for p in [os.environ.get("LCP_SHARED_DATA", "")] if p] + beside
    return next((place for place in places if place.is_dir()), places[0])


def simulated(asked: argparse.Namespace) -> Section:
    import claims_simulated as section

    cases = section.work(asked.output / "simulated", asked.data, asked.cases, asked.draws)
    return section.report(cases, asked.draws, asked.output)


SECTIONS: dict[str, Callable[[argparse.Namespace], Section]] = {
    "simulated": simulated,
}


if __name__ == "__main__":
    main()
