"""Rays against a triangulated heightfield."""
