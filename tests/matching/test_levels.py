"""A catalogue of several levels in an image: the points whose cells suit its pixels."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import small_world
from helpers.navigable import everywhere_usable
from helpers.posed import HADLEY
from helpers.small_world import GSD_M, LAW, World, overhead
from helpers.twins_match import catalog_of_patches
from lcp_cli.main import run as run_command

from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.schema import summarise_usable
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.geometry.frames import EnuFrame, direction_enu, mcmf_to_lonlat
from lcp_catalog.images.image import Image
from lcp_catalog.matching.matches import Matches
from lcp_catalog.matching.options import Options
from lcp_catalog.matching.point_choice import (
    at_one_scale,
    points_in_view,
    searched_first,
    working_image,
)
from lcp_catalog.matching.point_search import SearchImage, find_points
from lcp_catalog.matching.pose import position_error
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.validation import run
from lcp_catalog.validation.run import ImageFiles, Validation

UP = HADLEY.rotation[2]
CELLS_M = (100.0, 200.0, 400.0)


def levels(counts: tuple[int, ...], coarsest: float = 2.0) -> Catalog:
    """Flat patches around Hadley, so many of each level; ``coarsest``: greatest pixel over cell."""
    gsd = np.repeat(CELLS_M, counts)
    dice = np.random.default_rng(1)
    frames = [
        EnuFrame(HADLEY.lon_deg + x, HADLEY.lat_deg + y)
        for x, y in dice.uniform(-0.2, 0.2, (len(gsd), 2))
    ]
    return catalog_of_patches(
        np.zeros((len(gsd), 17, 17), np.float32),
        frames,
        1.0,
        gsd=gsd,
        gsd_min=gsd,
        gsd_max=coarsest * gsd,
        level=np.searchsorted(CELLS_M, gsd).astype(np.int32),
    )


@pytest.mark.parametrize(
    ("pixel_m", "counts", "used"),
    [
        (10.0, (8, 4, 2), {0}),  # reduced to the finest
        (100.0, (8, 4, 2), {0}),
        (150.0, (8, 4, 2), {0}),
        (250.0, (8, 4, 2), {1}),
        (390.0, (8, 4, 2), {1}),
        (700.0, (8, 4, 2), {2}),
        (900.0, (8, 4, 2), {0, 1, 2}),  # too coarse for all: as without levels
        (10.0, (1, 1, 8), {1, 2}),  # too few of the finest: reduced to the coarsest
        (10.0, (3, 4, 2), {0, 1}),  # seven at 200 m, six at 400 m; three at 100 m are too few
        (10.0, (0, 5, 0), {1}),
        (900.0, (0, 5, 0), {1}),
    ],
)
def test_points_of_the_levels_that_suit_the_pixel(
    pixel_m: float, counts: tuple[int, ...], used: set[int]
) -> None:
    catalog = levels(counts)
    camera = overhead(pixel_m=pixel_m)
    rows = at_one_scale(catalog, np.arange(len(catalog)), camera, None)
    np.testing.assert_array_equal(rows, np.flatnonzero(np.isin(catalog.level, list(used))))


def test_the_image_is_searched_at_the_scale_of_the_coarsest_level() -> None:
    catalog = levels((8, 4, 2))
    blank = np.ones((200, 200), np.float32)
    image = Image("blank", blank, blank, overhead(pixel_m=10.0), sun_direction_mcmf=UP)
    fine, both = np.arange(8), np.arange(12)
    assert working_image(catalog, image, fine).sensor.factor == 10
    assert working_image(catalog, image, both).sensor.factor == 20


def two_levels(world: World) -> Catalog:
    """Points of a small world with cells of 400 m, and others with every other node of wider patches."""
    steps = (7e3, 14e3)
    frames = [[frame_at(world, x, y) for x in axis for y in axis] for axis in map(lattice, steps)]
    fine = [world.patch(frame, 33) for frame in frames[0]]
    coarse = [world.patch(frame, 65)[::2, ::2] for frame in frames[1]]
    level = np.repeat([0, 1], [len(fine), len(coarse)]).astype(np.int32)
    gsd = GSD_M * 2.0**level
    return catalog_of_patches(
        np.array(fine + coarse, np.float32),
        [*frames[0], *frames[1]],
        GSD_M,
        gsd=gsd,
        gsd_min=gsd / 4.0,
        gsd_max=4.0 * gsd,
        dem_resolution=gsd,
        level=level,
    )


def lattice(step_m: float) -> np.ndarray:
    return np.arange(-14e3, 14e3 + 1.0, step_m)


def frame_at(world: World, east_m: float, north_m: float) -> EnuFrame:
    lon, lat, _ = mcmf_to_lonlat(world.frame.to_mcmf([[east_m, north_m, 0.0]]))
    return EnuFrame(lon[0], lat[0], world.level(lon, lat)[0])


@pytest.mark.slow
def test_a_position_is_solved_from_all_levels_each_at_its_own_scale(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Pixels of 190 m: the first search takes the points of 400 m, in pixels twice as large; the second
    those of 800 m besides, in pixels four times as large.
    """
    world, uncertain = small_world.world(), Uncertainty(1000.0, np.radians(0.2))
    catalog, camera = two_levels(world), overhead(pixel_m=190.0, size_px=300)
    photo = world.photo(camera)
    given = photo.with_sensor(camera.moved([900.0, -700.0, 500.0, 0.002, -0.003, 0.002]))
    asked: list[tuple[set[int], int]] = []

    def listen(sought: Catalog, image: SearchImage, *args: object, **options: Any) -> Matches:
        levels = set(np.asarray(sought.level)[options["points"]].tolist())
        asked.append((levels, image.factor))
        return find_points(sought, image, *args, **options)

    monkeypatch.setattr("lcp_catalog.matching.position_fix.find_points", listen)
    both = locate(catalog, given, uncertain, LAW)
    assert asked[:3] == [({0}, 2), ({0}, 2), ({1}, 4)]
    assert {(min(levels), factor) for levels, factor in asked} == {(0, 2), (1, 4)}
    assert both.pose is not None
    level = np.asarray(catalog.level)[both.matches.point]
    assert both.pose.used[level == 0].sum() >= 15
    assert both.pose.used[level == 1].sum() >= 5
    assert position_error(both.pose, camera).squared < 16.3


