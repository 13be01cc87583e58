"""Constants that several sub-packages share; the unit is part of the name."""

import math

MOON_RADIUS_M = 1_737_400.0
"""Radius of the reference sphere of all LOLA and LROC products, and of the IAU_2015 Moon."""

LOWEST_M, HIGHEST_M = -9.2e3, 11e3
"""Bounds of all heights above the reference sphere: the lowest place is at -9.13 km (LOLA), the
highest at 10.786 km.
"""

FRAME = "MOON_ME"
"""Moon-fixed mean-Earth/polar-axis frame (DE421); it differs from IAU_MOON by up to 155 m on the
surface.
"""

SUBSOLAR_LATITUDE_MAX_DEG = 1.59
"""Greatest absolute latitude of the subsolar point (DE421, 1990-2050)."""

SOLAR_RADIUS_RAD = math.radians(0.2666)
"""Mean angular radius of the solar disc seen from the Moon (696 000 km at 1 au)."""

ASTRONOMICAL_UNIT_M = 149_597_870_700.0

SIGMA_PER_FWHM = 1.0 / math.sqrt(8.0 * math.log(2.0))
"""Standard deviation of a Gaussian of full width 1 at half maximum."""
