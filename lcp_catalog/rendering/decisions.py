"""Decisions of a scene plan: one function for each effect says whether it is modelled, why, and with
what error. Renders and builds use the same functions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..accuracy import Accuracy
from ..atomic_files import file_facts
from ..constants import ASTRONOMICAL_UNIT_M, LOWEST_M, MOON_RADIUS_M, SOLAR_RADIUS_RAD
from ..light.bounced_light import BouncedSample
from ..light.environment import Environment
from ..light.sources import Lighting
from ..photometry.albedo_map import AlbedoCover, AlbedoMap, ColourMap
from ..photometry.law_choice import LawChoice
from ..terrain.far_terrain import FarTerrain
from ..terrain.relief_bounds import Relief, Ring, Steepness
from ..terrain.surroundings import CELL_SHARE, HORIZON_RMS_DEG
from .error_bounds import NORMAL_ROUNDING_RAD, PENUMBRA_PX, SHIFT_PX, SphereCost


@dataclass(frozen=True)
class Decision:
    """Decision about one effect: ``error_bound``, in ``unit``, is None where no bound is known."""

    effect: str
    modelled: bool
    reason: str
    error_bound: float | None
    unit: str


@dataclass(frozen=True)
class LightWords:
    """The light of a scene in the words of its plan. ``first``: the first source; ``rest``: what
    lights ground that the first source does not reach; ``at_infinity``: True for a panorama.
    """

    first: str = "the Sun"
    rest: str = "surfaces out of sunlight are black"
    at_infinity: bool = False

    @classmethod
    def of(cls, light: Lighting) -> LightWords:
        """Words for sources and sky."""
        if light.sky is None:
            names = " and ".join(f"the {source.name}'s" for source in light.others)
            return cls(rest=f"surfaces out of sunlight have {names} light") if names else cls()
        sky = light.sky.power_above
        if light.first.irradiance == 0.0:
            return cls(f"the {light.first.name}", "all light is the sky's", True)
        others = "the other sources' light and " if light.others else ""
        rest = f"surfaces that {light.first.name} does not reach have {others}the sky's ({100.0 * sky:.2f} % of all light)"
        return cls(light.first.name, rest, True)


SUN_ALONE = LightWords()


@dataclass
class _Tally:
    """Decisions of several areas: their number, the one with the largest error bound, and whether the
    bounds differ.
    """

    count: int = 0
    area: str = ""
    worst: Decision | None = None
    bounds_differ: bool = False

    def add(self, area: str, decision: Decision) -> None:
        bound = decision.error_bound
        if self.worst is None or (bound or 0.0) > (self.worst.error_bound or 0.0):
            self.bounds_differ |= self.worst is not None
            self.area, self.worst = area, decision
        self.bounds_differ |= bound != self.worst.error_bound
        self.count += 1

    @property
    def reason(self) -> str:
        """The reason of the area with the largest error bound."""
        chosen = "the largest error bound in" if self.bounds_differ else "for example"
        return f"{chosen} {self.area}: {self.worst.reason if self.worst else ''}"


class MergedDecision:
    """One decision for several areas, which are added one by one and not kept."""

    def __init__(self) -> None:
        self._all, self._modelled, self._left_out = _Tally(), _Tally(), _Tally()
        self._first: Decision | None = None
        self._alike = self._bounded = True

    def add(self, area: str, decision: Decision) -> None:
        """Add the decision of an area."""
        first = self._first = self._first or decision
        self._alike &= (decision.modelled, decision.reason) == (first.modelled, first.reason)
        self._bounded &= decision.error_bound is not None
        self._all.add(area, decision)
        (self._modelled if decision.modelled else self._left_out).add(area, decision)

    @property
    def decision(self) -> Decision:
        """Modelled if it is modelled in any of the areas, with the largest error bound (None if one has
        none) and the reason of the area that has it. ValueError without areas.
        """
        first, worst = self._first, self._all.worst
        if first is None or worst is None:
            raise ValueError("no areas to merge")
        whole, modelled, left_out = self._all, self._modelled, self._left_out
        if self._alike:
            reason = first.reason
        elif not modelled.count or not left_out.count:
            reason = f"all {whole.count} areas, {whole.reason}"
        else:
            reason = (
                f"modelled in {modelled.count} of {whole.count} areas, {modelled.reason}; "
                f"not modelled in {left_out.count} of {whole.count} areas, {left_out.reason}"
            )
        bound = worst.error_bound if self._bounded else None
        return Decision(first.effect, modelled.count > 0, reason, bound, first.unit)


@dataclass(frozen=True)
class RayMethod:
    """The method of ray tracing in words, and the share of nodes that may be wrong."""

    method: str
    node_error: float = 0.0

    @classmethod
    def of(cls, accuracy: Accuracy) -> RayMethod:
        """Parallel rays in the tier of an accuracy."""
        return cls(f"{accuracy.tier}: {accuracy.shadow_method}", accuracy.node_error)


EVERY_PIXEL = RayMethod("a ray from the surface point of every pixel")
EVERY_NODE = RayMethod("a line of sight from every node to the camera")


def hiding(
    effect: str, what: str, tangent: float, slope: Steepness | None, rays: RayMethod
) -> Decision:
    """Decision about cast shadows or occlusion. ``what`` names the elevation of the rays and
    ``tangent`` is its least tangent; ``slope`` None: model the effect for any relief.

    A connected surface cannot rise above a ray that is steeper than its steepest facet.
    """
    elevation = f"{what} of {_degrees(tangent)}"
    unit = "share of nodes"
    if slope is None:
        reason = f"for any relief; {elevation}; {rays.method}"
        return Decision(effect, True, reason, rays.node_error, unit)
    steepest = f"the steepest facet, {_degrees(slope.tangent)},"
    if slope.clears(tangent):
        reason = f"{steepest} is below {elevation}: terrain cannot block a ray"
        return Decision(effect, False, reason, 0.0, unit)
    if slope.connected:
        reason = f"{steepest} reaches {elevation}; {rays.method}"
    else:
        reason = f"some nodes have no height, so the slopes beside them are unknown; {elevation}"
        reason += f"; {rays.method}"
    return Decision(effect, True, reason, rays.node_error, unit)


def straight_down() -> Decision:
    """Decision about occlusion in a view straight down."""
    reason = "the view is straight down: no part of a heightfield hides another"
    return Decision("occlusion", False, reason, 0.0, "share of nodes")


def solar_disc(
    asked: bool,
    slope: Steepness | None,
    limb: float,
    width_px: float,
    accuracy: Accuracy,
    point: str = "a point Sun",
) -> Decision:
    """Decision between the Sun's disc and a point at its centre. ``limb``: tangent of the lower
    limb's elevation; ``width_px``: width of the widest penumbra on level terrain
    (`decisions.penumbra_px`); ``point``: the source that is no disc.

    The two differ only at nodes whose horizon cuts the disc.
    """
    effect, unit = "solar disc", "share of the disc"
    if slope is not None and slope.clears(limb):
        reason = (
            f"the steepest facet, {_degrees(slope.tangent)}, is below the Sun's lower limb, "
            f"{_degrees(limb)}: terrain hides no part of the disc"
        )
        return Decision(effect, False, reason, 0.0, unit)
    widest = f"penumbras on level terrain are up to {width_px:.3g} pixels wide"
    if math.isinf(width_px):
        widest = "penumbras have no greatest width under this Sun"
    if slope is None:
        widest = "the width of penumbras depends on the relief"
    exact = (
        f"nodes whose horizon is more than {math.degrees(SOLAR_RADIUS_RAD):.3f} deg from the Sun's "
        "centre are exact"
    )
    if not asked:
        return Decision(effect, False, f"{point}; {widest}; {exact}", 1.0, unit)
    if width_px <= (0.0 if accuracy.exact else PENUMBRA_PX):
        reason = f"{widest}, less than {PENUMBRA_PX}; {exact}"
        return Decision(effect, False, reason, 1.0, unit)
    reason = f"{widest}; {accuracy.tier}: the error is the measured rms over all nodes"
    return Decision(effect, True, reason, accuracy.disc_rms, unit)


DISC_SHIFT, DISC_SHIFT_DEG = 0.024, 0.5
"""Cells by which the disc shifts matches under a Sun of this elevation, the most that was measured; 0.014 under 6 deg."""


def disc_of_matches(node: Decision, lowest_deg: float) -> Decision:
    """The decision between disc and point for matches of patches, from that for single nodes: the error is the measured
    shift; None below the lowest Sun that was measured.
    """
    if node.modelled:
        return node
    shift: float | None = 0.0
    reason = node.reason
    if node.error_bound:
        shift = DISC_SHIFT if lowest_deg >= DISC_SHIFT_DEG else None
        reason += (
            f"; a node in a penumbra errs by up to 1, matches shift by 0.014 to {DISC_SHIFT} cells under Suns of 6 to "
            f"{DISC_SHIFT_DEG} deg"
        )
    return Decision(node.effect, False, reason, shift, "cells of a match (measured)")


PERSPECTIVE, PERSPECTIVE_UNIT = "perspective", "share of the radiance factor; rad of the angles"


def perspective_of_infinity() -> Decision:
    """Decision about perspective in a view from infinity."""
    reason = "the camera is at infinity: its rays are parallel"
    return Decision(PERSPECTIVE, False, reason, 0.0, PERSPECTIVE_UNIT)


def perspective_of_pixels() -> Decision:
    """Decision about perspective in the camera's plane."""
    return Decision(PERSPECTIVE, True, "every pixel has its own ray", 0.0, PERSPECTIVE_UNIT)


