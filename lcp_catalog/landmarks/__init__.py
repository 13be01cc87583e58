"""What makes a control point: localisable, unique, independent of the relief around it; and which
of them to keep.

Pure functions: arrays in, arrays or small frozen dataclasses out. Images are float32 radiance
(rows, cols), row 0 north; NaN is nodata or unseen, 0 is shadow. A patch is the (2 half + 1)^2 nodes
around a node.
"""
