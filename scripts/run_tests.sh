#!/usr/bin/env bash
# Runs the whole suite: the tests of one rank in a process a core, then the parallel ones on 2, 3 and 4 ranks.
# Arguments go to every pytest, e.g. scripts/run_tests.sh tests/solvers -x
# DDIC_TEST_TIMEOUT: seconds allowed for each number of ranks (900): for a test that hangs, not for a busy machine.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. scripts/mpi_env.sh
export PATH="$PWD/.venv/bin:$PATH"

readonly LIMIT="${DDIC_TEST_TIMEOUT:-900}"
readonly NOTHING_COLLECTED=5
logs="$(mktemp -d)"
trap 'rm -rf "$logs"' EXIT
summary=()
worst=0

record() { # name, exit code, seconds
    local verdict=passed
    case "$2" in
    0) ;;
    "$NOTHING_COLLECTED") verdict="no test is marked" ;;
    124 | 137) verdict="TIMED OUT after $LIMIT s" worst=1 ;;
    *) verdict="FAILED (exit code $2)" worst=1 ;;
    esac
    summary+=("$(printf '%-8s %4d s  %s' "$1" "$3" "$verdict")")
}

show_other_ranks() { # number of ranks
    local log
    for log in "$logs/$1".rank*; do
        [[ -s "$log" ]] || continue
        printf '\n-- end of the output of rank %s of %s\n' "${log##*rank}" "$1"
        tail -n 40 "$log"
    done
}

run_alone() { # name, marker expression, pytest arguments
    local name="$1" marked="$2" start=$SECONDS code=0
    shift 2
    printf '\n== %s\n' "$name"
    timeout --kill-after=10 "$((2 * LIMIT))" python -m pytest -n auto -m "$marked" "$@" || code=$?
    record "$name" "$code" "$((SECONDS - start))"
}

run_ranks() { # number of ranks, pytest arguments
    local n="$1" start=$SECONDS code=0
    shift
    local marked="parallel and parallel[$n]"
    printf '\n== parallel tests on %s ranks\n' "$n"
    timeout --kill-after=10 "$LIMIT" "$MPIEXEC" -n "$n" \
        bash scripts/rank_output.sh "$logs/$n" \
        python -m mpi4py -m pytest -p no:cacheprovider -m "$marked" "$@" || code=$?
    # Exit code 5 on a rank may also mean that the ranks collected different tests: ask one process.
    if ((code == NOTHING_COLLECTED)); then
        python -m pytest --collect-only -qq -m "$marked" "$@" >/dev/null
        (($? == NOTHING_COLLECTED)) || code=1
    fi
    ((code == 0 || code == NOTHING_COLLECTED)) || show_other_ranks "$n"
    record "$n ranks" "$code" "$((SECONDS - start))"
}

run_alone serial "not parallel" "$@"
run_alone "1 rank" "parallel and parallel[1]" "$@"
for n in 2 3 4; do
    run_ranks "$n" "$@"
done
printf '\n== summary\n'
printf '%s\n' "${summary[@]}"
exit "$worst"