def perspective_of_nodes() -> Decision:
    """Decision about perspective at nodes that are each seen from their own direction, by a scanner
    or on the sphere.
    """
    return Decision(
        PERSPECTIVE, True, "every node has its own direction to the camera", 0.0, PERSPECTIVE_UNIT
    )


def perspective(angle_rad: float, error: float, accuracy: Accuracy) -> Decision:
    """Decision about perspective for a camera at a finite position: one direction for all nodes if
    its error is within the tolerance (`decisions.ray_angle_rad`, `parallel_error`).
    """
    turned = f"directions to the camera differ from that at the area's centre by up to {_small(angle_rad)}"
    if error <= accuracy.tolerance and accuracy.tolerance > 0.0:
        reason = f"{turned}, and every slope faces all of them: within {accuracy.tolerance:g}"
        return Decision(PERSPECTIVE, False, reason, error, PERSPECTIVE_UNIT)
    if math.isinf(error):
        reason = f"{turned}, and slopes may face away from some of them"
    else:
        reason = f"{turned}: parallel rays would have an error of up to {error:.2g}"
    return Decision(PERSPECTIVE, True, reason, 0.0, PERSPECTIVE_UNIT)


def perspective_of_patches(angle_rad: float, tolerance_rad: float) -> Decision:
    """Decision about perspective in a build; ``angle_rad``: by how much the directions to a camera
    vary around a point, over its patch and search region; ``tolerance_rad``: what the build
    permits of a direction.
    """
    unit = "rad of the angles"
    if angle_rad == 0.0:
        reason = "each view has parallel rays, in the direction from the point to the camera"
        return Decision(PERSPECTIVE, False, reason, 0.0, unit)
    turned = f"directions to a camera vary by up to {_small(angle_rad)} around a point"
    limit = f"direction tolerance of {_small(tolerance_rad)}"
    if angle_rad <= tolerance_rad:
        reason = f"{turned}, within the {limit}: parallel rays"
        return Decision(PERSPECTIVE, False, reason, angle_rad, unit)
    reason = (
        f"{turned}, more than the {limit}: at views of finite altitude every point is rendered for its "
        "own camera, every node with its own direction to it"
    )
    return Decision(PERSPECTIVE, True, reason, 0.0, unit)


