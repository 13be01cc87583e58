"""Reflectance models evaluated on arrays."""
