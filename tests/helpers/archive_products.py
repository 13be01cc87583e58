"""One of each product of the archives, small: their exact label texts with sizes, offsets and bounds cut consistently, and real
heights. `python tests/archive_products.py FOLDER` writes them.
"""

from __future__ import annotations

import dataclasses
import re
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from . import real_heights
from .archive_files import (
    Frame,
    Product,
    archive_text,
    attached,
    cut_to,
    cylinder_frame,
    img_product,
    jp2_product,
    map_object,
    polar_frame,
)
from .products import DEGREE_M, LABELS, RADIUS_M, geotiff


def cylindrical_products(folder: Path) -> Iterator[Product]:
    """SLDEM2015 and LDEM around Hadley Rille: .IMG and .JP2."""
    surface = real_heights.hadley
    jp2 = (LABELS.parent / "ldem_4" / "LDEM_4_JP2.LBL").read_bytes().decode("latin-1")
    for per_degree in (512, 256, 128):
        source = (
            "SLDEM2015_512_00N_30N_000_045_FLOAT"
            if per_degree > 128
            else "SLDEM2015_128_60S_60N_000_360_FLOAT"
        )
        tile = f"SLDEM2015_{per_degree}_" + (
            "60S_60N_000_360" if per_degree == 128 else "00N_30N_000_045"
        )
        frame = cylinder_frame(3.0, 26.5, 72, 60, per_degree, 180.0)
        scale = {} if per_degree != 256 else {"MAP_RESOLUTION": 256, "MAP_SCALE": "0.1184505876"}
        text = archive_text(f"{source}.LBL").replace(source, f"{tile}_FLOAT")
        yield img_product(
            folder, f"{tile}_FLOAT", f"SLDEM2015_{per_degree}", text, frame, surface, True, **scale
        )
        text = archive_text("SLDEM2015_512_00N_30N_000_045_JP2.LBL").replace(
            "SLDEM2015_512_00N_30N_000_045", tile
        )
        scale = (
            {}
            if per_degree == 512
            else {"MAP_RESOLUTION": per_degree, "MAP_SCALE": repr(DEGREE_M / per_degree / 1e3)}
        )
        yield jp2_product(folder, tile, f"SLDEM2015_{per_degree}", text, frame, surface, **scale)
    for per_degree in (4, 16, 64, 128, 512):
        name = f"LDEM_{per_degree}" + ("_00N_45N_000_090" if per_degree == 512 else "")
        source = "LDEM_128" if per_degree > 16 else "LDEM_16"
        frame = cylinder_frame(
            1.0,
            29.0,
            30 if per_degree == 4 else 72,
            24 if per_degree == 4 else 60,
            per_degree,
            180.0,
        )
        scale = {
            "MAP_RESOLUTION": per_degree,
            "MAP_SCALE": f"{frame.pixel_m:.6g}",
        }  # rounded as in LDEM_16
        text = archive_text(f"{source}.LBL").replace(source, name)
        yield img_product(folder, name, f"LDEM_{per_degree}", text, frame, surface, False, **scale)
        frame = dataclasses.replace(
            frame, crs=frame.crs.replace("+lon_0=180", "+lon_0=0"), west_m=DEGREE_M
        )
        scale["MAP_SCALE"] = f"{frame.pixel_m / 1e3:.10f}"
        yield jp2_product(
            folder, name, f"LDEM_{per_degree}", jp2.replace("LDEM_4", name), frame, surface, **scale
        )


def polar_products(folder: Path) -> Iterator[Product]:
    """LDEM_75/80/85/875, N and S: int16 and float .IMG, .JP2."""
    jp2 = (LABELS.parent / "ldem_4" / "LDEM_4_JP2.LBL").read_bytes().decode("latin-1")
    for area, pixel_m in (("75", 30), ("80", 20), ("85", 10), ("875", 5)):
        source = "LDEM_875S_5M" if area == "875" else "LDEM_80S_20M"
        for pole, side in ((1, "N"), (-1, "S")):
            name, frame = f"LDEM_{area}{side}_{pixel_m}M", polar_frame(pole, pixel_m)
            changes = {
                "CENTER_LATITUDE": 90 * pole,
                "MAP_SCALE": pixel_m,
                "MAP_RESOLUTION": f"{DEGREE_M / pixel_m:.2f}",
            }
            text = archive_text(f"{source}.LBL").replace(source, name)
            yield img_product(folder, name, name, text, frame, real_heights.polar, False, **changes)
            unit = {
                "SAMPLE_TYPE": "PC_REAL",
                "SAMPLE_BITS": 32,
                "UNIT": "KILOMETER",
                "SCALING_FACTOR": 1,
                "OFFSET": 1737.4,
            }
            yield img_product(
                folder, f"{name}_FLOAT", name, text.replace(name, f"{name}_FLOAT"), frame, real_heights.polar, True,
                **changes, **unit,
            )  # fmt: skip
            text = jp2.replace(map_object(jp2), map_object(text)).replace("LDEM_4", name)
            yield jp2_product(folder, name, name, text, frame, real_heights.polar, **changes)