def surface(
    relief: Relief | None,
    least_view_tangent: float,
    away_m: float,
    plain: SphereCost | None = None,
    accuracy: Accuracy | None = None,
) -> Decision:
    """Decision between the heightfield and the plain sphere. ``away_m``: distance from the frame's
    origin to the farthest node. ``plain``: errors of the sphere, if terrain can hide nothing; None:
    not computed.
    """
    unit = "share of the radiance factor; rad of the angles"
    if plain is not None:
        cost = (
            f"the plain sphere turns normals by up to {_small(plain.tilt_rad)}, changes the radiance "
            f"factor by up to {plain.radiance:.2g} and shifts the surface by up to "
            f"{plain.shift_px:.2g} pixels"
        )
        if accuracy is not None and plain.within(accuracy):
            bound = max(plain.tilt_rad, plain.radiance)
            reason = f"{cost}: within {accuracy.tolerance:g} and {SHIFT_PX} pixels"
            return Decision("relief", False, reason, bound, unit)
        return Decision("relief", True, f"the heightfield's own triangles; {cost}", 0.0, unit)
    reason = "the heightfield's own triangles"
    if relief is not None:
        turn = math.asin(min(1.0, away_m / (MOON_RADIUS_M + LOWEST_M)))
        tilt = math.degrees(math.atan(relief.node_tangent) + turn)
        height = max(abs(float(relief.box.low_m[2])), abs(float(relief.box.high_m[2])))
        shift = height / max(least_view_tangent, 1e-9) / relief.gsd_m
        reason += (
            f"; the plain sphere would turn normals by up to {tilt:.3g} deg and shift the surface by "
            f"up to {shift:.3g} pixels"
        )
    return Decision("relief", True, reason, 0.0, unit)


