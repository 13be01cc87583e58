"""Reflectance models (laws), their published parameters, and albedo maps."""
