"""The cheapest catalogues that may have more points for an image: by each cause, with a price that is computed."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from helpers import catalogs
from helpers.navigable import everywhere_usable
from helpers.posed import camera, turned

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.schema import summarise_usable
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.images.image import Image
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.navigation.better_catalog import better_catalog
from lcp_catalog.navigation.frame_points import PlannedImage

ABOVE = EnuFrame(*catalogs.CENTER)
SUN = SunChoice(100.0, 17.0)


def told(catalog: Catalog, taken: Camera, sun: SunChoice = SUN) -> str:
    return better_catalog(catalog, PlannedImage.lit(taken, sun))


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    return everywhere_usable(40)


def test_a_catalogue_that_has_enough_needs_no_other(catalog: Catalog) -> None:
    assert told(catalog, camera(ABOVE)) == ""
    blank = np.zeros((404, 404), np.float32)
    sun = PlannedImage.lit(camera(ABOVE), SUN).sun
    image = Image("i", blank, blank, camera(ABOVE), sun_direction_mcmf=sun)
    assert better_catalog(catalog, PlannedImage.of(image)) == ""


@pytest.mark.parametrize(("elevation", "node"), [(88.0, 89), (3.0, 2)])
def test_a_sun_outside_the_table_is_priced(
    catalog: Catalog, elevation: float, node: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every point works under the Suns of the catalogue; one far above or below them needs a row of its own, beyond that of the
    point where it stands highest or lowest.
    """
    monkeypatch.setattr("lcp_catalog.navigation.better_catalog.SUBSOLAR_LATITUDE_MAX_DEG", 90.0)
    text = told(catalog, camera(ABOVE), SunChoice(90.0, elevation))
    seen = len(points_in_view(catalog, camera(ABOVE)))
    assert f"; of {seen} points in view 0 are usable here (else sun {seen}): " in text
    price = 1.0 + 1.0 / len(catalog.sun_elevation)
    more = f"`build_catalog` with `sun.elevations_deg` that include {node}, for at most {seen} points more"
    assert text.endswith(f"a catalogue that may have more: {more}, at {price:.3g} times the work")


def test_a_sun_that_sets_within_the_image_is_priced_for_the_points_by_day(
    catalog: Catalog,
) -> None:
    """1.3 deg high in the middle: some points have it below 1 deg."""
    planned = PlannedImage.lit(camera(ABOVE), SunChoice(90.0, 1.3))
    text = better_catalog(catalog, planned)
    rows = points_in_view(catalog, camera(ABOVE))
    up = catalog.position_mcmf[rows] / np.linalg.norm(catalog.position_mcmf[rows], axis=1)[:, None]
    above = np.degrees(np.arcsin(up @ planned.sun))
    assert above.min() < 1.0 < above.max()
    by_day = np.count_nonzero(above >= 1.0)
    assert f"`sun.elevations_deg` that include 1, for at most {by_day} points more, at " in text


def test_no_catalogue_helps_under_a_sun_below_the_horizon(catalog: Catalog) -> None:
    night = PlannedImage.lit(camera(ABOVE), SunChoice(273.0, -5.0))
    text = better_catalog(catalog, night)
    assert text.endswith("no other catalogue is known to have more")
    planned = better_catalog(catalog, night, planned=True)
    assert planned == f"{text}; without a build: the Sun 5 to 75 deg high"


def test_no_catalogue_helps_under_a_sun_that_never_comes(catalog: Catalog) -> None:
    """88 deg high at 26 deg north: the Sun is at most 1.6 deg from the equator."""
    text = told(catalog, camera(ABOVE), SunChoice(90.0, 88.0))
    assert text.endswith("no other catalogue is known to have more; the Sun never stands there")


def test_a_view_far_from_those_of_the_table_is_priced(catalog: Catalog) -> None:
    """A camera 80 km south of the points that looks north, 45 deg off nadir: its Sun is in the table."""
    south = EnuFrame(ABOVE.lon_deg, ABOVE.lat_deg - math.degrees(110.0 / 1737.4))
    text = told(catalog, camera(south, tilt=(math.radians(-45.0), 0.0, 0.0)))
    off_nadir, azimuth = re.search(
        r"a view (\d+) deg off nadir at azimuth (\d+), for", text
    ).groups()
    assert float(off_nadir) == pytest.approx(45.0, abs=7.0)
    assert float(azimuth) == pytest.approx(180.0, abs=3.0)
    assert text.endswith(f"at {1.0 + 1.0 / len(catalog.view_off_nadir):.3g} times the work")


def test_a_pixel_too_coarse_needs_cells_of_its_size(catalog: Catalog) -> None:
    high = camera(ABOVE, altitude_m=110e3 * 200)
    seen = len(points_in_view(catalog, high))
    text = told(catalog, high)
    assert f"else scale {seen}" in text
    cell = float(np.median(catalog.gsd))
    pixel = float(text.split("`area.gsd_m` ")[1].split(",")[0])
    assert pixel == pytest.approx(110e3 * 200 / 268.0, rel=0.01)
    assert f"at {(cell / pixel) ** 2:.3g} times the work" in text


def test_unlikely_detection_names_finer_cells_and_brightness() -> None:
    plain = everywhere_usable(40)
    condition = np.full(plain.condition.shape, 1 + 8 + 16, np.uint8)  # neither found nor alone
    lowest, highest = summarise_usable(condition, plain.sun_elevation)
    poor = replace(
        plain,
        condition=condition,
        detection_probability=np.full_like(plain.detection_probability, 0.2),
        sun_elevation_min=lowest,
        sun_elevation_max=highest,
    )
    text = told(poor, camera(ABOVE))
    cheap, dear = text.split(": ")[-1].split("; ")
    assert cheap.startswith("an albedo map, whose effect only a build can tell, at 1 times")
    half = 0.5 * float(np.median(poor.gsd))
    assert dear.startswith(
        f"`build_catalog` with `area.gsd_m` {half:.3g}, if the DEM resolves it, "
    )


def test_few_points_need_a_smaller_spacing() -> None:
    few = everywhere_usable(3)
    text = told(few, camera(ABOVE))
    seen = len(points_in_view(few, camera(ABOVE)))
    assert seen
    more = f"`build_catalog` with `points.spacing_m` halved, for at most {3 * seen} points more, at 4 times the work"
    assert text == f"; of {seen} points in view {seen} are usable here: a catalogue that may have more: {more}"  # fmt: skip


def test_a_camera_elsewhere_needs_a_catalogue_of_its_ground(catalog: Catalog) -> None:
    """The price is that of the areas; one that looks at the sky by a mistake of its file needs none."""
    text = told(catalog, camera(EnuFrame(40.0, 10.0)))
    start, _, rest = text.partition("`area.bounds_deg` ")
    assert start == "; a catalogue of what the image shows: `build_catalog` with "
    *numbers, _, price, _, _, _ = rest.split()
    west, south, east, north = map(float, numbers)
    assert west < 40.0 < east
    assert south < 10.0 < north
    lat = np.radians(catalog.latitude)
    own = np.radians(np.ptp(catalog.longitude)) * np.ptp(np.sin(lat))
    seen = math.radians(east - west) * np.ptp(np.sin(np.radians([south, north])))
    assert float(price) == pytest.approx(seen / own, rel=0.06)
    sky = replace(
        camera(ABOVE), rotation_mcmf_to_camera=turned((math.pi, 0.0, 0.0)) @ camera(ABOVE).rotation_mcmf_to_camera
    )  # fmt: skip
    time = SunChoice(time_utc="2026-01-27T02:00:00")
    assert told(catalog, sky, time) == ""
