"""Text of ``lcp dem info``, from its JSON: single files, and all files together."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lcp_catalog.geometry.bounds import Bounds

_MOST = 5
"""Greatest number of listed overlaps, gaps and files with missing pixels; the JSON has all."""


def file_text(one: dict[str, Any]) -> str:
    """Path and facts of a file, one a line."""
    size = f"{one['width']} x {one['height']} pixels of {one['gsd_m']:.10g} m"
    rows = [
        ("product", one["product"]),
        ("projection", f"{one['projection']}, {size}"),
        ("bounds", _box(one["bounds"])),
        ("heights", _heights(one)),
        ("no data", _missing(one["nodata_share"])),
        ("use", _use(one)),
    ]
    if one["vertical_uncertainty_m"] is not None:
        rows.append(("uncertainty", f"{one['vertical_uncertainty_m']:g} m of height (1 sigma)"))
    rows += [("resolves", text) for text in _resolved(one)]
    rows += [(f"at {s['lon']:g} {s['lat']:g}", _sample(s, one["bounds"])) for s in one["samples"]]
    return "\n".join([one["path"], *_aligned(rows)])


def _use(one: dict[str, Any]) -> str:
    """Latitudes for which the product is meant, and where its heights are another product's."""
    span, filled = one["abs_latitude_use"], one["filled_beyond_deg"]
    if span is not None:
        return f"latitudes {span[0]:g} .. {span[1]:g} north and south"
    if filled is None or max(-one["bounds"]["south"], one["bounds"]["north"]) <= filled:
        return "any latitude"
    return (
        f"latitudes up to {filled:g} north and south; beyond, the file is filled with heights of "
        f"{one['filled_with']}: use a {one['filled_with']} product of the pole"
    )


def _resolved(one: dict[str, Any]) -> list[str]:
    """The measured resolution with its interval, and the published one; an empty list of neither."""
    found, published = one["effective_resolution_m"], one["resolution_m"]
    lines = []
    if found is not None:
        sides = [one["effective_resolution_low_m"], one["effective_resolution_high_m"]]
        low, high = map(_rounded, sides)
        lines.append(
            f"{_rounded(found)} m on the surface by its heights (1 sigma: {low} .. {high} m)"
        )
    if published is not None:
        lines.append(f"{published:g} m as published")
    return lines


def _rounded(metres: float) -> str:
    """Metres in three digits or more."""
    return f"{metres:.0f}" if metres >= 100.0 else f"{metres:.3g}"


def set_text(whole: dict[str, Any]) -> str:
    """Coverage of all files together; of a single file only its coverage and missing pixels."""
    files = whole["files"]
    names = _short_names([file["path"] for file in files])
    title = "coverage" if len(files) == 1 else f"{len(files)} files together"
    rows = [("covered", _covered(whole)), ("reaches", _reaches(whole))]
    if len(files) > 1:
        rows.insert(0, ("bounds", _box(whole["bounds"])))
        rows += _uses(files, names) + _overlaps(whole["overlaps"], names) + _gaps(whole["gaps"])
    rows += _holes(whole["holes"], names)
    rows += [("warning", one["message"]) for one in whole["disagreements"] or []]
    table = _table(whole["bands"], len(files) > 1)
    return "\n".join([title, *_aligned(rows), "", *(f"  {line}".rstrip() for line in table)])


def _aligned(rows: list[tuple[str, str]]) -> list[str]:
    """Names and values in two columns; a repeated name is printed once."""
    width = max(len(name) for name, _ in rows)
    said, lines = "", []
    for name, value in rows:
        lines.append(f"  {'' if name == said else name:<{width}}  {value}".rstrip())
        said = name
    return lines


def _table(bands: list[dict[str, Any]], together: bool) -> list[str]:
    """One line for each band of latitude; of one file only the covered share, equal neighbours in
    one line.
    """
    head = ["latitude", "covered"] + (["overlap", "gaps, km2", "used"] if together else [])
    cells = [head]
    for band in bands if together else _merged(bands):
        used = ", ".join(f"{name} {_percent(share)}" for name, share in band["used_share"].items())
        more = [_percent(band["overlap_share"]), _number(band["gap_km2"]), used] if together else []
        cells.append([_latitudes(band), _percent(band["covered_share"]), *more])
    widths = [max(len(line[column]) for line in cells) for column in range(len(head))]
    return [
        "  ".join(
            f"{cell:{way}{width}}" for cell, way, width in zip(line, "<>>><", widths, strict=False)
        )
        for line in cells
    ]


