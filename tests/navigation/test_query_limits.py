"""What a query may ask: limits hold for Python as for the command line."""

from __future__ import annotations

import math

import pytest

from lcp_catalog.errors import ConfigError
from lcp_catalog.navigation.expected_position import Query


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("most", 0),
        ("attitude_sigma_rad", -0.1),
        ("height_sigma_m", -1.0),
        ("map_sigma_m", math.nan),
        ("pixel_sigma_px", -1.0),
    ],
)
def test_values_out_of_range_are_refused(field: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"`{field}` must be"):
        Query(**{field: value})


def test_an_exact_and_an_unknown_attitude_are_allowed() -> None:
    assert Query(attitude_sigma_rad=0.0).most is None
    assert Query(attitude_sigma_rad=math.inf, most=1).most == 1
