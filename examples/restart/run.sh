#!/usr/bin/env bash
# Measures two frames of a series on two ranks, the second from the result of the first.
# Usage: run.sh [folder for all files, default ./restart]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
. "$here/../../scripts/mpi_env.sh" # mpirun as root, and on fewer cores than ranks
out=${1:-restart}
mkdir -p "$out"
cp "$here"/frame_?.toml "$out"

# One seed: both pairs have the same reference image.
ddic synth affine --gradient 0.01 0 0 -0.003 --vector 6 -2 --size 320x320 --noise 1 --seed 4 --output "$out/frame_1"
ddic synth affine --gradient 0.014 0 0 -0.0042 --vector 8 -2.5 --size 320x320 --noise 1 --seed 4 \
    --output "$out/frame_2"
cmp "$out/frame_1/reference.tif" "$out/frame_2/reference.tif"

for frame in 1 2; do
    timeout 300 "${MPIEXEC:-mpirun}" -n 2 ddic run "$out/frame_$frame.toml"
done
python "$here/compare.py" "$out"
