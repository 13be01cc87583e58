"""The fit of the error model, on residuals made of random fields with known statistics."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path
from statistics import NormalDist
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lcp_catalog.errors import ImageError
from lcp_catalog.landmarks.error_model import ErrorModel, PatchErrors
from lcp_catalog.landmarks.localization import registration
from lcp_catalog.landmarks.patches import through_optics
from lcp_catalog.validation import error_fit, run
from lcp_catalog.validation.claims import Claims
from lcp_catalog.validation.error_fit import (
    FEWEST,
    HEIGHT_LENGTHS,
    FittedErrors,
    Residuals,
    _with_places,
    fit_errors,
    fitted_by_kind,
    fitted_shift,
    residuals_of,
)
from lcp_catalog.validation.output import errors_files

PIXEL_M = 100.0
NODES = 25
FINE = 4
"""Steps of the random fields in a pixel, so that a pixel is a mean of its square."""

PERIOD = 192
"""Steps after which the fields repeat: opposite edges of a patch are four lengths of brightness apart."""

TRUE = ErrorModel(
    sensor_noise=0.05,
    height_sigma_m=8.0,
    height_length_m=200.0,
    albedo_sigma=0.1,
    albedo_length_m=600.0,
)
STATED = replace(
    TRUE, shadow_shift=0.11, moving_share=0.4, contrast_power=0.9, position_sigma_cells=0.3
)
"""A catalogue's model, whose part that displaces matches a fit uses."""
EAST, NORTH_EAST = (4.0, 0.0), (-2.0, 2.5)
"""Relative sensitivities to slopes east and south under two Suns."""


def field(dice: np.random.Generator, count: int, length_m: float) -> np.ndarray:
    """Gaussian fields (count, k, k) of variance 1 and autocorrelation exp(-r^2 / 2 l^2): white noise
    times the root of its spectrum, 2 pi l^2 exp(-(k l)^2 / 2), on steps of a quarter of a pixel. The
    fields are cut from periodic ones of `PERIOD` steps.
    """
    step = PIXEL_M / FINE
    ky, kx = (2.0 * np.pi * to(PERIOD, step) for to in (np.fft.fftfreq, np.fft.rfftfreq))
    power = 2.0 * np.pi * length_m**2 * np.exp(-0.5 * (ky[:, None] ** 2 + kx**2) * length_m**2)
    white = np.fft.rfft2(dice.normal(size=(count, PERIOD, PERIOD)))
    return np.fft.irfft2(white * np.sqrt(power) / step)[:, : NODES * FINE, : NODES * FINE]


def blocks(values: np.ndarray) -> np.ndarray:
    """Means over pixels."""
    return values.reshape(len(values), NODES, FINE, NODES, FINE).mean(axis=(2, 4))


@cache
def residuals(
    seed: int, sun: tuple[float, float], model: ErrorModel = TRUE, count: int = 40
) -> Residuals:
    """An image's residuals: the model's sources with sensitivities that vary smoothly by 30 %."""
    dice = np.random.default_rng(seed)
    height = field(dice, count, model.height_length_m) * model.height_sigma_m
    south_slope, east_slope = np.gradient(height, PIXEL_M / FINE, axis=(1, 2))
    ground = blocks(field(dice, count, model.albedo_length_m)) * model.albedo_sigma
    patches = 1.0 + 0.15 * blocks(field(dice, count, 250.0))
    changes = 1.0 + 0.3 * blocks(field(dice, count, 900.0))
    east, south = (side * changes for side in sun)
    noise = model.sensor_noise * dice.normal(size=patches.shape)
    whole = east * blocks(east_slope) + south * blocks(south_slope) + patches * ground + noise
    whole -= whole.mean(axis=(1, 2), keepdims=True)
    errors = PatchErrors(*(a.astype(np.float32) for a in (patches, east, south)))
    return Residuals(
        whole.astype(np.float32),
        np.ones(whole.shape, bool),
        patches.astype(np.float32),
        errors,
        np.zeros((count, 2)),
        PIXEL_M,
        dice.uniform(0.02, 0.2, count),
    )


@pytest.mark.slow
def test_known_errors_come_back_from_two_suns() -> None:
    """Lengths lie on a grid of steps of 18 and 41 %. A length between two steps moves some variance to
    the white noise; the limits are shares of the whole variance of the residuals.
    """
    samples = [residuals(1, EAST), residuals(2, NORTH_EAST)]
    found = fit_errors(samples, STATED)
    assert found.height_length_m == pytest.approx(TRUE.height_length_m, rel=0.2)
    assert found.albedo_length_m == pytest.approx(TRUE.albedo_length_m, rel=0.5)
    whole = float(np.mean([np.square(s.residual).mean() for s in samples]))
    for got, wanted in zip(parts(found, samples), parts(TRUE, samples), strict=True):
        assert got == pytest.approx(wanted, abs=0.1 * whole)
    assert found.spread < 0.2


