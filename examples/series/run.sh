#!/usr/bin/env bash
# Measures eight frames of a bar that is pulled on two ranks, and draws them.
# Usage: run.sh [folder for all files, default ./series]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
. "$here/../../scripts/mpi_env.sh" # mpirun as root, and on fewer cores than ranks
out=${1:-series}
mkdir -p "$out/images" "$out/pictures"
cp "$here/case.toml" "$here/probes.toml" "$out"

python "$here/bar.py" picture "$out/images"
timeout 300 "${MPIEXEC:-mpirun}" -n 2 ddic run "$out/case.toml"
ddic info "$out/series.vtkhdf"
ddic probe "$out/series.vtkhdf" --probes "$out/probes.toml" --csv "$out/strain.csv"
ddic plot "$out/series.vtkhdf" --output "$out/pictures"
ddic plot "$out/series.vtkhdf" --frame 8 --kind strain --output "$out/pictures"
ddic plot "$out/series.vtkhdf" --animate --kind strain --strain xx --output "$out/pictures"
python "$here/bar.py" compare "$out"
