"""A page of pictures: each reflectance model, each light, sphere and heightfield. ``make gallery`` runs it.

Every picture is made by the command below it, run in the repository's root; the panoramas, the albedo maps and the mock-up
are synthetic and made here. ``python docs/gallery.py FOLDER [--only SECTION]``.
"""

# ruff: noqa: E501 - lines of captions and markup

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path

import cv2
import numpy as np
import rasterio
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning
from rasterio.transform import from_origin
from reflectance_charts import (
    brightness_chart,
    incidence_chart,
    intensity_chart,
    phase_curve_chart,
    shadowing_chart,
)

from lcp_catalog.photometry.facet_file import facet_model
from lcp_catalog.photometry.laws import Reflectance, reflectance_model
from lcp_catalog.plots.png import encode_png
from lcp_catalog.rendering.rasters import picture

LCP = Path(sys.executable).with_name("lcp")
DEM = "sample_data/hadley_gld100_256ppd.tif"
CRATER = f"{DEM} --center 2.8 25.4 --size 24"
SPHERE = "--surface sphere --frame camera --center 0 0 --size 3500 --gsd 12000 --altitude 20000"
LAWS = (
    "lommel-seeliger",
    "lambert",
    "lunar-lambert",
    "minnaert",
    "hapke",
    "facet:labunets-2019-table-3",
)
MOON_M = 1737400.0


@dataclass(frozen=True)
class Shot:
    """A picture: its name, its caption, and the arguments of ``lcp render``; the pictures of a
    ``group`` have one grey scale. ``band``: of the output; "colour": red, green and blue.
    """

    name: str
    caption: str
    arguments: str
    group: str | None = None
    band: str = "radiance"


@dataclass(frozen=True)
class Section:
    """A heading, a remark on what to observe, and its pictures."""

    name: str
    title: str
    look_for: str
    shots: Sequence[Shot]


def laws() -> Section:
    shots = [
        Shot(
            f"law-{sun}-{law.replace(':', '-')}",
            f"{law}, Sun {sun}° high in the east",
            f"{CRATER} --sun-azimuth 90 --sun-elevation {sun} --reflectance {law}",
        )
        for sun in (10, 30, 70)
        for law in LAWS
    ]
    return Section(
        "laws", "One crater under every reflectance model", "Hadley C and the rille. Shadows are the same; the contrast of slopes is lower under Lommel-Seeliger than under Lambert, "
        "and lowest under a high Sun. Each picture has its own grey scale.", shots
    )  # fmt: skip


def phases() -> Section:
    shots = [
        Shot(
            f"sphere-{phase}-{law.replace(':', '-')}",
            f"{law}, phase {phase}°",
            f"{SPHERE} --sun-azimuth 90 --sun-elevation {90 - phase} --reflectance {law}",
            law,
        )
        for law in LAWS
        for phase in (2, 30, 90)
    ]
    return Section(
        "phases", "One sphere under every reflectance model, from 20 000 km", "The full Moon’s disc has no darker limb: Lommel-Seeliger and Hapke agree with this, Lambert does not. "
        "All pictures of a model have one grey scale: the brightness decreases with the phase as in the model’s phase function. The Sun is in the east, to the right; north is up.", shots
    )  # fmt: skip


def sides() -> Section:
    shots = []
    for azimuth, name in ((0, "north"), (90, "east"), (180, "south"), (270, "west")):
        sun = f"--sun-azimuth {azimuth} --sun-elevation 20"
        shots.append(
            Shot(
                f"crater-{name}",
                f"crater, Sun in the {name}: the far wall is lit, the near one in shadow",
                f"{CRATER} {sun}",
            )
        )
        shots.append(Shot(f"ball-{name}", f"sphere, Sun in the {name}", f"{SPHERE} {sun}"))
    for lat, name in ((60, "north"), (-60, "south")):
        place = SPHERE.replace("--center 0 0", f"--center 0 {lat}")
        shots.append(
            Shot(
                f"pole-{name}",
                f"sphere seen from over latitude {lat}°, the Sun over longitude 90° E",
                f"{place} --subsolar 90 0",
            )
        )
    return Section(
        "sides", "The Sun from each side", "The light comes from the direction in the caption, on a crater and on the sphere.", shots
    )  # fmt: skip


