#!/usr/bin/env bash
# Measures eight frames of a bar that is pulled on two ranks, and draws them.
# Usage: run.sh [folder for all files, default ./series]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
. "$here/../../scripts/mpi_env.sh" # mpirun as root, and on fewer cores than ranks
out=${1:-series}
mkdir -p "$out/images"
cp "$here/case.toml" "$out/case.toml"

python "$here/bar.py" picture "$out/images"
timeout 300 "${MPIEXEC:-mpirun}" -n 2 ddic run "$out/case.toml"
python "$here/bar.py" compare "$out"
