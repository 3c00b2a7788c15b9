#!/usr/bin/env bash
# Runs every benchmark of bench/ but the acceptance table; one that fails does not stop the others.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. scripts/mpi_env.sh
export PATH="$PWD/.venv/bin:$PATH"

failed=()
for script in bench/[a-z]*.py; do
    # The acceptance table and the grid of iterations have targets of their own: they take long.
    [[ "$script" == bench/accept_core.py || "$script" == bench/iterations.py || ! -f "$script" ]] && continue
    printf '\n== %s\n' "$script"
    python "$script" || failed+=("$script")
done
if ((${#failed[@]})); then
    printf 'failed: %s\n' "${failed[@]}" >&2
    exit 1
fi
