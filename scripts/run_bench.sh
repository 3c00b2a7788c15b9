#!/usr/bin/env bash
# Runs every benchmark of bench/ but the acceptance table; one that fails does not stop the others.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. scripts/mpi_env.sh
export PATH="$PWD/.venv/bin:$PATH"

failed=()
for script in bench/[a-z]*.py; do
    # These have targets of their own: they take long.
    case "$(basename "$script")" in accept_*.py | iterations.py | interface_solvers.py | paper.py | peers.py | big.py | scaling.py) continue ;; esac
    printf '\n== %s\n' "$script"
    python "$script" || failed+=("$script")
done
if ((${#failed[@]})); then
    printf 'failed: %s\n' "${failed[@]}" >&2
    exit 1
fi
