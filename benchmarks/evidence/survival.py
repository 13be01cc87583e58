"""Which matcher survives which Sun: photographs against renders whose Sun is turned, two photographs under different Suns, and
simulated frames of one place under five Suns.

    python -m benchmarks.evidence survival [-o FOLDER] [--data FOLDER]

A match is right within 3 pixels of the true place. A picture is located if 10 matches agree on a shift, turn and scale to 3
pixels, falsely if its corners then move by more. `lcp` searches for the points for which its catalogue states a probability
under the photograph's own Sun, and is told the Sun of the row. Written are `survival.md` and the picture `survival.svg`;
finished scenes are kept in the folder. Ten minutes of one core with learned matchers, which are left out where they are not
installed (`matchers`).
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from markupsafe import Markup

from benchmarks.evidence import frames
from benchmarks.evidence.cases import FAR, HADLEY, framed
from benchmarks.evidence.catalogues import ALBEDO, LAW
from benchmarks.evidence.matchers import Matcher, Pairs, Picture, matchers
from benchmarks.markdown import table
from benchmarks.sections import evidence_parser
from lcp_catalog.arrays import Array, Index, Mask
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import pixel_size_m
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.ephemeris.solar_position import direction_from_subsolar
from lcp_catalog.geometry.frames import EnuFrame, mcmf_to_lonlat
from lcp_catalog.images.image import Image
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.matching.point_choice import NO_CLAIM, points_in_view, working_image
from lcp_catalog.matching.point_search import Criteria, find_points
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.matching.sun_check import with_sun
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.laws import Reflectance, reflectance_model
from lcp_catalog.plots.axes import Axes, Axis
from lcp_catalog.plots.pictures import grey
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.simulation.detector import Detector
from lcp_catalog.validation.claims import ClaimSearch, search_radius_m
from tests.helpers import located_frames
from tests.helpers.closed_loops import SUN_M, embree_frame
from tests.helpers.dem_clones import Errors, clone
from tests.helpers.embree_camera import Ground
from tests.helpers.embree_mesh import mcmf, read_nodes
from tests.helpers.match_frames import simulated_image
from tests.helpers.small_world import overhead

PHOTO, OTHER = "AS15-M-0414", "AS15-M-1134"
TURNS_DEG = (0, 15, 30, 60, 90, 120, 180)
RAISES_DEG = (-10, -5, 10, 20, 30)
SUNS = {"morning, 10": 80.0, "morning, 30": 60.0, "noon": 0.0, "evening, 30": -60.0, "evening, 10": -80.0}  # fmt: skip
"""Suns of the simulated frames by their height, deg: longitude of the subsolar point minus the site's."""
MAP = "morning, 30"  # the Sun of the one map with which they are compared
SITE, SIZE_PX, ALTITUDE_M = "farside", 256, 300e3
RIGHT_PX, EDGE_PX, AGREEING = 3.0, 16, 10
OURS = "lcp"
THUMB_PX = 104
BELOW = (
    "azimuth of the render's Sun minus the photograph's",
    "Sun of the frame; lcp renders its points under it",
)


@dataclass(frozen=True)
class Tally:
    """Right matches of all, and what was made of them: ``yes``, ``no`` or ``false``. Of `OURS` alone ``tried``: points searched
    for, ``stated``: their mean probability under the photograph's own Sun, ``usable``: those called usable there, and of these
    the right ones.
    """

    right: int
    count: int
    located: str
    tried: int | None = None
    stated: float | None = None
    usable: Sequence[int] = ()

    @property
    def share(self) -> float:
        """Of all matches; of the points searched for, where they are known."""
        return self.right / max(1, self.count if self.tried is None else self.tried)

    def __str__(self) -> str:
        of = f"{self.right}/{self.count}"
        return of if self.located == "no" else f"**{of}**" if self.located == "yes" else f"{of} !"


Row = dict[str, Tally]
Scene = dict[str, Row]  # rows by the name of the Sun