def float_width() -> Decision:
    """Decision about float64 and float32."""
    reason = (
        "float64 for rays, cosines and azimuths; float32 for normals and, except in the tier "
        "reference, for the sum of radiances under parallel light and a parallel view (relative "
        "error 2e-6), which halves the time of a render"
    )
    return Decision("float width", True, reason, NORMAL_ROUNDING_RAD, "rad of a normal")


REFLECTANCE, REFLECTANCE_UNIT = "reflectance", "share of the mean signal"


def reflectance(choice: LawChoice) -> Decision:
    """Decision about the reflectance model, and its difference from Hapke's."""
    reason = choice.reason
    if choice.model.file is not None:  # the result names the file's content, not its folder
        (facts,) = file_facts([choice.model.file])
        reason += f"; read from {facts['name']}, sha256 {facts['sha256']}"
    return Decision(REFLECTANCE, True, reason, choice.own.residual, REFLECTANCE_UNIT)


def reflectance_as_asked(model: str) -> Decision:
    """Decision about a reflectance model that was not compared with another."""
    reason = f"{model}, as asked; not compared with another model"
    return Decision(REFLECTANCE, True, reason, None, REFLECTANCE_UNIT)


BEYOND, BEYOND_UNIT = "terrain beyond the area", "deg of the horizon"


def far_terrain(
    ring_m: float,
    needed_m: float,
    ring: Ring,
    far: FarTerrain,
    gsd_m: float,
    limit_m: float | None,
    horizon_rad: float | None,
) -> Decision:
    """Decision about terrain around an area, with coarser cells beyond a ring of the area's own.

    ring_m, needed_m: distances to which there are own cells, and to which terrain matters;
    ``limit_m``: distance beyond which no terrain was read, if that may matter; ``horizon_rad``:
    greatest elevation of missing terrain (`decisions.horizon_beyond_rad`), None: none is missing.
    """
    finest_m, coarsest_m = far.cells_m
    reason = (
        f"terrain up to {ring_m / 1e3:.1f} km beyond the area has the area's own cells of {gsd_m:g} m; "
        f"from there to {needed_m / 1e3:.0f} km cells of {finest_m:g} to {coarsest_m:g} m, never wider "
        f"than {CELL_SHARE:.3f} of their distance; error of the horizon {HORIZON_RMS_DEG} deg "
        "(measured rms on lunar relief)"
    )
    bound = HORIZON_RMS_DEG
    if horizon_rad is not None and horizon_rad > 0.0:
        bound = max(bound, math.degrees(horizon_rad))
        missing, gap_m = max(ring.missing, far.missing), min(ring.gap_m, far.gap_m)
        reason += _left_out(missing, gap_m, limit_m)
        reason += f"; terrain that is left out rises at most to an elevation of {bound:.2f} deg"
    return Decision(BEYOND, True, reason, bound, BEYOND_UNIT)


