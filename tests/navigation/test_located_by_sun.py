"""Probability of being located at single moments: the cameras see the footprint, the Suns stand in the row, and the figures
are those of `lcp query`.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.catalogs import promised
from helpers.navigable import everywhere_usable
from lcp_cli.main import run

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.schema import NO_CELL, UNIQUE, USABLE, Cause, summarise_usable
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.navigation.expected_position import Query, answers, joint_of
from lcp_catalog.navigation.frame_points import points_of_frames
from lcp_catalog.navigation.located_by_sun import WHOLE, _RowOfSuns, located_by_sun


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    """Points with claims of 0.2 to 0.5, and a promise at places over them: two see half as much of the region."""
    plain = everywhere_usable()
    rng, told = np.random.default_rng(3), promised(plain)
    chance = rng.uniform(0.2, 0.5, len(plain))[:, None, None, None, None]
    lon, lat = (float(np.median(values)) for values in (plain.longitude, plain.latitude))
    demand = np.array([1, 1, 2, 2, 2, 2, 2], np.uint8)
    enough = (told.points >= demand[:, None, None, None]) & (told.points != NO_CELL)
    places = replace(
        told,
        longitude=np.full(7, lon) + np.linspace(-0.02, 0.02, 7),
        latitude=np.full(7, lat),
        demand=demand,
        cause=np.where(enough, Cause.MET, told.cause).astype(np.uint8),
        located_probability=np.array([0.9]),
        per_view=np.zeros(1, np.int32),
        footprint=np.array([60_000.0]),
    )
    condition = np.full_like(plain.condition, USABLE & ~UNIQUE)
    lowest, highest = summarise_usable(condition, plain.sun_elevation)
    return replace(
        plain,
        promise=places,
        condition=condition,
        sun_elevation_min=lowest,
        sun_elevation_max=highest,
        detection_probability=np.broadcast_to(chance, np.shape(plain.detection_probability)),
    )


@pytest.fixture(scope="module")
def path(catalog: Catalog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("located") / "c.h5"
    write_catalog(catalog, found)
    return found


def rows(catalog: Catalog) -> list[_RowOfSuns]:
    count = len(catalog.sun_elevation)
    return [_RowOfSuns(catalog, catalog.promise, 0, number) for number in range(count)]


def test_cameras_see_the_footprint_and_no_more(catalog: Catalog) -> None:
    """The ground within the image's borders has the footprint's area, by the spherical rays of its sides."""
    for row in rows(catalog):
        for image in row.images(10):
            height, width = image.sensor.shape
            middle = [(width - 1) / 2.0, (height - 1) / 2.0]
            origin, look = image.sensor.looks(middle)
            along = origin @ look
            away = -along - np.sqrt(along**2 - origin @ origin + MOON_RADIUS_M**2)
            ground = origin + away * look
            up = ground / np.linalg.norm(ground)
            cosine = -look @ up
            pixel_m = away / image.sensor.focal_plane.focal_length_px
            area_m2 = width * height * pixel_m**2 / cosine
            assert pixel_m == pytest.approx(float(catalog.promise.gsd[0]), rel=0.01)
            assert area_m2 == pytest.approx(np.pi / 4.0 * 60e3**2, rel=0.03)


def test_suns_stand_in_the_row_and_places_are_whole(catalog: Catalog) -> None:
    seen = 0
    for number, row in enumerate(rows(catalog)):
        low, high = catalog.sun_elevation[number], catalog.sun_elevation[row.cells.above[number]]
        for image in row.images(10):
            height, width = image.sensor.shape
            origin, look = image.sensor.looks([(width - 1) / 2.0, (height - 1) / 2.0])
            along = origin @ look
            ground = origin + look * (
                -along - np.sqrt(along**2 - origin @ origin + MOON_RADIUS_M**2)
            )
            up = ground / np.linalg.norm(ground)
            assert low - 0.01 <= np.degrees(np.arcsin(up @ image.sun)) <= high + 0.01
            lon = np.degrees(np.arctan2(ground[1], ground[0])) % 360.0
            place = np.abs(catalog.promise.longitude - lon).argmin()
            assert catalog.promise.demand[place] >= WHOLE * 2
            seen += 1
    assert seen >= 10


@pytest.mark.slow
def test_the_figures_are_those_of_a_query(catalog: Catalog) -> None:
    found = located_by_sun(catalog, 8)
    assert found
    assert found == located_by_sun(catalog, 8)
    by_row = iter(found)
    for row in rows(catalog):
        joints = [answer.joint for answer in answers(catalog, row.images(8), Query())]
        if not joints:
            continue
        stated = next(by_row)
        points, ground = ([getattr(j, n) for j in joints] for n in ("located_by_points", "located"))
        assert stated.frames == len(joints)
        assert stated.by_points == pytest.approx(np.mean(points), abs=1e-9)
        assert stated.with_ground == pytest.approx(np.mean(ground), abs=1e-9)
        assert stated.share_by_points == np.mean(np.array(points) >= 0.9)
        assert stated.share_with_ground == np.mean(np.array(ground) >= 0.9)
    assert max(row.with_ground - row.by_points for row in found) > 0.02


def test_nothing_is_stated_where_nothing_is_promised(catalog: Catalog) -> None:
    assert located_by_sun(replace(catalog, promise=None)) == []
    told = catalog.promise
    cause = np.full_like(told.cause, NO_CELL)
    none = replace(told, cause=cause, points=cause)
    assert located_by_sun(replace(catalog, promise=none)) == []


@pytest.mark.slow
def test_the_commands_show_it(path: Path, capsys: pytest.CaptureFixture, tmp_path: Path) -> None:
    assert run(["inspect", str(path), "--located", "4", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["located_at_moments"]
    assert {row["frames"] for row in found} <= {1, 2, 3, 4}
    assert run(["inspect", str(path), "--located", "4"]) == 0
    text = capsys.readouterr().out
    first = found[0]
    assert f"located with {first['by_points']:.2f} by points, {first['with_ground']:.2f}" in text
    page = tmp_path / "page.html"
    assert run(["report", str(path), "-o", str(page)]) == 0
    assert "At single moments" in page.read_text(encoding="utf-8")
    write_catalog(everywhere_usable(), tmp_path / "plain.h5")
    assert run(["inspect", str(tmp_path / "plain.h5"), "--located", "4"]) == 2
    assert "states no promise" in capsys.readouterr().err


def test_patches_that_the_image_cuts_do_not_count(catalog: Catalog) -> None:
    """Whether they are usable or not: of the points in view only those whose four corners are shown are expected to be found."""
    image = next(rows(catalog)[2].images(1))
    (points,) = points_of_frames(catalog, [image])
    half = 0.5 * (catalog.patch_nodes - 1) * catalog.gsd[points.rows]
    shown = np.ones(len(points.rows), bool)
    for east, north in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        off = half[:, None] * np.array([east, north, 0.0])
        corner = catalog.position_mcmf[points.rows] + np.einsum("nij,ni->nj", points.rotation, off)
        column, row = image.sensor.project(corner).T
        height, width = image.sensor.shape
        shown &= (np.abs(column - (width - 1) / 2.0) <= width / 2.0) & (
            np.abs(row - (height - 1) / 2.0) <= height / 2.0
        )
    assert not points.claims.usable.any()
    assert 0 < shown.sum() < len(shown)
    expected = np.nansum(points.claims.detection_probability[shown])
    assert joint_of(catalog, points, Query()).expected == pytest.approx(float(expected), rel=1e-6)
