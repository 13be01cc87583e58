"""Small rasters, VRTs of them and a label of an ISIS cube whose data file is a pipe."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .products import EQC, geotiff

SIDE = 8

ISIS_OF_A_PIPE = """Object = IsisCube
  Object = Core
    StartByte = 1
    Format = BandSequential
    ^Core = pipe
    Group = Dimensions
      Samples = 8
      Lines = 8
      Bands = 1
    End_Group
    Group = Pixels
      Type = Real
      ByteOrder = Lsb
      Base = 0.0
      Multiplier = 1.0
    End_Group
  End_Object
End_Object
End
"""
"""A label that names the file `pipe` beside it."""


def tif(path: Path, height_m: float = 100.0) -> Path:
    heights = height_m + np.arange(SIDE * SIDE, dtype=np.float32).reshape(SIDE, SIDE)
    return geotiff(path, heights, 0.0, 8000.0, 1000.0)


def vrt(path: Path, source: str, relative: bool = True, band: str = "", more: str = "") -> Path:
    """A VRT of one source; ``band``: other content of its band, ``more``: of the file."""
    band = band or (
        f'<SimpleSource><SourceFilename relativeToVRT="{int(relative)}">{source}</SourceFilename>'
        "<SourceBand>1</SourceBand></SimpleSource>"
    )
    path.write_text(
        f'<VRTDataset rasterXSize="{SIDE}" rasterYSize="{SIDE}"><SRS>{EQC}</SRS>'
        f"<GeoTransform>0, 1000, 0, 8000, 0, -1000</GeoTransform>{more}"
        f'<VRTRasterBand dataType="Float32" band="1">{band}</VRTRasterBand></VRTDataset>'
    )
    return path