def lights(folder: Path) -> Section:
    low = f"{CRATER} --sun-azimuth 270 --sun-elevation 4"
    pano = [
        f"{CRATER} --environment {folder / name} --accuracy draft"
        for name in ("lamps.hdr", "overcast.hdr", "sun.hdr")
    ]
    shots = [
        Shot("light-point", "a point Sun 4° high in the west: hard shadows", f"{low} --sun point"),
        Shot("light-disc", "the Sun’s disc, 4° high: penumbrae", f"{low} --sun disc"),
        Shot("light-night", "earthshine alone, at new Moon: the full Earth at 65° in the south", f"{CRATER} --time 2024-01-11T12:00:00Z --earthshine"),
        Shot("light-lamps", "a panorama with two lamps, at 30° in the east and at 40° in the south-west: each lamp lights the shadow of the other", pano[0]),
        Shot("light-overcast", "a panorama of a uniform sky: no shadows, hollows are darker", pano[1]),
        Shot("light-sun", "a panorama with one small Sun at 20° in the east", pano[2]),
        Shot("light-that-sun", "that Sun alone", f"{CRATER} --sun-azimuth 90 --sun-elevation 20"),
    ]  # fmt: skip
    return Section(
        "lights", "One crater under every light", "Each light leaves other parts dark.", shots
    )


def matter(folder: Path) -> Section:
    made, marked = (
        folder / "made_albedo.tif",
        "a synthetic map: a chequerboard of 15° with a dark disc of 20° around 30° N 40° W and a bright one of 10° around 40° S 10° W",
    )
    crater = f"{CRATER} --sun-azimuth 90 --sun-elevation 20 --albedo {folder / 'made_rays.tif'}"
    shots = [
        Shot("albedo-near", f"{marked}; from over 0° N 0° E, Sun 60° high", f"{SPHERE} --sun-azimuth 90 --sun-elevation 60 --albedo {made}"),
        Shot("albedo-far", "the same map around the antimeridian: no seam", f"{SPHERE.replace('--center 0 0', '--center 180 0')} --sun-azimuth 90 --sun-elevation 60 --albedo {made}"),
        Shot("albedo-pole", "the same map around the north pole: no hole", f"{SPHERE.replace('--center 0 0', '--center 0 90')} --subsolar 0 30 --albedo {made}"),
        Shot("albedo-crater", "the crater with a synthetic map of rays from its centre", crater),
        Shot("albedo-colour", "a synthetic map in colour, seen by a camera of 40° from 4000 km over 10° E 20° N that looks 10° to the east of its nadir", f"--surface sphere --fov 40 --altitude 4000 --center 10 20 --look 90 -80 --image-size 300 300 --subsolar 60 1 --albedo {folder / 'made_colour.tif'}", None, "colour"),
        Shot("albedo-none", "the same without a map", crater.partition(" --albedo")[0]),
    ]  # fmt: skip
    return Section(
        "matter", "Albedo", "The map is at its place, neither mirrored nor shifted.", shots
    )


def mock_up(folder: Path) -> Section:
    model = f"{folder / 'mock_up.tif'} --frame camera --off-nadir 35 --view-azimuth 180 --altitude 0.01 --gsd 0.02 --accuracy draft"
    shots = [
        Shot("mock-up", "a boulder of a terrain mock-up under two lamps; its floor is not modelled", f"{model} --environment {folder / 'lamps.hdr'}"),
        Shot("mock-up-shadow", "the same with a shadow catcher: the shadows of both lamps on the panorama’s floor", f"{model} --environment {folder / 'lamps.hdr'} --shadow-catcher 0", None, "composite"),
    ]  # fmt: skip
    return Section(
        "mock-up",
        "A rendered object in a picture",
        "Shadows on a plane that is not modelled.",
        shots,
    )


# -- input files


def panoramas(folder: Path) -> None:
    """Three synthetic panoramas, equirectangular with the middle at north: two lamps, a uniform
    sky, one small Sun.
    """
    rows, cols = 256, 512
    elevation = np.radians(90.0 - (np.arange(rows) + 0.5) * 180.0 / rows)[:, None]
    azimuth = np.radians((np.arange(cols) + 0.5) * 360.0 / cols - 180.0)[None, :]
    floor = np.where(elevation < 0.0, 0.04, 0.0) * (1.0 + 0.3 * np.sign(np.sin(8 * azimuth)))

    def disc(azimuth_deg: float, elevation_deg: float, radius_deg: float) -> np.ndarray:
        a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
        cosine = np.sin(e) * np.sin(elevation) + np.cos(e) * np.cos(elevation) * np.cos(azimuth - a)
        return cosine > np.cos(np.radians(radius_deg))

    lamps = 0.05 + floor + 400.0 * disc(90, 30, 2.0) + 250.0 * disc(225, 40, 2.0)
    even = np.where(elevation > 0.0, 1.0, 0.0) + 0.0 * azimuth
    sun = 1e-4 + 5000.0 * disc(90, 20, 0.8)
    for name, light in (("lamps", lamps), ("overcast", even), ("sun", sun)):
        grey = np.repeat(np.broadcast_to(light, (rows, cols))[..., None], 3, axis=2)
        cv2.imwrite(str(folder / f"{name}.hdr"), np.ascontiguousarray(grey, dtype=np.float32))


