"""Published facts about DEM products, by their names.

Only figures with a source are given; None means that no figure was found, not that there is no
error. A figure is that of the family: single places can be far better (on a laser track) or worse
(in a gap between tracks, on a steep slope).
"""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class ProductFacts:
    """Facts about a family of products: ``abs_latitude_use`` degrees at which the method uses it,
    ``sigma_m`` 1 sigma of a height, ``resolution_m`` the effective resolution on the surface; None
    if nothing is published. ``calibrated_sigma_m``, ``calibrated_length_m``: 1 sigma and correlation
    length of height errors that explain images of the ground; None without a calibration.
    ``filled_beyond_deg``: north and south of this latitude the heights are those of ``filled_with``;
    None if all heights are the product's own.
    """

    family: str
    abs_latitude_use: tuple[float, float] | None = None
    sigma_m: float | None = None
    resolution_m: float | None = None
    source: str = "nothing published is known"
    calibrated_sigma_m: float | None = None
    calibrated_length_m: float | None = None
    filled_beyond_deg: float | None = None
    filled_with: str = ""


_BARKER_2016 = (
    "Barker et al. 2016, Icarus 273, 346-355: typical vertical accuracy 3 to 4 m (the larger is taken), "
    "512 pixels per degree without surface interpolation; coarser versions resolve their pixel"
)
_SMITH_2010 = (
    "Smith et al. 2010, Geophys. Res. Lett. 37, L18204: heights within 10 m of the Moon's centre of mass; "
    "what is resolved across tracks changes with the gaps (up to a few km near the equator, PGDA product 54): no one figure"
)
_LOLA_POLAR = (
    "no figure is published for the archive's polar grids; single LOLA heights are accurate to 1 m "
    "(PGDA product 54), the ground between tracks is interpolated"
)
_BARKER_2021 = (
    "Barker et al. 2021, Planet. Space Sci. 203, 105119, and PGDA product 78: median rms height error "
    "0.30 to 0.50 m (the larger is taken); some 90 % of the 5 m pixels are interpolated: no one resolution"
)
_PGDA_LARGE = (
    "PGDA product 90 gives error and effective resolution as maps beside the heights, no one figure"
)
_SCHOLTEN_2012 = (
    "Scholten et al. 2012, J. Geophys. Res. 117, E00H17, as summed up on the LROC page of the product: accuracy 10 to 20 m "
    "(the larger is taken), resolution in a formal sense close to 300 m; own heights from 79 S to 79 N, filled by LOLA beyond"
)
_BURNS_2012 = (
    "Burns et al. 2012, ISPRS Archives XXXIX-B4, 483-488 (Henriksen et al. 2017, Icarus 283, 122-137, is the later account): "
    "vertical precision 1 to 2 m (the larger is taken); no true resolution is stated"
)

LENGTH_PER_RESOLUTION = 0.5
"""Correlation length of height errors (l of exp(-r^2 / (2 l^2))) over the effective resolution,
where no calibration gives the length.
"""

PLACE_PER_LENGTH = 38.0 / 530.0
"""1 sigma of a patch's place over the correlation length of height errors, as fitted for GLD100 with frames of Apollo 15,
together with `production.error_config.ErrorConfig.moving_share`; with maps of Apollo 16 it is 150 of 1420 m."""