def judged(pairs: Pairs, mask: Mask, true: Array | None = None) -> Tally:
    """Matches of two pictures of one geometry, those near a border of ``mask`` (rows, cols) left out."""
    inside = cv2.erode(np.pad(mask, 1).astype(np.uint8), np.ones((2 * EDGE_PX + 1,) * 2))[1:-1, 1:-1]  # fmt: skip
    rows, cols = mask.shape
    here, there = pairs
    col, row = np.rint(here).astype(np.int64).T
    kept = inside[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)] > 0
    here, there = here[kept], there[kept]
    right = int((np.linalg.norm(there - here, axis=1) <= RIGHT_PX).sum())
    found: Any = None
    if len(here) >= AGREEING:
        found, agree = cv2.estimateAffinePartial2D(here, there, ransacReprojThreshold=RIGHT_PX)
        found = found if np.sum(agree) >= AGREEING else None
    if found is None:
        return Tally(right, len(here), "no")
    corners = np.array([[0, 0], [cols, 0], [0, rows], [cols, rows]], float)
    off = np.linalg.norm(corners @ found[:, :2].T + found[:, 2] - corners, axis=1).max()
    return Tally(right, len(here), "yes" if off <= RIGHT_PX else "false")


@dataclass(frozen=True, eq=False)
class Ours:
    """The catalogue of a photograph of a known camera, and the points (rows) for which it states a probability there."""

    catalog: Catalog
    photo: Image
    law: Reflectance
    rows: Index
    stated: float
    usable: Mask

    @classmethod
    def of(cls, catalog: Catalog, photo: Image, law: Reflectance) -> Ours:
        rows = points_in_view(catalog, photo.sensor)
        claims = ClaimSearch(catalog, photo, law, Criteria(), photo.sensor).claims(rows, True)
        some, stated = claims.tried, float(claims.probability[claims.tried].mean())
        return cls(catalog, photo, law, rows[some], stated, claims.usable[some])

    def tally(self, told: Image) -> Tally:
        """The search under the Sun of ``told``, and `locate` from a camera 5 km and 0.5 deg off."""
        places, camera = self.catalog.position_mcmf[self.rows], self.photo.sensor
        assert isinstance(camera, Camera)
        matches = find_points(
            self.catalog,
            working_image(self.catalog, told, self.rows),
            self.law,
            search_radius_m(self.catalog, self.rows) / pixel_size_m(camera, places),
            points=self.rows,
            criteria=replace(Criteria(), prior=NO_CLAIM),
        )
        off = np.linalg.norm(matches.found_px - camera.project(places), axis=1)
        right = matches.found & (off <= RIGHT_PX)
        usable = int((right & self.usable).sum()), int(self.usable.sum())
        fix = locate(self.catalog, located_frames.displaced(told, 0), FAR, self.law)
        false = located_frames.is_wrong(fix, self.catalog, camera)
        located = "no" if fix.pose is None else "false" if false else "yes"
        count = int(matches.found.sum())
        return Tally(int(right.sum()), count, located, len(right), self.stated, usable)


def pictures(first: Array, second: Array) -> tuple[Picture, Picture, Mask]:
    """Two images (rows, cols) as grey pixels, each by its own percentiles, and where both are known."""
    both = np.isfinite(first) & np.isfinite(second)
    one, two = (
        np.where(both, grey(v, w)[..., 0], 0) for v, w in ((first, second), (second, first))
    )
    return one.astype(np.uint8), two.astype(np.uint8), both


def compared(first: Array, second: Array, some: dict[str, Matcher]) -> Row:
    """Tallies of all matchers of two images of one geometry."""
    one, two, both = pictures(first, second)
    return {name: judged(match(one, two), both) for name, match in some.items()}


