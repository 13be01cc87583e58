"""``python -m benchmarks.speed SECTION``."""

import sys

from benchmarks.sections import run

SECTIONS = {
    "matching": "points a second, and their search beside OpenCV's",
    "build": "areas by stage beside a straightforward pipeline; whole builds beside another commit",
    "peers": "shadows, sweeps and camera rays beside Mitsuba and Embree",
    "render": "lcp render as a whole process beside a minimal Embree script",
    "query": "frames and trajectories asked of a catalogue of 100 000 points",
    "merge": "the end of a large build, and the check of finished areas",
    "scale": "plans and areas of the belt of the Moon; what --plan states; a large catalogue's commands",
}

if __name__ == "__main__":
    sys.exit(run("benchmarks.speed", SECTIONS))
