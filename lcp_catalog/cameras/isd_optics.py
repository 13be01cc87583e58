"""Lens and detector of an ISD."""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from .distortion import KaguyaLism, Lens, LroNac, NoLens, OpenCV, UsgsRadial
from .focal_plane import FocalPlane, plane_of
from .json_fields import JsonFields

CORNER_PX = 0.5
"""Offset from an ISD's lines and samples, which count from the corner, to pixels."""

_SKEWEST = 1e3
_BACK = np.diag([-1.0, 1.0, -1.0])


def plane_of_isd(
    fields: JsonFields, *, looks_back: bool, upside_down: int | None = None
) -> tuple[FocalPlane, Array]:
    """Focal plane from directions to pixels of the image, of a framelet (with first row 0), or of a
    line (with upper edge -0.5), and rotation (3, 3) from the ISD's sensor frame to its axes.

    ``looks_back``: True if the scene is towards -z of the sensor frame. ``upside_down``: number of
    rows of a framelet whose last line is first in the image. CameraError for an invalid field.
    """
    matrix, origin = np.empty((2, 2)), np.empty(2)
    for i, axis in enumerate(("sample", "line")):
        summing = fields.positive(f"detector_{axis}_summing")
        offset, *matrix[i] = fields.numbers(f"focal2pixel_{axis}s", (3,)) / summing
        centre = fields.number(f"detector_center.{axis}")
        start = fields.number(f"starting_detector_{axis}")
        origin[i] = offset + (centre - start) / summing - CORNER_PX
    if not np.linalg.cond(matrix) < _SKEWEST:
        fields.refuse("focal2pixel_lines", "and focal2pixel_samples are parallel")
    if upside_down is not None:
        matrix[1], origin[1] = -matrix[1], upside_down - 1.0 - origin[1]
    focal_mm = fields.positive("focal_length_model.focal_length")
    column, row = origin.tolist()
    plane, turn = plane_of(_lens(fields), focal_mm, matrix, (column, row), flipped=looks_back)
    # half a turn about y brings the scene ahead; this changes the sign of y / z but not of x / z
    return plane, turn @ _BACK if looks_back else turn


def _lens(fields: JsonFields) -> Lens:
    """The lens, in millimetres of the focal plane."""
    stated = fields.need("optical_distortion")
    kinds = {"radial": _radial, "radtan": _radtan, "lrolrocnac": _lro_nac, "kaguyalism": _kaguya}
    if not isinstance(stated, dict) or len(stated) != 1 or not set(stated) <= set(kinds):
        said = ", ".join(stated) if isinstance(stated, dict) else stated
        fields.refuse("optical_distortion", f"is {said}; supported are {', '.join(kinds)}")
    return kinds[next(iter(stated))](fields)


def _coefficients(fields: JsonFields, kind: str, most: int) -> list[float]:
    path = f"optical_distortion.{kind}.coefficients"
    numbers = fields.numbers(path, (None,)).tolist()
    if any(numbers[most:]):
        fields.refuse(path, f"has more than {most} numbers")
    return [*numbers, *[0.0] * most][:most]


def _radial(fields: JsonFields) -> Lens:
    k0, k1, k2 = _coefficients(fields, "radial", 3)
    return UsgsRadial(k0, k1, k2) if k0 or k1 or k2 else NoLens()


def _radtan(fields: JsonFields) -> Lens:
    return OpenCV(*_coefficients(fields, "radtan", 5))


def _lro_nac(fields: JsonFields) -> Lens:
    return LroNac(*_coefficients(fields, "lrolrocnac", 1))


def _kaguya(fields: JsonFields) -> Lens:
    path = "optical_distortion.kaguyalism"
    (a0, a1, a2, a3), (b0, b1, b2, b3) = (
        fields.numbers(f"{path}.{axis}", (4,)).tolist() for axis in ("x", "y")
    )
    x, y = (fields.number(f"{path}.boresight_{axis}") for axis in ("x", "y"))
    return KaguyaLism((a0, a1, a2, a3), (b0, b1, b2, b3), x, y)
