"""What several tests and benchmarks share: made inputs, readers and judges that use nothing of the library's own formulas.

Tests import ``helpers.NAME`` (pytest puts ``tests`` on its path), benchmarks ``tests.helpers.NAME`` (they run from the
checkout's root). Modules of this folder import one another relatively, so that both work.
"""
