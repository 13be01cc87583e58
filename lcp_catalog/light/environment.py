"""An environment map with its bright sources, as a scene uses it.

Sun over sky of an environment map: whether its Sun is scaled, and why.

No camera records the Sun's luminance without a filter, so that the Sun of most panoramas is too
weak (Voloboy et al. 2006, section 3.2). The paper scales it to four times the rest of the sky on a
horizontal plane, the ratio of the CIE clear sky (section 4). That holds for a clear sky and a high
Sun, not for the lamps of a laboratory and not for a low Sun.
"""

from __future__ import annotations

import logging
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..errors import ImageError
from ..geometry.frames import Direction
from .environment_map import Panorama, read_panorama
from .sources import Lighting, SourceSearch, SourceSplit, report, split_sources

log = logging.getLogger(__name__)

CLEAR_SKY_RATIO = 4.0
"""Irradiance of a horizontal plane by the Sun over that by the rest of a CIE clear sky."""

HIGH_DEG = 30.0
"""Least elevation of a Sun for `CLEAR_SKY_RATIO`: the sunlight on a horizontal plane, and with it
the ratio, decreases towards the horizon."""

WIDEST_DEG = 2.5
"""Greatest radius of the flat part of a Sun: its disc (0.27 deg) with a saturated glare. A wider one
is a lamp or a window."""

RatioChoice = float | Literal["auto"] | None
"""A ratio to scale to; "auto": `CLEAR_SKY_RATIO` where that applies; None: as recorded."""


@dataclass(frozen=True)
class SunOverSky:
    """The sources as used, and the reason. ``clipped``: True if the strongest source is too weak
    because its luminance looks cut off.
    """

    split: SourceSplit
    scaled: bool
    reason: str
    clipped: bool


def sun_over_sky(found: SourceSplit, choice: RatioChoice) -> SunOverSky:
    """Scale the strongest source of a panorama, or not. ImageError for a number as choice if there
    is no source or no sky.

    "auto" scales a source that is flat (`BrightSource.is_flat`), gives less than `CLEAR_SKY_RATIO`
    times the rest, is at least `HIGH_DEG` high, has a flat part of at most `WIDEST_DEG`, and is the
    only flat source.
    """
    clipped, weak = _is_clipped(found), _told(found)
    if isinstance(choice, (int, float)):
        used = found.with_ratio(choice)
        return SunOverSky(used, True, f"{weak}; scaled to {choice:g}, as asked", clipped)
    if choice is None:
        return SunOverSky(found, False, f"{weak}; not scaled, as asked", clipped)
    unlike = _unlike_a_sun(found)
    if unlike:
        return SunOverSky(found, False, f"{weak}; {unlike}: not scaled", clipped)
    used = found.with_ratio(CLEAR_SKY_RATIO)
    reason = f"{weak}; scaled to {CLEAR_SKY_RATIO:g}, the ratio of a CIE clear sky"
    return SunOverSky(used, True, reason, clipped)


def _is_clipped(found: SourceSplit) -> bool:
    return bool(found.sources) and found.sources[0].is_flat and _is_weak(found)


def _is_weak(found: SourceSplit) -> bool:
    return found.sun_sky_ratio < CLEAR_SKY_RATIO


def _told(found: SourceSplit) -> str:
    """The ratio as found, and the signs of a luminance that is cut off."""
    if not found.sources:
        return "no bright source"
    sun = found.sources[0]
    text = (
        "on a horizontal plane the strongest source is "
        f"{found.sun_sky_ratio:.3g} times as strong as the rest of the sky"
    )
    if not sun.is_flat:
        return text
    return (
        f"{text}; {sun.peak_pixels} of its {sun.bright_pixels} bright pixels have one luminance, as "
        "where a camera's range ends"
    )


def _unlike_a_sun(found: SourceSplit) -> str:
    """The reason why the ratio of a clear sky does not apply; empty if it does."""
    if not found.sources:
        return "nothing to scale"
    sun = found.sources[0]
    flat = sum(source.is_flat for source in found.sources)
    elevation_deg = math.degrees(math.asin(min(1.0, float(sun.direction[2]))))
    radius_deg = math.degrees(sun.peak_rad)
    reasons = (
        (not sun.is_flat, "its luminance is not cut off"),
        (not _is_weak(found), f"that is {CLEAR_SKY_RATIO:g} (CIE clear sky) or more"),
        (flat > 1, f"{flat} sources are like that, as lamps are"),
        (
            elevation_deg < HIGH_DEG,
            f"it is {elevation_deg:.0f} deg high, and only above {HIGH_DEG:g} deg is a Sun's ratio known",
        ),
        (
            radius_deg > WIDEST_DEG,
            f"their radius of {radius_deg:.1f} deg is too large for a Sun",
        ),
    )
    return next((reason for holds, reason in reasons if holds), "")


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
            f"{100.0 * one['power_share']:.2f} %"
            for one in found["sources"]
        )
        scaled = found["sun_sky_ratio_found"] != found["sun_sky_ratio"]
        before = f", {found['sun_sky_ratio_found']:.3g} before it was scaled" if scaled else ""
        return (
            f"{found['panorama']}: dynamic range {found['dynamic_range']:.3g} "
            f"({found['dynamic_range_above_horizon']:.3g} above the horizon); "
            f"{len(found['sources'])} sources{': ' + sources if sources else ''}; sky "
            f"{100.0 * found['remainder_share']:.2f} %; Sun over sky {found['sun_sky_ratio']:.3g}{before}"
        )
