#!/usr/bin/env bash
# Measures a bent beam on two ranks with three cut-off wavelengths and compares the strains with the exact
# ones. Usage: run.sh [folder for all files, default ./bending_beam]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
. "$here/../../scripts/mpi_env.sh" # mpirun as root, and on fewer cores than ranks
out=${1:-bending_beam}
mkdir -p "$out/images"

ddic synth bending --curvature 2e-5 --center 400 150 --size 800x300 --noise 2 --seed 5 --output "$out/images"
python "$here/mesh.py" "$out/beam.msh"
for wavelength in 32 128 512; do
    sed -e "s/^cut_off_wavelength = .*/cut_off_wavelength = $wavelength/" \
        -e "s/beam_128/beam_$wavelength/" "$here/case.toml" >"$out/beam_$wavelength.toml"
    timeout 300 "${MPIEXEC:-mpirun}" -n 2 ddic run "$out/beam_$wavelength.toml"
done
python "$here/compare.py" "$out" 32 128 512
