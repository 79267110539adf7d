#!/usr/bin/env bash
# A sweep as a Slurm job array, without a library for clusters: job i of k computes the chunks i, i + k, i + 2k ... and writes them to one
# store on a file system that all nodes see. A job that is lost is submitted again: it computes only what is missing.
#
#   sbatch examples/cluster/array.sh /scratch/me/sweep.zarr
#
#SBATCH --job-name=sweep
#SBATCH --array=0-19
#SBATCH --cpus-per-task=8
#SBATCH --mem=16G
#SBATCH --time=01:00:00
#SBATCH --requeue
#SBATCH --signal=B:INT@60
set -euo pipefail
out=${1:?give the path of the store}
here=${SLURM_SUBMIT_DIR:-$PWD}/examples/cluster

export JAX_COMPILATION_CACHE_DIR=${JAX_COMPILATION_CACHE_DIR:-$HOME/.cache/jaxbody-programs}
mkdir -p "$JAX_COMPILATION_CACHE_DIR"
exec python "$here/designs.py" --out "$out" --job "${SLURM_ARRAY_TASK_ID:-0}" --jobs "${SLURM_ARRAY_TASK_COUNT:-1}" \
    --workers "${SLURM_CPUS_PER_TASK:-1}"