def maps(folder: Path) -> None:
    """Synthetic albedo maps: a marked chequerboard of the Moon, the same in colours, and rays around the
    crater.
    """
    lon, lat = np.meshgrid(np.arange(-180, 180, 0.25) + 0.125, 90 - np.arange(0, 180, 0.25) - 0.125)
    board = 0.8 + 0.4 * ((np.floor(lon / 15) + np.floor(lat / 15)) % 2)
    for lon0, lat0, radius, value in ((-40, 30, 20, 0.4), (-10, -40, 10, 2.0)):
        cosine = np.sin(np.radians(lat)) * np.sin(np.radians(lat0))
        cosine += (
            np.cos(np.radians(lat)) * np.cos(np.radians(lat0)) * np.cos(np.radians(lon - lon0))
        )
        board[cosine > np.cos(np.radians(radius))] = value
    degree = np.radians(1.0) * MOON_M
    whole = from_origin(-180 * degree, 90 * degree, 0.25 * degree, 0.25 * degree)
    _raster(folder / "made_albedo.tif", board, whole)
    red = 1.0 + 0.4 * np.sin(np.radians(3 * lon))
    blue = 0.8 + 0.4 * np.cos(np.radians(5 * lat))
    _raster(folder / "made_colour.tif", board * np.stack([red, np.ones_like(red), blue]), whole)
    step = 0.002
    x, y = np.meshgrid(
        np.arange(2.0, 3.6, step) + step / 2 - 2.84,
        26.0 - np.arange(0, 1.2, step) - step / 2 - 25.45,
    )
    x, away = x * np.cos(np.radians(25.4)), np.hypot(x * np.cos(np.radians(25.4)), y)
    rays = 1.0 + 0.8 * np.exp(-((away - 0.11) / 0.25)) * (np.cos(9 * np.arctan2(y, x)) > 0.5) * (
        away > 0.11
    )
    _raster(
        folder / "made_rays.tif",
        rays,
        from_origin(2.0 * degree, 26.0 * degree, step * degree, step * degree),
    )


def boulder(folder: Path) -> None:
    """A boulder of 1.2 m, half a metre high, as a height map of 2 cm cells, surrounded by nodata."""
    step = 0.02
    x, y = np.meshgrid(
        np.arange(-2.0, 2.0, step) + step / 2, -np.arange(-2.0, 2.0, step) - step / 2
    )
    inside = 1.0 - (x / 0.7) ** 2 - (y / 0.5) ** 2
    height = (
        0.6 * np.sqrt(np.clip(inside, 0.0, None)) * (1.0 + 0.1 * np.sin(9 * x) * np.cos(11 * y))
    )
    height[inside <= 0.0] = -9999.0
    _raster(folder / "mock_up.tif", height, from_origin(-2.0, 2.0, step, step), -9999.0)


def _raster(
    path: Path, values: np.ndarray, transform: rasterio.Affine, nodata: float | None = None
) -> None:
    crs = CRS.from_proj4(f"+proj=eqc +R={MOON_M} +units=m +no_defs")
    bands = values.reshape(-1, *values.shape[-2:])
    shape = dict(zip(("count", "height", "width"), bands.shape, strict=True))
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        dtype="float32",
        crs=crs,
        transform=transform,
        nodata=nodata,
        **shape,
    ) as file:
        file.write(bands.astype(np.float32))


# -- the page


