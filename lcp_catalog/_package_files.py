"""Files that the package hands out: the sample data (a DEM, an albedo map, a photograph with its camera, what builds a
catalogue of them, examples and schemas), the C reference of the flight file with its test vector, the how-to pages and
those of the reference.
"""

from __future__ import annotations

import re
from pathlib import Path

from .atomic_files import check_folder, write_bytes

SAMPLE_FILES = (
    "PROVENANCE.txt",
    "Makefile",
    "hadley.toml",
    "hadley_gld100_256ppd.tif",
    "hadley_albedo_643nm_11ppd.tif",
    "AS15-M-0414.png",
    "AS15-M-0414_camera.json",
    "goniometer_synthetic.csv",
    "sample.ipynb",
    "own_site.ipynb",
    "pipeline/Makefile",
    "pipeline/site.toml",
    "schemas/build.json",
    "schemas/camera.json",
    "schemas/report.json",
    "examples/locate_camera.py",
    "examples/orbit_pass.py",
    "examples/made_dem.py",
    "examples/descent.py",
    "examples/descent.toml",
)
"""Files of the sample; `PROVENANCE.txt` states source and licence of each datum."""

FLIGHT_FILES = (
    *("Makefile", "lcpf.h", "lcpf.c", "lcpf_example.c", "lcpf_fuzz.c"),
    *("vector.lcpf", "vector.pgm", "vector_camera.txt", "vector_expected.txt"),
)
"""Files of the C reference."""


def sample_folder() -> Path:
    """Folder with the sample data."""
    return _folder("sample_data", "sample_data")


_MADE = ("api", "commands")
"""Pages that only a build of the documentation fills."""


def pages() -> dict[str, str]:
    """The how-to pages and those of the reference, Markdown without comments, by the names of their files."""
    folders = _folder("howto", "docs/howto"), _folder("reference", "docs/reference")
    files = [path for folder in folders for path in folder.glob("*.md") if path.stem not in _MADE]
    texts = sorted((path.stem, path.read_text(encoding="utf-8")) for path in files)
    return {name: re.sub(r"<!--.*?-->\n*", "", text, flags=re.S) for name, text in texts}


def _folder(installed: str, in_checkout: str) -> Path:
    """A folder in the installed package or, for a checkout, beside the package."""
    package = Path(__file__).resolve().parent
    own = package / installed
    return own if own.is_dir() else package.parent / in_checkout


def write_sample(folder: Path, overwrite: bool = False) -> tuple[Path, ...]:
    """Write the files of the sample into a folder (`_written`)."""
    return _written(sample_folder(), SAMPLE_FILES, folder, overwrite)


def write_flight_source(folder: Path, overwrite: bool = False) -> tuple[Path, ...]:
    """Write the C reference of the flight file into a folder (`_written`)."""
    source = Path(__file__).resolve().parent / "flight"
    return _written(source, FLIGHT_FILES, folder, overwrite)


def _written(
    source: Path, files: tuple[str, ...], folder: Path, overwrite: bool
) -> tuple[Path, ...]:
    """Write files of the package into a folder, which is created if missing.

    The paths that were written. Nothing is written if one of the files exists (OutputExistsError, unless
    ``overwrite``) or no folder can be at that place (OutputError).
    """
    for part in sorted({Path(name).parent for name in files}):
        names = [Path(name).name for name in files if Path(name).parent == part]
        if (folder / part).exists() or part == Path():
            check_folder(folder / part, names, overwrite)
    for name in files:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / name, (source / name).read_bytes(), overwrite)
    return tuple(folder / name for name in files)
