"""Rates of what a build, a render and a search are made of, and ratios to plain programs of the same result.

    python -m benchmarks.speed kernels [terrain] [light] [matching] [--rounds N]

One thread, processor time, medians of interleaved rounds; Markdown. Shadows and rays: `peers`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import cv2
import numpy as np

from benchmarks import sections
from benchmarks.markdown import percent, table
from benchmarks.places import DEM, SAMPLE
from benchmarks.timing import Task, in_turn, median, ratio
from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import nadir_view
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.kernels.matching import search
from lcp_catalog.kernels.photometry.images import add_light
from lcp_catalog.light.sources import Lighting, split_sources
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.point_search import SearchImage, find_points
from lcp_catalog.matching.templates import render_patches
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.laws import DEFAULT_MODEL, reflectance_model
from lcp_catalog.rendering.renderer import Method, render_enu
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.simulation.detector import Detector
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.terrain import Terrain, build_terrain
from lcp_catalog.threads import limit_threads
from tests.helpers.environment_maps import Lamp, cie_sky, with_lamps
from tests.helpers.match_frames import simulated_image
from tests.helpers.synthetic import cratered
from tests.helpers.twins_match import catalog_of_dem, looking_at

Row = list[str]
SIDE, CELL_M = 1024, 20.0
DEM_CELL_M = 118.45
PIXELS = 512
PATCH, REACH_PX, POINTS, SEARCHED = 33, 64, 1000, 40
LAWS = ("lommel-seeliger", "hapke")


def main(words: Sequence[str]) -> int:
    parser = sections.parser("speed kernels", __doc__)
    parser.add_argument("parts", nargs="*", choices=[[], *PARTS], metavar="PART")
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args(words)
    with limit_threads(1):
        for name in given.parts or PARTS:
            print(f"{table([name, 'rate', 'beside'], PARTS[name](given.rounds))}\n", flush=True)
    return 0


def row(what: str, count: float, unit: str, tasks: dict[str, Task], rounds: int) -> Row:
    """Units a second of the first task, and the time of each other one over its."""
    times = in_turn(tasks, rounds)
    first, *others = tasks
    told = [f"{name} {ratio(times[first], times[name]):.2f}" for name in others]
    rate = count / median(times[first])
    speed = f"{rate / 1e6:.3g} M{unit}/s" if rate > 1e5 else f"{rate:.0f} {unit}/s"
    return [what, speed, ", ".join(told)]


def made_terrain() -> Terrain:
    """A cratered square, mirrored so that its copies join without a step."""
    z = cratered(SIDE // 2, CELL_M)
    field = Heightfield(np.block([[z, z[:, ::-1]], [z[::-1], z[::-1, ::-1]]]), CELL_M)
    index = np.zeros((SIDE, SIDE), np.int16)
    window = NodeWindow(0, SIDE, 0, SIDE)
    return Terrain(field, EnuFrame(0.0, 0.0), field.whole, window, index, ("made",))


def terrain(rounds: int) -> list[Row]:
    """Heights of a GeoTIFF at nodes, and the albedo factors of the same nodes."""
    dems, frame = DemSet.open([DEM]), EnuFrame(5.0, 25.0)
    window = NodeWindow(-SIDE // 2, SIDE // 2, -SIDE // 2, SIDE // 2)
    heights = partial(build_terrain, dems, frame, window, DEM_CELL_M)
    albedo = AlbedoMap.open(SAMPLE / "hadley_albedo_643nm_11ppd.tif")
    factors = partial(albedo.at_nodes, heights())
    tasks: dict[str, Task] = {"heights": heights, "albedo factors": factors}
    return [row("heights of a DEM", SIDE**2, "node", tasks, rounds)]


def light(rounds: int) -> list[Row]:
    """Whole renders: share of the shading, and a panorama beside a Sun."""
    ground, rows = made_terrain(), []
    sky = with_lamps(cie_sky(512, 120.0, 30.0), [Lamp(120, 30, 8, 0.3), Lamp(300, 50, 1, 2)])
    towards = direction_enu(30.0, 20.0)
    planes = np.ascontiguousarray(np.moveaxis(ground.field.normals(ground.field.whole), -1, 0))
    for name in LAWS:
        law = reflectance_model(name)
        render = partial(render_enu, ground, how=Method(law, accuracy=TIERS["standard"]))
        shot = render(towards, nadir_view())
        lit = np.zeros_like(shot.sunlit), planes, towards, np.asarray(nadir_view().direction)
        tasks: dict[str, Task] = {
            "render": partial(render, towards, nadir_view()),
            "its shading": partial(add_light, *lit, shot.sunlit, law.code, law.numbers),
            "panorama": partial(render, Lighting.of_panorama(split_sources(sky)), nadir_view()),
        }
        rows.append(row(f"render, {name}", SIDE**2, "node", tasks, rounds))
    return rows


def matching(rounds: int) -> list[Row]:
    """Points from catalogue to covariance, and the search beside OpenCV's masked one at every place."""
    lon, lat = np.meshgrid(np.linspace(2.7, 4.3, 12), np.linspace(25.3, 26.7, 12))
    catalog = catalog_of_dem(lon.ravel(), lat.ravel(), PATCH, DEM_CELL_M)
    frame = EnuFrame(3.5, 26.0, -1000.0)
    camera = looking_at(frame, 300e3, 0, 0, 20, 300e3 / DEM_CELL_M, (640, 640))
    request = Request(
        DemSet.open([DEM]), sun=SunChoice(90, 20), view=ViewChoice(camera), disc=False
    )
    photo = simulated_image(request, Detector(blur_px=0.5, noise=0.02, bits=12, seed=1))
    points = np.resize(points_in_view(catalog, photo.sensor), POINTS)
    whole = partial(find_points, catalog, photo, DEFAULT_MODEL, REACH_PX, points=points)
    some = points[:SEARCHED]
    image = SearchImage.of(photo)
    made = render_patches(
        catalog, some, photo.sensor, photo.sun_directions(catalog.position_mcmf[some])
    )
    found = {coarse: np.full((SEARCHED, search.NUMBERS), np.nan) for coarse in (True, False)}

    def ours(coarse: bool) -> None:
        search.find_templates(
            image.fine, image.weight, image.half, image.half_weight, made.values, made.mask, made.origin,
            np.full(SEARCHED, REACH_PX), np.full(SEARCHED, PATCH / 2.0), 0.7, np.full(SEARCHED, coarse), found[coarse],
        )  # fmt: skip

    def theirs() -> None:
        for values, mask, (column, line) in zip(made.values, made.mask, made.origin, strict=True):
            top, left = max(line - REACH_PX, 0), max(column - REACH_PX, 0)
            bottom, right = line + REACH_PX + len(values), column + REACH_PX + values.shape[1]
            region = image.fine[top:bottom, left:right]
            cv2.matchTemplate(region, values, cv2.TM_CCOEFF_NORMED, mask=mask.astype(np.float32))

    tasks: dict[str, Task] = {
        "by halves": partial(ours, True),
        "at every place": partial(ours, False),
        "OpenCV": theirs,
    }
    sought = row("search of +-64 px", SEARCHED, "point", tasks, rounds)
    same = float(np.all(found[True][:, :2] == found[False][:, :2], axis=1).mean())
    sought[2] += f"; same place {percent(same)}"
    return [row("all stages", POINTS, "point", {"": whole}, rounds), sought]


PARTS: dict[str, Callable[[int], list[Row]]] = {f.__name__: f for f in (terrain, light, matching)}