def _rendered(dem: Path, camera: Camera, towards: Array, law: Reflectance, albedo: Any) -> Array:
    """The camera's picture of a DEM under a Sun in a direction (3,) MCMF."""
    lon, lat, _ = (float(v) for v in mcmf_to_lonlat(towards))
    request = Request(
        DemSet.open([dem]),
        sun=SunChoice(subsolar_deg=(lon, lat)),
        view=ViewChoice(replace(camera, sun_position_mcmf_m=None)),
        model=law,
        albedo=albedo,
    )
    return np.asarray(simulated_image(request, Detector(blur_px=0.5)).signal, np.float64)


Thumbs = list[Picture]


def photograph(data: Path, folder: Path, some: dict[str, Matcher]) -> Iterator[tuple[str, Row, Picture]]:  # fmt: skip
    """A photograph against renders of its ground, the Sun of the renders turned and raised."""
    case, law = framed(data, folder, PHOTO), reflectance_model(LAW)
    photo, path = located_frames.frame(data, PHOTO), case.catalog()
    assert path is not None
    assert isinstance(photo.sensor, Camera)
    catalog = open_catalog(path)
    ours, albedo = Ours.of(catalog, photo, law), AlbedoMap.open(data / ALBEDO, "linear")
    signal = np.where(photo.valid, photo.signal, np.nan)
    for turn, up in [*((t, 0) for t in TURNS_DEG), *((0, r) for r in RAISES_DEG)]:
        told = with_sun(photo, catalog.position_mcmf, turn, up)
        towards = np.asarray(told.sun_directions(catalog.position_mcmf.mean(axis=0)[None]))
        render = _rendered(case.dem, photo.sensor, towards.reshape(3), law, albedo)
        row = compared(signal, render, some) | {OURS: ours.tally(told)}
        name = f"azimuth {turn:+d}" if turn else f"elevation {up:+d}" if up else "as it is"
        yield name, row, pictures(signal, render)[1]


def two_photographs(data: Path, some: dict[str, Matcher]) -> Iterator[tuple[str, Row, Picture]]:
    """Two photographs of one ground on the grid of the DEM, where both show it."""
    paths = [data / "images" / HADLEY / f"{name}_image_on_dem_grid.tif" for name in (PHOTO, OTHER)]
    files = [rasterio.open(path) for path in paths]
    west, south = (max(f.bounds[k] for f in files) for k in (0, 1))
    east, north = (min(f.bounds[k] for f in files) for k in (2, 3))
    cuts = []
    for file in files:
        values = file.read(1, window=file.window(west, south, east, north).round()).astype(float)
        cuts.append(np.where(values == file.nodata, np.nan, values))
        file.close()
    row = compared(cuts[0], cuts[1], some)
    yield f"{PHOTO} and {OTHER}", row, pictures(*cuts)[0]


def five_suns(data: Path, folder: Path, some: dict[str, Matcher]) -> Iterator[tuple[str, Row, Picture]]:  # fmt: skip
    """Frames of one place by the independent renderer, against a map of one Sun; ours against its catalogue."""
    place, law = frames.PLACES[SITE], reflectance_model(frames.LAW)
    dem = data / place.dem
    catalog = open_catalog(frames.built(folder / f"{SITE}.h5", dem, place))
    centre = EnuFrame(*place.center_deg)
    camera = overhead(centre, size_px=SIZE_PX, pixel_m=place.gsd_m, altitude_m=ALTITUDE_M)
    errors = Errors(*(float(catalog.errors[k]) for k in Errors.__dataclass_fields__))
    dice = np.random.default_rng(frames.SEED)
    nodes = read_nodes(dem, *place.center_deg, frames.REACH_M)
    surface, brightness = clone(nodes, errors, dice)
    ground = Ground(surface, mcmf(*place.center_deg), brightness)
    towards = {name: direction_from_subsolar(centre.lon_deg + away, 0.0) for name, away in SUNS.items()}  # fmt: skip
    render = _rendered(dem, camera, towards[MAP], law, None)
    for seed, (name, sun) in enumerate(towards.items()):
        lit = replace(camera, sun_position_mcmf_m=centre.origin_mcmf_m + SUN_M * sun)
        snr = 1.0 / float(catalog.errors["sensor_noise"])
        photo = embree_frame(ground, lit, snr, frames.BITS, samples=2, seed=seed)
        signal = photo.signal.astype(np.float64)
        row = compared(signal, render, some)
        row[OURS] = Ours.of(catalog, photo, law).tally(photo)
        yield name, row, pictures(signal, render)[0]


