"""The section ``[model]`` of a build's configuration (`config`): how an area is rendered."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path

from ..accuracy import DEFAULT_TIER, TIERS, Accuracy, accuracy
from ..choices import AUTO_LAW, BOUNCES, ENCODINGS, MOON_MAP, NO_MAP, REFLECTANCE_MODELS, SUN_SHAPES
from ..fields import check_fields, meant, require
from ..photometry.moon_map import map_file
from ..remote_files import beside

AREA_NODES_MIN = 16
"""Least number of nodes along an area's side."""


@dataclass(frozen=True)
class ModelConfig:
    """The model of an area: reflectance, albedo, accuracy, surroundings."""

    reflectance: str = meant(
        AUTO_LAW,
        f"Reflectance model of the surface (law): {', '.join(REFLECTANCE_MODELS)}; some take a parameter set, like "
        "hapke:wac-643-mare or minnaert:0.7.",
        default=f"{AUTO_LAW}, chosen by the phase angles of the scene",  # `photometry.laws`
    )
    albedo: str = meant(
        MOON_MAP,
        "Albedo map: a raster of relative surface brightness in a lunar CRS. Radiance is multiplied by the ratio of its "
        "value to `model.albedo_reference`. Three bands are red, green and blue in lcp render. "
        f"{MOON_MAP}: the package's map of the whole Moon, 2.7 km a pixel; {NO_MAP}: uniform ground.",
        default=MOON_MAP,
        replaces=("albedo_encoding", "albedo_reference"),
    )
    albedo_encoding: str | None = meant(
        None,
        f"Encoding of the albedo map: {ENCODINGS[0]} (values proportional to brightness) or {ENCODINGS[1]} (codes of a "
        "display image).",
        default=ENCODINGS[0],
        choices=ENCODINGS,
    )
    albedo_reference: float | None = meant(
        None,
        "Decoded value of the albedo map that leaves the radiance unchanged.",
        default="the mean of the map, in colour of its luminance",
        above=0.0,
        below=math.inf,
    )
    accuracy: str | None = meant(
        None,
        "Accuracy tier. It limits the share of nodes whose shadow may be wrong: draft 0.5 %, standard 0.02 %, high and "
        "reference 0; reference computes in float64 throughout. A more accurate tier takes longer. A build depends on the "
        "tier in two more ways. High and reference search for places that resemble a point at full resolution everywhere. "
        "Under a low Sun they decide the flag unshadowed with the direction of the Sun at the point; draft and standard take "
        "that at the area's centre, which changes about 2.3 % of the flags at 5 deg of Sun elevation, 0.6 % at 10 deg.",
        default=DEFAULT_TIER,
        choices=tuple(TIERS),
        replaces=("tolerance",),
    )
    tolerance: float | None = meant(
        None,
        "Permitted share of nodes with a wrong shadow; selects the fastest sufficient tier. Instead of "
        "`model.accuracy`.",
        default="that of the tier",
        least=0.0,
        below=math.inf,
        replaces=("accuracy",),
    )
    direction_tolerance_deg: float = meant(
        0.5, "Greatest difference of the Sun's direction over an area.", least=0.05, most=10.0
    )
    ring_max_km: float = meant(
        400.0,
        "Greatest distance from an area of terrain that is read for its shadows.",
        least=0.0,
        most=3000.0,
    )
    area_nodes_max: int = meant(
        512,
        "Most nodes along an area's side; a limit of memory makes it smaller.",
        least=AREA_NODES_MIN,
        most=4096,
    )
    sun: str | None = meant(
        None,
        "Shape of the Sun in the images: a point, or a disc with penumbras.",
        default=SUN_SHAPES[0],
        choices=SUN_SHAPES,
    )
    bounce: str | None = meant(
        None,
        "Light that reaches dark ground by way of other ground, in the images that points are tested in. `on` multiplies the time "
        "of a build.",
        default=BOUNCES[2],
        choices=BOUNCES[1:],
    )
    own_sun_deg: float | None = meant(
        None,
        "Up to this elevation of the Sun, a point whose share of shadow from outside is close to the limit is judged with the "
        "direction of the Sun at the point, not that at the area's centre.",
        default="that of the tier: 0 (never) in draft and standard, 15 in high and reference",
        least=0.0,
        most=90.0,
    )
    whole_search: bool | None = meant(
        None,
        "Search for places that resemble a point at full resolution everywhere.",
        default="that of the tier: false in draft and standard, true in high and reference",
    )

    def __post_init__(self) -> None:
        check_fields(self, "model")
        require(
            self.accuracy is None or self.tolerance is None,
            "`model.accuracy` and `model.tolerance` exclude each other",
        )
        for name in ("albedo_encoding", "albedo_reference"):
            require(
                self.albedo not in (MOON_MAP, NO_MAP) or getattr(self, name) is None,
                f"`model.{name}` needs `model.albedo`, a map's file",
            )

    @property
    def albedo_file(self) -> Path | None:
        """The file of the albedo map; None without a map."""
        return map_file(self.albedo)

    @property
    def precision(self) -> Accuracy:
        """The accuracy of the tier or the tolerance."""
        found = accuracy(self.accuracy, self.tolerance)
        own = {name: getattr(self, name) for name in ("whole_search", "own_sun_deg")}
        given = {name: value for name, value in own.items() if value is not None}
        return dataclasses.replace(found, **given)

    def beside(self, folder: Path) -> ModelConfig:
        """The same with file names relative to a folder resolved; absolute names stay."""
        own = self.albedo not in (MOON_MAP, NO_MAP)
        albedo = beside(folder, self.albedo) if own else self.albedo
        law, _, which = self.reflectance.partition(":")
        if law == "facet" and which.lower().endswith(".toml"):
            law = f"{law}:{folder / which}"
            return dataclasses.replace(self, albedo=albedo, reflectance=law)
        return dataclasses.replace(self, albedo=albedo)

    @property
    def portable(self) -> ModelConfig:
        """The same with file names without folders."""
        name = Path(self.albedo).name
        law, colon, which = self.reflectance.partition(":")
        if law == "facet":  # a file, or a name without folders
            law = f"{law}{colon}{Path(which).name}"
            return dataclasses.replace(self, albedo=name, reflectance=law)
        return dataclasses.replace(self, albedo=name)
