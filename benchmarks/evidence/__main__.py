"""``python -m benchmarks.evidence SECTION``."""

import sys

from benchmarks.sections import run

SECTIONS = {
    "photographs": "every photograph: located, windows, claims, metres; pictures",
    "frames": "simulated frames: claims of their points, and of their positions",
    "wrong": "photographs with wrong Suns, mirrored, of other ground: does `locate` say so?",
    "survival": "which matcher survives which Sun: correlation, OpenCV's and learned features, ours",
}

if __name__ == "__main__":
    sys.exit(run("benchmarks.evidence", SECTIONS))
