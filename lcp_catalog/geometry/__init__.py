"""Frames, rotations, map projections, boxes of longitude and latitude, spheres."""