def pds4_product(folder: Path) -> Product:
    """LDEM_875S_20M_FLOAT by a PDS4 label that holds the excerpt's elements in the archive's structure."""
    name, frame = "ldem_875s_20m_float", polar_frame(-1, 20.0)
    heights = frame.heights_of(real_heights.polar)
    excerpt = archive_text("LDEM_875S_20M_FLOAT_PDS4_excerpt.xml")

    def lines(*keys: str) -> str:
        return "\n".join(re.search(rf"<{key}[ >].*?</{key}>", excerpt)[0] for key in keys)

    cart = [f"cart:{key}" for key in ("west", "east", "north", "south")]
    scale = [
        f"cart:{key}"
        for key in ("pixel_resolution_x", "pixel_resolution_y", "pixel_scale_x", "pixel_scale_y")
    ]
    model = [
        f"cart:{key}"
        for key in (
            "latitude_type",
            "a_axis_radius",
            "b_axis_radius",
            "c_axis_radius",
            "longitude_direction",
        )
    ]
    text = f"""<?xml version="1.0" encoding="UTF-8"?>
<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1" xmlns:cart="http://pds.nasa.gov/pds4/cart/v1">
<Identification_Area>{lines("logical_identifier", "title")}</Identification_Area>
<Observation_Area><Target_Identification><name>Moon</name><type>Satellite</type></Target_Identification>
<Discipline_Area><cart:Cartography><cart:Spatial_Domain><cart:Bounding_Coordinates>
{lines(*(f"{key}_bounding_coordinate" for key in cart))}
</cart:Bounding_Coordinates></cart:Spatial_Domain><cart:Spatial_Reference_Information>
<cart:Horizontal_Coordinate_System_Definition><cart:Planar><cart:Map_Projection>
{lines("cart:map_projection_name")}<cart:Polar_Stereographic>
{lines("cart:longitude_of_central_meridian", "cart:latitude_of_projection_origin")}
</cart:Polar_Stereographic></cart:Map_Projection><cart:Planar_Coordinate_Information>
<cart:planar_coordinate_encoding_method>Coordinate Pair</cart:planar_coordinate_encoding_method><cart:Coordinate_Representation>
{lines(*scale)}
</cart:Coordinate_Representation></cart:Planar_Coordinate_Information><cart:Geo_Transformation>
<cart:upperleft_corner_x unit="m">{frame.west_m!r}</cart:upperleft_corner_x>
<cart:upperleft_corner_y unit="m">{frame.north_m!r}</cart:upperleft_corner_y>
</cart:Geo_Transformation></cart:Planar><cart:Geodetic_Model>
{lines(*model)}
</cart:Geodetic_Model></cart:Horizontal_Coordinate_System_Definition></cart:Spatial_Reference_Information>
</cart:Cartography></Discipline_Area></Observation_Area>
<File_Area_Observational><File>{lines("file_name")}</File><Array_2D_Map>{lines("offset")}<axes>2</axes>
{lines("axis_index_order")}<Element_Array>{lines("data_type", "unit", "scaling_factor", "value_offset")}</Element_Array>
<Axis_Array><axis_name>Line</axis_name><elements>{frame.rows}</elements><sequence_number>1</sequence_number></Axis_Array>
<Axis_Array><axis_name>Sample</axis_name><elements>{frame.cols}</elements><sequence_number>2</sequence_number></Axis_Array>
</Array_2D_Map></File_Area_Observational></Product_Observational>
"""
    edge = float(np.degrees(2.0 * np.arctan(frame.north_m / (2.0 * RADIUS_M)))) - 90.0
    text = text.replace(">-87.5<", f">{edge:.9f}<")
    label, image = folder / f"{name}.xml", folder / f"{name}.img"
    label.write_text(text, encoding="utf-8")
    image.write_bytes((heights / 1000.0).astype("<f4").tobytes())
    return Product("LDEM_875S_20M", label, image, frame, heights, 0.002)


def pgda_products(folder: Path) -> Iterator[Product]:
    """GeoTIFFs of the Planetary Geodesy Data Archive: float32 metres, south polar stereographic, tiled.

    CRS and units as pgda.gsfc.nasa.gov/products/78 and /90 give them: X/Y in metres, MOON_ME, sphere of 1737.4 km.
    """
    crs = (
        'PROJCS["Moon South Pole Stereographic",GEOGCS["GCS_Moon",DATUM["D_Moon",SPHEROID["Moon",1737400,0]],'
        'PRIMEM["Reference_Meridian",0],UNIT["degree",0.0174532925199433]],PROJECTION["Polar_Stereographic"],'
        'PARAMETER["latitude_of_origin",-90],PARAMETER["central_meridian",0],PARAMETER["scale_factor",1],'
        'PARAMETER["false_easting",0],PARAMETER["false_northing",0],UNIT["metre",1]]'
    )
    for name, called, pixel_m in (
        ("ldem_87s_5mpp", "LDEM_87S_5MPP", 5.0),
        ("LDEM_80S_20MPP_ADJ", "LDEM_80S_20MPP_ADJ", 20.0),
        ("Haworth_final_adj_5mpp_surf", "Haworth_final_adj_5mpp_surf", 5.0),
    ):
        frame = polar_frame(-1, pixel_m)
        if name.startswith(
            "Haworth"
        ):  # a site beside the pole: 86.8 S is beyond the heights at hand, 89.5 S is not
            frame = dataclasses.replace(frame, west_m=-6_000.0, north_m=15_000.0)
        heights = frame.heights_of(real_heights.polar)
        heights[3:5, 7:10] = np.nan
        path = folder / f"{name}.tif"
        stored = np.where(np.isnan(heights), -99999.0, heights).astype(np.float32)
        geotiff(path, stored, frame.west_m, frame.north_m, pixel_m, crs=crs, nodata=-99999.0)
        yield Product(called, None, path, frame, heights, 0.002)


