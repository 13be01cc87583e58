"""PDS4 labels (XML) of lunar DEM products.

Elements as in LOLA's LDEM labels: ``cart:`` for the map, one ``Array_2D`` for the pixels. GDAL
reads such files too, but gives zeros for the missing end of a truncated image and ignores
west-positive longitudes.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree import ElementTree

from ..errors import LabelError
from . import pds3
from .label import DeclaredStatistics, Label, beginning, file_bytes, refuse_foreign

_DTYPES = {
    "IEEE754LSBSingle": "<f4",
    "IEEE754MSBSingle": ">f4",
    "IEEE754LSBDouble": "<f8",
    "IEEE754MSBDouble": ">f8",
    "SignedLSB2": "<i2",
    "SignedMSB2": ">i2",
    "SignedLSB4": "<i4",
    "SignedMSB4": ">i4",
}
_CYLINDRICAL = {"simple cylindrical", "equirectangular", "equidistant cylindrical"}
_CONSTANTS = (
    "missing_constant",
    "invalid_constant",
    "unknown_constant",
    "not_applicable_constant",
    "saturated_constant",
)


def is_pds4(path: Path) -> bool:
    """True if the file is the label of a PDS4 observational product."""
    return b"<Product_Observational" in beginning(path, 65_536)


def read_pds4(path: Path) -> Label:
    """The label in an XML file. LabelError states what is wrong with it."""
    try:
        return _Pds4(xml_root(path), path).label()
    except LabelError as error:
        raise LabelError(f"{path}: {error}") from None


def xml_root(path: Path) -> ElementTree.Element:
    """The outermost element of an XML file. LabelError, without the path, for damaged XML."""
    try:
        return ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # of encodings, too
        raise LabelError(f"damaged XML ({error}); fetch the label again") from error


class _Pds4:
    """Elements of a label by their names without the prefixes of namespaces."""

    def __init__(self, root: ElementTree.Element, path: Path) -> None:
        self.path = path
        self.found: dict[str, list[ElementTree.Element]] = {}
        for element in root.iter():
            self.found.setdefault(str(element.tag).rpartition("}")[2], []).append(element)

    def text(self, key: str) -> str:
        """Text of the first element of a name; empty if there is none."""
        return ((self.found[key][0].text or "") if key in self.found else "").strip()

    def number(self, key: str) -> float:
        try:
            value = float(self.text(key))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise LabelError(
                f"the label does not give {key} as a number (it says {self.text(key)!r})"
            )
        return value

    def maybe(self, key: str) -> float | None:
        return self.number(key) if self.text(key) else None

    def metres(self, key: str) -> float:
        """A length in metres, by its own unit ("m", "km", "m/pixel")."""
        unit = self.found[key][0].get("unit", "") if key in self.found else ""
        if not unit:
            raise LabelError(f"{key} has no unit: metres or kilometres?")
        return self.number(key) * pds3.metres(unit.split("/")[0], key)

    def label(self) -> Label:
        self._refuse_foreign_maps()
        projection, latitude, center = self._projection()
        lines, samples = self._size()
        pixel_m = self._pixel_m()
        dtype = _DTYPES.get(self.text("data_type"))
        name = self.text("file_name")
        if dtype is None:
            raise LabelError(
                f"samples of type {self.text('data_type') or '(none)'} are not supported"
            )
        if not name:
            raise LabelError("the label does not name its image (file_name)")
        return Label(
            path=self.path,
            product_id=Path(name).stem.upper(),
            projection=projection,
            center_lon_deg=center,
            center_lat_deg=latitude,
            pixel_m=pixel_m,
            line_offset=self.metres("upperleft_corner_y") / pixel_m
            - 0.5,  # the corner's own corner: half a pixel
            sample_offset=-self.metres("upperleft_corner_x") / pixel_m - 0.5,
            lines=lines,
            line_samples=samples,
            height_scale_m=self._height_scale_m(),
            missing=tuple(
                float(v) for v in (self.maybe(key) for key in _CONSTANTS) if v is not None
            ),
            sample_dtype=dtype,
            image_name=name,
            image_offset_bytes=file_bytes(self.number("offset"), "offset"),
            compressed=False,
            declared=self._declared(),
        )

    def _refuse_foreign_maps(self) -> None:
        targets = [
            (e.findtext("{*}name") or "").strip()
            for e in self.found.get("Target_Identification", [])
        ]
        if any(target.upper() != "MOON" for target in targets):
            raise LabelError(f"the label's target is {targets[0]}; only the Moon is supported")
        if "map_projection_name" not in self.found:
            raise LabelError(
                "the label has no cart:map_projection_name; a map-projected DEM is required"
            )
        for key in ("a_axis_radius", "b_axis_radius", "c_axis_radius"):
            refuse_foreign(self.metres(key), key)
        if self.text("longitude_direction").lower() not in ("", "positive east"):
            raise LabelError("west-positive longitudes are not supported")
        for key in ("map_projection_rotation", "oblique_proj_pole_latitude"):
            if self.maybe(key):
                raise LabelError(f"a map with {key} {self.number(key):g} is not supported")
        if self.text("line_display_direction").lower() == "bottom to top":
            raise LabelError("lines that run from bottom to top are not supported")

    def _projection(self) -> tuple[str, float, float]:
        """(projection, standard parallel or +-90, centre longitude)."""
        name, center = (
            self.text("map_projection_name").lower(),
            self.number("longitude_of_central_meridian"),
        )
        latitude = self.number("latitude_of_projection_origin")
        if name == "polar stereographic" and abs(latitude) == 90.0:
            return "polar-stereographic", latitude, center
        if name in _CYLINDRICAL and latitude == 0.0:
            return "equirectangular", self.maybe("standard_parallel_1") or 0.0, center
        raise LabelError(
            f"map projection {self.text('map_projection_name')} at latitude {latitude:g} is not supported; "
            "cylindrical and polar stereographic are"
        )

    def _size(self) -> tuple[int, int]:
        axes = {
            (axis.findtext("{*}axis_name") or "").strip().lower(): axis.findtext("{*}elements")
            or ""
            for axis in self.found.get("Axis_Array", [])
        }
        lines, samples = axes.get("line", ""), axes.get("sample", "")
        if set(axes) != {"line", "sample"} or not (
            re.fullmatch(r"[0-9]{1,9}", lines.strip())
            and re.fullmatch(r"[0-9]{1,9}", samples.strip())
        ):
            raise LabelError("an array of lines and samples with one band is required")
        if (
            self.text("axis_index_order") != "Last Index Fastest"
            or len(self.found.get("Element_Array", [])) != 1
        ):
            raise LabelError("one array whose samples run fastest is required")
        return int(lines), int(samples)

    def _pixel_m(self) -> float:
        across, down = self.metres("pixel_resolution_x"), self.metres("pixel_resolution_y")
        if not across > 0.0 or abs(across - down) > 1e-6 * across:
            raise LabelError(f"square pixels are required, not {across:g} x {down:g} m")
        return across

    def _height_scale_m(self) -> float:
        unit, radius = self.text("unit"), self.maybe("value_offset")
        if not unit:
            raise LabelError("the heights have no unit: metres or kilometres?")
        metres, factor = pds3.metres(unit, "unit"), self.maybe("scaling_factor")
        if radius:
            refuse_foreign(radius * metres, "value_offset")
        return metres if factor is None else factor * metres

    def _declared(self) -> DeclaredStatistics:
        size = self.maybe("file_size")
        return DeclaredStatistics(
            minimum=self.maybe("minimum"),
            maximum=self.maybe("maximum"),
            md5=self.text("md5_checksum").lower() or None,
            file_bytes=None if size is None else file_bytes(size, "file_size"),
            north_deg=self.maybe("north_bounding_coordinate"),
            south_deg=self.maybe("south_bounding_coordinate"),
            east_deg=self.maybe("east_bounding_coordinate"),
        )
