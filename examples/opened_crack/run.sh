#!/usr/bin/env bash
# Measures a crack that opens, with its line given, and draws it. Usage: run.sh [folder for all files, default ./opened_crack]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
out=${1:-opened_crack}
mkdir -p "$out/images"
cp "$here/case.toml" "$out/case.toml"

python "$here/crack.py" picture "$out/images"
timeout 300 ddic run "$out/case.toml"
ddic plot "$out/case.vtkhdf" --kind deformed --component y --amplification 5
ddic plot "$out/case.vtkhdf" --kind opening
ddic crack "$out/case.vtkhdf"
python "$here/crack.py" compare "$out"
