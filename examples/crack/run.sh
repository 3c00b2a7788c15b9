#!/usr/bin/env bash
# Measures two frames of a real notched test, with the crack's line and without it, and looks at the crack.
# Usage: DDIC_REAL_DATA=folder with fracture/ run.sh [folder for all files, default ./crack]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
images="${DDIC_REAL_DATA:?name the folder in which fracture/img_0030.png is}/fracture"
out=${1:-crack}
mkdir -p "$out"
ln -sfn "$(cd "$images" && pwd)" "$out/images"
cp "$here/case.toml" "$out/case.toml"
# The same without the line.
sed -e '/^\[\[discontinuity\]\]/,/^uncertainty/d' -e 's/"result\./"continuous./' "$here/case.toml" >"$out/continuous.toml"

ddic run "$out/case.toml"
ddic run "$out/continuous.toml"
for frame in 1 2; do
    ddic opening "$out/result.vtkhdf" --frame "$frame"
done
for frame in 1 2; do
    ddic crack "$out/result.vtkhdf" --frame "$frame" --tip 250 605
done
python "$here/compare.py" "$out"
