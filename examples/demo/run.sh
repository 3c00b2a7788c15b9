#!/usr/bin/env bash
# Makes an image pair with a known displacement, measures it on two ranks, draws the result and
# compares it with the truth. Usage: run.sh [folder for all files, default ./demo]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
. "$here/../../scripts/mpi_env.sh" # mpirun as root, and on fewer cores than ranks
out=${1:-demo}
mkdir -p "$out/images" "$out/pictures"
cp "$here/case.toml" "$out/case.toml"

ddic synth kirsch --size 1000x1000 --strain 0.005 --radius 100 --noise 2 --seed 1 --output "$out/images"
timeout 300 "${MPIEXEC:-mpirun}" -n 2 ddic run "$out/case.toml"
ddic plot "$out/result.vtkhdf" --output "$out/pictures"
python "$here/compare.py" "$out"
