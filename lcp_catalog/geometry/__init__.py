"""Frames, rotations, map projections, boxes of longitude and latitude, the reference sphere."""
