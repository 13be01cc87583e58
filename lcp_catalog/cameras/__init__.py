"""Sensor models of framing cameras, scanners and map-projected images, and their files."""
