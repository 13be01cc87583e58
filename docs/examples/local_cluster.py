"""Build a catalogue on a dask cluster that this program starts: two workers of one thread."""

from pathlib import Path

from distributed import LocalCluster

import lcp_catalog as lcp

if __name__ == "__main__":
    config = lcp.BuildConfig.from_toml(Path("tile.toml"))
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        report = lcp.build_catalog(
            "dem.tif", "tile.h5", config=config, scheduler=cluster.scheduler_address
        )
    print(f"{report.points} points from {report.areas} areas")
