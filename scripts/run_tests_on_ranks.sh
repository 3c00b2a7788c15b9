#!/usr/bin/env bash
# Runs the parallel tests of one number of ranks; a part of scripts/run_tests.sh, which sets the environment. Rank 0
# writes to the terminal, what the others wrote is shown where a test fails. The exit code goes to DDIC_TEST_RESULTS.
# Usage: run_tests_on_ranks.sh N PYTEST_ARGUMENTS...
set -uo pipefail
readonly N="$1" MARKED="parallel and parallel[$1]"
shift
readonly NOTHING_COLLECTED=5
logs="$(mktemp -d)"
trap 'rm -rf "$logs"' EXIT

show_other_ranks() {
    local log
    for log in "$logs"/*.rank*; do
        [[ -s "$log" ]] || continue
        printf '\n-- end of the output of rank %s of %s\n' "${log##*rank}" "$N"
        tail -n 40 "$log"
    done
}

start=$SECONDS code=0
printf '\n== parallel tests on %s ranks\n' "$N"
"$MPIEXEC" -n "$N" bash scripts/rank_output.sh "$logs/of" \
    python -m mpi4py -m pytest -p no:cacheprovider -m "$MARKED" "$@" || code=$?
# Exit code 5 on a rank may also mean that the ranks collected different tests: ask one process.
if ((code == NOTHING_COLLECTED)); then
    python -m pytest --collect-only -qq -m "$MARKED" "$@" >/dev/null
    (($? == NOTHING_COLLECTED)) || code=1
fi
((code == 0 || code == NOTHING_COLLECTED)) || show_other_ranks
echo "$code $((SECONDS - start)) $N ranks" >>"$DDIC_TEST_RESULTS"
