"""The files of the tutorial of a descent: made DEMs that continue the sample, and levels that they resolve."""

from __future__ import annotations

import importlib.util
import tomllib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import rasterio
from rasterio.windows import from_bounds
from scipy.ndimage import label

from lcp_catalog.dem.dem import Dem
from lcp_catalog.terrain.useful_cell import resolves

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "sample_data/hadley_gld100_256ppd.tif"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The made DEMs."""
    made = example("made_dem")
    made.SAMPLE, made.FOLDER = str(SAMPLE), tmp_path_factory.mktemp("made")
    made.main()
    return made.FOLDER


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / f"sample_data/examples/{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def means(heights: np.ndarray, times: int) -> np.ndarray:
    """Means of blocks of so many pixels a side."""
    rows, cols = (n // times for n in heights.shape)
    return heights.reshape(rows, times, cols, times).mean(axis=(1, 3))


def heights(path: Path, bounds: tuple[float, ...] | None = None) -> np.ndarray:
    with rasterio.open(path) as file:
        window = bounds and from_bounds(*bounds, file.transform).round_offsets().round_lengths()
        return file.read(1, window=window).astype(float)


@pytest.mark.slow
def test_the_made_dems_continue_the_sample(folder: Path) -> None:
    """The heights of the sample at the border, and everywhere its waves of several kilometres; else within its
    errors.
    """
    wide = folder / "made_59m.tif"
    with rasterio.open(wide) as file:
        bounds = file.bounds
    own, coarse = means(heights(wide), 2), heights(SAMPLE, bounds)
    off = own - coarse
    edge = np.ones(off.shape, bool)
    edge[1:-1, 1:-1] = False
    assert np.abs(off[edge]).max() < 2.0  # mean of a cubic spline over a pixel against its middle
    assert 15.0 < np.std(off) < 30.0  # of the sample's own errors, 24.5 m
    assert np.std(means(off, 48)) < 8.0  # over 5.7 km


@pytest.mark.slow
@pytest.mark.parametrize("names", [("made_59m", "made_30m"), ("made_30m", "made_15m")])
def test_finer_made_dems_have_the_means_of_coarser_ones(
    folder: Path, names: tuple[str, str]
) -> None:
    coarse, fine = (folder / f"{name}.tif" for name in names)
    with rasterio.open(fine) as file:
        bounds = file.bounds
    np.testing.assert_allclose(means(heights(fine), 2), heights(coarse, bounds), atol=1e-3)


@pytest.mark.slow
def test_every_level_of_the_tutorial_is_resolved(folder: Path) -> None:
    config = tomllib.loads((ROOT / "sample_data/examples/descent.toml").read_text(encoding="utf-8"))
    dems = [Dem.open(path) for path in (SAMPLE, *sorted(folder.glob("made_*m.tif")))]
    finest = [
        min(cell for cell in config["area"]["levels_m"] if resolves(dem, cell)) for dem in dems
    ]
    assert finest == [472.0, 15.0, 30.0, 59.0]


def test_made_craters_are_as_many_as_stated() -> None:
    """Bowls of 0.45 to 0.9 km on 60 x 60 km: 0.077 (D^-2 - 0.9^-2) a km2 wider than D; their floors are deepest."""
    made = example("made_dem")
    made.CRATERS_KM = 0.45, 0.9
    ground = made.craters((600, 600), 100.0, np.random.default_rng(3))
    count = label(ground < -5.0)[1]
    assert count == pytest.approx(0.077 * (0.45**-2 - 0.9**-2) * 3600, rel=0.15)
    assert -0.16 * 900.0 * 1.5 < ground.min() < -0.1 * 450.0
    assert 0.0 < ground.max() < 0.1 * 900.0
