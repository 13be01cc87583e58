"""Special codes, compared with the table of ISIS; plateaus, compared with clipped histograms."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.images.pixels import isis_special, plateau_ends, touching_edge

# ISIS, SpecialPixel.h: NULL, LRS, LIS, HIS, HRS, first and last valid value of each type
ISIS = {
    "int16": (-32768, -32767, -32766, -32765, -32764, -32752, 32767),
    "uint16": (0, 1, 2, 65534, 65535, 3, 65522),
    "int32": (
        -(2**31),
        -(2**31) + 1,
        -(2**31) + 2,
        -(2**31) + 3,
        -(2**31) + 4,
        -(2**31) + 16,
        2**31 - 1,
    ),
    "uint32": (0, 1, 2, 2**32 - 2, 2**32 - 1, 3, 2**32 - 14),
}


@pytest.mark.parametrize("kind", ISIS)
def test_codes_of_integers(kind: str) -> None:
    samples = np.array(ISIS[kind], dtype=kind)[None]
    found = isis_special(samples)
    assert found.missing[0].tolist() == [True] + 6 * [False]
    assert found.low[0].tolist() == [False, True, True] + 4 * [False]
    assert found.high[0].tolist() == 3 * [False] + [True, True] + 2 * [False]


def test_bytes_have_one_low_code_which_is_null() -> None:
    found = isis_special(np.array([[0, 1, 254, 255]], dtype=np.uint8))
    assert found.missing[0].tolist() == [True, False, False, False]
    assert not found.low.any()
    assert found.high[0].tolist() == [False, False, False, True]


def test_reserved_codes_are_missing() -> None:
    found = isis_special(np.array([[-32763, -32753, -32752]], dtype=np.int16))
    assert found.missing[0].tolist() == [True, True, False]
    assert isis_special(np.array([[65523, 65533]], dtype=np.uint16)).missing.all()


@pytest.mark.parametrize(
    ("kind", "first"), [("float32", 0xFF7FFFFB), ("float64", 0xFFEFFFFFFFFFFFFB)]
)
def test_codes_of_floats(kind: str, first: int) -> None:
    """Bit patterns as ISIS prints them, and a large negative number that is not special."""
    unsigned, real = ("<I", "<f") if kind == "float32" else ("<Q", "<d")
    codes = [struct.unpack(real, struct.pack(unsigned, first + i))[0] for i in range(5)]
    samples = np.array([[*codes, -1e38, 0.0, np.nan, np.inf]], dtype=kind)
    found = isis_special(samples)
    assert found.missing[0].tolist() == [True, *6 * [False], True, True]
    assert found.low[0].tolist() == [False, True, True, *6 * [False]]
    assert found.high[0].tolist() == [*3 * [False], True, True, *4 * [False]]


def test_other_types_have_no_special_codes() -> None:
    found = isis_special(np.array([[-128, 0, 127]], dtype=np.int8))
    assert not np.stack([found.missing, found.low, found.high]).any()


# -- plateaus


def bell(rng: np.random.Generator, mean: float, sigma: float = 30.0) -> np.ndarray:
    return rng.normal(mean, sigma, (120, 130))


@given(seed=st.integers(0, 2**32 - 1))
def test_a_bell_within_its_scale_has_no_plateau(seed: int) -> None:
    values = bell(np.random.default_rng(seed), 128.0, 20.0)
    assert plateau_ends(values, np.ones(values.shape, bool)) == (None, None)
    codes = np.round(values).astype(np.uint8)
    assert plateau_ends(codes, np.ones(codes.shape, bool)) == (None, None)


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.01, 0.6), as_codes=st.booleans())
def test_clipping_at_the_top_is_a_plateau(seed: int, share: float, as_codes: bool) -> None:
    values = bell(np.random.default_rng(seed), 128.0)
    top = float(np.floor(np.quantile(values, 1.0 - share)))
    clipped = np.minimum(values, top)
    clipped = np.clip(np.round(clipped), 1, 255).astype(np.uint8) if as_codes else clipped
    low, high = plateau_ends(clipped, np.ones(clipped.shape, bool))
    assert (low, high) == (None, top)


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.01, 0.6))
def test_both_ends_are_alike(seed: int, share: float) -> None:
    """For negated samples the results of both ends are exchanged."""
    values = np.clip(bell(np.random.default_rng(seed), 0.0), None, 30.0 * share)
    there = np.ones(values.shape, bool)
    low, high = plateau_ends(values, there)
    assert plateau_ends(-values, there) == (
        None if high is None else -high,
        None if low is None else -low,
    )


def test_only_valid_samples_count() -> None:
    values = bell(np.random.default_rng(0), 100.0)
    there = np.ones(values.shape, bool)
    values[:40] = 1e6
    there[:40] = False
    assert plateau_ends(values, there) == (None, None)
    assert plateau_ends(values, np.ones(values.shape, bool)) == (None, 1e6)


def test_few_of_one_value_are_chance() -> None:
    values = bell(np.random.default_rng(0), 100.0)
    there = np.ones(values.shape, bool)
    values.flat[:7] = 1e3
    assert plateau_ends(values, there) == (None, None)
    values.flat[:8] = 1e3
    assert plateau_ends(values, there) == (None, 1e3)


def test_nothing_and_one_value_have_no_ends() -> None:
    one = np.full((4, 4), 7, np.uint8)
    assert plateau_ends(one, np.ones((4, 4), bool)) == (None, None)
    assert plateau_ends(one, np.zeros((4, 4), bool)) == (None, None)


def test_two_values_are_no_plateau() -> None:
    """Black and white drawings are not clipped."""
    two = np.random.default_rng(0).integers(0, 2, (40, 40)).astype(np.uint8)
    assert plateau_ends(two, np.ones(two.shape, bool)) == (None, None)


# -- parts that touch the edge


def flooded(mask: np.ndarray) -> np.ndarray:
    """Flood fill pixel by pixel."""
    rows, cols = mask.shape
    reached = np.zeros_like(mask)
    todo = [
        (r, c) for r in range(rows) for c in range(cols) if r in (0, rows - 1) or c in (0, cols - 1)
    ]
    while todo:
        r, c = todo.pop()
        if 0 <= r < rows and 0 <= c < cols and mask[r, c] and not reached[r, c]:
            reached[r, c] = True
            todo += [(r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)]
    return reached


@given(
    seed=st.integers(0, 2**32 - 1), density=st.floats(0.1, 0.9),
    shape=st.tuples(st.integers(1, 25), st.integers(1, 25)),
)  # fmt: skip
def test_touching_the_edge_is_a_flood_from_it(
    seed: int, density: float, shape: tuple[int, int]
) -> None:
    mask = np.random.default_rng(seed).random(shape) < density
    np.testing.assert_array_equal(touching_edge(mask), flooded(mask))


def test_a_spiral_is_followed_to_its_end() -> None:
    mask = np.zeros((21, 21), bool)
    r = c = 0
    for turn, length in enumerate([20, 20, 20, 18, 18, 16, 16, 14, 14, 12, 12]):
        dr, dc = [(0, 1), (1, 0), (0, -1), (-1, 0)][turn % 4]
        for _ in range(length):
            mask[r, c] = True
            r, c = r + dr, c + dc
    assert mask[2:19, 2:19].any()
    np.testing.assert_array_equal(touching_edge(mask), mask)
    np.testing.assert_array_equal(touching_edge(np.pad(mask, 1)), np.zeros((23, 23), bool))
