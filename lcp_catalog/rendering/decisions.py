"""One function an effect: whether it is modelled, why, and what that costs. Renders and builds ask
the same ones; a build, which has no terrain yet, knows no relief (``None``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..accuracy import Accuracy
from ..atomic_files import file_facts
from ..constants import ASTRONOMICAL_UNIT_M, LOWEST_M, MOON_RADIUS_M, SOLAR_RADIUS_RAD
from ..photometry.albedo_map import AlbedoMap, Cover
from ..photometry.law_choice import Choice
from ..terrain.far_terrain import FarTerrain
from ..terrain.relief_bounds import Relief, Ring, Steepness
from ..terrain.surroundings import CELL_SHARE, HORIZON_RMS_DEG, NEAR_NODES
from .error_bounds import NORMAL_ROUNDING_RAD, PENUMBRA_PX, horizon_beyond_rad
from .sphere_error_bounds import SHIFT_PX, SphereCost


@dataclass(frozen=True)
class Decision:
    """What was decided about an effect; ``error_bound`` is None where nothing bounds it here."""

    effect: str
    modelled: bool
    reason: str
    error_bound: float | None
    unit: str


@dataclass(frozen=True)
class Rays:
    """How rays are followed in words, and the share of nodes that may be wrong."""

    method: str
    node_error: float = 0.0

    @classmethod
    def of(cls, accuracy: Accuracy) -> Rays:
        """Parallel rays in a tier."""
        return cls(f"{accuracy.tier}: {accuracy.shadow_method}", accuracy.node_error)


EVERY_PIXEL = Rays("a ray from every pixel's hit")
EVERY_NODE = Rays("a segment from every node to the camera")


def hiding(effect: str, what: str, tangent: float, slope: Steepness | None, rays: Rays) -> Decision:
    """Cast shadows or occlusion under rays that climb with a tangent at least. On a connected
    surface nothing rises above a ray that is steeper than the steepest facet.
    """
    above = f"{what} of {_degrees(tangent)}"
    unit = "share of nodes"
    if slope is None:
        reason = f"whatever the relief; {above}; {rays.method}"
        return Decision(effect, True, reason, rays.node_error, unit)
    steepest = f"the steepest facet, {_degrees(slope.tangent)},"
    if slope.clears(tangent):
        reason = f"{steepest} is below {above}: nothing can come between"
        return Decision(effect, False, reason, 0.0, unit)
    if slope.connected:
        reason = f"{steepest} reaches {above}; {rays.method}"
    else:
        reason = f"some nodes have no height, so that steps beside them are not known; {above}"
        reason += f"; {rays.method}"
    return Decision(effect, True, reason, rays.node_error, unit)


def straight_down() -> Decision:
    """Occlusion where all is seen from the zenith."""
    reason = "seen from straight above: a heightfield hides nothing of itself"
    return Decision("occlusion", False, reason, 0.0, "share of nodes")


def solar_disc(
    asked: bool, slope: Steepness | None, limb: float, width_px: float, accuracy: Accuracy
) -> Decision:
    """The Sun's disc, or a point in its middle. ``limb``: tangent of the lower limb's elevation;
    ``width_px``: of the widest penumbra on level ground (`scene_bounds.penumbra_px`).

    A node's share differs from a point Sun's 0 or 1 only where the disc is cut by its horizon.
    """
    effect, unit = "solar disc", "share of the disc"
    if slope is not None and slope.clears(limb):
        reason = (
            f"the steepest facet, {_degrees(slope.tangent)}, is below the Sun's lower limb, "
            f"{_degrees(limb)}: the terrain hides no part of the disc"
        )
        return Decision(effect, False, reason, 0.0, unit)
    widest = f"penumbras are up to {width_px:.3g} pixels wide on level ground"
    if math.isinf(width_px):
        widest = "penumbras have no widest one under this Sun"
    if slope is None:
        widest = "how wide penumbras are depends on each area's relief"
    exact = f"nodes whose horizon is over {math.degrees(SOLAR_RADIUS_RAD):.3f} deg from the Sun's"
    exact += " middle are exact"
    if not asked:
        return Decision(effect, False, f"a point Sun; {widest}; {exact}", 1.0, unit)
    if width_px <= _penumbra_limit(accuracy):
        reason = f"{widest}, below {PENUMBRA_PX}; {exact}"
        return Decision(effect, False, reason, 1.0, unit)
    reason = f"{widest}; {accuracy.tier}: the error is rms over all nodes, measured"
    return Decision(effect, True, reason, accuracy.disc_rms, unit)


def _penumbra_limit(accuracy: Accuracy) -> float:
    return 0.0 if accuracy.exact else PENUMBRA_PX


PERSPECTIVE, PERSPECTIVE_UNIT = "perspective", "share of the radiance factor; rad of the angles"


def perspective_of_infinity() -> Decision:
    """A view from infinity has parallel rays."""
    reason = "the view is at infinity: its rays are parallel"
    return Decision(PERSPECTIVE, False, reason, 0.0, PERSPECTIVE_UNIT)


def perspective_of_pixels() -> Decision:
    """In the camera's plane every pixel has its own ray."""
    return Decision(PERSPECTIVE, True, "a ray a pixel", 0.0, PERSPECTIVE_UNIT)


