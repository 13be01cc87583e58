#!/bin/bash
#SBATCH --job-name=merge --time=00:30:00
# After the array: the catalogue from the areas of all tasks.
set -eu
lcp build-catalog dem.tif -o tile.h5 --config tile.toml --merge
