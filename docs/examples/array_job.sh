#!/bin/bash
#SBATCH --job-name=tile --array=1-16 --cpus-per-task=4 --mem-per-cpu=1G --time=04:00:00
# One task of the array: every 16th area, on 4 processor cores.
set -eu
lcp build-catalog dem.tif -o tile.h5 --config tile.toml \
    --part "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT" --jobs "$SLURM_CPUS_PER_TASK"