# -- files, tables, the picture


def kept(folder: Path, name: str, made: Iterator[tuple[str, Row, Picture]]) -> tuple[Scene, Thumbs]:
    """A scene: from the folder if it is finished there, else computed and written to it."""
    path = folder / f"{name}.json"
    if not path.exists():
        scene = {}
        for sun, row, shown in made:
            scene[sun] = {matcher: vars(tally) for matcher, tally in row.items()}
            cv2.imwrite(str(folder / f"{name} {sun}.png"), shown)
            print(f"{name}, {sun}: {', '.join(f'{m} {t}' for m, t in row.items())}", flush=True)
        path.write_text(json.dumps(scene, indent=1), encoding="utf-8")
    saved = json.loads(path.read_text(encoding="utf-8"))
    rows = {sun: {m: Tally(**t) for m, t in row.items()} for sun, row in saved.items()}
    read = [cv2.imread(str(folder / f"{name} {sun}.png"), cv2.IMREAD_GRAYSCALE) for sun in rows]
    return rows, [np.asarray(one, np.uint8) for one in read]


def scene_table(scene: Scene) -> str:
    """A row a Sun: right of all matches, bold where located, ``!`` where falsely; ours: of the points searched for."""
    names = list(next(iter(scene.values())))
    rows = []
    for sun, row in scene.items():
        searched = []
        if (own := row.get(OURS)) and own.tried:
            right, count = own.usable
            searched = [f"{own.right / own.tried:.2f} ({own.stated:.2f})", f"{right}/{count}"]
        rows.append([sun, *(str(row[name]) for name in names), *searched])
    more = ["share of points searched (stated)", "right of usable"] if OURS in names else []
    return table(["Sun", *names, *more], rows)


COLOURS = ("#888", "#c05a00", "#a08000", "#2a7f3e", "#8a4fb0", "#c0307a", "#1f5fbf")
STYLE = (
    "svg{background:#fff;font:13px system-ui,sans-serif;fill:#333}.grid{stroke:#ddd}.axis{fill:none;stroke:#888}"
    ".middle{text-anchor:middle}.end{text-anchor:end}polyline{fill:none;stroke-width:2}.title{font-weight:600;font-size:15px}"
    ".stated{stroke:#111;stroke-dasharray:2 4}"
    + "".join(f".m{k}{{stroke:{c}}}.d{k}{{fill:{c}}}" for k, c in enumerate(COLOURS))
)


def panel(
    rows: Scene, names: Sequence[str], ticks: Sequence[str], title: str, below: str
) -> Markup:
    """Shares of right matches over the Suns; dots filled where the picture is located."""
    last = len(rows) - 1
    axes = Axes(
        Axis(-0.15, last + 0.15, list(zip(range(last + 1), ticks, strict=True)), below),
        Axis(0.0, 1.0, [(v / 4, f"{25 * v} %") for v in range(5)], "right matches", grid=True),
        width=520.0, height=300.0, top=THUMB_PX + 44.0,
    )  # fmt: skip
    parts = [Markup('<text class="title" x="0" y="{}">{}</text>').format(-THUMB_PX - 24, title)]
    for k, name in enumerate(names):
        tallies = [row[name] for row in rows.values()]
        shares = [t.share for t in tallies]
        parts.append(axes.line(range(last + 1), shares, f"m{k}"))
        for x, y, tally in zip(*axes.at(range(last + 1), shares), tallies, strict=True):
            css = f"m{k} d{k}" if tally.located == "yes" else f"m{k}"
            fill = "" if tally.located == "yes" else ' fill="#fff"'
            parts.append(Markup(f'<circle class="{css}" cx="{x:.1f}" cy="{y:.1f}" r="4"{fill}/>'))
    stated = [row[OURS].stated for row in rows.values()]
    parts.append(axes.line(range(last + 1), [s or 0.0 for s in stated], "stated"))
    return axes.draw(Markup().join(parts), title, STYLE)