def _merged(bands: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Neighbouring bands with the same covered share as one, from north to south."""
    found: list[dict[str, Any]] = []
    for band in bands:
        if (
            found
            and found[-1]["south"] == band["north"]
            and found[-1]["covered_share"] == band["covered_share"]
        ):
            found[-1] = {**found[-1], "south": band["south"]}
        else:
            found.append(band)
    return found


def _covered(whole: dict[str, Any]) -> str:
    return f"{_km2(whole['covered_km2'])}, {_percent(whole['moon_share'])} of the Moon"


def _reaches(whole: dict[str, Any]) -> str:
    """Poles, full ring and antimeridian, as far as the set reaches them."""
    poles = [name for name in ("north", "south") if whole[f"has_{name}_pole"]]
    said = [f"the {poles[0]} pole" if len(poles) == 1 else "both poles"] if poles else ["no pole"]
    if whole["is_full_ring"]:
        said.append("all the way around")
    elif whole["crosses_antimeridian"]:
        said.append("across longitude 180")
    return ", ".join(said)


def _uses(files: list[dict[str, Any]], names: dict[str, str]) -> list[tuple[str, str]]:
    """Used share of each file that others replace somewhere."""
    return [
        (
            "used",
            f"{names[file['path']]}: {_percent(file['used_km2'] / file['area_km2'])} of its area",
        )
        for file in files
        if file["used_km2"] < 0.999999 * file["area_km2"]
    ]


def _overlaps(overlaps: list[dict[str, Any]], names: dict[str, str]) -> list[tuple[str, str]]:
    words = [
        f"{names[one['files'][0]]} and {names[one['files'][1]]}: {_km2(one['area_km2'])}"
        for one in overlaps
    ]
    return _listed("overlaps", words)


def _gaps(gaps: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """Gaps; those that files enclose come first, since gaps at the edge of the box are often only
    an outline.
    """
    ordered = sorted(gaps, key=lambda gap: (gap["at_edge"], -gap["area_km2"]))
    words = [
        f"{_km2(gap['area_km2'])} within {_box(gap['bounds'])}"
        + ("; open to the box's edge" if gap["at_edge"] else "")
        for gap in ordered
    ]
    return _listed("gaps", words)


def _holes(holes: list[dict[str, Any]] | None, names: dict[str, str]) -> list[tuple[str, str]]:
    """Missing pixels of each file; another file can have heights there."""
    if holes is None:
        return [("holes", "not read (--quick)")]
    return _listed("holes", [f"{names[one['path']]}: {_hole(one)}" for one in holes])


def _hole(one: dict[str, Any]) -> str:
    first = one["largest"][0]
    return (
        f"{_km2(one['area_km2'])} of missing pixels, {_percent(one['share'])} of its area, the largest region "
        f"{_km2(first['area_km2'])} within {_box(first['bounds'])}"
    )


def _listed(name: str, words: list[str]) -> list[tuple[str, str]]:
    """The first words, and the number of the others."""
    more = [f"and {len(words) - _MOST} more"] if len(words) > _MOST else []
    return [(name, text) for text in (words[:_MOST] or ["none"]) + more]


def _short_names(paths: list[str]) -> dict[str, str]:
    """File names if they are unique, else the paths as given."""
    names = [Path(path).name for path in paths]
    return {p: n if names.count(n) == 1 else p for p, n in zip(paths, names, strict=True)}


def _latitudes(band: dict[str, Any]) -> str:
    south, north = band["south"], band["north"]
    if south < 0.0 < north:
        return f"{-south:g} S .. {north:g} N"
    low, high = sorted((abs(south), abs(north)))
    return f"{low:g} .. {high:g} {'N' if north > 0.0 else 'S'}"


def _box(box: dict[str, float]) -> str:
    return (
        f"longitude {box['west']:.6g} .. {box['east']:.6g}, latitude "
        f"{box['south']:.6g} .. {box['north']:.6g}"
    )


def _heights(one: dict[str, Any]) -> str:
    if one["min_m"] is None:
        return "none" if one["nodata_share"] is not None else "not read (--quick)"
    return f"{one['min_m']:.2f} .. {one['max_m']:.2f} m above the sphere of {one['radius_m']:.0f} m"


def _missing(share: float | None) -> str:
    return "not read (--quick)" if share is None else f"{100.0 * share:.4f} % of the pixels"


def _sample(place: dict[str, Any], box: dict[str, float]) -> str:
    """The height at a place, or why there is none: in a file of an area, places outside it, too."""
    if place["height_m"] is not None:
        return f"{place['height_m']:.2f} m"
    lon, lat = place["lon"], place["lat"]
    bounds = Bounds(box["west"], box["south"], box["east"], box["north"])
    inside = bounds.contains([lon, lat], [lat, lon])
    asked = ": are longitude and latitude exchanged?" if inside[1] else ""
    return "no data" if inside[0] else f"outside the file{asked}"


def outside(files: list[dict[str, Any]]) -> Iterator[str]:
    """A line for each place that lies in none of the files."""
    for told in zip(*(one["samples"] for one in files), strict=True):
        said = {_sample(place, one["bounds"]) for place, one in zip(told, files, strict=True)}
        if all(one.startswith("outside") for one in said):
            yield f"--at {told[0]['lon']:g} {told[0]['lat']:g}: {min(said, key=len)}; give a place within its bounds"


def _percent(share: float) -> str:
    """A percentage that is 100 % or 0 % only if it is exact."""
    if 0.0 < share < 1.0 - 1e-9:
        percent = 100.0 * share
        if percent < 0.005:
            return "<0.01 %"
        if percent > 99.995:
            return ">99.99 %"
    return f"{100.0 * share:.2f} %"


def _number(value: float) -> str:
    if value < 1e-6:
        return "0"
    return f"{value:.3g}" if value < 100.0 else f"{value:,.0f}".replace(",", " ")


def _km2(value: float) -> str:
    return f"{_number(value)} km2"
