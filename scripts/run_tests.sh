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
export PYTEST_ADDOPTS="${PYTEST_ADDOPTS:-} -o faulthandler_timeout=$LIMIT -o faulthandler_exit_on_timeout=true"
readonly NOTHING_COLLECTED=5
# Ranks wait for one another, so that a job alone leaves cores idle: of the whole suite two run at a time. More files
# than this, of one number of ranks, are dealt to several jobs.
readonly N_JOBS=2 MOST_FILES=40
# A line for each part: exit code, seconds, name.
DDIC_TEST_RESULTS="$(mktemp)"
export DDIC_TEST_RESULTS
trap 'rm -f "$DDIC_TEST_RESULTS"' EXIT
worst=0
# Whoever names tests may name serial ones alone; the whole suite has tests for every number of ranks.
whole=$(($# == 0))

run_alone() { # pytest arguments
    local start=$SECONDS code=0 marked="not parallel or parallel[1]"
    if ((whole)); then marked="($marked) and not program"; fi
    printf '\n== serial tests, and parallel ones on 1 rank\n'
    # A file in one process: what its tests share is made once.
    python -m pytest -n auto --dist loadfile -m "$marked" "$@" || code=$?
    echo "$code $((SECONDS - start)) 1 rank" >>"$DDIC_TEST_RESULTS"
}

list_jobs() { # a line for each: the number of ranks, then files
    local n files n_shares share k
    for n in "${RANKS[@]}"; do
        # Every rank reads what it may have to run: the files that name this number of ranks.
        mapfile -t files < <(grep -rlE --include='test_*.py' "(^RANKS = |mark\.parallel\()[^)]*\b$n\b" tests | sort)
        n_shares=$((1 + ${#files[@]} / MOST_FILES))
        for ((share = 0; share < n_shares; share++)); do
            printf '%s' "$n"
            for ((k = share; k < ${#files[@]}; k += n_shares)); do printf ' %s' "${files[k]}"; done
            printf '\n'
        done
    done
}

print_result() { # exit code, seconds, name
    local verdict=passed
    ((selected += ($1 != NOTHING_COLLECTED)))
    case "$1" in
    0) ;;
    "$NOTHING_COLLECTED")
        verdict="no test is marked"
        if ((whole)); then verdict="FAILED: no test is marked" worst=1; fi
        ;;
    *) verdict="FAILED (exit code $1)" worst=1 ;;
    esac
    printf '%-8s %4d s  %s\n' "$3" "$2" "$verdict"
}

# What a job prints is shown when it ends: two of them would mix their lines.
readonly PRINT_AT_END='code=0; printed="$("$@" 2>&1)" || code=1; printf "%s\n" "$printed"; exit "$code"'

run_alone "$@"
if ((whole)); then
    list_jobs | xargs -P "$N_JOBS" -L 1 bash -c "$PRINT_AT_END" - bash scripts/run_tests_on_ranks.sh || worst=1
else
    for n in "${RANKS[@]}"; do bash scripts/run_tests_on_ranks.sh "$n" "$@" || worst=1; done
fi
printf '\n== summary\n'
selected=0
while read -r code seconds name; do print_result "$code" "$seconds" "$name"; done <"$DDIC_TEST_RESULTS"
if ((selected == 0)); then
    echo "no test was selected" >&2
    worst=1
fi
exit "$worst"
