"""Parts of a build, which processes without a connection compute on a shared disk: the tasks of an array job.

Part K of N computes the areas K, K + N, K + 2 N ... into the checkpoints beside the output. Parts run in
any order, at the same time or not. The merge writes the catalogue, the same as that of one build.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..atomic_files import check_output
from ..errors import AreaFailedError, ConfigError
from .area_job import AreaJob
from .checkpoints import Checkpoints
from .run import Build, BuildReport, Progress, compute_areas, finish, missing


@dataclass(frozen=True)
class BuildPart:
    """Part ``number`` (from 1) of ``count``. ConfigError if there is no such part."""

    number: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count:
            raise ConfigError(f"part {self}: K of K/N must be between 1 and N")

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def share(self, jobs: Sequence[AreaJob]) -> Sequence[AreaJob]:
        """The part's areas of all those of a build."""
        return jobs[self.number - 1 :: self.count]


@dataclass(frozen=True)
class PartState:
    """State of a part: the number of its areas, and the names of those that are not computed yet."""

    part: BuildPart
    areas: int
    missing: tuple[str, ...]


def run_part(
    build: Build,
    output: Path,
    part: BuildPart,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    overwrite: bool = False,
    keep_going: bool = False,
    progress: Progress = lambda done, total: None,
) -> dict[str, str]:
    """Compute the areas of a part that have no checkpoint yet; options as in `run.build_catalog`. Return
    the causes of those that failed, by name (with ``keep_going``).

    Raises OutputExistsError while a whole build of the output runs, and if the checkpoints there are of
    a build with other inputs; AreaFailedError for an area that fails.
    """
    check_output(output, overwrite, build.files)
    checkpoints = Checkpoints.beside(output, build.fingerprint())
    with checkpoints.locked(shared=True):
        checkpoints.join(part.count)
        areas = part.share(build.jobs)
        return compute_areas(build, areas, checkpoints, jobs, scheduler, keep_going, progress)


def list_parts(build: Build, output: Path) -> list[PartState]:
    """The states of all parts of a build; of one part that is the whole if none has been started.
    OutputExistsError if the checkpoints beside the output are of a build with other inputs.
    """
    checkpoints = Checkpoints.beside(output, build.fingerprint())
    checkpoints.require_same_run()
    count = checkpoints.parts or 1
    parts = [BuildPart(k + 1, count) for k in range(count)]
    shares = [(part, part.share(build.jobs)) for part in parts]
    return [
        PartState(part, len(share), tuple(job.task.name for job in missing(share, checkpoints)))
        for part, share in shares
    ]


def merge_parts(
    build: Build, output: Path, *, overwrite: bool = False, keep_going: bool = False
) -> BuildReport:
    """Write the catalogue from the areas that the parts have computed, and remove these.

    AreaFailedError if areas are missing, unless ``keep_going`` leaves them out (they are named in the
    report); OutputExistsError while parts are running.
    """
    check_output(output, overwrite, build.files)
    checkpoints = Checkpoints.beside(output, build.fingerprint())
    if not checkpoints.folder.is_dir():
        raise AreaFailedError(f"{checkpoints.folder}: no area is computed; run the parts first")
    with checkpoints.locked():
        checkpoints.begin(resume=True)
        left = [job.task.name for job in missing(build.jobs, checkpoints)]
        if left and not keep_going:
            raise AreaFailedError(
                f"{checkpoints.folder}: {len(left)} of {len(build.jobs)} areas are missing, the first: "
                f"{left[0]}; run their parts again (`list_parts` names them)"
            )
        failed = {name: f"area {name} is not computed" for name in left}
        return finish(build, output, checkpoints, failed, overwrite)
