"""Write the list of the kernels that commands call, `lcp_catalog/kernels/entries.json`, from runs of the commands on the
sample, each in a process: .venv/bin/python tests/kernels/refresh_entries.py

The seconds are processor times of compilation, those of a run without compiled kernels (``NUMBA_CACHE_DIR=EMPTY_FOLDER``);
a kernel that is only loaded keeps the seconds that the list has.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
LIST = ROOT / "lcp_catalog" / "kernels" / "entries.json"
SAMPLE = ROOT / "sample_data"
DEM, CAMERA = "hadley_gld100_256ppd.tif", "AS15-M-0414_camera.json"
MAPS = ["--dem", DEM, "--albedo", "hadley_albedo_643nm_11ppd.tif"]
HADLEY = ["--center", "3.5", "26"]
SUN = ["--sun-azimuth", "96.5", "--sun-elevation", "13.7"]
AREA = [*HADLEY, "--size", "40", *SUN]

VALIDATE = ["validate", "{}/sample.h5", "AS15-M-0414.png", "--camera", CAMERA]

RUNS = [
    ["build-catalog", DEM, "-o", "{}/sample.h5", "--config", "hadley.toml", "--jobs", "1"],
    ["build-catalog", DEM, "-o", "{}/plain.h5", *HADLEY, "--size", "30", "--jobs", "1"],
    ["camera", "info", CAMERA, "--catalog", "{}/sample.h5"],
    ["render", DEM, "-o", "{}/c.tif", "--camera", CAMERA, "--frame", "camera", "--gsd", "474"],
    ["render", DEM, "-o", "{}/a.tif", *AREA],
    ["", "render", DEM, "-o", "{}/r.tif", *AREA, "--accuracy", "reference"],
    ["", "render", DEM, "-o", "{}/d.tif", *AREA, "--accuracy", "draft"],
    [*VALIDATE, *MAPS, "--known-pose", "-o", "{}/known"],
    [*VALIDATE, "-o", "{}/searched"],
    ["query", "{}/sample.h5", "--camera", CAMERA],
    ["simulate", "{}/sample.h5", "--camera", CAMERA, "-o", "{}/s.tif"],
]
"""Commands in the folder of the sample; {} is a temporary folder. What a command with an empty word before it calls is not
compiled before the command's first run, only by `lcp warm-up`."""


def calls(arguments: list[str]) -> list[tuple[str, str, float]]:
    """Run a command here; kernel, signature, and seconds of compilation of each kernel that Python called."""
    import os

    from numba.core import event

    from lcp_catalog.kernels import cache

    os.chdir(SAMPLE)
    found: list[tuple[str, str, float]] = []
    open_since: list[float] = []
    load = cache._Files.load_overload

    class Compilations(event.Listener):  # type: ignore[misc]  # numba has no types
        def on_start(self, event: Any) -> None:
            open_since.append(time.process_time())

        def on_end(self, event: Any) -> None:
            seconds = time.process_time() - open_since.pop()
            files = event.data["dispatcher"]._cache
            if (
                not open_since
                and isinstance(files, cache._Files)
                and not any(event._exc_details or ())
            ):
                found.append((files.kernel, repr(event.data["args"]), seconds))

    def loaded(self: cache._Files, signature: Any, context: Any) -> Any:
        result = load(self, signature, context)
        if result is not None and not open_since:
            found.append((self.kernel, repr(signature), 0.0))
        return result

    cache._Files.load_overload = loaded  # type: ignore[method-assign]  # listened to from outside
    event.register("numba:compile", Compilations())
    from lcp_cli.main import run

    code = run(arguments)
    assert code in (0, 4), code
    return found


def refreshed(folder: str) -> None:
    """Run all commands and write the list."""
    known = {(e["kernel"], e["signature"]): e for e in json.loads(LIST.read_text())}
    entries: dict[tuple[str, str], dict[str, Any]] = {}
    for run in RUNS:
        arguments = [part.format(folder) for part in run]
        command = [sys.executable, __file__, *filter(None, arguments)]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        for kernel, signature, seconds in json.loads(done.stdout.splitlines()[-1]):
            key = kernel, signature
            before = known.get(key, {}).get("seconds", 0.0)
            entry = entries.setdefault(
                key, {"kernel": kernel, "signature": signature, "seconds": 0.0, "commands": []}
            )
            entry["seconds"] = max(entry["seconds"], round(seconds, 1) or before)
            if run[0] and run[0] not in entry["commands"]:
                entry["commands"].append(run[0])
    rows = [json.dumps(entries[key]) for key in sorted(entries)]
    LIST.write_text("[\n" + ",\n".join(rows) + "\n]\n")
    print(*rows, sep="\n")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print("\n" + json.dumps(calls(sys.argv[1:])))
    else:
        import tempfile

        with tempfile.TemporaryDirectory() as made:
            refreshed(made)
