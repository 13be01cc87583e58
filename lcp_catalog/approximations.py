"""The registry of approximations: what each may change, what switches it, and how it is priced.

`lcp trade` measures the rows that have a switch of the configuration; the reference lists all; a test compares
them with the configuration, the tiers and the scene plan. The alternatives that it names are in `alternatives`.
"""

# ruff: noqa: E501 - cells of a table, one line each so that a row is read as a row
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from . import alternatives

EXACT, LIMIT, MEASURED, ON_SAMPLE = "exact", "limit", "measured", "sample, no bound"
"""Where the figure of an error is from: a formula or a proof; the code, which lets no more pass; the greatest of the
measurements that the row names; what the alternatives to the sample's configuration change."""


@dataclass(frozen=True)
class Figure:
    """An error as one number: ``value``, in ``unit``, of ``what``; ``basis``: `EXACT`, `LIMIT`, `MEASURED` or `ON_SAMPLE`."""

    value: float
    unit: str
    what: str
    basis: str

    def __str__(self) -> str:
        value = f"{self.value:g}".replace("e-0", "e-")
        return f"{value}{self.unit and ' '}{self.unit} of {self.what} ({self.basis})"


@dataclass(frozen=True)
class Approximation:
    """One approximation. ``error``: its error as one number, the greatest unless it names a mean or an rms; ``bound``: that error in words, its conditions and the
    source of the figure; ``switch``: the fields of the configuration that control it, or none, the reason in
    ``unpriced`` and what it was measured to save or to change in ``price``; ``values``: alternatives to a configuration with
    a cell size, coarser ones first; ``effects``, ``settings``, ``constants``: decisions of a scene plan, fields of an
    accuracy tier, constants and functions that are part of it; ``expected``: share of the usable conditions that
    its alternatives change on the sample, by which they are measured in turn; ``slower``: time of its slowest
    alternative, over that of the configuration, at least and at most of what was measured; ``fineness`` of a configuration: greater is finer; None
    where another value is another catalogue, not the same one computed otherwise; ``sample``: of each alternative there
    its time over that of the configuration, the share of the usable conditions that it changes (90 % interval of the mean
    over areas), and points lost and gained (`SAMPLE`).
    """

    name: str
    error: Figure
    bound: str
    switch: tuple[str, ...] = ()
    values: Callable[[Any], alternatives.Values] = alternatives.none
    unpriced: str = ""
    price: str = ""
    effects: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    constants: tuple[str, ...] = ()
    expected: float = 0.0
    slower: tuple[float, float] = (1.0, 1.0)
    fineness: Callable[[Any], float] | None = None
    sample: str = ""

    def sample_times(self) -> dict[str, float]:
        """Times of the alternatives of ``sample`` by name."""
        told = (one.rpartition(": ") for one in self.sample.split("; ") if one)
        return {name: float(figures.partition(",")[0]) for name, _, figures in told}