@pytest.mark.parametrize(
    ("fine", "coarse", "used"),
    [
        (0.98, 0.98, {0}),  # enough at the finest
        (0.3, 0.98, {0, 1}),  # 40 of the finest are not
        (0.3, 0.3, {0, 1}),  # nowhere enough: all together are worth most
        (0.02, 0.02, {0}),  # nothing is worth anything: by their number, as without claims
    ],
)
def test_the_scale_is_the_finest_at_which_points_are_enough_under_the_sun(
    fine: float, coarse: float, used: set[int]
) -> None:
    """11 certain points locate a frame, 40 of 0.3 do not (docs/explanation/selection.md)."""
    level = np.repeat([0, 1], [40, 20])
    catalog = claiming(np.where(level == 0, fine, coarse), level)
    camera = overhead(pixel_m=100.0)
    sun = HADLEY.direction_to_mcmf(direction_enu(100.0, 17.0))
    rows = at_one_scale(catalog, np.arange(60), camera, sun)
    np.testing.assert_array_equal(rows, np.flatnonzero(np.isin(level, list(used))))


def claiming(claims: np.ndarray, level: np.ndarray) -> Catalog:
    """Flat patches around Hadley with cells of 100 m times two to the ``level`` (n,), and one claim (n,) each in all conditions."""
    gsd = 100.0 * 2.0**level
    whole = everywhere_usable(len(level))
    claims = claims[:, None, None, None, None]
    usable = np.where(claims[:, 0] >= 0.9, 31, 25).astype(np.uint8)
    condition = np.broadcast_to(usable, whole.condition.shape)
    lowest, highest = summarise_usable(condition, whole.sun_elevation)
    return dataclasses.replace(
        whole,
        level=level.astype(np.int32),
        gsd=gsd,
        gsd_min=gsd,
        gsd_max=4.0 * gsd,
        condition=condition,
        sun_elevation_min=lowest,
        sun_elevation_max=highest,
        detection_probability=np.broadcast_to(claims, whole.detection_probability.shape),
    )


