"""Which light a render asks for besides or instead of the Sun: a panorama, the Earth."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .environment_map import Panorama, read_panorama
from .environment_sources import SourceSearch, Split, report, split_sources
from .sources import Lighting

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Environment:
    """A panorama that lights a scene, and what was found in it. ``split``: as found; ``used``: as it
    lights, which differs where its Sun was scaled.
    """

    panorama: Panorama
    split: Split
    used: Split
    files: tuple[Path, ...] = ()

    @classmethod
    def open(
        cls,
        path: Path | str,
        azimuth_deg: float = 0.0,
        search: SourceSearch | None = None,
        sun_sky_ratio: float | None = None,
    ) -> Environment:
        """Read and split; ImageError for what is no panorama, or has no Sun to scale."""
        return cls.of(read_panorama(path, azimuth_deg), search, sun_sky_ratio, (Path(path),))

    @classmethod
    def of(
        cls,
        panorama: Panorama,
        search: SourceSearch | None = None,
        sun_sky_ratio: float | None = None,
        files: tuple[Path, ...] = (),
    ) -> Environment:
        """The same of a panorama that is at hand."""
        split = split_sources(panorama, search)
        used = split if sun_sky_ratio is None else split.with_ratio(sun_sky_ratio)
        found = cls(panorama, split, used, files)
        log.info("%s", found.sentence)
        return found

    @property
    def lighting(self) -> Lighting:
        return Lighting.of_panorama(self.used)

    @property
    def in_factors(self) -> Panorama:
        """What a camera sees of it, luminance over what lights the scene: radiance factors over pi. A
        scaled Sun is shown as it was photographed.
        """
        return self.panorama.times(1.0 / self.used.power_above)

    @property
    def report(self) -> dict[str, Any]:
        """For tags and ``--explain``."""
        return report(self.panorama, self.split, self.used)

    @property
    def sentence(self) -> str:
        """The report in a line."""
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
