"""Criteria for control points (localisable, unique, independent of the terrain around them) and the
choice of points.

Pure functions: arrays in, arrays or small frozen dataclasses out. Images are float32 radiance
(rows, cols), row 0 north; NaN means nodata or not visible, 0 means shadow. A patch is the
(2 half + 1)^2 nodes around a node.
"""
