"""The catalogue: schema, HDF5 file, checks, summary and report."""