def near_terrain(
    ring_m: float,
    needed_m: float,
    ring: Ring,
    gsd_m: float,
    limit_m: float | None,
    horizon_rad: float | None,
) -> Decision:
    """Decision about the ring of terrain around an area; parameters as in `far_terrain`."""
    reason = (
        f"terrain up to {ring_m / 1e3:.1f} km beyond the area, with the area's own cells of "
        f"{gsd_m:g} m, can shadow or hide it"
    )
    if needed_m > ring_m:
        reason += f"; {needed_m / 1e3:.1f} km would be needed: capped"
    bound = 0.0
    if horizon_rad is not None:
        bound = math.degrees(horizon_rad)
        reason += _left_out(ring.missing, ring.gap_m, limit_m)
        reason += (
            f"; terrain that is left out rises at most to an elevation of {bound:.2f} deg: the image "
            "is complete for a Sun and a camera above that"
        )
    return Decision(BEYOND, True, reason, bound, BEYOND_UNIT)


def _left_out(missing: float, gap_m: float, limit_m: float | None) -> str:
    """Text about terrain that is missing in the DEM, or beyond the limit."""
    text = ""
    if missing > 0.0:
        text += (
            f"; {100.0 * missing:.1f} % of this terrain has no height in the DEM, from {gap_m / 1e3:.1f} km on, "
            "and casts no shadow"
        )
    if limit_m is not None:
        text += f"; terrain more than {limit_m / 1e3:g} km away is not read"
    return text


def always(
    half_m: float, words: LightWords = SUN_ALONE, scattered: Decision | None = None
) -> tuple[Decision, ...]:
    """Decisions about effects that do not depend on relief; ``half_m``: from an area's centre to its
    corners; ``scattered``: decision about scattered light, None to leave it out.
    """
    parallax = math.degrees(half_m / ASTRONOMICAL_UNIT_M)
    one = "one direction for the whole area"
    if words.at_infinity:
        parallax, one = 0.0, "a panorama's light comes from infinity"
    return (
        Decision("curvature", True, "heights are ENU z of the area's frame", 0.0, "m"),
        Decision("parallax of the Sun", False, one, parallax, "deg"),
        scattered or Decision(SCATTERED, False, words.rest, None, SCATTERED_UNIT),
    )


SCATTERED, SCATTERED_UNIT = "scattered light", "radiance factor"


def bounced_light(
    choice: str,
    words: LightWords,
    bound: float,
    sample: BouncedSample | None,
    rms: float,
    shows: float,
) -> Decision:
    """Decision about light that reaches ground by way of other ground (`light.bounced_light`).
    ``choice``: one of `BOUNCES`; ``bound``: `bounced_bound`; ``sample``: None if it was not
    computed; ``rms``: error of the directions, as a share; ``shows``: share of the brightest ground from
    which on it is modelled by itself.
    """
    if choice == "off" or sample is None:
        reason = f"{words.rest}; light by way of other ground is left out"
        return Decision(SCATTERED, False, reason, bound, SCATTERED_UNIT)
    if choice == "auto" and not sample.nodes:
        reason = f"{words.rest}; {words.first} reaches all sampled nodes"
        return Decision(SCATTERED, False, reason, bound, SCATTERED_UNIT)
    found = (
        f"light by way of other ground gives {sample.nodes} sampled nodes that {words.first} does not "
        f"reach a radiance factor of up to {sample.greatest:.2g}"
    )
    if sample.white > 0.0:
        found += f", {100.0 * sample.greatest / sample.white:.2f} % of the brightest ground's"
    if choice == "auto" and sample.greatest <= shows * sample.white:
        reason = f"{words.rest}; {found}: below the tier's limit ({100.0 * shows:.2f} %)"
        return Decision(SCATTERED, False, reason, min(bound, 2.0 * sample.greatest), SCATTERED_UNIT)
    reason = f"one bounce, on ground that {words.first} does not reach; {found}; a second bounce is left out"
    return Decision(SCATTERED, True, reason, rms * sample.greatest, SCATTERED_UNIT)