def picture(panels: Sequence[tuple[Markup, Thumbs]], names: Sequence[str]) -> str:
    """SVG of the panels beside each other, pictures above them, a legend below."""
    wide, high = 588, 540
    parts = []
    for k, (drawn, thumbs) in enumerate(panels):
        parts.append(str(drawn).replace("<svg", f'<svg x="{wide * k}" y="0" width="{wide}" height="496"', 1))  # fmt: skip
        for n, shown in enumerate(thumbs):
            small = cv2.resize(shown, (THUMB_PX, THUMB_PX), interpolation=cv2.INTER_AREA)
            jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
            code = base64.b64encode(jpeg.tobytes())
            x = wide * k + 56 + (520 - THUMB_PX) * n / (len(thumbs) - 1)
            parts.append(
                f'<image x="{x:.0f}" y="28" width="{THUMB_PX}" height="{THUMB_PX}" href="data:image/jpeg;base64,{code.decode()}"/>'
            )
    starts = accumulate((66 + 7 * len(name) for name in names), initial=56)
    for k, (x, name) in enumerate(zip(starts, names, strict=False)):
        parts.append(f'<path class="m{k}" stroke-width="3" d="M{x} 516h24"/><text x="{x + 30}" y="520">{name}</text>')  # fmt: skip
    x, box = 56, f'viewBox="0 0 {wide * len(panels)} {high}"'
    parts.append(
        f'<path class="stated" stroke-width="2" d="M{x} 534h24"/><text x="{x + 30}" y="538">probability that the '
        "catalogue states under the photograph's own Sun. Filled: located. "
        "lcp: of the points searched for; the others: of all matches.</text>"
    )
    return f'<svg xmlns="http://www.w3.org/2000/svg" {box} role="img"><style>{STYLE}</style>{"".join(parts)}</svg>\n'


def main(words: Sequence[str]) -> int:
    parser = evidence_parser("survival", __doc__)
    asked = parser.parse_args(words)
    folder = asked.output / "survival"
    catalogues = asked.output / "catalogues"
    for needed in (folder, catalogues):
        needed.mkdir(parents=True, exist_ok=True)
    every = dict(matchers())
    some = {name: match for name, match in every.items() if match}
    turned, shown = kept(folder, "photograph", photograph(asked.data, catalogues, some))
    suns, seen = kept(folder, "five Suns", five_suns(asked.data, folder, some))
    pair, _ = kept(folder, "two photographs", two_photographs(asked.data, some))
    missing = [f"Not installed, not run: {name}." for name, match in every.items() if not match]
    text = "\n\n".join([*missing, scene_table(turned), scene_table(pair), scene_table(suns)])
    (asked.output / "survival.md").write_text(text + "\n", encoding="utf-8")
    names = [name for name in (*every, OURS) if name in suns[MAP]]
    azimuths = dict(list(turned.items())[: len(TURNS_DEG)])
    ticks = [f"{t}°" for t in TURNS_DEG], ("am 10°", "am 30°", "noon", "pm 30°", "pm 10°")
    drawn = [
        panel(azimuths, names, ticks[0], f"{PHOTO}, Sun 14°, against renders", BELOW[0]),
        panel(suns, names, ticks[1], f"Simulated frames, map of one Sun ({MAP}°)", BELOW[1]),
    ]
    thumbs = [shown[n] for n in (0, 2, 4, 6)], seen
    figure = picture(list(zip(drawn, thumbs, strict=True)), names)
    (asked.output / "survival.svg").write_text(figure, encoding="utf-8")
    print(text)
    return 0
