#!/usr/bin/env bash
# Imports every serial module of ddic under numpy 2, without petsc4py and mpi4py, in .venv-numpy2.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

readonly VENV="$PWD/.venv-numpy2"
readonly STAMP="$VENV/.ddic-setup"

if [[ ! "$STAMP" -nt pyproject.toml || ! "$STAMP" -nt scripts/check_numpy2.sh ]]; then
    .venv/bin/python -m venv --clear "$VENV"
    echo '*' >"$VENV/.gitignore"
    mapfile -t requirements < <(.venv/bin/python scripts/serial_requirements.py)
    "$VENV/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary=:all: \
        'numpy>=2' "${requirements[@]}"
    touch "$STAMP"
fi
PYTHONPATH="$PWD/src" "$VENV/bin/python" scripts/import_serial_layers.py --numpy-major 2
