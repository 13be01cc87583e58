"""Simulated camera frames."""