def nac_products(folder: Path) -> Iterator[Product]:
    """NAC DTMs at Hadley Rille, 2 m, standard parallel 26: GeoTIFF with its label, .IMG with its label beside or in front."""
    source = archive_text("NAC_DTM_APOLLO11.LBL")
    frame = cylinder_frame(3.62, 26.12, 72, 60, DEGREE_M / 2.0, 180.0, 26.0)
    frame = dataclasses.replace(
        frame, west_m=round(frame.west_m / 2) * 2.0, north_m=round(frame.north_m / 2) * 2.0
    )
    heights = frame.heights_of(real_heights.hadley)
    samples = heights.astype("<f4")
    for name, ending in (("NAC_DTM_APOLLO15", "TIF"), ("NAC_DTM_APOLLO15_2", "IMG")):
        image = folder / f"{name}.{ending}"
        start = 1
        if ending == "TIF":
            geotiff(
                image,
                samples,
                frame.west_m,
                frame.north_m,
                2.0,
                crs=frame.crs,
                nodata=float(np.float32(-3.40282266e38)),
            )
            with rasterio.open(image) as dataset:
                start = 1 + int(dataset.get_tag_item("BLOCK_OFFSET_0_0", "TIFF", bidx=1))
        else:
            image.write_bytes(samples.tobytes())
        text = source.replace("NAC_DTM_APOLLO11", name).replace(f"{name}.TIF", image.name)
        text = text.replace("112496 <BYTES>", f"{start} <BYTES>")
        text = cut_to(text, frame, CENTER_LATITUDE=26.0, RECORD_BYTES=4 * frame.cols)
        label = folder / f"{name}.LBL"
        label.write_bytes(text.encode("latin-1"))
        yield Product(name, label, image, frame, heights, 0.002)
    yield attached(
        folder,
        "NAC_DTM_APOLLO15_3",
        "NAC_DTM_APOLLO15_3",
        _nac_attached(source, frame),
        frame,
        samples,
        0.002,
    )


def _nac_attached(source: str, frame: Frame) -> str:
    text = source.replace("NAC_DTM_APOLLO11", "NAC_DTM_APOLLO15_3")
    text = re.sub(r"\^IMAGE .*", "LABEL_RECORDS = 1\n^IMAGE = 2", text)
    return cut_to(text, frame, CENTER_LATITUDE=26.0)


def gld100_products(folder: Path) -> Iterator[Product]:
    """WAC GLD100 at 16, 64 and 256 pixels a degree: int16 metres behind their labels, some pixels null."""
    for name, called, text_name, per_degree in (
        ("WAC_GLD100_E000N1800_016P", "GLD100_16", "WAC_GLD100_E000N1800_016P_attached", 16),
        ("WAC_GLD100_E000N1800_064P", "GLD100_64", "WAC_GLD100_E000N1800_064P_attached", 64),
        ("WAC_GLD100_E300N0450_256P", "GLD100_256", "WAC_GLD100_E300N0450_256P_from_readme", 256),
    ):
        frame = cylinder_frame(2.0, 27.5, 72, 60, per_degree, 0.0)
        heights = frame.heights_of(real_heights.hadley)
        heights[5, 11:14] = np.nan
        samples = np.where(np.isnan(heights), -32768, np.round(heights)).astype("<i2")
        text = cut_to(archive_text(f"{text_name}.LBL"), frame)
        yield attached(folder, name, called, text, frame, samples, 1.0, heights)


def all_products(folder: Path) -> list[Product]:
    """One of each product that the documentation names."""
    makers = (cylindrical_products, polar_products, pgda_products, nac_products, gld100_products)
    return [*(product for make in makers for product in make(folder)), pds4_product(folder)]


def main(folder: str) -> None:
    """Write one of each and say what was written."""
    warnings.simplefilter(
        "ignore", NotGeoreferencedWarning
    )  # of the JP2: their map is in the label
    Path(folder).mkdir(parents=True, exist_ok=True)
    for product in all_products(Path(folder)):
        print(f"{product.name:28}", *(path.name for path in product.opened_by))


if __name__ == "__main__":
    main(*sys.argv[1:2] or sys.exit("usage: python tests/archive_products.py FOLDER"))
