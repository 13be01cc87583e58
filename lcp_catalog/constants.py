"""Figures that several rooms share; the unit is in the name."""

import math

MOON_RADIUS_M = 1_737_400.0
"""Reference sphere of every LOLA and LROC product, and of the IAU_2015 Moon."""

LOWEST_M, HIGHEST_M = -9.2e3, 11e3
"""No ground of the Moon stands lower (-9.13 km, LOLA) or higher (10.786 km) over the reference sphere."""

FRAME = "MOON_ME"
"""Moon-fixed mean-Earth/polar-axis frame (DE421); differs from IAU_MOON by up to 155 m on the ground."""

SUBSOLAR_LATITUDE_MAX_DEG = 1.59
"""The subsolar point never leaves +-1.59 deg of latitude (facts.md; DE421, 1990-2050)."""

SOLAR_RADIUS_RAD = math.radians(0.2666)
"""Mean angular radius of the solar disc seen from the Moon (696 000 km at 1 au)."""

ASTRONOMICAL_UNIT_M = 149_597_870_700.0
