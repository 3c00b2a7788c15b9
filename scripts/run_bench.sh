#!/usr/bin/env bash
# Runs every benchmark of bench/ that takes minutes; one that fails does not stop the others.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. scripts/mpi_env.sh
export PATH="$PWD/.venv/bin:$PATH"

failed=()
for script in bench/[a-z]*.py; do
    name="$(basename "$script" .py)"
    # These have targets of their own: they take long.
    case "$name" in iterations | interface_solvers | paper | peers | big | scaling | kernel_rates) continue ;; esac
    printf '\n== %s\n' "$name"
    python -m "bench.$name" || failed+=("$name")
done
if ((${#failed[@]})); then
    printf 'failed: %s\n' "${failed[@]}" >&2
    exit 1
fi
