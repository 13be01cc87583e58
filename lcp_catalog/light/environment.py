"""An environment map with its bright sources, as a scene uses it."""

from __future__ import annotations

import logging
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ImageError
from ..geometry.direction import Direction
from .environment_map import Panorama, read_panorama
from .environment_sources import SourceSearch, SourceSplit, report, split_sources
from .sources import Lighting
from .sun_sky_ratio import RatioChoice, SunOverSky, sun_over_sky

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Environment:
    """An environment map (panorama) that lights a scene. ``split``: its sources and remainder as
    found; ``ratio``: the same as used, with the reason why its strongest source is scaled or not.
    """

    panorama: Panorama
    split: SourceSplit
    ratio: SunOverSky
    files: tuple[Path, ...] = ()

    @classmethod
    def open(
        cls,
        path: Path | str,
        azimuth_deg: float = 0.0,
        search: SourceSearch | None = None,
        sun_sky_ratio: RatioChoice = "auto",
    ) -> Environment:
        """Read a panorama and find its sources; ImageError for a file that is not a panorama, or
        has no source to scale.
        """
        return cls.of(read_panorama(path, azimuth_deg), search, sun_sky_ratio, (Path(path),))

    @classmethod
    def opened(cls, environment: Environment | Path | str | None) -> Environment | None:
        """An environment map, `open`ed if its file is given; None without one."""
        return cls.open(environment) if isinstance(environment, Path | str) else environment

    @classmethod
    def of(
        cls,
        panorama: Panorama,
        search: SourceSearch | None = None,
        sun_sky_ratio: RatioChoice = "auto",
        files: tuple[Path, ...] = (),
    ) -> Environment:
        """Find the sources of a panorama in memory. ImageError for one without light above the horizon."""
        if panorama.power_above < sys.float_info.min:
            raise ImageError(f"{panorama.name}: the panorama is black above the horizon")
        split = split_sources(panorama, search)
        found = cls(panorama, split, sun_over_sky(split, sun_sky_ratio), files)
        log.info("%s", found.sentence)
        if found.ratio.clipped and sun_sky_ratio == "auto":
            other = "found to keep it" if found.ratio.scaled else "RATIO to scale it"
            log.warning("%s: %s (`sun_sky_ratio` %s)", panorama.name, found.ratio.reason, other)
        return found

    @property
    def used(self) -> SourceSplit:
        """Sources and remainder that light the scene."""
        return self.ratio.split

    @property
    def lighting(self) -> Lighting:
        return Lighting.of_panorama(self.used)

    @property
    def middle(self) -> Direction:
        """Direction of the vector sum of all light. A Lambert surface that faces all of it, without
        shadows, looks as under one source there.
        """
        moments = [source.power * source.direction for source in self.used.sources]
        whole = np.sum([*moments, self.used.remainder.moment_above], axis=0)
        return Direction(whole / np.linalg.norm(whole))

    @property
    def in_factors(self) -> Panorama:
        """Panorama as a background: luminance in radiance factors over pi. A scaled source keeps
        its original luminance here.
        """
        return self.panorama.times(1.0 / self.used.power_above)

    @property
    def report(self) -> dict[str, Any]:
        """Values for tags and the explained plan."""
        return report(self.panorama, self.split, self.used)

    @property
    def sentence(self) -> str:
        """`report` as one line of text."""
        found = self.report
        sources = "; ".join(
            f"{one['azimuth_deg']:.2f} deg az {one['elevation_deg']:.2f} deg el "
            f"{one['power_share']:.2%}"
            for one in found["sources"]
        )
        scaled = found["sun_sky_ratio_found"] != found["sun_sky_ratio"]
        before = f", {found['sun_sky_ratio_found']:.3g} before it was scaled" if scaled else ""
        return (
            f"{found['panorama']}: dynamic range {found['dynamic_range']:.3g} "
            f"({found['dynamic_range_above_horizon']:.3g} above the horizon); "
            f"{len(found['sources'])} sources{': ' + sources if sources else ''}; sky "
            f"{found['remainder_share']:.2%}; Sun over sky {found['sun_sky_ratio']:.3g}{before}"
        )
