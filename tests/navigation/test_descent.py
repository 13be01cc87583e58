"""The flight file of a descent: what its frames claim is what they claim of the whole file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import flight_c, navigable, posed
from helpers.commands import refusal
from lcp_cli.main import run

import lcp_catalog as lcp
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.exports.flight import FlightFile
from lcp_catalog.geometry.frames import EnuFrame, direction_enu


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue, its flight file, and a trajectory of two frames that sees a part of it under one Sun."""
    folder = tmp_path_factory.mktemp("descent")
    write_catalog(navigable.everywhere_usable(100), folder / "c.h5")
    cameras = []
    for lon in (3.4, 3.6):
        frame = EnuFrame(lon, 26.0)
        sun = 1.5e11 * frame.direction_to_mcmf(direction_enu(100.0, 17.0))
        cameras.append(replace(posed.camera(frame), sun_position_mcmf_m=sun))
    (folder / "way.json").write_text(json.dumps([one.to_json() for one in cameras]))
    assert run(["export", str(folder / "c.h5"), "-o", str(folder / "whole.lcpf")]) == 0
    return folder


def _export(site: Path, *words: str) -> list[str]:
    return ["export", str(site / "c.h5"), "-o", str(site / "few.lcpf"), "--overwrite", *words]


def test_it_is_smaller_and_says_so(site: Path, capsys) -> None:
    assert run(_export(site, "--for-trajectory", str(site / "way.json"))) == 0
    said = capsys.readouterr().err
    few, whole = (FlightFile.of(site / f"{name}.lcpf") for name in ("few", "whole"))
    share = (site / "few.lcpf").stat().st_size / (site / "whole.lcpf").stat().st_size
    assert f"{few.header['file_bytes']} bytes, {100 * (1 - share):.1f} % less than without" in said
    located = [
        answer.joint.located for answer in lcp.query_trajectory(site / "c.h5", site / "way.json")
    ]
    assert (
        f"2 frames is located: {min(located):.3f} to {max(located):.3f}, median {max(located):.3f}"
        in said
    )
    assert f"at least 0.99 in {sum(value >= 0.99 for value in located)}\n" in said
    assert len(few.points) < len(whole.points)
    assert few.header["suns"] <= 6 < whole.header["suns"]


@pytest.mark.slow
@pytest.mark.skipif(flight_c.COMPILER is None, reason="no C compiler is installed")
def test_its_frames_claim_the_same(site: Path, tmp_path: Path) -> None:
    assert run(_export(site, "--for-trajectory", str(site / "way.json"))) == 0
    reference = flight_c.Reference(tmp_path)
    for document in json.loads((site / "way.json").read_text()):
        camera = flight_c.camera_record(lcp.Camera(**{**document, "time_utc": None}))
        found = []
        for name in ("few", "whole"):
            path = site / f"{name}.lcpf"
            assert reference.open(path.read_bytes()) == 0
            ids = FlightFile.of(path).points["point_id"]
            claims = reference.in_view(camera, 200)
            order = np.argsort(ids[claims["point"]])
            known = order[np.isfinite(claims["probability"][order])]
            found.append((ids[claims["point"]][known], claims[known]))
        (few_id, few), (whole_id, whole) = found
        assert len(few_id) > 5
        np.testing.assert_array_equal(few_id, whole_id)
        np.testing.assert_allclose(few["probability"], whole["probability"])
        np.testing.assert_array_equal(few["usable"], whole["usable"])
        np.testing.assert_allclose(few["sigma"], whole["sigma"], rtol=0.03)  # steps of its own


def test_refusals(site: Path, capsys, tmp_path: Path) -> None:
    way = str(site / "way.json")
    csv = ["export", str(site / "c.h5"), "-o", str(tmp_path / "a.csv"), "--for-trajectory", way]
    assert ".lcpf files only" in refusal(csv, 2, capsys)
    assert "--for-trajectory" in refusal(_export(site, "--camera", way), 2, capsys)
    far = json.loads((site / "way.json").read_text())[:1]
    far[0] |= replace(posed.camera(EnuFrame(80.0, 26.0))).to_json()
    (tmp_path / "far.json").write_text(json.dumps(far))
    words = _export(site, "--for-trajectory", str(tmp_path / "far.json"))
    assert "no frame of the trajectory sees a point" in refusal(words, 1, capsys)
    assert list(tmp_path.glob("*.csv")) == []
