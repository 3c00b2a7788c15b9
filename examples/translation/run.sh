#!/usr/bin/env bash
# Measures a known translation on one rank. Usage: run.sh [folder for all files, default ./translation]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
out=${1:-translation}
mkdir -p "$out/images"
cp "$here/case.toml" "$out/case.toml"

ddic synth translation --vector 0.3 -0.2 --size 256x256 --seed 3 --output "$out/images"
timeout 300 ddic run "$out/case.toml"
python "$here/compare.py" "$out"
