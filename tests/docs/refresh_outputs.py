"""Write what the commands print into the pages that quote it: python tests/docs/refresh_outputs.py [PAGE.md ...]

Without pages: all that have a session. Read the difference (git diff) before it is committed.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers.quoted_outputs import ROOT, SESSION, outputs, refreshed, sample_catalog, session_folder


def main(pages: list[Path]) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        catalog = Path(scratch) / "hadley.h5"
        for number, page in enumerate(pages):
            text = page.read_text(encoding="utf-8")
            session = SESSION.search(text)
            if session is None:
                continue
            folder = Path(scratch) / str(number)
            folder.mkdir()
            if session[1] == "the checkout":
                session_folder(folder, catalog if catalog.exists() else sample_catalog(catalog))
            runs = outputs(text, folder)
            faults = [fault for run in runs if (fault := run.fault()) is not None]
            page.write_text(refreshed(text, runs), encoding="utf-8")
            print(f"{page}: {len(faults)} of {len(runs)} outputs or exit codes differed")
            for fault in faults:
                print(fault)


if __name__ == "__main__":
    given = [Path(name) for name in sys.argv[1:]]
    main(given or [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))])
