#!/usr/bin/env bash
# Under mpiexec: runs a command, on rank 0 to the terminal, on every other rank to PREFIX.rankN.
# Usage: mpiexec -n N bash scripts/rank_output.sh PREFIX COMMAND...
set -euo pipefail
prefix="$1"
shift
# Open MPI; Open MPI 5 and other PMIx launchers; MPICH and Intel MPI.
rank="${OMPI_COMM_WORLD_RANK:-${PMIX_RANK:-${PMI_RANK:-0}}}"
[[ "$rank" == 0 ]] || exec >"$prefix.rank$rank" 2>&1
exec "$@"