def perspective_of_nodes() -> Decision:
    """A sensor that moves while it looks sees every node from its own direction."""
    return Decision(PERSPECTIVE, True, "a direction a node", 0.0, PERSPECTIVE_UNIT)


def perspective(angle_rad: float, error: float, accuracy: Accuracy) -> Decision:
    """For a camera at a finite position: one direction for all nodes where that costs no more than
    the tolerance (`scene_bounds.ray_angle_rad`, `parallel_error`).
    """
    turned = f"directions to the camera differ from the middle's by up to {_small(angle_rad)}"
    if error <= accuracy.tolerance and accuracy.tolerance > 0.0:
        reason = f"{turned}, and no slope can hide under any: within {accuracy.tolerance:g}"
        return Decision(PERSPECTIVE, False, reason, error, PERSPECTIVE_UNIT)
    if math.isinf(error):
        reason = f"{turned}, and slopes may hide under some of them"
    else:
        reason = f"{turned}: parallel rays would cost up to {error:.2g}"
    return Decision(PERSPECTIVE, True, reason, 0.0, PERSPECTIVE_UNIT)


def perspective_of_patches(angle_rad: float) -> Decision:
    """In a build each view is a bundle of parallel rays."""
    reason = "each view is a bundle of parallel rays to the camera from the point"
    if angle_rad > 0.0:
        reason += f"; over a patch their directions would vary by up to {_small(angle_rad)}"
    return Decision(PERSPECTIVE, False, reason, angle_rad, "rad of the angles")


def surface(
    relief: Relief | None,
    least_view_tangent: float,
    away_m: float,
    plain: SphereCost | None = None,
    accuracy: Accuracy | None = None,
) -> Decision:
    """The sphere or the heightfield; ``away_m``: from the frame's origin to the farthest node.
    ``plain``: what the sphere costs where nothing can be hidden, None: not looked at.
    """
    unit = "share of the radiance factor; rad of the angles"
    if plain is not None:
        cost = (
            f"the plain sphere turns normals by up to {_small(plain.tilt_rad)}, changes the radiance "
            f"factor by up to {plain.radiance:.2g} and shifts ground by up to {plain.shift_px:.2g} "
            "pixels"
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
            f"; the plain sphere would turn normals by up to {tilt:.3g} deg and shift ground by up "
            f"to {shift:.3g} pixels"
        )
    return Decision("relief", True, reason, 0.0, unit)


def float_width() -> Decision:
    """float64 or float32."""
    reason = (
        "rays, cosines and azimuths float64, normals kept in float32; what parallel light and a "
        "parallel view make bright is summed up in float32 (not in reference), within 2e-6 of itself, "
        "which halves the time of a render (measured)"
    )
    return Decision("float width", True, reason, NORMAL_ROUNDING_RAD, "rad of a normal")


REFLECTANCE, REFLECTANCE_UNIT = "reflectance", "share of the mean signal"


def reflectance(choice: Choice) -> Decision:
    """Which law of reflection, and how far it is from Hapke's."""
    reason = choice.reason
    if choice.model.file is not None:  # the result names the file's content, not its folder
        (facts,) = file_facts([choice.model.file])
        reason += f"; read from {facts['name']}, sha256 {facts['sha256']}"
    return Decision(REFLECTANCE, True, reason, choice.own.left_over, REFLECTANCE_UNIT)


def reflectance_as_asked(model: str) -> Decision:
    """A law that nobody compared with another."""
    reason = f"{model}, as asked; models are different assumptions, none approximates another"
    return Decision(REFLECTANCE, True, reason, None, REFLECTANCE_UNIT)


def far_terrain(
    ring_m: float, needed_m: float, ring: Ring, far: FarTerrain, gsd_m: float, horizon_rad: float
) -> Decision:
    """Terrain around an area on its own cells, and beyond on nested coarser ones; ``horizon_rad``:
    what ground that is not there could rise to.
    """
    finest_m, coarsest_m = far.cells_m
    reason = (
        f"terrain up to {ring_m / 1e3:.1f} km beyond the area is on the area's own cells of {gsd_m:g} m, "
        f"from there to {needed_m / 1e3:.0f} km on cells of {finest_m:g} to {coarsest_m:g} m, never "
        f"wider than {CELL_SHARE:.3f} of their distance: its horizon is off by {HORIZON_RMS_DEG} deg "
        "(rms, measured on lunar relief)"
    )
    bound = HORIZON_RMS_DEG
    if horizon_rad > 0.0:
        bound = max(bound, math.degrees(horizon_rad))
        missing = max(ring.missing, far.missing)
        nearest_m = min(ring.gap_m, far.gap_m)
        if missing > 0:
            reason += (
                f"; {missing:.1%} of it has no height in the DEM, the nearest "
                f"{nearest_m / 1e3:.1f} km off, and hides nothing"
            )
        reason += f"; no ground of the Moon that is left out rises over {bound:.2f} deg"
    return Decision("terrain beyond the area", True, reason, bound, "deg of the horizon")


