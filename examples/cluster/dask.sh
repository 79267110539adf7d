#!/usr/bin/env bash
# A sweep by a Dask cluster inside one Slurm allocation: a scheduler and the caller on the first node, a worker of one thread on each core.
#
#   sbatch examples/cluster/dask.sh /scratch/me/sweep.zarr
#
#SBATCH --job-name=sweep-dask
#SBATCH --nodes=4
#SBATCH --ntasks-per-node=8
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=2G
#SBATCH --time=01:00:00
set -euo pipefail
out=${1:?give the path of the store}
here=${SLURM_SUBMIT_DIR:-$PWD}/examples/cluster
scheduler=$PWD/scheduler-${SLURM_JOB_ID:-0}.json
trap 'kill $(jobs -p) 2>/dev/null || true; rm -f "$scheduler"' EXIT

export PJRT_NPROC=1 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 # one thread a worker
export JAX_COMPILATION_CACHE_DIR=${JAX_COMPILATION_CACHE_DIR:-$HOME/.cache/jaxbody-programs}
export JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0 JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES=-1
mkdir -p "$JAX_COMPILATION_CACHE_DIR"

dask scheduler --scheduler-file "$scheduler" --no-dashboard &
until [[ -s $scheduler ]]; do sleep 1; done
srun --ntasks="${SLURM_NTASKS:-2}" dask worker --scheduler-file "$scheduler" --nworkers 1 --nthreads 1 --nanny --death-timeout 120 --no-dashboard &
python "$here/designs.py" --out "$out" --dask "$scheduler"