def shoot(section: Section, folder: Path) -> list[str]:
    """Render a section's pictures; return the figures of the page."""
    bands: dict[str, np.ndarray] = {}
    for shot in section.shots:
        output = folder / f"{shot.name}.tif"
        run = [str(LCP), "render", *shlex.split(shot.arguments), "-o", str(output), "--overwrite"]
        done = subprocess.run(run, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{shot.name}: {' '.join(run)}\n{done.stderr.strip()}")
        with (
            warnings.catch_warnings(action="ignore", category=NotGeoreferencedWarning),
            rasterio.open(output) as file,
        ):
            names = (
                [f"radiance_{colour}" for colour in ("red", "green", "blue")]
                if shot.band == "colour"
                else [shot.band]
            )
            found = file.read([file.descriptions.index(name) + 1 for name in names])
            bands[shot.name] = found if shot.band == "colour" else found[0]
    figures = []
    for shot in section.shots:
        together = [bands[s.name] for s in section.shots if s.group and s.group == shot.group]
        pixels = _grey(bands[shot.name], together)
        pixels = np.moveaxis(pixels, 0, -1) if pixels.ndim == 3 else pixels
        (folder / f"{shot.name}.png").write_bytes(encode_png(pixels))
        command = f"lcp render {shot.arguments} -o {shot.name}.tif"
        figures.append(f"<figure><img src='{shot.name}.png' alt='{escape(shot.caption)}'><figcaption>{escape(shot.caption)}<code>{escape(command)}</code></figcaption></figure>")  # fmt: skip
    return figures


def _grey(band: np.ndarray, together: list[np.ndarray]) -> np.ndarray:
    """Grey values as in a preview, or with a gamma of 2.2 between 0 and the 99.5th percentile of
    the group.
    """
    if not together:
        return picture(band)
    seen = np.concatenate([b[np.isfinite(b)] for b in together])
    top = np.percentile(seen, 99.5)
    return (255.0 * np.clip(np.nan_to_num(band) / top, 0.0, 1.0) ** (1 / 2.2)).astype(np.uint8)


def charts(folder: Path) -> list[str]:
    """Charts of the reflectance models."""
    figures = []
    for name, caption, make in CHARTS:
        (folder / f"{name}.svg").write_text(make(), encoding="utf-8")
        figures.append(
            f"<figure class='wide'><img src='{name}.svg' alt='{escape(caption)}'><figcaption>{escape(caption)}</figcaption></figure>"
        )
    return figures


def _laws_of(*names: str) -> list[Reflectance]:
    return [reflectance_model(name) for name in names]


_PAINT = facet_model("labunets-2019-table-3")
_LUNAR = ("lommel-seeliger:rolo", "lambert", "lunar-lambert", "minnaert", "hapke")
CHARTS: tuple[tuple[str, str, Callable[[], str]], ...] = (
    (
        "phase-curves",
        "The Moon's disc under each law, beside the observed one",
        lambda: phase_curve_chart(_laws_of(*_LUNAR)),
    ),
    *(
        (
            f"polar-{law.replace(':', '-')}",
            f"{law}: directions of the light that level terrain reflects",
            partial(incidence_chart, reflectance_model(law)),
        )
        for law in LAWS
    ),
    (
        "facet-lobes",
        "The measured paint of table 3 and its lobes",
        lambda: brightness_chart(_PAINT, (0.0, 30.0, 60.0, 70.0)),
    ),
    (
        "facet-intensity",
        "The same as intensities (the paper's figure 6)",
        lambda: intensity_chart(_PAINT, (0.0, 30.0, 50.0, 60.0)),
    ),
    (
        "facet-shadowing",
        "Share of the facets that are lit and visible (the paper's figure 7)",
        lambda: shadowing_chart(_PAINT, (0.0, 30.0, 50.0, 60.0)),
    ),
)

STYLE = """body{margin:0 auto;max-width:1200px;padding:24px;background:#16171b;color:#e8e8ea;font:16px/1.5 system-ui,sans-serif}
h2{margin:40px 0 4px}p{max-width:80ch;color:#b5b7bf}.shots{display:grid;grid-template-columns:repeat(auto-fill,minmax(300px,1fr));gap:16px}
figure{margin:0}.wide{grid-column:1/-1;background:#fff}img{width:100%;image-rendering:pixelated;display:block}figcaption{font-size:.85rem;color:#cfd0d6}
code{display:block;font-size:.68rem;color:#8d909b;overflow-wrap:anywhere}.wide figcaption{color:#333;padding:4px 8px}"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", help="one section alone, by name")
    asked = parser.parse_args()
    folder = asked.folder
    folder.mkdir(parents=True, exist_ok=True)
    for made in (panoramas, maps, boulder):
        made(folder)
    sections = [laws(), phases(), sides(), lights(folder), matter(folder), mock_up(folder)]
    parts = [
        f"<h2>The reflectance models as curves</h2><div class='shots'>{''.join(charts(folder))}</div>"
    ]
    for section in sections:
        if asked.only in (None, section.name):
            figures = "".join(shoot(section, folder))
            parts.append(
                f"<h2>{escape(section.title)}</h2><p>{escape(section.look_for)}</p><div class='shots'>{figures}</div>"
            )
            print(f"{section.name}: {len(section.shots)} pictures", flush=True)
    page = f"<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><title>lcp: light and matter</title><style>{STYLE}</style></head><body><h1>Light and matter</h1>"
    page += (
        "<p>Each picture was made by the command below it, run in the repository’s root.</p>"
        + "".join(parts)
        + "</body></html>\n"
    )
    (folder / "index.html").write_text(page, encoding="utf-8")
    print(f"gallery    {folder / 'index.html'}")


if __name__ == "__main__":
    main()