def parts(model: ErrorModel, samples: list[Residuals]) -> tuple[float, float, float]:
    """Mean variances of a pixel by white noise, height errors and unmapped brightness; a pixel's mean
    widens the square of a length by a sixth of its side's square.
    """
    sides = np.mean([np.square(s.errors.east) + np.square(s.errors.south) for s in samples])
    level = np.mean([np.square(s.errors.level) for s in samples])
    wide = model.height_length_m**2 + PIXEL_M**2 / 6.0
    heights = (model.height_sigma_m * model.height_length_m / wide) ** 2 * float(sides)
    return model.sensor_noise**2, heights, model.albedo_sigma**2 * float(level)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("sensor_noise", ErrorModel(0.1, 0.0, 200.0, 0.0, 600.0)),
        ("height_sigma_m", ErrorModel(0.0, 10.0, 200.0, 0.0, 600.0)),
        ("albedo_sigma", ErrorModel(0.0, 0.0, 200.0, 0.1, 300.0)),
    ],
)
def test_a_single_source_is_told_from_the_others(name: str, model: ErrorModel) -> None:
    """Shares of the residual variance: at least four fifths go to the source that is there."""
    samples = [residuals(3, EAST, model), residuals(4, NORTH_EAST, model)]
    found = fit_errors(samples, STATED)
    assert getattr(found, name) == pytest.approx(getattr(model, name), rel=0.25)
    names = ("sensor_noise", "height_sigma_m", "albedo_sigma")
    shares = dict(zip(names, parts(found, samples), strict=True))
    assert shares[name] > 0.8 * sum(shares.values())


@pytest.mark.slow
def test_an_error_of_places_is_found() -> None:
    """40 m per axis, in addition to the errors of the matches themselves; and none."""
    for place_m in (40.0, 0.0):
        samples = [
            displaced(residuals(5, EAST), place_m),
            displaced(residuals(6, NORTH_EAST), place_m),
        ]
        found = fit_errors(samples, STATED)
        assert found.position_sigma_m == pytest.approx(place_m, rel=0.2, abs=12.0)
        stated = found.shadow_shift, found.moving_share, found.contrast_power
        assert stated == (0.11, 0.4, 0.9)  # the catalogue's: a fit leaves them alone
        assert found.position_sigma_cells == 0.0  # the error of place is fitted as a whole


@pytest.mark.slow
def test_the_spread_of_the_noise_is_not_an_error_of_places() -> None:
    """It is part of the matches' covariances, once."""
    wide = replace(STATED, spread=0.7)
    samples = [displaced(residuals(s, EAST), 40.0, wide) for s in range(8, 12)]
    assert _with_places(samples, wide).position_sigma_m == pytest.approx(40.0, rel=0.15)


def displaced(sample: Residuals, place_m: float, model: ErrorModel = STATED) -> Residuals:
    """Residuals with places as the matches' covariances and another error scatter them: those of patches through the
    optics without their border, and of the part of the noise that displaces a match.
    """
    dice = np.random.default_rng(7)
    inner = np.s_[:, 1:-1, 1:-1]
    seen, slopes = (
        through_optics(sample.patches, 1)[inner],
        (sample.errors.east, sample.errors.south),
    )
    match = registration(seen, PatchErrors(seen, *(s[inner] for s in slopes)), model, PIXEL_M)
    contrast = np.minimum(np.maximum(sample.contrast, 0.03), 0.15) / 0.06
    moved = model.moving_share * contrast ** (2.0 * model.contrast_power) * PIXEL_M**2
    covariance = moved[:, None, None] * match.covariance_px2 + place_m**2 * np.eye(2)
    errors = np.linalg.cholesky(covariance) @ dice.normal(size=(len(sample), 2, 1))
    return replace(sample, place_m=errors[..., 0])


@pytest.mark.parametrize("true", [0.4, -0.3])
def test_the_shift_is_that_of_the_trials(true: float) -> None:
    """2000 points, each found with its probability moved by probits; none changes what the catalogue states."""
    dice = np.random.default_rng(3)
    stated = dice.uniform(0.02, 0.98, 2000)
    moved = [NormalDist().cdf(NormalDist().inv_cdf(p) + true) for p in stated]
    claims = tried_claims(stated, dice.random(2000) < moved)
    assert fitted_shift(claims, 0.25) == pytest.approx(0.25 + true, abs=0.08)
    assert fitted_shift(Claims.none(), 0.25) == pytest.approx(0.25)


def tried_claims(probability: np.ndarray, found: np.ndarray) -> Claims:
    """Claims whose points were all tried."""
    tried = np.ones(len(found), bool)
    return replace(Claims.none(len(found)), probability=probability, tried=tried, found=found)


@pytest.mark.parametrize("alike", [0, 1])
def test_residuals_have_no_unit_of_brightness(alike: int, monkeypatch) -> None:
    """Codes of an image give the residuals that its radiances give, also where no patch resembles its render."""
    dice, none = np.random.default_rng(5), np.zeros((9, 9))
    light, render = (1.0 + 0.1 * dice.normal(size=(4, 9, 9)) for _ in range(2))
    valid, place, contrast = np.ones((9, 9), bool), np.full(2, np.nan), np.array(np.nan)
    catalog = SimpleNamespace(gsd=np.full(4, PIXEL_M))

    def residual(unit: float) -> np.ndarray:
        def sample(_catalog, _image, row, *_):
            gain = np.array(unit if row < alike else np.nan)
            return unit * light[row], valid, render[row], none, none, place, gain, contrast

        monkeypatch.setattr("lcp_catalog.validation.error_fit._sample", sample)
        return residuals_of(catalog, None, np.arange(4), np.full((4, 2), np.nan), None).residual

    np.testing.assert_allclose(residual(70.0), residual(1.0), atol=1e-6)
    assert 0.1 < residual(1.0).std() < 0.2  # of two independent fields of 0.1


