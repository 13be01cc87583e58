"""The sample data: a DEM, an albedo map, a photograph with its camera, and what builds a catalogue of them."""

from __future__ import annotations

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
    "pipeline/Makefile",
    "pipeline/site.toml",
)
"""Files of the sample; `PROVENANCE.txt` states source and licence of each datum."""


def sample_folder() -> Path:
    """Folder with the sample data: in the installed package or, for a checkout, beside the package."""
    package = Path(__file__).resolve().parent
    installed = package / "sample_data"
    return installed if installed.is_dir() else package.parent / "sample_data"


def write_sample(folder: Path, overwrite: bool = False) -> tuple[Path, ...]:
    """Write the files of the sample into a folder, which is created if missing.

    The paths that were written. Nothing is written if one of the files exists (OutputExistsError, unless
    ``overwrite``) or no folder can be at that place (OutputError).
    """
    source = sample_folder()
    for part in sorted({Path(name).parent for name in SAMPLE_FILES}):
        names = [Path(name).name for name in SAMPLE_FILES if Path(name).parent == part]
        if (folder / part).exists() or part == Path():
            check_folder(folder / part, names, overwrite)
    for name in SAMPLE_FILES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / name, (source / name).read_bytes(), overwrite)
    return tuple(folder / name for name in SAMPLE_FILES)
