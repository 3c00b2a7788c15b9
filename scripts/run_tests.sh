#!/usr/bin/env bash
# Runs the suite: the tests of one rank in a process a core, then the parallel ones on 2, 3 and 4 ranks. Those marked
# "program", which start whole programs, run where they are named, and by make test-programs.
# Arguments go to every pytest, e.g. scripts/run_tests.sh tests/solvers -x
# DDIC_TEST_TIMEOUT: seconds allowed for one test (600): for a test that hangs, however long all of them take.
# DDIC_TEST_RANKS: the numbers of ranks ("2 3 4").
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. scripts/mpi_env.sh
export PATH="$PWD/.venv/bin:$PATH"

readonly LIMIT="${DDIC_TEST_TIMEOUT:-600}"
read -ra RANKS <<<"${DDIC_TEST_RANKS:-2 3 4}"
# Python's own watchdog: it needs no lock of the interpreter, so that it also ends a rank that waits inside MPI.
readonly PYTEST=(python -m pytest -o "faulthandler_timeout=$LIMIT" -o faulthandler_exit_on_timeout=true)
readonly NOTHING_COLLECTED=5
logs="$(mktemp -d)"
trap 'rm -rf "$logs"' EXIT
summary=()
worst=0
selected=0
# Whoever names tests may name serial ones alone; the whole suite has tests for every number of ranks.
whole=$(($# == 0))

record() { # name, exit code, seconds
    local verdict=passed
    ((selected += ($2 != NOTHING_COLLECTED)))
    case "$2" in
    0) ;;
    "$NOTHING_COLLECTED")
        verdict="no test is marked"
        if ((whole)); then verdict="FAILED: no test is marked" worst=1; fi
        ;;
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

run_alone() { # pytest arguments
    local start=$SECONDS code=0 marked="not parallel or parallel[1]"
    if ((whole)); then marked="($marked) and not program"; fi
    printf '\n== serial tests, and parallel ones on 1 rank\n'
    # A file in one process: what its tests share is made once.
    "${PYTEST[@]}" -n auto --dist loadfile -m "$marked" "$@" || code=$?
    record "1 rank" "$code" "$((SECONDS - start))"
}

run_ranks() { # number of ranks, pytest arguments
    local n="$1" start=$SECONDS code=0
    shift
    local marked="parallel and parallel[$n]"
    # Every rank reads what it may have to run: of the whole suite, the files that name this number of ranks.
    local named="(^RANKS = |mark\.parallel\()[^)]*\b$n\b"
    if ((whole)); then mapfile -t < <(grep -rlE --include='test_*.py' "$named" tests) && set -- "${MAPFILE[@]}"; fi
    printf '\n== parallel tests on %s ranks\n' "$n"
    "$MPIEXEC" -n "$n" bash scripts/rank_output.sh "$logs/$n" \
        python -m mpi4py "${PYTEST[@]:1}" -p no:cacheprovider -m "$marked" "$@" || code=$?
    # Exit code 5 on a rank may also mean that the ranks collected different tests: ask one process.
    if ((code == NOTHING_COLLECTED)); then
        python -m pytest --collect-only -qq -m "$marked" "$@" >/dev/null
        (($? == NOTHING_COLLECTED)) || code=1
    fi
    ((code == 0 || code == NOTHING_COLLECTED)) || show_other_ranks "$n"
    record "$n ranks" "$code" "$((SECONDS - start))"
}

run_alone "$@"
for n in "${RANKS[@]}"; do
    run_ranks "$n" "$@"
done
printf '\n== summary\n'
printf '%s\n' "${summary[@]}"
if ((selected == 0)); then
    echo "no test was selected" >&2
    worst=1
fi
exit "$worst"