APPROXIMATIONS: tuple[Approximation, ...] = (
    Approximation(
        "accuracy tier",
        Figure(0.5, "%", "the nodes with a wrong shadow in `draft` on lunar terrain (0.7 on white noise); 0.02 in `standard`, 0 above", MEASURED),
        "wrong shadows at no more than 0.5, 0.02, 0 and 0 % of the nodes (measured, 4fadbe6, 2026-11-21; `high` proved)",
        ("model.accuracy", "model.tolerance"), alternatives.tiers,
        effects=("cast shadows", "occlusion"),
        settings=("node_error", "tolerance", "shadows", "shadow_method", "far_doubt"),
        constants=("terrain.occlusion.EPSILON", "kernels.shadows.draft.NEAR_CELLS", "kernels.shadows.draft.DENSITY", "terrain.occlusion.LIKELY", "terrain.occlusion.PROVED"), expected=0.001,
        fineness=lambda c: alternatives.TIERS.index(c.model.precision.tier),
        sample="draft: 0.94, 0, 0/0; high: 1.14, 0.12 % (0.042..5.2), 0/0; reference: 1.26, 0.12 % (0.042..5.2), 0/0",
    ),
    Approximation(
        "reflectance law",
        Figure(10.0, "%", "the mean signal, rms, in `draft`; 5, 1 and 0 in the others", LIMIT),
        "rms difference from Hapke's image, gain and offset free, stated by the scene plan: where the law is chosen at most 10, 5, 1 and 0 % of the mean signal by tier; a law that is asked for is only stated; a facet model is integrated to 0.5 % of its albedo",
        ("model.reflectance",), alternatives.choices("model.reflectance", "lommel-seeliger:rolo", "lunar-lambert:rolo", "hapke:rolo"),
        effects=("reflectance",), settings=("law_residual",), constants=("photometry.law_choice.SLOPE_RMS", "rendering.plan._PHASES", "kernels.photometry.facet.TABLE", "kernels.photometry.facet.CONE_SIN", "photometry.facet_model._QUADRATURE", "photometry.law_choice._QUADRATURE", "photometry.facet_model._PER_SIGMA"), expected=0.02, fineness=alternatives.law,
        sample="lommel-seeliger:rolo: 1.04, 6.6 % (4.6..12), 6/6; hapke:rolo: 1.29, 2 % (1.1..7.1), 6/6",
    ),
    Approximation(
        "brightness of the ground",
        Figure(26.0, "%", "the mean radiance, rms over the Moon, without a map", MEASURED),
        "without a map the map's contrast, which the scene plan states for your area: standard deviation over mean 26 % on the whole Moon, 23 % on the sample's map (35b57c98, 2026-11-28); what no map holds is `errors.albedo_sigma`",
        ("model.albedo", "model.albedo_encoding", "model.albedo_reference"), alternatives.choices("model.albedo", "none", "moon"),
        effects=("albedo",), expected=0.08,
        sample="none: 0.98, 7 % (2.5..13), 20/19; moon: 1.22, 1.8 % (0.29..6.9), 7/7",
    ),
    Approximation(
        "one direction per area",
        Figure(4.7, "%", "the `unshadowed` flags under the lowest Sun measured, 0.5 deg, in `draft` and `standard`; 0 above", MEASURED),
        "a Sun and a view wrong by the tolerance: 4.7 % at 0.5 deg of Sun (84 N), 2.3, 0.6 and 0.4 % at 5, 10 and 12 deg (sample), stated by the scene plan; none up to 15 deg in `high` and `reference`; nearly proportional to the tolerance (c167345, ede1714, 2b1335ac, 2026-11-27, decision 5)",
        ("model.direction_tolerance_deg", "model.own_sun_deg"), alternatives.directions,
        effects=("one direction per area",), settings=("own_sun_deg",), constants=("production.patch_light.OWN_SUN_DOUBT", "production.build_decisions.TURNED"), expected=0.01,
        fineness=lambda c: 0.01 * c.model.precision.own_sun_deg - c.model.direction_tolerance_deg,
        sample="1: 0.58, 2.5 % (1.1..7.6), 18/14; 0.25: 1.60, 1.6 % (0.81..6.7), 14/13; own Sun to 15 deg: 1.01, 0.12 % (0.042..5.2), 0/0",
    ),
    Approximation(
        "parallel or near views",
        Figure(0.0087, "rad", "the direction to a near camera whose rays are taken as parallel", LIMIT),
        "half the patch and the search radius over the distance (exact, stated by the scene plan); taken as parallel up to `model.direction_tolerance_deg`, 0.5 deg",
        ("view.altitude_km",), alternatives.altitudes, effects=("perspective",),
        constants=("production.sweep._LOWEST_VIEW_DEG", "rendering.error_bounds.SHIFT_PX"), expected=0.0001,
        sample="near, 100 km: 8.46, 1.6 % (0.87..6.6), 2/2",
    ),
    Approximation(
        "views, interpolated between",
        Figure(0.05, "", "a probability, mean over points", MEASURED),
        "claims of the nearest view hold to 20 deg: mean error of a probability 0.01 to 0.05 (two regions, 3276aa4, 2026-11-25)",
        ("view.off_nadir_deg", "view.azimuth_deg"), alternatives.views,
        constants=("catalog.prediction.VIEW_REACH_DEG",), expected=0.2,
        sample="the first alone: 0.35, 41 % (32..50), 3/2; and 35 deg from 4 sides: 1.66, 2.3 % (1.5..7.3), 2/2",
    ),
    Approximation(
        "Sun azimuths, interpolated between",
        Figure(1.0, "%", "the points claimed usable between the grid's Suns that are not", MEASURED),
        "99 % of the points claimed usable between the grid's Suns are (random Suns and views, c896266, 2026-11-24)",
        ("sun.azimuths_deg",), alternatives.azimuths, constants=("catalog.prediction.BETWEEN_MARGIN",), expected=0.05,
        fineness=lambda c: len(c.sun.azimuths_deg),
        sample="every second azimuth: 0.70, 2.5 % (1.2..7.6), 9/8; twice the azimuths: 1.34, 1.3 % (0.51..6.4), 5/6",
    ),
    Approximation(
        "Sun elevations, interpolated between",
        Figure(1.0, "%", "the points claimed usable between the grid's Suns that are not", MEASURED),
        "99 % of the points claimed usable between them are (random Suns and views, c896266, 2026-11-24); more than 2.5 deg below the lowest no claim is made",
        ("sun.elevations_deg",), alternatives.elevations, constants=("catalog.prediction.BEYOND_MARGIN",), expected=0.05,
        fineness=lambda c: len(c.sun.elevations_deg),
        sample="every second elevation: 0.70, 7.4 % (4.6..12), 10/10; twice the elevations: 1.54, 2.5 % (1.2..7.6), 7/6",
    ),
    Approximation(
        "cell size",
        Figure(5.0, "m", "heights between the nodes, rms, cells of 474 m in place of the sample's 118 m", MEASURED),
        "detail below two cells is lost: rms 5.0 m of the sample's heights (35b57c98, 2026-11-28); claims are those of images of these cells",
        ("area.gsd_m", "area.levels_m", "area.altitudes_km", "area.ifov_rad"), alternatives.numbers("area.gsd_m", 2.0, 0.5), expected=0.3,
        sample="948 m: 0.87, 35 % (13..64), 27/22; 237 m: 2.02, 33 % (20..49), 22/18",
    ),
    Approximation(
        "patch size",
        Figure(40.0, "%", "the usable conditions, twice the side", ON_SAMPLE),
        "none by itself: the claims are those of this patch; another side is another question",
        ("points.patch_nodes",), alternatives.patches, expected=0.3,
        sample="17: 0.56, 41 % (30..54), 18/14; 65: 3.79, 40 % (23..61), 15/14",
    ),
    Approximation(
        "search radius",
        Figure(8.9, "%", "the usable conditions, twice the radius", ON_SAMPLE),
        "none for a camera whose position is known to within the radius: rivals beyond it do not count", ("points.search_m",), alternatives.searches, expected=0.1,
        sample="16 cells: 1.06, 0.76 % (0.22..5.8), 3/3; 34 cells: 1.60, 8.9 % (2.5..18), 7/7",
    ),
    Approximation(
        "area size",
        Figure(0.84, "%", "the usable conditions, 64 in place of 96 nodes", MEASURED),
        "areas are cut at the direction tolerance or at this size: of 64 instead of 96 nodes on cells of 237 m they change 0.84 % (0.39..1.3) of the usable conditions and most points (4 areas of the sample, d153cb8, 2026-11-27)",
        ("model.area_nodes_max",), alternatives.numbers("model.area_nodes_max", 2.0, 0.125), expected=0.005,
        sample="1024: 0.97, 0, 0/0; 64: 0.98, 0, 0/0",
    ),
    Approximation(
        "candidates per cell",
        Figure(17.9, "%", "the points, others with one candidate", ON_SAMPLE),
        "better points are missed: 5 of the sample's 28 are others with one candidate, 3 with four; a point's claims are the same",
        ("points.candidates_per_cell",), alternatives.numbers("points.candidates_per_cell", 0.5, 2.0), expected=0.0,
        fineness=lambda c: c.points.candidates_per_cell,
        sample="1: 0.86, 0.17 % (0..5.2), 5/2; 4: 1.04, 0, 3/3",
    ),
    Approximation(
        "corners that become candidates",
        Figure(27.0, "%", "the points, others with the 99.9th percentile", MEASURED),
        "candidates are proposed by the response over its 99th percentile in an image, at most 1; of each group of Suns where it is 1.2 times that of those taken. Claims of a point are the same. Of 67 points (75 km of the sample) with the 98th percentile 14 are others, with the 99.9th 18 (27 %); with 1.1 and 1.5 times 11 and 13; 0.98, 0.96, 1.01, 0.96 times the usable conditions (789c278e, 2026-11-29)",
        constants=("landmarks.corners._HIGH_PERCENTILE", "landmarks.corners.GROUP_GAIN"),
        unpriced="no switch: `points.candidates_per_cell` takes more of them", price="none beside noise: 0.85 to 0.95 of the processor time (one run each, under load, 789c278e, 2026-11-29)",
    ),
    Approximation(
        "two passes",
        Figure(9.0, "%", "the usable conditions, on a mare; 2 over four regions", MEASURED),
        "points that a first look misjudges are missed: 0.98 of the usable conditions of one pass, on a mare 0.91, claims the same (four regions, c791be4, 2026-11-27)",
        ("points.passes",), alternatives.choices("points.passes", 1, 2, usual=1), expected=0.0,
        fineness=lambda c: -(c.points.passes or 1),
        sample="2: 0.69, 0, 5/4",
    ),
    Approximation(
        "search at half resolution first",
        Figure(0.49, "", "a probability away from the limit", MEASURED),
        "a probability up to 0.49 too high away from the limit (sample, decision 6, 2026-11-24); `second_peak` too low by at most 0.10 in 67 points of 75 km of the sample (1 by more than 0.05; 789c278e, 2026-11-29), 0.29 in 97 of Hadley (86f40c1, 2026-11-27), 0.43 in 142 points, 0.80 in 486 candidates of 60 km of the sample (eff4066c, 2026-11-28): found, not bounded. Not exact for the chosen points alone: they are chosen after their areas, whose images, 37 % of an area, would be made again in 55 of 67 areas of the sample (stages of docs/explanation/build-speed.md)",
        ("model.whole_search",), alternatives.whole_search, settings=("whole_search",), expected=0.0005,
        constants=("kernels.matching.rivals._ASCENTS", "kernels.matching.rivals._AROUND", "kernels.matching.rivals._LOSS", "kernels.matching.rivals._MARGIN", "kernels.matching.search.PEAKS", "kernels.matching.search._SLACK", "kernels.matching.rivals._FEW", "landmarks.uniqueness._COARSE_HALF_MIN", "landmarks.uniqueness._COARSE_REACH_MIN", "matching.point_search._HALVED_FROM"),
        fineness=lambda c: c.model.precision.whole_search,
        sample="full resolution: 1.10, 0, 0/0",
    ),
    Approximation(
        "searched again near the limit",
        Figure(0.71, "%", "the usable conditions, without it", MEASURED),
        "without it 0.71 % (0.48 to 0.94 %) of the usable conditions, 0.47 of a probability at most (measured on the sample, ede1714, 2026-11-27; 0.55 % (0.1 to 1.2 %) with the claims of 07451ed1, 2026-11-30)",
        ("points.search_doubt",), alternatives.choices("points.search_doubt", (0.0, 0.0), (0.1, 0.2)),
        constants=("production.point_config.SEARCH_DOUBT",), expected=0.001,
        fineness=lambda c: sum(c.points.search_doubt or (0.035, 0.09)),
        sample="(0.0, 0.0): 0.85, 0.77 % (0.48..5.8), 0/0; (0.1, 0.2): 1.12, 0, 0/0",
    ),
    Approximation(
        "image scales",
        Figure(0.05, "", "a probability between two scales, mean over points", MEASURED),
        "between scales interpolated as between Suns: mean error of a probability 0.01 to 0.05 (two regions, 3276aa4, 2026-11-25); with one scale no claim for coarser pixels: of the conditions at all scales 25 % are no longer usable (as the others, 07451ed1, 2026-11-30)",
        ("points.image_scales",), alternatives.scales, constants=("production.point_config.SMALLEST_PX",), expected=0.4,
        sample="1: 0.75, 25 % (18..33), 0/0",
    ),
    Approximation(
        "point Sun",
        Figure(0.024, "cells", "a match, 0.5 deg of Sun", MEASURED),
        "shift of a match 0.014 to 0.024 cells at 6 to 0.5 deg of Sun (86f40c1, 2026-11-27); a build's plan states it, a render's 1.0 is that of one node in a penumbra",
        ("model.sun",), alternatives.choices("model.sun", "point", "disc", usual="point"),
        effects=("solar disc",), settings=("disc", "disc_strips", "disc_directions", "disc_rms"),
        constants=("ephemeris.limb_darkening.STEPS", "light.solar_disc.TRACE", "light.solar_disc.FIRST_STRIPS", "light.solar_disc.MOST_STRIPS", "light.solar_disc.CONVERGED", "light.solar_disc.STEEP_RAD", "light.solar_disc.LEAN_MAX", "rendering.error_bounds.PENUMBRA_PX"), expected=0.005,
        fineness=lambda c: c.model.sun == "disc",
        sample="disc: 1.17, 0.25 % (0.071..5.3), 3/3",
    ),
    Approximation(
        "far terrain",
        Figure(0.018, "deg", "the horizon, rms, 86 N", MEASURED),
        "elevation of terrain that is left out, stated by the scene plan; 0.008 deg rms of the horizon from coarser cells at 26 N, 0.018 at 86 N (1e61e03, 2026-11-21)",
        ("model.ring_max_km",), alternatives.numbers("model.ring_max_km", 0.075, 0.25),
        effects=("terrain beyond the area",),
        constants=("terrain.surroundings.CELL_SHARE", "terrain.surroundings.HORIZON_RMS_DEG", "terrain.surroundings.REACH_MAX_M", "terrain.relief_bounds.COARSE_SLOPE", "terrain.far_terrain.PLACES", "terrain.surroundings.NEAR_NODES", "terrain.relief_bounds.COARSE_NODES"), expected=0.005,
        fineness=lambda c: c.model.ring_max_km,
        sample="30: 0.97, 0, 0/0; 100: 0.97, 0, 0/0",
    ),
    Approximation(
        "light by way of other ground",
        Figure(1.4, "%", "the usable conditions, 84 N; 0.3 to 1.0 on the sample", MEASURED),
        "R² Omega / pi (R: greatest radiance factor, Omega: solid angle of the terrain above a facet) for a node, stated by the scene plan; 0.35 to 1.06 % of the brightest ground in craters; with it 0.3 to 1.0 % of the usable conditions of the sample are others, in 18 to 36 times the time, around 84 N 1.4 %, in 110 times (measured, ede1714, 7bb57269, 2b1335ac, 2026-11-27, 07451ed1, 2026-11-30)",
        ("model.bounce",), alternatives.choices("model.bounce", "off", "on", usual="off"),
        effects=("scattered light",), constants=("light.bounced_light.SHOWS", "light.bounced_light.BOUNCE_RMS", "light.bounced_light._CODE", "light.bounced_light._SAMPLED"), slower=(21.0, 110.0), expected=0.01,
        fineness=lambda c: c.model.bounce == "on",
        sample="on: 21, 0.4 % (0.24..5.5), 7/7",
    ),
    Approximation(
        "second bounce of light",
        Figure(5.3, "%", "the bounced light in shadows, mean, of a crater two thirds as deep as wide; 0.45 on the sample", MEASURED),
        "share A f of the first bounce in a bowl (A: albedo, f: the bowl's share of its sphere; exact); two bounces by brute force: 5.3 % in a crater of 840 m on 1300 m (Lambert), on the sample 0.45 % under 5 to 20 deg, 7e-6 of I/F and 1e-4 of a probability at most, none of 226 flags (e94c45d2, 2026-11-28)",
        constants=("light.bounced_light.bounced_at_points",), unpriced="no switch: one bounce or none, `model.bounce`",
        price="with the second bounce 7 times the time of one (three areas of the sample, e94c45d2, 2026-11-28)",
    ),
    Approximation(
        "penumbrae on the ground that reflects",
        Figure(4.2, "%", "the bounced light in shadows, rms, 5 deg of Sun", MEASURED),
        "that ground sees a point Sun. With the disc 4.2 to 0.03 % rms on the sample under 5 to 20 deg, 0.2 in the mean, 0.6 % in a crater at 25 deg (6bb26eca, 2026-11-28)",
        constants=("light.bounced_light._reached",), unpriced="no switch: `model.sun` is that of the light itself",
        price="with it nine horizons for every place met, in place of one ray",
    ),
    Approximation(
        "ground beyond an area, in its bounced light",
        Figure(97.0, "%", "the bounced light in a render's shadows, mean of ten nodes; 13 in builds", MEASURED),
        "only ground of the area and its ring reflects. Of the sample's shadows under 2 to 20 deg 10 to 97 % is lost without a ring, 0 to 13 % with the 36 cells that a build has at least, 1e-4 of I/F at most (6bb26eca, 2026-11-28)",
        constants=("light.bounced_light._gathered",), unpriced="no switch: a render of a larger area has it", price="time and memory of the wider ring",
    ),
    Approximation(
        "point spread of an image",
        Figure(3.5, "%", "the usable conditions, 0.7 in place of 0.5 pixels", ON_SAMPLE),
        "0.5 pixels assumed; a sharper or duller image changes them",
        ("points.point_spread_px",), alternatives.choices("points.point_spread_px", 0.35, 0.7),
        constants=("landmarks.point_spread.POINT_SPREAD_PX",), expected=0.02,
        sample="0.35: 1.00, 2 % (1.2..7), 3/3; 0.7: 1.01, 3.5 % (2.4..8.6), 4/4",
    ),
    Approximation(
        "number of rivals",
        Figure(0.043, "%", "the usable conditions, 12 in place of 64", ON_SAMPLE),
        "with 12 instead of 64 the Brier score doubles in pure noise (simulated, c896266, 2026-11-24); 256 change nothing on the sample",
        ("points.rivals",), alternatives.choices("points.rivals", 12, 256), constants=("landmarks.uniqueness.RIVALS", "landmarks.detection._CLEAR"), expected=0.002,
        fineness=lambda c: c.points.rivals or 64,
        sample="12: 0.94, 0.043 % (0..5.1), 0/0; 256: 0.97, 0, 0/0",
    ),
    Approximation(
        "least correlation of a match",
        Figure(1.0, "%", "the usable conditions, 0.4 in place of 0.3", ON_SAMPLE),
        "none by itself: a match below it is refused, and the claim counts that",
        ("points.least_correlation",), alternatives.choices("points.least_correlation", 0.2, 0.4),
        constants=("landmarks.detection.LEAST_CORRELATION",), expected=0.02,
        sample="0.2: 1.01, 0.12 % (0..5.2), 0/0; 0.4: 1.00, 0.98 % (0.27..6.1), 3/2",
    ),
    Approximation(
        "limit of dependence",
        Figure(10.0, "%", "a patch's nodes, darkened or hidden from outside", LIMIT),
        "at most this share of a patch is darkened or hidden from outside where it counts as usable",
        ("points.max_dependence",), alternatives.numbers("points.max_dependence", 2.0, 0.5), expected=0.03,
        sample="0.2: 0.97, 0.79 % (0.34..5.9), 0/0; 0.05: 1.04, 1.8 % (0.69..6.9), 2/2",
    ),
    Approximation(
        "least lit share",
        Figure(0.35, "%", "the usable conditions, 0.3 in place of 0.1", ON_SAMPLE),
        "none by itself: darker patches have no claim",
        ("points.min_lit_share",), alternatives.choices("points.min_lit_share", 0.3, 0.05), expected=0.01,
        sample="0.3: 0.96, 0.35 % (0..5.4), 0/0; 0.05: 0.97, 0, 0/0",
    ),
    Approximation(
        "interpolation of a claim over Sun and scale",
        Figure(0.05, "", "a probability, mean over points", MEASURED),
        "mean error of a probability 0.01 to 0.05 (two regions, 3276aa4, 2026-11-25); usable only with the margins",
        constants=("catalog.sun_cells._SAMPLES", "catalog.sun_cells.WIDEST_DEG", "catalog.prediction.FREE_SHARE", "catalog.prediction.BEYOND_DEG", "catalog.prediction.LONE_STEP_DEG", "catalog.prediction._LEAST_WEIGHT"),
        unpriced="no switch: it belongs to a query", price="nothing in a build; the rows of Suns and views measure it",
    ),
    Approximation(
        "quadrature over places",
        Figure(0.073, "", "a probability", MEASURED),
        "five nodes instead of 31: 0.0008 of a probability at the 99th percentile, 0.073 at most, 0.006 % of the usable conditions (measured on the sample, 5da61c4, 2026-11-27, 07451ed1, 2026-11-30)",
        ("points.spread_nodes",), alternatives.choices("points.spread_nodes", 1, 31, usual=5),
        constants=("landmarks.detection.SPREAD_NODES",), expected=0.0001,
        fineness=lambda c: c.points.spread_nodes or 5,
        sample="1: 0.97, 2.9 % (1.8..7.9), 2/2; 31: 1.21, 0.012 % (0..5.1), 0/0",
    ),
    Approximation(
        "point spread of a reduced image",
        Figure(4.0, "%", "sigma in images reduced 4 times", MEASURED),
        "sigma is 7 and 14 % smaller in images reduced 2 and 4 times; errors were by 7 and 11 to 17 %, so that it is within 4 % of them (photographs reduced, a6f7568, 2026-11-27)",
        constants=("landmarks.point_spread.SHARPEST_PX", "landmarks.point_spread._GAIN"), unpriced="no switch: a claim is made before it is known how often an image will be reduced",
        price="nothing in a build; with less than 0.125 pixels 24 of 224 points of a frame are lost",
    ),
    Approximation(
        "top of a broad peak",
        Figure(0.1, "", "a probability near 0.7, too high; 0.03 above 0.9, too low", MEASURED),
        "compared with the strongest of 16 places 5 cells away, others left out: in the mean up to 0.1 too high near 0.7, 0.03 too low above 0.9 (200 draws of noise over each of ten peaks, e969fc6d, 2026-11-30)",
        constants=("landmarks.detection.top_probability", "landmarks.uniqueness.EXCLUSION_PX", "landmarks.uniqueness.RING", "landmarks.uniqueness._RING_PX"),
        unpriced="no switch: part of every claim", price="none beside a claim; without it 0.7 % of the usable conditions are others, 0.84 of a probability at most (25 areas of the sample, e969fc6d, 2026-11-30)",
    ),
    Approximation(
        "tops that noise raises",
        Figure(0.51, "", "a probability, 4 in place of 3 pixels' slope of the noise", MEASURED),
        "other peaks rise by 3 g exp(-0.7 t g / G) less what the true one rises: off by 0.015 of a correlation (rms, 599 peaks in 60 draws of noise each, on two grounds not used for the fit; mean rise 0.034). 2 or 4 in place of 3 change 0.72 or 0.66 % of the usable conditions, 0.51 of a probability at most; 0.5 or 1 in place of 0.7 0.13 or 0.38 %, 0.15 at most (9 areas of the sample, 7178760c, 2026-11-30)",
        constants=("kernels.matching.acquisition.slope_of_noise", "kernels.matching.acquisition.REACH_PX", "kernels.matching.acquisition.SHARPNESS"),
        unpriced="no switch: part of every claim", price="none beside a claim; without it 2.1 % of the usable conditions are others, 0.95 of a probability at most",
    ),
    Approximation(
        "noise as rough as the patch",
        Figure(1.6, "", "times the stated standard deviation of a correlation, in noise much smoother than the relief", MEASURED),
        "the noise in a window has the patch's spectrum (k = 1/2): correlations at the true place scatter by 0.78 to 1.01 times the stated, in one of 16 cases by 1.11 (searches on clones of three DEMs, Suns of 10 to 65 deg; with k = 1 0.65 to 0.94); on made relief of 1.7 cells in noise of 4 cells by up to 1.6, of 6 cells 2.9. k = 1 or 1/4 change 2.2 or 1.3 % of the usable conditions, 0.17 of a probability at most (9 areas of the sample, 7178760c, 2026-11-30)",
        constants=("kernels.matching.acquisition._SMOOTHER",), unpriced="no switch: part of every claim", price="none",
    ),
    Approximation(
        "sigma of a match",
        Figure(50.0, "%", "sigma without the growth by its residuals", LIMIT),
        "residuals count as correlated up to 7 pixels apart, and the variance grows 1 + 3 r times, r their correlation, 0 to 1: sigma 1 to 2 times, for errors of a render that leave residuals only in part (exact; fitted to photographs). 2 or 4 in place of 3: 0.87 to 1.12 times (exact). 3 or 14 in place of 7 pixels: in the median 0.91 or 1.03 times; mean squared error over it 1.15 or 0.87, with 7 0.95 (182 points of AS15-M-0414, 3e4c68bf, 2026-11-29); a match has at least the sigma of its claim: then 0.67 or 0.64, with 7 0.66 (decoded as sRGB, with the albedo map)",
        constants=("kernels.matching.subpixel_fit._LAGS", "kernels.matching.subpixel_fit._MISMATCH"),
        unpriced="no switch: part of a match; `lcp validate` states its normalised squared error", price="none in builds; 3 or 14 in place of 7 pixels take 0.8 to 0.9 or 1.7 to 1.9 times the processor time of the fits (under load, 3e4c68bf, 2026-11-29)",
    ),
    Approximation(
        "fits that broad peaks lose",
        Figure(1.05, "%", "the usable conditions, 0.25 a pixel in place of 0.3", MEASURED),
        "share lost: a straight line over sigma, within 0.01 of what 3568 searches lost (48e88658, 2026-11-25), which allow 0.27 to 0.32 a pixel; with 0.25 1.05 %, with 0.35 0.82 % of the usable conditions, 0.032 of a probability at most (50 km of the sample, 6bb26eca, 2026-11-28)",
        constants=("landmarks.detection._FIRM_PX", "landmarks.detection._LOST"), unpriced="no switch: part of every claim", price="none beside a claim; without it 5.3 % of the usable conditions are others, 0.18 of a probability at most",
    ),
    Approximation(
        "places that a search refuses",
        Figure(0.08, "", "a probability before a search", EXACT),
        "0.57 probits lie between the highest correlation and a match, 0.48 to 0.77 over claims of 0.1 to 0.9: at most 0.08 of the probability (exact). With 0 to 3 probits the points found in two photographs (341) and six simulated frames (1184) are the same (6bb26eca, 2026-11-28)",
        constants=("landmarks.detection._PROBITS_OF_SEARCH",), unpriced="no switch: it decides between two similar peaks alone", price="nothing in a build: it belongs to matching",
    ),
    Approximation(
        "how clearly relief shows between conditions",
        Figure(0.026, "", "a probability, mean over claims between elevations twice as far apart", MEASURED),
        "claims of the sample against those of their neighbours: mean error 0.026 over elevation, 0.022 over azimuth; of averages of logits 0.033 and 0.016. A spread of 0.9 or 1.3 in place of 1.1 changes 2.0 and 1.3 % of the usable conditions between, 0.13 of a probability at most, other constants fewer (6bb26eca, 2026-11-28)",
        constants=("landmarks.relief_signal._NEEDED", "landmarks.relief_signal._SPREAD", "landmarks.relief_signal._LEAST_HEIGHT", "landmarks.relief_signal.LEAST_SLOPE_SIGNAL", "landmarks.relief_signal.LEAST_COSINE"),
        unpriced="no switch: it belongs to a query", price="nothing in a build",
    ),
    Approximation(
        "failures in common",
        Figure(0.042, "", "the probability that a frame is located", MEASURED),
        "variance 0.1 of the common factor; frames allow 0.08 to 0.13: 0.042 at most, 0.007 in the mean, for 4 to 120 points of probabilities of 0.1 to 0.98; 99 % need 17 to 20 points of 0.7 in cells of 10 m, 18 are stated (6bb26eca, 2026-11-28)",
        constants=("landmarks.located.COMMON_VARIANCE", "landmarks.located.NODES", "landmarks.located.WEIGHTS"),
        unpriced="no switch: known after a flight alone", price="none; 61 nodes in place of 15 change 0.0002 of the probability",
    ),
    Approximation(
        "wrong matches",
        Figure(0.17, "", "the probability that a frame is located, where one more match is needed", MEASURED),
        "0.05 of the points that are not found: with none 0.14, with twice as many 0.17 at most, 0.018 in the mean, over 4 to 120 points in cells of 10 to 474 m (9dc850f9, 2026-11-28)",
        constants=("landmarks.located.WRONG",), unpriced="no switch: known after a flight alone", price="none: a number",
    ),
    Approximation(
        "matches that agree by accident",
        Figure(0.8, "", "the probability that a frame is located, matches of 1 in place of 0.5 pixels", MEASURED),
        "a match of 0.5 pixels, a tolerance of 1 pixel, a camera known to 1 km decide how many points must agree. Half and twice of them: 0.8 at most where a few more are needed, 0.04 in the mean; 99 % need 18 points of 0.7 in cells of 10 m, with 1 pixel 21 (9dc850f9, 2026-11-28)",
        constants=("landmarks.located._SIGMA_PX", "landmarks.located._TOLERANCE_PX", "landmarks.located._POSITION_M", "landmarks.located._REACH_PX"),
        unpriced="no switch: `query` and `validate` take the camera's own uncertainty; a build does not know it", price="none: numbers",
    ),
    Approximation(
        "votes of all points",
        Figure(0.055, "", "the probability that the ground as a whole shows", MEASURED),
        "highest rival at 2.7 sigmas; frames are likeliest at 2.72 and 2.74: 0.055 at most, for 10 to 200 points of probabilities of 0.01 to 0.7 within 64 pixels; levels of a vote 0.25 apart: 0.006 (6bb26eca, 2026-11-28)",
        constants=("landmarks.ground_votes.RIVAL_Z", "landmarks.ground_votes._Z"), unpriced="no switch: known after a flight alone", price="none: a number",
    ),
    Approximation(
        "pixels of a template",
        Figure(2.0, "%", "the pixels that a search compares", MEASURED),
        "(W - 1.9)^2 of a patch W pixels wide, W cos e - 1.9 along a slant view's plane: 2 % off in 7000 templates (dc01fc93, 2026-11-28); a claim evaluates the whole nodes that are nearest, and takes a search to see 0.2 of the joint sigma of two correlations, of 0.36 to 0.76 measured, because claims of usable points hold best with it",
        constants=("landmarks.point_spread.LEAST_COVER", "landmarks.detection.SEEN"), unpriced="no switch: a search leaves out what its image does not show of a patch",
        price="nothing in a build; with all nodes claims in pixels of 2 cells are 0.09 too high",
    ),
    Approximation(
        "packing of claims",
        Figure(0.002, "", "a probability", EXACT),
        "0.002 of a probability, half a step of 1/250; 0.0005 of a cell of a sigma; 0.00025 of an albedo factor (exact); no flag changes",
        constants=("catalog.schema.DETECTION_STEP", "catalog.layout.SIGMA_STEPS_PER_CELL", "photometry.albedo_map.PATCH_STEP"), unpriced="no switch: the file's format",
        price="seven bytes a claim instead of eighteen",
    ),
    Approximation(
        "float32",
        Figure(6e-8, "rad", "a normal; 2e-6 of a radiance", EXACT),
        "2e-6 of a radiance, 2^-24 rad of a normal (exact)", effects=("float width",), settings=("float64",), constants=("kernels.elementary._EXP", "kernels.elementary._LOG", "kernels.elementary._TAIL", "kernels.photometry.images._ATAN", "kernels.photometry.hapke_simd._ACOS"),
        unpriced="no switch in builds, whose kernels are written for it; in renders the tier `reference`",
        price="half the memory of an image; with float64 and every ray traced an area takes 1.2 to 1.9 times the time of `high` (2584014, 2026-11-24)",
    ),
    Approximation(
        "resampling of the DEM",
        Figure(0.13, "m", "heights midway between four posts of 118 m, rms; 7.3 at most", MEASURED),
        "cubic convolution (Keys 1981, a = -0.5): exact for parabolas, error of third order in the posting; against quintic splines midway between the posts of the sample rms 0.13 m, of 237 m 0.32, of 474 m 1.0 (35b57c98, 2026-11-28); bilinear beside missing pixels",
        constants=("kernels.resampling.heights.sample", "kernels.resampling.area_means._A", "kernels.resampling.area_means.SAMPLES_MAX"), unpriced="no switch: nodes lie on the area's grid whatever the DEM's projection",
        price="bilinear instead changes 7.5 % of the usable conditions of the sample, cells of 474 m, and 0.99 of the time (7bb57269, 2026-11-27)",
    ),
    Approximation(
        "height errors of a product",
        Figure(3.7, "%", "the usable conditions, twice the 1 sigma of heights", MEASURED),
        "24.5 m and 530 m calibrated for GLD100 with frames; for a product without a figure the same shares of what it resolves (2.45 and 50 %). On 50 km of the sample the published 20 m change 0.39, half 0.93, twice 3.7 %, lengths of 375 and 750 m 0.14 and 0.35 % of the usable conditions (8c7b1a90, 2026-11-28); a patch's place 7.2 % of the length, 10.6 with maps of Apollo 16",
        constants=("dem.error_maps.SIGMA_PER_RESOLUTION", "dem.products.LENGTH_PER_RESOLUTION", "dem.products.PLACE_PER_LENGTH"),
        unpriced="no alternative of its own: `errors.height_sigma_m`, `errors.height_length_m` and maps replace them", price="none: numbers",
    ),
    Approximation(
        "differences between image and render",
        Figure(9.9, "%", "the conditions, `errors.albedo_sigma` 0.12 in place of 0.09", MEASURED),
        "fitted to frames. On 60 km of the sample (145 points) 0.12 for 0.09 of `errors.albedo_sigma` changes 9.9 %, 0 for 0.25 of `errors.spread` 2.8 % of the conditions; `localization_sigma` is 1.39 times as great with 0.5 for 0.25 of `errors.moving_share`, 1.17 times with a typical contrast of 0.05 for 0.06 (eff4066c, 2026-11-28)",
        constants=("landmarks.error_model.TYPICAL_CONTRAST",), unpriced="no alternative of its own: fields of `errors`, which `validate` fits", price="none: numbers",
    ),
    Approximation(
        "mistakes that a search allows",
        Figure(0.95, "%", "the conditions, 0.1 in place of 0.2", MEASURED),
        "a match is ambiguous where a second peak is the true one with a probability of 0.2. On 60 km of the sample 0.1 changes 0.95, 0.4 0.79 % of the conditions, and 24 and 23 of 145 points are others (eff4066c, 2026-11-28)",
        constants=("landmarks.detection.AMBIGUOUS",), unpriced="no switch: claims and searches must ask the same", price="none: a number",
    ),
    Approximation(
        "derivatives of an image",
        Figure(0.024, "", "a probability", MEASURED),
        "differences over a slope of 0.01: against 0.001 0.009 % of the flags, 0.024 of a probability at most (measured on the sample, 7bb57269, 2026-11-27)",
        constants=("photometry.laws.SLOPE_STEP",), unpriced="no switch: a smaller step rounds more", price="none: every step takes the same time",
    ),
    Approximation(
        "rounding of height errors",
        Figure(2.5, "%", "sigma and length", EXACT),
        "2.5 % of sigma and length (exact)",
        ("points.error_step",), alternatives.choices("points.error_step", 0.4, 0.01, usual=0.05),
        constants=("production.evaluation.STEP",), expected=0.0001,
        fineness=lambda c: -(c.points.error_step or 0.05),
        sample="0.4: 1.01, 0, 0/0; 0.01: 1.01, 0, 0/0",
    ),
    Approximation(
        "one direction to the Sun from an area",
        Figure(1.6e-5, "deg", "the direction, areas of 60 km", EXACT),
        "half the area's diagonal over 1 au (exact), stated by the scene plan: 1.6e-5 deg for 60 km",
        effects=("parallax of the Sun", "motion of the Sun"), constants=("rendering.pipeline.SUN_MOVES_DEG",),
        unpriced="no switch: 2e-4 deg in cells of 10 km", price="none: a direction for each node would change no value of float32",
    ),
    Approximation(
        "shape of the ground",
        Figure(0.0, "m", "the height of the triangles between nodes, over the curved Moon, in builds", EXACT),
        "none: builds render and shadow these triangles as they are (what the ground has between the nodes: cell size); a render may take the plain sphere, with its error stated",
        effects=("relief", "curvature", "dependence", "cell size", "Suns"), constants=("rendering.sphere_renderer.COVERAGE_ERROR",),
        unpriced="no approximation in builds; in renders `surface`", price="none in builds",
    ),
    Approximation(
        "light other than the Sun's",
        Figure(0.6, "%", "the mean radiance, rms, in `draft`; 0.06 in `reference`", MEASURED),
        "rms 0.6, 0.4, 0.15 and 0.06 % of the mean radiance by tier (measured, fe00479, 2026-11-21)",
        effects=("sky light", "other sources", "Sun over sky", "background"), settings=("sky_directions", "sky_tier", "sky_rms"),
        constants=("light.sky_sampling.BETWEEN_NODES_RMS", "light.sky_sampling.SKY_FLOOR_RAD", "rendering.decisions.BACKGROUND_PX"),
        unpriced="in renders alone, by `model.accuracy`; builds have the Sun alone", price="none in builds; a plan of a render states its share of the time",
    ),
    Approximation(
        "light of the Earth",
        Figure(93.0, "%", "the earthlight over all phases; 79 of a full Earth", MEASURED),
        "one albedo and one phase function, those of the Astronomical Almanac (Mallama and Hilton 2018). Phase curves give 0.242 (Robinson 2025, arXiv:2507.22258): a full Earth is 79 % too bright; over all phases 0.57 of the light is sent back, 0.294 is measured: 93 % too much. Clouds 5 to 10 %, without a time -11 to 16 % by the distance, beyond 170 deg extrapolated: below 6e-7 of the Sun's light. So in shadow; of sunlit ground 0.3, 0.03, 0.013 % at 0.5, 5, 10 deg of Sun at most (e94c45d2, 2026-11-28)",
        constants=("light.sources.EARTH_ALBEDO", "light.sources.LAST_PHASE_DEG", "light.sources.MEAN_DISTANCE_M"),
        unpriced="in renders alone, where earthshine is asked for; builds have the Sun alone", price="none in builds; 1.02 (0.93 to 1.10) of the time of a render of 100 km of the sample (four pairs, e94c45d2, 2026-11-28)",
    ),
    Approximation(
        "units of a promise",
        Figure(15.0, "%", "the points, more than a frame needs, mean over mixed sets of claims", MEASURED),
        "15 units, rounded down: never fewer points than are needed (tests). 11 to 15 % more than by their joint probability, in single sets up to 26 %, of which 60 units would leave 7 to 9 % fewer (60 random sets a cell size and probability). On 75 km of the sample 68.5 % of the promise is kept by 61 of 64 candidates, with 60 units 71.3 % by 62 (e94c45d2, 2026-11-28)",
        constants=("landmarks.located.MOST_UNITS",), unpriced="no switch: the number of units in a byte of a checkpoint",
        price="none: a choice takes the same time with 60 units",
    ),
    Approximation(
        "places of a promise",
        Figure(6.0, "%", "the points, more than with 40 steps in a footprint", MEASURED),
        "places 16 steps apart in a footprint, 4 in a large region; a point counts where it is in view from every place between them, so never fewer points than are needed: in 0.81 of the area in which a footprint shows patches whole. 300 km, footprints of 60 km, cells of 59 m, 3000 made candidates: 554 points, with 24 steps 539, with 40 steps 525: 6 % more (68073a09, 2026-11-29)",
        constants=("production.promise._FINEST", "production.promise._COARSEST"), unpriced="no switch: it follows from `points.footprint_km` and the region",
        price="1.8 s of the choice, 7.4 s with 24 steps (150 km at Hadley, cells of 474 m, 264 Suns, 5 views)",
    ),
    Approximation(
        "moments of a promise",
        Figure(0.01, "%", "the moments at random Suns, whose units are fewer than told", MEASURED),
        "the corners of where the Sun can stand in a cell, and Suns at most 2 by 5 deg apart between them: of 38 000 random moments 0.01 % (2) have fewer units than told, by 1 %, and of 37 160 told as kept none lacks a unit (Hadley, Taurus-Littrow, 18 000 of them with the Sun within 15 deg of a camera; 00cea8b4, 2026-11-30). Of more than a million pairs of a candidate and a place, the worst place in a part of the circle around the candidate counts: 80 % of a promise is told as kept for 81 % (44140e46, 2026-11-29)",
        constants=("kernels.sun_moments.PART_DEG", "production.moments._SLOPE_STEP", "production.moments._HEIGHTS", "production.moments._ROWS", "production.moments._PARTS"),
        unpriced="no switch: a part is far below the steps of a grid of Suns", price="6.6 s of processor time where whole cells took 9.1 (125 000 pairs of 1500 made candidates and places, 5 views, 17b0d2b7, 2026-11-29)",
    ),
    Approximation(
        "latitudes of a promise",
        Figure(0.125, "deg", "the latitude at which Suns happen", LIMIT),
        "latitudes are rounded to 0.25 deg for what Suns happen at a place. None of 64 points is another with 0.025 or 1 deg (promise of six points in 30 km, 75 km of the sample, 789c278e, 2026-11-29)",
        constants=("production.promise._LATITUDE_STEP_DEG",), unpriced="no switch: it is far below the steps of a grid of Suns",
        price="none beside noise: with 0.025 deg 1.02, with 1 deg 1.04 of the processor time (one run each, 789c278e, 2026-11-29)",
    ),
    Approximation(
        "exchanges of points",
        Figure(2.6, "%", "the points, more without exchanges", MEASURED),
        "above 30 000 candidates none is tried: without them 2.6 % more points of 2000 made candidates, 1.6 of 8000, 1.9 of 32 000; none on 75 km of the sample, where 61 of 64 are needed (e94c45d2, 2026-11-28); what is promised is kept alike, and the lower bound is stated beside the choice",
        constants=("landmarks.selection.EXCHANGE_MAX",), unpriced="no switch: `points.max_points` limits the choice",
        price="2.0 in place of 0.2 s for 32 000 made candidates in 40 conditions, 0.02 in place of 0.004 s for 2000",
    ),
    Approximation(
        "position of the Sun",
        Figure(0.005, "deg", "the direction to the Sun, 1990 to 2050", LIMIT),
        "series for the Earth and the Moon, IAU's rotation and a correction to the mean-Earth frame; tests hold it against DE421",
        constants=("ephemeris.solar_position.DIRECTION_ERROR_DEG", "ephemeris.solar_position._RA", "ephemeris.solar_position._DEC", "ephemeris.solar_position._W", "ephemeris.solar_position._E0", "ephemeris.solar_position._E1", "ephemeris.solar_position._J2000"),
        unpriced="no switch: a Sun is also given by angles or by a camera's file", price="none in builds, whose Suns are angles",
    ),
    Approximation(
        "inverse of a camera",
        Figure(1e-6, "pixels", "a pixel that is seen and projected back", LIMIT),
        "iterated until a pixel comes back to within 1e-6 pixels (lens) or 1e-8 lines (scanner); else there is no direction",
        constants=("cameras.distortion.INVERSE_TOLERANCE_PX", "cameras.scanners.CONVERGED"),
        unpriced="no switch: the next step is below the last digit", price="one step of the iteration",
    ),
    Approximation(
        "shape of a patch in an image",
        Figure(0.002, "pixels", "the place of a node in a template", LIMIT),
        "cubic polynomials for a patch's places in an image, checked at nine nodes and on the grid; where they differ by more every node is projected",
        constants=("matching.templates.TOLERANCE_PX", "matching.templates._ORDER", "matching.templates._ACROSS", "matching.templates._SAMPLES_A_NODE"),
        unpriced="no switch: a tenth of the least sigma of a match", price="nothing in a build: it belongs to matching",
    ),
    Approximation(
        "blur of a simulated frame",
        Figure(1.27e-4, "", "a point's light, beyond four sigmas in either direction", EXACT),
        "the Gaussian is cut off at four sigmas, and what is beyond is spread over the rest",
        constants=("simulation.detector.REACH",), unpriced="no switch: below the steps of a detector of 12 bits", price="none in builds",
    ),
    Approximation(
        "rays of a simulated frame",
        Figure(7.4, "%", "the mean radiance, rms, two rays a side, 5 deg of Sun on the sample; 35 in a frame of which 94 % is in shadow", MEASURED),
        "2 to 4 rays along a pixel's side, one a cell; against eight, two err by 7.4 % rms of the mean in 50 pixels of the sample under 5 deg; against sixteen in 100 by 4.9, 1.5 and 0.2 % under 5, 15 and 40 deg, three by 2.3 and four by 1.3 % under 5 (6bb26eca, 2026-11-28); by 35 % of a mean that is nearly black (eff4066c, 2026-11-28)",
        constants=("simulation.frame.SAMPLES_LEAST", "simulation.frame.SAMPLES_MOST"), unpriced="no field of a build: `samples` of `simulate`",
        price="none in builds; 16 rays a side take 23 to 48 times the time of two",
    ),
    Approximation(
        "motion of a camera between rows of its table",
        Figure(0.0125, "deg", "the attitude, rows 10 s apart, its rate changing by 0.001 deg/s in a second", EXACT),
        "constant rate between rows: an eighth of the change of rate times the step squared (exact). Tables of LROC with rows left out: 0.0044 deg at most for rows up to 8 s apart, 0.0096 up to 55 s; positions 2 mm up to 13 s (6bb26eca, 2026-11-28)",
        constants=("cameras.trajectory.Attitude", "cameras.trajectory.Track", "cameras.trajectory._NEAREST"), unpriced="no switch: more rows in the table", price="none in builds",
    ),
    Approximation(
        "steps of the flight file",
        Figure(0.7, "deg", "the direction of an ellipse's axis", EXACT),
        "half a step of 180/128 deg; heights half a step of their range in a patch over 65 534 (exact)",
        constants=("exports.flight.ANGLE_STEPS",), unpriced="no switch: the file's format", price="none in builds; a claim takes four bytes in the file",
    ),
)  # fmt: skip
"""Every approximation, once."""

SAMPLE = "4 of 67 areas of the sample with 28 points, cells of 474 m, 757da234, 2026-11-30; times ede1714, d153cb8, 2026-11-27"
"""Scene, commit and date of the figures of ``sample``."""

SWITCHES = {
    effect: one.switch[0] if one.switch else None
    for one in APPROXIMATIONS
    for effect in one.effects
} | {
    "cell size": "area.gsd_m",
    "Suns": "sun.elevations_deg",
    "dependence": "points.max_dependence",
}
"""The field that controls each decision of a scene plan; None without one."""
