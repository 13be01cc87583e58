"""Shadows of parallel light, by scan lines and proved bounds."""