_FAMILIES: tuple[tuple[re.Pattern[str], ProductFacts], ...] = tuple(
    (re.compile(pattern, re.I), facts)
    for pattern, facts in (
        # latitudes: the table of Pivovarchuk et al. 2026
        (r"SLDEM2015_512", ProductFacts("SLDEM2015", (0.0, 60.0), 4.0, 60.0, _BARKER_2016)),
        (r"SLDEM2015_256", ProductFacts("SLDEM2015", (0.0, 60.0), 4.0, 118.5, _BARKER_2016)),
        (r"SLDEM2015_128", ProductFacts("SLDEM2015", (0.0, 60.0), 4.0, 236.9, _BARKER_2016)),
        (r"SLDEM2015", ProductFacts("SLDEM2015", (0.0, 60.0), 4.0, None, _BARKER_2016)),
        (r"LDEM_75[NS]?_\d+MPP", ProductFacts("PGDA", (75.0, 80.0), None, None, _PGDA_LARGE)),
        (r"LDEM_80[NS]?_\d+MPP", ProductFacts("PGDA", (80.0, 85.0), None, None, _PGDA_LARGE)),
        (r"LDEM_85[NS]?_\d+MPP", ProductFacts("PGDA", (85.0, 90.0), None, None, _PGDA_LARGE)),
        (r"LDEM_\d+[NS]_\d+MPP", ProductFacts("PGDA", None, None, None, _PGDA_LARGE)),
        (r"(SITE|LM)\w*_FINAL_ADJ_5MPP", ProductFacts("PGDA", None, 0.5, None, _BARKER_2021)),
        (r"LDEM_75[NS]", ProductFacts("LDEM_POLAR", (75.0, 80.0), None, None, _LOLA_POLAR)),
        (r"LDEM_80[NS]", ProductFacts("LDEM_POLAR", (80.0, 85.0), None, None, _LOLA_POLAR)),
        (r"LDEM_85[NS]", ProductFacts("LDEM_POLAR", (85.0, 90.0), None, None, _LOLA_POLAR)),
        (r"LDEM_\d+[NS]", ProductFacts("LDEM_POLAR", None, None, None, _LOLA_POLAR)),
        (r"LDEM_512(?!\d)", ProductFacts("LDEM", (60.0, 75.0), 10.0, None, _SMITH_2010)),
        (r"LDEM_\d+", ProductFacts("LDEM", None, 10.0, None, _SMITH_2010)),
        (
            r"GLD100",
            ProductFacts(
                "GLD100",
                None,
                20.0,
                300.0,
                _SCHOLTEN_2012,
                # fitted to AS15-M-0414 and AS15-M-0295 on cells of 474 m (validation.error_fit)
                24.5,
                530.0,
                79.0,
                "LOLA",
            ),
        ),
        (r"NAC_DTM", ProductFacts("NAC_DTM", None, 2.0, None, _BURNS_2012)),
    )
)
UNKNOWN = ProductFacts("unknown")
"""What is known of a product of no family: nothing."""

_WAC_TIE = "FGDC metadata of the WAC mosaic on Moon Trek: placed as well as LOLA, 12 to 50 m horizontally (their middle is taken)"
_LOLA_TIE = (
    "Barker et al. 2016, abstract: errors of LOLA's profiles in place are typically below 10 m horizontally and 1 m vertically "
    "(the larger is taken); orbits without GRAIL's gravity are worse, to about 100 m (Smith et al. 2010)"
)
_NAC_TIE = f"tied to LOLA's heights (READMEs of the products), what that adds is not published; {_LOLA_TIE}"

_TIES = {
    "GLD100": (30.0, _WAC_TIE),
    **dict.fromkeys(("SLDEM2015", "LDEM", "LDEM_POLAR", "PGDA"), (10.0, _LOLA_TIE)),
    "NAC_DTM": (10.0, _NAC_TIE),
}

_NAMES = (
    # (pattern in the product id or the file's stem, name)
    (re.compile(r"(SLDEM2015_\d+)", re.I), "{0}"),
    (re.compile(r"(LDEM_\d+[NS]_\d+MPP(?:_ADJ)?)", re.I), "{0}"),  # PGDA, not the archive's
    (re.compile(r"(LDEM_\d+[NS]_\d+M)", re.I), "{0}"),
    (re.compile(r"(LDEM_\d+)P?(?![0-9])", re.I), "{0}"),
    (re.compile(r"GLD100_\w*?_?0*(\d+)P", re.I), "GLD100_{0}"),
)


def product_name(identifier: str) -> str:
    """Name of a product: SLDEM2015_512, LDEM_512, LDEM_80S_20M, GLD100_256; else the identifier
    itself.
    """
    for pattern, name in _NAMES:
        found = pattern.search(identifier)
        if found:
            return name.format(found.group(1).upper())
    return identifier


def facts_of(product: str) -> ProductFacts:
    """Facts about a product by its name (`product_name`); of the family "unknown" if there are
    none.
    """
    return next((facts for pattern, facts in _FAMILIES if pattern.match(product)), UNKNOWN)


def tie_of(product: str) -> tuple[float, str] | None:
    """1 sigma, each axis, metres, of the place of a product's whole map in the Moon's frame, and its source; None if none
    is published.
    """
    return _TIES.get(facts_of(product).family)


def is_called(product: str, name: str) -> bool:
    """True if ``name`` is the name of a product, its family, or the start of its name up to an
    underscore; the case does not matter.
    """
    product, name = product.upper(), name.upper()
    return name in (product, facts_of(product).family.upper()) or product.startswith(f"{name}_")
