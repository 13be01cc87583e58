"""Measurements that are run again: `speed`, `evidence` (what is claimed against what happens), `faults`.

Each is a package with sections, run from the checkout's root: ``python -m benchmarks.speed build --help``.
"""
