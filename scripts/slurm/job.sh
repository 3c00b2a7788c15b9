#!/usr/bin/env bash
# A measurement as a Slurm job: edit the three places, then `sbatch job.sh`. The log grows while it runs.

# EDIT 1 of 3: what the job may use. One task is one MPI rank; one core each.
#SBATCH --nodes=1
#SBATCH --ntasks=2
#SBATCH --time=01:00:00

#SBATCH --job-name=ddic
#SBATCH --cpus-per-task=1
#SBATCH --output=ddic-%j.log
# Seconds before the end of that time at which the run is asked to stop: more than an iteration and the writing of the
# result take. Slurm may do it a minute earlier.
#SBATCH --signal=B:USR1@180

# EDIT 2 of 3: the program, and the modules with which it was set up.
# module load python openmpi petsc4py
ddic=/path/to/ddic/.venv/bin/ddic

# EDIT 3 of 3: the case file; paths in it are relative to it.
case_file=/path/to/measurement/case.toml

# Or: sbatch --export=ALL,DDIC_LAUNCH="srun --mpi=pmix" job.sh
read -ra launch <<<"${DDIC_LAUNCH:-mpirun}"
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
# Else mpirun waits for ever where files in $TMPDIR are refused: a full /tmp, ulimit -f.
export PMIX_MCA_gds="${PMIX_MCA_gds:-hash}"
# A rank that cannot start ends the job: srun would leave the others waiting for it.
export SLURM_KILL_BAD_EXIT=1

"${launch[@]}" -n "$SLURM_NTASKS" "$ddic" run "$case_file" &
run=$!
# Slurm signals this shell alone; mpirun and srun pass SIGUSR1 on to all ranks.
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
