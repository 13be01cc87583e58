"""Files of a product: the label of an image, the image of a label."""

from __future__ import annotations

from pathlib import Path

from ..errors import LabelError
from . import pvl
from .label import Label
from .pds3 import read_label_text, read_pds3
from .pds4 import is_pds4, read_pds4


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
        return "COMPRESSED_FILE" in pvl.parse_pvl(read_label_text(path) or "")
    except LabelError as error:
        raise LabelError(f"{path}: {error}") from None