def test_the_scale_is_that_of_the_points_in_view_whoever_asks() -> None:
    """Points of the finest cells are enough beside the image and in a part of it, in the whole of it they are not."""
    level = np.tile([0, 0, 1], 30)
    camera = overhead(pixel_m=100.0, size_px=450)
    seen = points_in_view(claiming(np.full(90, 0.9), level), camera)
    assert 20 < len(seen) < 60
    everyone = np.arange(90)
    beside = np.setdiff1d(everyone, seen)
    claims = np.where(level == 1, 0.98, 0.3)
    claims[beside] = 0.98
    catalog = claiming(claims, level)
    sun = HADLEY.direction_to_mcmf(direction_enu(100.0, 17.0))
    assert set(level[at_one_scale(catalog, seen, camera, sun)]) == {0, 1}
    assert set(level[at_one_scale(catalog, everyone, camera, sun)]) == {0}  # a scale of others
    for rows in (seen, everyone, beside, seen[:12]):
        np.testing.assert_array_equal(searched_first(catalog, rows, camera, sun), rows)
        suns = np.tile(sun, (len(rows), 1))
        np.testing.assert_array_equal(searched_first(catalog, rows, camera, suns), rows)
    claims[seen] = 0.98
    better = claiming(claims, level)
    fine = np.flatnonzero(level == 0)
    np.testing.assert_array_equal(searched_first(better, everyone, camera, sun), fine)
    coarse = np.flatnonzero(level == 1)  # none of those that are searched first: all
    np.testing.assert_array_equal(searched_first(better, coarse, camera, sun), coarse)


def test_a_query_expects_of_all_levels_and_locates_by_the_scale_that_is_searched(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Points whose patches the image shows whole, all with a claim; the finer ones alone are searched for, and are enough."""
    level = np.tile([0, 0, 1], 30)
    camera = overhead(pixel_m=100.0, size_px=450)
    (path := tmp_path / "c.json").write_text(json.dumps(camera.to_json()), encoding="utf-8")
    told = []
    for claim in (0.4, 0.0):
        write_catalog(claiming(np.where(level == 0, 0.98, claim), level), tmp_path / f"{claim}.h5")
        words = f"query {tmp_path}/{claim}.h5 --camera {path} --json --sun-azimuth 100 --sun-elevation 17"
        assert run_command(words.split()) == 0
        told.append(json.loads(capsys.readouterr().out))
    seen = points_in_view(claiming(np.full(90, 0.9), level), camera)
    often, never = (one["expected_found"] for one in told)
    coarse = np.count_nonzero(level[seen] == 1)
    assert often - never == pytest.approx(0.4 * coarse, rel=0.05)  # as it is stored
    for one in told:
        every = sum(one["probability_at_least"].values())
        assert every == pytest.approx(one["expected_found"], abs=0.05)
    for name in ("needed", "located_probability", "expected_points"):
        assert told[0][name] == told[1][name], name


def test_a_validation_keeps_the_scale_of_the_whole_catalogue() -> None:
    """Points of 100 m have 0.87 of the units that surely locate a frame, with those of 200 m 0.92, with those of 400 m three
    times as many as needed: that of 200 m is the finest scale at which points are nearly enough. Without points of 400 m that
    of 100 m would be, with 0.9 of the most.
    """
    level = np.repeat([0, 1, 2], [9, 2, 30])
    catalog = claiming(np.array([0.95, 0.7, 0.98])[level], level)
    camera = overhead(pixel_m=100.0, size_px=900)
    sun = HADLEY.direction_to_mcmf(direction_enu(100.0, 17.0))
    two = np.flatnonzero(level < 2)
    np.testing.assert_array_equal(at_one_scale(catalog, np.arange(41), camera, sun), two)
    np.testing.assert_array_equal(at_one_scale(catalog, two, camera, sun), np.arange(9))
    blank = np.zeros((900, 900), np.float32)
    image = Image("blank", blank, blank, camera, sun_direction_mcmf=sun)
    request = Validation(Path("none.h5"), (), Uncertainty(500.0, 0.001))
    files = ImageFiles(Path("blank.png"))
    found = run._searched(request, catalog, files, image, Options())
    ids = found.catalog.point_id[found.located.matches.point]
    np.testing.assert_array_equal(np.sort(ids), np.sort(catalog.point_id[two]))
