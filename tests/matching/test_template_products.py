"""Products of a template with windows of an image, against SciPy in double precision."""

import numpy as np
import pytest
from scipy.signal import correlate2d

from lcp_catalog.kernels.matching import template_products as products


def given(p, rows, cols, seed=0):
    """A template (p, p) and an image."""
    rng = np.random.default_rng(seed)
    return (rng.normal(size=shape).astype(np.float32) for shape in ((p, p), (rows, cols)))


def padded(template):
    """The template in its place among zeros."""
    p = len(template)
    out = products.place_for(p)
    out.reshape(p + 4, -1)[2:-2, :p] = template
    return out


def everywhere(template, image):
    return correlate2d(image.astype(np.float64), template.astype(np.float64), mode="valid")


@pytest.mark.slow
@pytest.mark.parametrize("p", [3, 8, 9, 16, 33])
@pytest.mark.parametrize(
    ("ny", "nx"), [(1, 1), (2, 8), (4, 9), (5, 16), (7, 17), (33, 25), (9, 40)]
)
def test_at_all_places(p, ny, nx):
    rows, cols, high, long = products.extent(p, ny, nx)
    template, image = given(p, rows, cols)
    image[:, nx + p - 1 :] = 0.0  # zeros behind, as the callers have them
    out = np.full((high, long), np.nan, np.float32)
    products.at_all(padded(template), p, image.ravel(), ny, nx, out.ravel())
    expected = everywhere(template, image)[:ny, :nx]
    np.testing.assert_allclose(out[:ny, :nx], expected, rtol=0.0, atol=2e-6 * p * p)


@pytest.mark.parametrize("p", [3, 8, 9, 16, 33])
def test_at_nine_and_eight_places(p):
    wide = products.row_length(p) + 5
    template, image = given(p, p + 6, wide)
    expected, flat = everywhere(template, image), image.ravel()
    nine, eight = np.empty(9, np.float32), np.empty(8, np.float32)
    products.at_nine(padded(template), p, flat, wide, 2 * wide + 1, nine)
    np.testing.assert_allclose(nine.reshape(3, 3), expected[2:5, 1:4], atol=2e-6 * p * p)
    places = [(0, 0), (3, 1), (1, 5), (5, 2), (6, 4), (2, 2), (3, 1), (0, 5)]
    starts = np.array([row * wide + col for row, col in places])
    products.at_eight(padded(template), p, flat, wide, starts, eight)
    np.testing.assert_allclose(eight, [expected[at] for at in places], atol=2e-6 * p * p)
