"""Frames of exports against SPICE's own frame kernels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import spiceypy

from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.errors import ConfigError
from lcp_catalog.exports.frames import frame_named

KERNEL = """KPL/FK
\\begindata
FRAME_MOON_PA_DE440 = 31008
FRAME_31008_NAME = 'MOON_PA_DE440'
FRAME_31008_CLASS = 2
FRAME_31008_CLASS_ID = 31008
FRAME_31008_CENTER = 301
FRAME_MOON_ME_DE440_ME421 = 31009
FRAME_31009_NAME = 'MOON_ME_DE440_ME421'
FRAME_31009_CLASS = 4
FRAME_31009_CLASS_ID = 31009
FRAME_31009_CENTER = 301
TKFRAME_31009_SPEC = 'ANGLES'
TKFRAME_31009_RELATIVE = 'MOON_PA_DE440'
TKFRAME_31009_ANGLES = ( 67.8526 78.6944 0.2785 )
TKFRAME_31009_AXES = ( 3, 2, 1 )
TKFRAME_31009_UNITS = 'ARCSECONDS'
\\begintext
"""
"""The definitions of NAIF's moon_de440_250416.tf."""


def test_spice_turns_positions_as_we_do(tmp_path: Path) -> None:
    (tmp_path / "moon.tf").write_text(KERNEL, encoding="ascii")
    spiceypy.furnsh(str(tmp_path / "moon.tf"))
    try:
        expected = spiceypy.pxform("MOON_ME_DE440_ME421", "MOON_PA_DE440", 0.0)
    finally:
        spiceypy.unload(str(tmp_path / "moon.tf"))
    np.testing.assert_allclose(frame_named("MOON_PA").from_me, expected, rtol=0, atol=1e-15)


def test_the_earth_of_naifs_example() -> None:
    """The example in moon_080317.tf, kilometres; its angles, those of DE421, differ from DE440's by
    0.15 arcseconds (0.3 km at the Earth; a wrong sign would be 250 km).
    """
    mean_earth = np.array([379892.825, 33510.118, -12661.5278])
    principal = np.array([379908.634, 33385.003, -12516.8859])
    turned = frame_named("MOON_PA").from_me @ mean_earth
    assert np.linalg.norm(turned - principal) < 0.35


def test_places_move_by_875_m_at_most() -> None:
    turn = frame_named("MOON_PA").from_me
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
    moved = np.linalg.svd(turn - np.eye(3))[1][0] * MOON_RADIUS_M
    assert moved == pytest.approx(875.0, abs=1.0)
    np.testing.assert_array_equal(frame_named("MOON_ME").from_me, np.eye(3))


def test_another_frame_is_refused() -> None:
    with pytest.raises(ConfigError, match="'IAU_MOON' is not known; choose MOON_ME or MOON_PA"):
        frame_named("IAU_MOON")
