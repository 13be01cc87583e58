"""``python -m benchmarks.evidence SECTION``."""

import sys

from benchmarks.sections import run

SECTIONS = {
    "photographs": "every photograph: located, windows, claims, metres; a page with pictures",
    "frames": "simulated frames: claims of their points, and of their positions",
    "wrong": "photographs with wrong Suns, mirrored, of other ground: does `locate` say so?",
    "promise": "random cameras over CATALOG.h5: as many points as are promised",
}
BY_DEFAULT = ("photographs", "frames", "wrong")

if __name__ == "__main__":
    sys.exit(run("benchmarks.evidence", SECTIONS, by_default=BY_DEFAULT))
