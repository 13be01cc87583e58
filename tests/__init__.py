"""Tests of the library, the command line, the documents and the benchmarks."""
