"""Files of a product: the label of an image, the image of a label.

Binary tables that ISIS's spiceinit attaches to a cube: the position of the Sun at the time of
the image.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array
from ..errors import LabelError
from ..geometry import rotations
from . import pds3
from .label import Label
from .pds3 import read_label_text, read_pds3
from .pds4 import is_pds4, read_pds4

log = logging.getLogger(__name__)


def sun_of_tables(path: Path, isis: Mapping[str, Any]) -> Array | None:
    """Position of the Sun, MCMF metres (3,), from the tables that ISIS's spiceinit attached to a
    cube; None without them.

    SunPosition holds the Sun from the centre of the body in J2000 axes, kilometres; BodyRotation
    the quaternions (scalar first) from J2000 to a frame, and a constant rotation from there to the
    body-fixed frame. The result is the mean over the records of the rotation, which cover the
    exposure.
    """
    try:
        sun = _table(path, isis["Table_SunPosition"], ("J2000X", "J2000Y", "J2000Z"))
        turns = _table(
            path, isis["Table_BodyRotation"], tuple(f"J2000Q{number}" for number in range(4))
        )
    except KeyError:
        return None
    except (OSError, ValueError, TypeError) as error:
        log.warning("%s: the Sun in its tables is ignored: %s", path, error)
        return None
    j2000 = sun.mean(axis=0)
    constant = isis["Table_BodyRotation"].get("ConstantRotation", np.eye(3).ravel())
    turns = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    fixed = rotations.turned(turns, j2000).mean(axis=0)
    position = 1e3 * np.array(constant, dtype=np.float64).reshape(3, 3) @ fixed
    if not 1e11 < np.linalg.norm(position) < 2e11:
        log.warning(
            "%s: the Sun in its tables is %g m away and is ignored", path, np.linalg.norm(position)
        )
        return None
    return np.asarray(position)


def _table(path: Path, table: Mapping[str, Any], columns: tuple[str, ...]) -> Array:
    """Columns (records, n) of a binary table; all its fields are doubles in every version of these
    tables.
    """
    fields = [value for key, value in table.items() if key.startswith("Field_") and "Name" in value]
    if any(field["Type"] != "Double" or int(field["Size"]) != 1 for field in fields):
        raise ValueError(f"table {table.get('Name')} holds fields other than doubles")
    names = [field["Name"] for field in fields]
    order = "<" if str(table.get("ByteOrder", "Lsb")).lower() == "lsb" else ">"
    count, start = int(table["Records"]), int(table["StartByte"]) - 1
    values = np.fromfile(path, f"{order}f8", count * len(names), offset=start)
    if values.size == 0 or values.size != count * len(names):
        raise ValueError(f"table {table.get('Name')} is truncated")
    return values.reshape(count, -1)[:, [names.index(name) for name in columns]].astype(np.float64)


def product_label(path: Path) -> Label | None:
    """The label of a product, given by its label or its image; None for a file that needs none
    (GeoTIFF).

    LabelError for an .IMG or .JP2 without its label, and for a label that is not supported or
    contradicts itself.
    """
    ending = path.suffix.lower()
    if ending == ".lbl" or read_label_text(path) is not None:
        return read_pds3(path)
    if ending == ".xml" and is_pds4(path):
        return read_pds4(path)
    if ending not in (".img", ".jp2"):
        return None
    try:
        return read_pds3(find_label(path))
    except LabelError:
        beside = [
            p for p in sorted(path.parent.iterdir()) if p.name.lower() == f"{path.stem.lower()}.xml"
        ]
        if beside and is_pds4(beside[0]):
            return read_pds4(beside[0])
        raise


def find_label(image: Path) -> Path:
    """The label file of an image: the image itself if the label is attached, else a file beside it.
    LabelError if there is none.

    LDEM_4.JP2 belongs to LDEM_4_JP2.LBL and not to LDEM_4.LBL, whose .IMG has another grid (0..360
    instead of -180..180).
    """
    if read_label_text(image) is not None:
        return image
    beside = {p.name.lower(): p for p in sorted(image.parent.iterdir())}
    stem, ending = image.stem.lower(), image.suffix.lower().lstrip(".")
    for name in (f"{stem}_{ending}.lbl", f"{stem}.lbl"):
        label = beside.get(name)
        if label is not None and (ending != "jp2" or _describes_compressed(label)):
            return label
    wanted = f"{image.stem}_JP2.LBL" if ending == "jp2" else f"{image.stem}.LBL"
    why = (
        "a JP2 does not state the scale of its heights"
        if ending == "jp2"
        else "an .IMG holds samples only"
    )
    raise LabelError(
        f"{image}: its label {wanted} is missing ({why}); put the label of the product beside it"
    )


def find_image(label: Label) -> Path:
    """The file with the pixels that a label describes; the case of its name does not matter.
    LabelError if it is missing.
    """
    if label.image_name == "":
        return label.path
    for path in sorted(label.path.parent.iterdir()):
        if path.name.lower() == label.image_name.lower():
            return path
    raise LabelError(
        f"{label.path}: the image that it describes, {label.image_name}, is not beside it; put it there"
    )


def _describes_compressed(path: Path) -> bool:
    try:
        return "COMPRESSED_FILE" in pds3.parse_pvl(read_label_text(path) or "")
    except LabelError as error:
        raise LabelError(f"{path}: {error}") from None
