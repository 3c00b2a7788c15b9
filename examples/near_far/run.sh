#!/usr/bin/env bash
# Measures a plate with a hole with two cameras of different magnification, on two ranks.
# Usage: run.sh [folder for all files, default ./near_far]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
. "$here/../../scripts/mpi_env.sh" # mpirun as root, and on fewer cores than ranks
out=${1:-near_far}
mkdir -p "$out/images"
cp "$here/case.toml" "$out/case.toml"

ddic synth near-far --size 400x320 --ratio 4 --radius 40 --noise 2 --seed 2 --output "$out/images"
# No command replaces what a case names: another calibration begins by removing the last one.
rm -f "$out/mapping.toml"
ddic calibrate "$out/images/far_reference.tif" "$out/images/near_reference.tif" --ratio 4.2 --model similarity \
    --output "$out/mapping.toml"
timeout 300 "${MPIEXEC:-mpirun}" -n 2 ddic run "$out/case.toml"
ddic plot "$out/result.vtkhdf" --kind near-far --component y
python "$here/compare.py" "$out"
