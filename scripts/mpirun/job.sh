#!/usr/bin/env bash
# A measurement with plain mpirun, on machines without a batch system: edit the three places, then
# `nohup bash job.sh &`. `kill -USR1` of this script stops the run after the iteration at hand.

# EDIT 1 of 3: ranks (one core each), and seconds after which the run is asked to stop; 0: never. For several machines
# mpirun takes `--host first:16,second:16`, with ddic under the same path on each.
ranks=2 seconds=0
hosts=()

# EDIT 2 of 3: the program.
ddic=/path/to/ddic/.venv/bin/ddic

# EDIT 3 of 3: the case file; paths in it are relative to it.
case_file=/path/to/measurement/case.toml

export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
# Else mpirun waits for ever where files in $TMPDIR are refused: a full /tmp, ulimit -f.
export PMIX_MCA_gds="${PMIX_MCA_gds:-hash}"

log="ddic-$$.log"
# mpirun passes SIGUSR1 on to all ranks, which stop after the iteration at hand; the exit code stays ddic's.
timeout --preserve-status --signal=USR1 "$seconds" \
    mpirun "${hosts[@]}" -n "$ranks" "$ddic" run "$case_file" >"$log" 2>&1 &
run=$!
trap 'signalled=1; echo "job.sh: asks ddic to stop"; kill -USR1 "$run" 2>/dev/null' USR1 TERM
# A signal ends `wait` early.
while :; do
    signalled=0
    wait "$run"
    code=$?
    ((signalled)) || break
done
# 0: converged. 3: stopped in time, the last field is kept, and `start.from_result` goes on from it. 2: bad input.
exit "$code"
