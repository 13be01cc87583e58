"""Find a camera's position from the control points in its image.

Usage: python locate_camera.py CATALOG.h5 [IMAGE CAMERA.json]; the defaults are the Apollo frame of the sample.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lcp_catalog as lcp
from lcp_catalog._package_files import sample_folder

IMAGE = sample_folder() / "AS15-M-0414.png"
CAMERA = sample_folder() / "AS15-M-0414_camera.json"


def main(
    catalog_path: str, image_path: str | Path = IMAGE, camera_path: str | Path = CAMERA
) -> None:
    # 1. Open the catalogue, the camera as far as it is known, and the image.
    catalog = lcp.open_catalog(catalog_path)
    camera = lcp.read_camera(camera_path)
    image = lcp.open_image(image_path, camera)

    # 2. Choose the points that are in view and usable under the camera file's Sun.
    points = lcp.choose_points(catalog, camera)
    print(f"{len(points)} of {len(catalog)} points are in view and usable")

    # 3. Render their patches into the camera's pixels.
    patches = lcp.render_patches(catalog, points, camera)
    rows, cols = patches.shape
    print(
        f"patches are up to {cols} x {rows} pixels; {100.0 * np.median(patches.lit_share):.0f} % of a patch is lit"
    )

    # 4. Find them in the image, within 30 pixels of where the camera file puts them.
    matches = lcp.find_points(catalog, image, points=points, reach_px=30.0)
    shift = np.median(matches.offset_px[matches.found], axis=0)
    print(
        f"{matches.found.sum()} found, {shift[0]:+.2f} px right and {shift[1]:+.2f} px down: {matches.counts()}"
    )

    # 5. Solve for the position; this searches again, with every point that the stated uncertainty allows.
    fix = lcp.locate(
        catalog, image, lcp.Uncertainty(position_m=2000.0, attitude_rad=np.radians(0.2))
    )
    if fix.pose is None:
        sys.exit(f"{fix.verdict}: {fix.reason}")
    print(f"{fix.verdict}: {fix.reason}")
    print("position, MCMF m:", fix.pose.position_mcmf_m.round(1))
    print("covariance, m^2:", fix.pose.position_covariance_m2.round(0), sep="\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
