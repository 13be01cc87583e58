"""Binary tables that ISIS's spiceinit attaches to a cube: the position of the Sun at the time of
the image.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array
from ..geometry import rotations

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
