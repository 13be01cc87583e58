"""Public function that measures the accuracy tiers on a user's own build."""

from __future__ import annotations

from pathlib import Path

from ..dem.public import Dems
from ..errors import ConfigError
from ..production.config import BuildConfig
from ..production.public import planned_build
from .measurement import AREAS, ROUNDS, Progress, Trade, measure_trade
from .report import check_trade_folder, write_trade


def trade(
    dem: Dems,
    output: Path | str | None = None,
    *,
    config: BuildConfig | Path | str | None = None,
    center_deg: tuple[float, float] | None = None,
    size_km: float | None = None,
    bounds_deg: tuple[float, float, float, float] | None = None,
    gsd_m: float | None = None,
    areas: int = AREAS,
    rounds: int = ROUNDS,
    isolated: bool = True,
    overwrite: bool = False,
    progress: Progress = lambda done, total: None,
) -> Trade:
    """Measure the run time and the errors of each accuracy tier on a DEM and a sweep: some areas of a
    build are computed in every tier and compared with the tier ``reference``.

    Parameters
    ----------
    dem:
        DEM files, or an opened set.
    output:
        Also write trade.json, trade.html and trade.md into this folder.
    config, center_deg, size_km, bounds_deg, gsd_m:
        The build, as `build_catalog`; one level of cells.
    areas:
        Number of the build's areas to compute, spread over the region.
    rounds:
        Timed runs of each area in each tier; the median counts.
    isolated:
        True: each tier in a process of its own; False: in this one, without memory figures.
    overwrite:
        True: replace existing files of the folder.
    progress:
        Called with the number of runs done and of all.

    Returns
    -------
    Trade
        ``rows``, one object a tier (seconds, errors, points lost and gained); ``document()``.

    Raises
    ------
    ConfigError
        For several levels of cells, or a number below 1.
    LcpError
        As `build_catalog`.

    Examples
    --------
    >>> measured = lcp.trade(
    ...     folder / "hadley_gld100_256ppd.tif", config=small_config, gsd_m=480,
    ...     center_deg=(3.5, 26.0), size_km=15, areas=1, rounds=1, isolated=False,
    ... )
    >>> [row["accuracy"] for row in measured.rows]
    ['draft', 'standard', 'high', 'reference']
    """
    folder = None if output is None else Path(output)
    if folder is not None:
        check_trade_folder(folder, overwrite)
    build = planned_build(
        dem, config, center_deg=center_deg, size_km=size_km, bounds_deg=bounds_deg, gsd_m=gsd_m
    )
    if len(build.levels) > 1:
        raise ConfigError(
            "the configuration has several levels, but the tiers are compared on one cell size: give `area.gsd_m`"
        )
    found = measure_trade(build, areas, rounds, isolated, progress)
    if folder is not None:
        write_trade(found, folder, overwrite)
    return found
