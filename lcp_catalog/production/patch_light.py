"""The patches of candidates in a heightfield: what terrain outside a patch shadows and hides of it, and the contrast
of its albedo.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..accuracy import TIERS
from ..arrays import Array, Bytes, Float32, Index, Mask
from ..geometry.frames import EnuFrame, mcmf_to_lonlat
from ..landmarks.error_model import local_contrast
from ..landmarks.patches import patches_of
from ..stages import timed
from .config import BuildConfig
from .sweep import Sweep

OWN_SUN_DOUBT = 0.5, 2.0
"""Dependence on shadows, as multiples of its limit, between which it is computed again under a point's own Sun. On the sample at 4
and 5 deg of Sun 2.8 and 1.1 % of the flags are others there, all of them between (356 conditions, 991ccae, 2026-11-27)."""


@dataclass(frozen=True)
class PatchLight:
    """The candidates' windows in the heightfield of a sweep, around nodes (rows, cols) of its core, and
    their dependence on terrain outside.
    """

    sweep: Sweep
    rows: Index
    cols: Index
    half: int
    limit: float = 0.0  # of the dependence
    own_sun_deg: float = 0.0

    @classmethod
    def of(cls, sweep: Sweep, rows: Index, cols: Index, config: BuildConfig) -> PatchLight:
        """The patches of a configuration."""
        points, own = config.points, config.model.precision.own_sun_deg
        return cls(sweep, rows, cols, points.half, points.max_dependence, own)

    @cached_property
    def contrast(self) -> Array:
        """Local contrast of the candidates' albedo (n,); NaN without a map."""
        bright = self.sweep.brightness
        if bright is None:
            return np.full(len(self.rows), np.nan)
        some = np.zeros(len(self.rows), np.int64)
        return local_contrast(patches_of(bright[None], some, self.rows, self.cols, self.half))

    @property
    def turn_deg(self) -> float:
        """Azimuth of the points' north in the area's frame."""
        return float(np.degrees(self.sweep.turn_rad))

    def shadow_dependence(self, elevation: int, azimuth: int) -> tuple[Float32, Mask]:
        """Share of each patch's nodes that only terrain outside the patch shadows, (n,), and these
        nodes, (n, p, p).
        """
        sun = self.sweep.sun_directions[elevation, azimuth]
        before = int(self.sweep.conditions.reachable[:elevation, azimuth].sum())
        share, cast = self._dependence(sun, self.sweep.dark(azimuth)[before])
        low = self.sweep.conditions.sun_elevation_deg[elevation] <= self.own_sun_deg
        if low and self.sweep.plan.cast_shadows.modelled:
            below, above = (factor * self.limit for factor in OWN_SUN_DOUBT)
            for k in np.flatnonzero((share >= below) & (share <= above)).tolist():
                share[k] = self._under_own_sun(k, elevation, azimuth)
        return share, cast

    @timed("one direction per area", is_stage=False)
    def _under_own_sun(self, k: int, elevation: int, azimuth: int) -> float:
        """`shadow_dependence` of one patch under its own Sun, every node traced."""
        sweep, half, (top, _, left, _) = self.sweep, self.half, self.sweep.window
        row, col = int(self.rows[k]), int(self.cols[k])
        node = sweep.field.nodes_m(self.rows[k : k + 1] + top, self.cols[k : k + 1] + left)[0]
        lon, lat, _ = mcmf_to_lonlat(sweep.terrain.frame.to_mcmf(node))
        own = EnuFrame(float(lon), float(lat)).direction_to_mcmf(
            sweep.conditions.sun_directions()[elevation, azimuth]
        )
        sun = sweep.terrain.frame.direction_from_mcmf(own)
        part = np.s_[row - half : row + half + 1, col - half : col + half + 1]
        window = (top + row - half, top + row + half + 1, left + col - half, left + col + half + 1)
        dark = sweep.field.occluded_nodes(sun, window)
        if sweep.far is not None:
            sweep.far.shadowed(sweep.field, sun, TIERS["reference"], window, dark)
        planes = np.ascontiguousarray(sweep.planes[:, *part])
        middle = np.array([half])
        cast = sweep.field.shadowed_from_outside(
            dark.view(np.uint8)[None], planes, window, (middle, middle), half, sun[None]
        )
        return float(cast.mean())

    def occlusion_dependence(self, view: int) -> Float32:
        """Share of each patch's nodes that only terrain outside the patch hides from the camera."""
        camera, hidden = self.sweep.camera_m(view), self.sweep.unseen(view)
        if camera is None:
            return self._dependence(self.sweep.view_directions[view], hidden.view(np.uint8))[0]
        centres = zip(self.rows.tolist(), self.cols.tolist(), strict=True)
        return np.array([self._hidden_from(view, camera, r, c) for r, c in centres], np.float32)

    @timed("dependence", is_stage=False)
    def _hidden_from(self, view: int, camera: Array, row: int, col: int) -> float:
        """Share of the nodes of one patch that face a near camera (ENU, (3,)), and that only terrain
        outside the patch hides from it.
        """
        sweep, half = self.sweep, self.half
        part = np.s_[row - half : row + half + 1, col - half : col + half + 1]
        towards = sweep.towards_camera(view)
        assert towards is not None
        faces = np.sum(sweep.planes[:, *part] * towards[:, *part], axis=0) > 0.0
        top, left = sweep.window[0] + row - half, sweep.window[2] + col - half
        alone = sweep.field.part((top, top + 2 * half + 1, left, left + 2 * half + 1))
        cast = sweep.unseen(view)[part] & faces & ~alone.occluded_nodes_from(camera)
        return float(cast.mean())

    @timed("dependence", is_stage=False)
    def _dependence(self, direction: Array, dark: Bytes) -> tuple[Float32, Mask]:
        sweep = self.sweep
        cast = sweep.field.shadowed_from_outside(
            dark[None],
            sweep.planes,
            sweep.window,
            (self.rows, self.cols),
            self.half,
            direction[None],
        )[0]
        return cast.mean(axis=(1, 2)).astype(np.float32), cast