def near_terrain(
    ring_m: float, needed_m: float, ring: Ring, gsd_m: float, horizon_rad: float
) -> Decision:
    """The ring of terrain around an area; ``horizon_rad``: what ground beyond it, or in its gaps,
    could rise to (`scene_bounds.horizon_beyond_rad`).
    """
    reason = (
        f"terrain up to {ring_m / 1e3:.1f} km beyond the area, on the area's own cells of "
        f"{gsd_m:g} m, can shadow or hide it"
    )
    if needed_m > ring_m:
        reason += f"; {needed_m / 1e3:.1f} km would be needed: capped"
    if ring.missing > 0:
        reason += (
            f"; {ring.missing:.1%} of that ring has no height in the DEM, the nearest "
            f"{ring.gap_m / 1e3:.1f} km off, and hides nothing"
        )
    bound = 0.0
    if needed_m > ring_m or ring.missing > 0:
        bound = math.degrees(horizon_rad)
        reason += f"; no ground of the Moon rises over {bound:.2f} deg from there: a Sun or camera"
        reason += " above that misses nothing"
    return Decision("terrain beyond the area", True, reason, bound, "deg of the horizon")


def ring_of_build(lowest_sun_deg: float, cap_m: float) -> Decision:
    """The rings of a build's areas, before any is looked at."""
    bound = math.degrees(horizon_beyond_rad(cap_m, LOWEST_M, cap_m))
    reason = (
        f"as far as relief reaches under the lowest Sun ({lowest_sun_deg:g} deg), at most "
        f"{cap_m / 1e3:g} km: on the area's own cells for {NEAR_NODES} of them, then on cells never "
        f"wider than {CELL_SHARE:.3f} of their distance, whose horizon is off by {HORIZON_RMS_DEG} deg "
        f"(rms, measured on lunar relief); no ground of the Moon rises over {bound:.2f} deg from "
        "beyond the cap; what the DEM lacks nearer than that hides nothing"
    )
    bound = HORIZON_RMS_DEG if bound < lowest_sun_deg else bound
    return Decision("terrain beyond the area", True, reason, bound, "deg of the horizon")


def always(half_m: float) -> tuple[Decision, ...]:
    """What no scene decides; ``half_m``: from an area's middle to its corners."""
    parallax = math.degrees(half_m / ASTRONOMICAL_UNIT_M)
    unit = "radiance factor"
    return (
        Decision("curvature", True, "heights are ENU z of the area's frame", 0.0, "m"),
        Decision("parallax of the Sun", False, "one direction for the whole area", parallax, "deg"),
        Decision("scattered light", False, "what the Sun does not reach is black", None, unit),
    )


def sky_light(name: str, share: float, samples: tuple[int, int], rms: float) -> Decision:
    """What a panorama gives besides its sources; ``share`` of all its light."""
    azimuths, elevations = samples
    reason = (
        f"{name}: {share:.2%} of its light comes from its sky, as {elevations} directions in each of "
        f"{azimuths} azimuths, each with the terrain's own shadow; rms over natural terrain, measured"
    )
    return Decision("sky light", True, reason, rms, "share of the sky's mean radiance")


def several_sources(count: int, rays: Rays) -> Decision:
    """Sources besides the first; their rays are followed whatever the relief."""
    reason = f"{count} more light the scene, each with its own shadows ({rays.method}); bands of angles are the first one's"
    return Decision("other sources", True, reason, rays.node_error, "share of nodes, each")


def albedo(brightness: AlbedoMap | None = None, cover: Cover | None = None) -> Decision:
    """A map of the ground's brightness, and what of an area it covers; nothing bounds its own
    error here.
    """
    effect, unit = "albedo", "radiance factor"
    if brightness is None or cover is None:
        return Decision(effect, False, "one albedo for the whole area", None, unit)
    mean = ", its mean" if brightness.reference_is_mean else ""
    reason = (
        f"{brightness.name}, {brightness.encoding}, over {brightness.reference:.4g}{mean}: factors "
        f"of {cover.lowest:.3g} to {cover.highest:.3g}; leaving it out would cost their contrast "
        f"over the area, {cover.contrast:.3g} (standard deviation over mean)"
    )
    if cover.share < 1.0:
        reason += f"; {1.0 - cover.share:.2%} of the area lies outside the map and has the factor 1"
    return Decision(effect, True, reason, None, unit)


def _degrees(tangent: float) -> str:
    return f"{math.degrees(math.atan(tangent)):.3f} deg"


def _small(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.3g} deg"
