"""Public functions that make catalogues: a build, and a merge of several."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..atomic_files import ending_of
from ..cameras.public import SensorOrPath, any_sensor
from ..catalog.comparison import CatalogOrPath
from ..choices import INDEX
from ..dem.mosaic import DemSet
from ..dem.public import Dems, dem_paths
from ..errors import not_a
from ..stages import Progress, unseen
from .camera_views import Seen
from .config import BuildConfig
from .merging import MergeReport, merge_catalogs
from .run import Build, BuildReport, BuildRun


def planned_build(
    dem: Dems,
    config: BuildConfig | Path | str | None = None,
    *,
    center: tuple[float, float] | None = None,
    size_km: float | None = None,
    bounds: tuple[float, float, float, float] | None = None,
    gsd_m: float | None = None,
    cameras: Sequence[SensorOrPath] = (),
    memory_gb: float | None = None,
) -> Build:
    """The plan of a build; parameters as `build_catalog`."""
    config = config or BuildConfig()
    if isinstance(config, Path | str):
        config = BuildConfig.from_toml(Path(config))
    if not isinstance(config, BuildConfig):
        raise not_a(config, "config", "a BuildConfig or the path of a BUILD.toml")
    given: dict[str, object] = {
        "area.center_deg": None if center is None else tuple(center),
        "area.size_km": size_km,
        "area.bounds_deg": None if bounds is None else tuple(bounds),
        "area.gsd_m": gsd_m,
        "dem.product_order": (isinstance(dem, DemSet) and dem.order) or None,
    }
    config = config.replaced({name: value for name, value in given.items() if value is not None})
    seen = Seen.by(map(any_sensor, cameras)) if cameras else None
    return Build.plan(dem_paths(dem), config, memory_gb, seen)


def build_catalog(
    dem: Dems,
    output: Path | str,
    *,
    config: BuildConfig | Path | str | None = None,
    center: tuple[float, float] | None = None,
    size_km: float | None = None,
    bounds: tuple[float, float, float, float] | None = None,
    gsd_m: float | None = None,
    cameras: Sequence[SensorOrPath] = (),
    jobs: int = 1,
    memory_gb: float | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    keep_going: bool = False,
    try_cures_s: float | None = 0.0,
    progress: Progress = unseen,
) -> BuildReport:
    """Build a catalogue of control points from DEM files.

    The region is divided into areas. Each is rendered for every Sun and view that can occur there;
    points are kept if they can be localised, are unique within the search radius, and do not depend
    on the relief around them.

    Parameters
    ----------
    dem:
        DEM files, or an opened set.
    output:
        The catalogue, .h5.
    config:
        Suns, views, points, errors and model: a `BuildConfig`, or a BUILD.toml. None: the defaults.
    center, size_km:
        Longitude and latitude of the region's centre, degrees, and its side; in place of the
        configuration's region. Without a region: the whole DEM.
    bounds:
        Or its west, south, east, north, degrees.
    gsd_m:
        Cell size, in place of the configuration's; None: by the DEM's effective resolution.
    cameras:
        Cameras or other sensors, or their files, of images that the catalogue is for. They give its views, and where the
        configuration leaves them open its Suns, cells, footprint and region.
    jobs:
        Areas computed at the same time, each in a process; the result does not depend on it.
    memory_gb:
        Greatest memory of each process; areas are made smaller for it, which changes the points near
        their borders.
    scheduler:
        Address, or scheduler file, of a dask scheduler that computes the areas instead.
    resume:
        True: keep the finished areas of an interrupted run with the same inputs.
    overwrite:
        True: replace an existing output; with ``resume`` also areas of a run with other inputs.
    keep_going:
        True: leave out areas that fail; the report names them.
    try_cures_s:
        Greatest time, seconds, in which changes of the configuration are tried on a part of the region if the catalogue
        holds no point or keeps less than half of its promise; a warning says what helps, and its price. 0: it only names
        them. None: as long as the areas took, at most 30.
    progress:
        Called with the number of finished areas and of all.

    Returns
    -------
    BuildReport
        Numbers of ``points`` and ``areas``, ``failed`` areas with their causes, the ``files`` read.

    Raises
    ------
    AreaError, CameraError, ConfigError, SunError
        For cameras that see nothing of the DEM, a region without cells, too little memory, a Sun that
        reaches no configured direction.
    AreaFailedError
        If an area fails.
    OutputExistsError, OutputError
        For the output.

    Examples
    --------
    >>> config = lcp.BuildConfig.from_dict({
    ...     "sun": {"elevations_deg": [15.0], "azimuths_deg": [90.0, 105.0]},
    ...     "view": {"off_nadir_deg": [0.0], "azimuth_deg": [0.0], "altitude_km": [float("inf")]},
    ...     "points": {"patch_nodes": 17, "spacing_m": 2000.0, "search_m": 2000.0},
    ... })
    >>> dem = folder / "hadley_gld100_256ppd.tif"
    >>> report = lcp.build_catalog(
    ...     dem, folder / "one.h5", config=config, center=(3.5, 26.0), size_km=15, gsd_m=240
    ... )
    >>> report.points > 0, report.failed
    (True, {})
    """
    ending_of(output, (".h5",))
    build = planned_build(
        dem,
        config,
        center=center,
        size_km=size_km,
        bounds=bounds,
        gsd_m=gsd_m,
        cameras=cameras,
        memory_gb=memory_gb,
    )
    return BuildRun(
        build,
        Path(output),
        jobs=jobs,
        scheduler=scheduler,
        resume=resume,
        overwrite=overwrite,
        keep_going=keep_going,
        try_cures_s=try_cures_s,
        progress=progress,
    ).whole()


def merge(
    catalogs: Sequence[CatalogOrPath], output: Path | str, *, overwrite: bool = False
) -> MergeReport:
    """Join catalogues of neighbouring regions, or of several cell sizes, into one without doubles.
    Their order does not change it.

    Of points with the same id, and of points of one level nearer to each other than the spacing, the
    one with more usable conditions is kept, as in a build.

    Parameters
    ----------
    catalogs:
        Catalogues, or their files, with the same Suns, views, image scales, patch sizes and errors.
    output:
        The joined catalogue, .h5, or .lcpx: an index, whose points stay in the files.
    overwrite:
        True: replace an existing output.

    Returns
    -------
    MergeReport
        Numbers of points read and written, of doubles and of points that were too near.

    Raises
    ------
    CatalogError
        For a file that is no catalogue, or does not go with the first.
    OutputExistsError, OutputError
        For the output.

    Examples
    --------
    >>> done = lcp.merge([catalog, catalog], folder / "both.h5")
    >>> done.points == len(lcp.open_catalog(catalog))
    True
    """
    ending_of(output, (".h5", INDEX))
    return merge_catalogs(catalogs, output, overwrite)