def test_too_few_points_are_refused() -> None:
    with pytest.raises(ImageError, match=f"^{FEWEST - 1} points were found"):
        fit_errors([residuals(1, EAST, count=FEWEST - 1)], STATED)
    with pytest.raises(ImageError, match=r"^0 points were found"):
        fit_errors([], STATED)


@pytest.mark.slow
def test_each_kind_of_images_has_its_own_model(tmp_path: Path) -> None:
    """The one with the most points first, under the given name; a kind with few points has none."""
    maps, frames = residuals(1, EAST, count=40), residuals(2, NORTH_EAST, count=60)
    few = residuals(3, EAST, count=FEWEST - 1)
    samples = [
        ("line scanner", "s", few, Claims.none()),
        ("map-projected image", "m", maps, Claims.none()),
        ("framing camera", "f", frames, Claims.none()),
    ]
    first, second = fitted_by_kind(samples, STATED)
    assert first == FittedErrors("framing camera", fit_errors([frames], STATED), 60, ("f",))
    assert second == FittedErrors("map-projected image", fit_errors([maps], STATED), 40, ("m",))
    files = errors_files(tmp_path / "e.toml", (first, second))
    assert [path.name for path, _ in files] == ["e.toml", "e-map-projected-image.toml"]
    written = tomllib.loads(second.to_toml())["errors"]
    assert written == pytest.approx(second.model.to_dict(), rel=1e-3)
    with pytest.raises(ImageError, match=r"^18 points of 2 kinds of images are too few for a fit"):
        fitted_by_kind(
            [(kind, kind, few, Claims.none()) for kind in ("line scanner", "framing camera")],
            STATED,
        )


@pytest.mark.parametrize("found", [True, False, None])
def test_a_value_at_an_end_of_what_is_tried_is_named(
    found: bool | None, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 2000 likely points none is found, or of as many unlikely ones all; of as many as are stated nothing is said."""
    chances = np.full(2000, 0.5 if found is None else 0.01 if found else 0.99)
    happened = np.arange(2000) % 2 == 0 if found is None else np.full(2000, found)
    tried = np.ones(2000, np.bool_)
    claims = SimpleNamespace(tried=tried, claimed=tried, probability=chances, found=happened)
    monkeypatch.setattr(error_fit.Claims, "pooled", lambda _: claims)
    middle = replace(STATED, height_length_m=HEIGHT_LENGTHS[3] * PIXEL_M, albedo_length_m=300.0)
    monkeypatch.setattr(error_fit, "fit_errors", lambda *_: middle)
    samples = [("framing camera", "f", residuals(1, EAST), claims)]
    (fitted,) = fitted_by_kind(samples, STATED)
    end = {True: "2", False: "-2", None: "none"}[found]
    assert (f"framing camera: detection_shift {end} at an end" in caplog.text) == (
        found is not None
    )
    assert abs(fitted.model.detection_shift) == pytest.approx(2.0 * (found is not None), abs=0.01)
    assert "length" not in caplog.text
    for length, told in ((HEIGHT_LENGTHS[0], True), (HEIGHT_LENGTHS[-1], True), (0.0, False)):
        caplog.clear()
        sigma = 8.0 if length else 0.0
        ended = replace(
            middle, height_sigma_m=sigma, height_length_m=(length or HEIGHT_LENGTHS[0]) * PIXEL_M
        )
        monkeypatch.setattr(error_fit, "fit_errors", lambda *_, model=ended: model)
        fitted_by_kind(samples, STATED)
        assert ("height_length_m" in caplog.text) == told


def test_what_is_found_in_an_image_that_is_not_located_is_no_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a known pose: its matches count as searched for and as found at no place."""
    pixels: list[np.ndarray] = []
    monkeypatch.setattr(run, "residuals_of", lambda *given: pixels.append(given[3]))
    matches = SimpleNamespace(
        code=np.array([run.SEARCHED[0], 255, run.SEARCHED[-1]]),
        found=np.array([True, True, False]),
        found_px=np.arange(6.0).reshape(3, 2),
        point=np.arange(3),
    )
    request: Any = SimpleNamespace(pose_is_known=True, law=None)
    nothing: Any = None
    for pose in (None, object()):
        located: Any = SimpleNamespace(pose=pose, matches=matches)
        image: Any = SimpleNamespace(name="frame")
        run._residuals(request, nothing, located, image)
    np.testing.assert_array_equal(pixels[0], np.full((2, 2), np.nan))
    np.testing.assert_array_equal(pixels[1], [[0.0, 1.0], [np.nan, np.nan]])