def sky_light(name: str, share: float, samples: tuple[int, int], rms: float) -> Decision:
    """Decision about the light of a panorama besides its sources; ``share`` of all its light."""
    azimuths, elevations = samples
    reason = (
        f"{name}: {100.0 * share:.2f} % of its light comes from the sky, sampled in {azimuths} azimuths and "
        f"{elevations} elevations, each with the shadow of the terrain; measured rms on natural terrain"
    )
    return Decision("sky light", True, reason, rms, "share of the sky's mean radiance")


def sun_over_sky(environment: Environment) -> Decision:
    """Decision about the strength of a panorama's strongest source."""
    scaled, reason = environment.ratio.scaled, environment.ratio.reason
    name, unit = environment.panorama.name, "ratio on a horizontal plane"
    return Decision("Sun over sky", scaled, f"{name}: {reason}", None, unit)


BACKGROUND_PX = 2.0
"""Size of a background's pixel, in pixels of the camera, above which the background looks blurred."""


def background(name: str, pixel_px: float) -> Decision:
    """Decision about the resolution of the picture behind the terrain: ``pixel_px``, the width of its
    pixel at the middle of the camera's image, in pixels of the camera.
    """
    told = f"a pixel of {name} is {pixel_px:.3g} pixels of the camera wide"
    if pixel_px > BACKGROUND_PX:
        told += "; a sharper picture from the same place helps"
    return Decision("background", True, told, pixel_px, "camera pixels")


def several_sources(count: int, rays: RayMethod) -> Decision:
    """Decision about the sources besides the first; their shadows are modelled for any relief."""
    reason = (
        f"{count} more sources, each with its own shadows ({rays.method}); the bands of angles are "
        "those of the first source"
    )
    return Decision("other sources", True, reason, rays.node_error, "share of nodes, each")


def albedo(
    brightness: AlbedoMap | ColourMap | None = None, cover: AlbedoCover | None = None
) -> Decision:
    """Decision about an albedo map, by what it covers of an area; its own error is not known."""
    effect, unit = "albedo", "radiance factor"
    if brightness is None or cover is None:
        return Decision(effect, False, "one albedo for the whole area", None, unit)
    if cover.share == 0.0:
        reason = f"{brightness.name} does not cover the area: the factor is 1"
        return Decision(effect, False, reason, None, unit)
    colour, of, luminance = "", "", ""
    if isinstance(brightness, ColourMap):
        colour, of, luminance = ", red, green and blue", " of luminance", " luminance"
    mean = f", its mean{luminance}" if brightness.reference_is_mean else ""
    reason = (
        f"{brightness.name}{colour}, {brightness.encoding}, over {brightness.reference:.4g}{mean}: "
        f"factors{of} of {cover.lowest:.3g} to {cover.highest:.3g}; without the map the error would be their "
        f"contrast over the area, {cover.contrast:.3g} (standard deviation over mean)"
    )
    if cover.share < 1.0:
        reason += f"; {100.0 * (1.0 - cover.share):.2f} % of the area lies outside the map and has the factor 1"
    return Decision(effect, True, reason, None, unit)


def _degrees(tangent: float) -> str:
    return f"{math.degrees(math.atan(tangent)):.3f} deg"


def _small(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.3g} deg"
