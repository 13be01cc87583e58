"""``python -m benchmarks.faults SECTION``."""

import sys

from benchmarks.sections import run

SECTIONS = {
    "kills": "processes of a build get signals at random moments",
    "disks": "full disks, replaced and cut inputs, two builds of one output, wrong bits in checkpoints",
    "damage": "catalogues and checkpoints with changed bytes",
    "calls": "every system call on a command's files fails once",
    "fuzz": "every parser, given files with random damage",
}

if __name__ == "__main__":
    sys.exit(run("benchmarks.faults", SECTIONS))
