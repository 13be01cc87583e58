"""Files that were given in the place of others."""

import os
from pathlib import Path

import pytest

from lcp_catalog.errors import LabelError
from lcp_catalog.file_kinds import may_wait, other_kind
from lcp_catalog.pds.label import beginning


def test_pipes_and_devices_may_wait_and_nothing_else(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "plain").write_bytes(b"some")
    (tmp_path / "broken").symlink_to("none")
    assert all(map(may_wait, (tmp_path / "pipe", tmp_path / "link", "/dev/zero")))
    assert not any(may_wait(tmp_path / name) for name in ("plain", "broken", "none", "."))
    with pytest.raises(LabelError, match="/dev/zero: is a pipe or a device; only plain files"):
        beginning(Path("/dev/zero"), 10)
    assert beginning(tmp_path / "plain", 3) == b"som"


@pytest.mark.parametrize(
    ("content", "wanted", "raster", "says"),
    [
        (b"\x89HDF\r\n\x1a\n", "a DEM", True, "is an HDF5 file, such as a catalogue, not a DEM"),
        (b"\x89HDF\r\n\x1a\n", "a catalogue", False, ""),
        (b"\x89PNG\r\n\x1a\n", "a catalogue", False, "is a PNG image, not a catalogue"),
        (b"\x89PNG cut short", "an image", True, ""),
        (b"II*\0", "a DEM", True, ""),
        (b'\n {"a": 1}', "a catalogue", False, "is a JSON file, such as a camera, not a catalogue"),
        (b"anything", "a catalogue", False, ""),
        (b"", "a catalogue", False, ""),
    ],
)
def test_a_file_is_known_by_its_beginning(
    content: bytes, wanted: str, raster: bool, says: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.dat"
    path.write_bytes(content)
    assert other_kind(path, wanted, raster) == says


def test_a_configuration_is_known_by_its_name_and_a_missing_file_is_not(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text("[area]\n")
    assert "which is given with `config`, not a DEM" in other_kind(path, "a DEM", True)
    assert other_kind(tmp_path / "none.h5", "a DEM") == ""
