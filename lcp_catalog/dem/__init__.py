"""DEM products: files, grids, tiles, mosaics, coverage and checks."""
