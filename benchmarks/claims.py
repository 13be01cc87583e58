"""Every figure of the page "Claims": simulated searches, simulated frames, photographs, navigation, sizes of cells and patches.

    .venv/bin/python benchmarks/claims.py [simulated frames photographs navigation positions descent sizes sample] [-o build/claims]

Without a section: all. The shared lunar data are needed (see `tests/conftest.py`). Each section writes `SECTION.md`,
`SECTION.json` and its diagrams; finished parts of an interrupted run are kept and used. `--cases`, `--draws` and `--frames` make
a shorter run.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

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
        "--frames",
        type=int,
        default=200,
        help="frames, navigation, positions, descent: number of frames",
    )
    parser.add_argument(
        "--relief",
        type=int,
        nargs="+",
        metavar="SEED",
        help="descent: seeds of made reliefs, which share the frames; default: the tutorial's",
    )
    parser.add_argument("--first", type=int, default=0, help="descent: number of the first frame")
    parser.add_argument(
        "--set", choices=("fit", "kept"), default="fit", help="photographs: which ones"
    )
    parser.add_argument(
        "--gsd",
        default="474",
        help="photographs: cell size in metres, or `own` for the build's choice",
    )
    parser.add_argument(
        "--no-albedo", action="store_true", help="photographs: without the albedo map"
    )
    parser.add_argument(
        "--before", type=Path, help="sample: an older catalogue of it, for comparison"
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
    if "LCP_SHARED_DATA" in os.environ:
        return Path(os.environ["LCP_SHARED_DATA"])
    places = [ROOT / "shared" / "data", ROOT.parent / "shared" / "data"]
    return next((place for place in places if place.is_dir()), places[0])


def simulated(asked: argparse.Namespace) -> Section:
    import claims_simulated as section

    cases = section.work(asked.output / "simulated", asked.data, asked.cases, asked.draws)
    return section.report(cases, asked.draws, asked.output)


def frames(asked: argparse.Namespace) -> Section:
    import claims_frames as section

    found = section.work(asked.output / "frames", asked.data, asked.frames)
    text, figures, scored = section.report(found)
    _drawn(asked.output / "frames.png", "Simulated frames", scored, ("all",))
    return text, figures


def photographs(asked: argparse.Namespace) -> Section:
    import claims_photographs as section

    names = section.chosen(asked.data, asked.set)
    build = section.Build(
        None if asked.gsd == "own" else float(asked.gsd), albedo=not asked.no_albedo
    )
    found = section.work(asked.output / "photographs", asked.data, names, build)
    text, figures, scored = section.report(found)
    _drawn(
        asked.output / f"photographs-{asked.set}.png",
        f"Photographs, {asked.set}",
        scored,
        tuple(scored),
    )
    return text, figures


def navigation(asked: argparse.Namespace) -> Section:
    import claims_frames
    import claims_navigation as section

    found = claims_frames.work(asked.output / "frames", asked.data, asked.frames)
    return section.report(found, asked.output / "navigation.png")


def positions(asked: argparse.Namespace) -> Section:
    import claims_positions as section

    folders = asked.output / "positions", asked.output / "frames"
    return section.report(section.work(*folders, asked.data, asked.frames))


def descent(asked: argparse.Namespace) -> Section:
    import claims_descent as section

    reliefs, found = asked.relief or [None], []
    count = asked.frames // len(reliefs)
    for k, relief in enumerate(reliefs):
        folder = asked.output / ("descent" if relief is None else f"descent-{relief}")
        found += section.work(folder, count, relief, asked.first + k * count)
    return section.report(found, asked.output / "descent.svg")


def sizes(asked: argparse.Namespace) -> Section:
    import claims_photographs as section

    return section.sizes(asked.output / "sizes", asked.data)


def sample(asked: argparse.Namespace) -> Section:
    import claims_sample as section

    return section.report(section.work(asked.output, asked.before))


def _drawn(path: Path, title: str, scored: dict[str, Any], names: Sequence[str]) -> None:
    """Reliability diagrams of the library's scores."""
    from claims_scores import diagram, of_scores

    diagram(path, title, {name: of_scores(scored[name]) for name in names if name in scored})


SECTIONS: dict[str, Callable[[argparse.Namespace], Section]] = {
    "simulated": simulated,
    "frames": frames,
    "photographs": photographs,
    "navigation": navigation,
    "positions": positions,
    "descent": descent,
    "sizes": sizes,
    "sample": sample,
}


if __name__ == "__main__":
    main()
