"""Readers of other programs' landmark files, written from their published layouts alone, without code
of the package.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np


def read_lvs_map(path: Path) -> dict[str, Any]:
    """A landmark map of JPL's landmark_tools: `Read_LMK` of its landmark.c, field by field."""
    data = path.read_bytes()
    place = 64

    def take(kind: str) -> Any:
        nonlocal place
        found = struct.unpack_from(">" + kind, data, place)
        place += struct.calcsize(">" + kind)
        return found

    found: dict[str, Any] = {"version": data[:32], "id": data[32:64].rstrip(b"\0").decode("ascii")}
    found["body"], columns, rows = take("iii")
    found["anchor_column"], found["anchor_row"], found["resolution_m"] = take("ddd")
    found["anchor_m"] = np.array(take("ddd"))
    found["map_from_world"] = np.array(take("9d")).reshape(3, 3)
    found["reflectance"] = np.array(take(f"{rows * columns}B")).reshape(rows, columns)
    found["height_m"] = np.array(take(f"{rows * columns}f")).reshape(rows, columns)
    assert place == len(data)
    return found


def lvs_node(lmk: dict[str, Any], column: int, row: int) -> np.ndarray:
    """World position of a pixel: `LMK_Col_Row_Elevation2World` of landmark.c."""
    x = lmk["resolution_m"] * column - lmk["resolution_m"] * lmk["anchor_column"]
    y = -lmk["resolution_m"] * row + lmk["resolution_m"] * lmk["anchor_row"]
    on_map = np.array([x, y, lmk["height_m"][row, column]])
    return lmk["map_from_world"].T @ on_map + lmk["anchor_m"]


def read_spc_landmark(path: Path) -> dict[str, Any]:
    """A landmark of SPC, as its programs read it: by the order of the lines."""
    lines = path.read_text(encoding="ascii").splitlines()

    def numbers(line: str, count: int) -> np.ndarray:
        return np.array([float(word.replace("D", "E")) for word in line.split()[:count]])

    size, scale = lines[1].split()[:2]
    assert lines.index("PICTURES") == 9
    assert "END FILE" in lines
    return {
        "name": lines[0][:6],
        "half": int(size),
        "scale_km": float(scale),
        "position_km": numbers(lines[4], 3),
        "axes": np.stack([numbers(lines[k], 3) for k in (5, 6, 7)]),
        "sigma_km": numbers(lines[8], 3),
        "labels": [line.split()[-1] for line in lines[4:9]],
        "last": lines[-1],
    }


def read_spc_maplet(path: Path) -> dict[str, Any]:
    """A maplet of SPC: the bytes that its READ_MAP takes (counted from 1 there), record by record."""
    data = path.read_bytes()
    assert len(data) % 72 == 0
    first = data[:72]

    def reals(start: int, count: int) -> np.ndarray:
        return np.array(struct.unpack(f">{count}f", first[start - 1 : start - 1 + 4 * count]))

    half = first[10] + 256 * first[11]
    height, albedo = np.zeros((2 * half + 1, 2 * half + 1)), np.zeros((2 * half + 1, 2 * half + 1))
    [scale] = reals(64, 1)
    number = 0
    for j in range(2 * half + 1):  # along UX
        for i in range(2 * half + 1):  # along UY
            record, place = divmod(number, 24)
            cell = data[72 * (record + 1) + 3 * place :][:3]
            height[j, i] = scale * int.from_bytes(cell[:2], "big", signed=True)
            albedo[j, i] = 0.01 * cell[2]
            number += 1
    return {
        "frame": first[:6].decode("ascii"),
        "scale_km": reals(7, 1)[0],
        "half": half,
        "sigma_share": np.array(list(first[12:15])) / 255.0,
        "position_km": reals(16, 3),
        "axes": reals(28, 9).reshape(3, 3),
        "sigma_km": reals(68, 1)[0],
        "height_cells": height,
        "albedo": albedo,
    }


def spc_node(maplet: dict[str, Any], along_x: int, along_y: int) -> np.ndarray:
    """World position, kilometres, of a node counted from the centre (SPC: V + S (J UX + I UY + H UZ))."""
    half, (x, y, z) = maplet["half"], maplet["axes"]
    height = maplet["height_cells"][along_x + half, along_y + half]
    return maplet["position_km"] + maplet["scale_km"] * (along_x * x + along_y * y + height * z)
