#!/usr/bin/env bash
#PBS -l select=1:ncpus=2:mpiprocs=2
#PBS -l walltime=01:00:00
#PBS -N ddic
#PBS -j oe
#PBS -S /bin/bash
# A measurement as a PBS job: edit the three places, then `qsub job.sh`. PBS reads the lines above, and none that come
# after a command; without the last one it would run this by your login shell.

# EDIT 1 of 3: what the job may use, in the lines `#PBS -l` above: one of `mpiprocs` is one rank, on a core of its own,
# and `select` is the number of machines. Here the seconds of that walltime less what an iteration and the writing of
# the result take: PBS itself signals too late.
seconds=3420

# EDIT 2 of 3: the program, and the modules with which it was set up.
# module load python openmpi petsc4py
ddic=/path/to/ddic/.venv/bin/ddic

# EDIT 3 of 3: the case file; paths in it are relative to it.
case_file=/path/to/measurement/case.toml

# PBS's list of machines: each is there once for each of its ranks. An Open MPI that was built without PBS knows no other.
machines="${PBS_NODEFILE:?PBS sets it: submit this by qsub, or take scripts/mpirun/job.sh}"
ranks=$(wc -l <"$machines")

cd "${PBS_O_WORKDIR:-.}" || exit 1
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
# Else mpirun waits for ever where files in $TMPDIR are refused: a full /tmp, ulimit -f.
export PMIX_MCA_gds="${PMIX_MCA_gds:-hash}"

# PBS keeps a job's output to itself until the end; here it can be read while it grows.
log="ddic-${PBS_JOBID:-$$}.log"
# mpirun passes SIGUSR1 on to all ranks, which stop after the iteration at hand; the exit code stays ddic's.
timeout --preserve-status --signal=USR1 "$seconds" \
    mpirun --hostfile "$machines" -n "$ranks" "$ddic" run "$case_file" >"$log" 2>&1 &
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
