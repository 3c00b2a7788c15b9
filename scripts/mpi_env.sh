# Environment of every MPI run of this repository; to be sourced: `. scripts/mpi_env.sh`.
# A value that is already set is kept.

# One thread per rank: the ranks are the parallelism, BLAS threads on top of them only compete.
export OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}"
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"
export MKL_NUM_THREADS="${MKL_NUM_THREADS:-1}"

# Open MPI refuses to run as root (containers, continuous integration) without both of these.
export OMPI_ALLOW_RUN_AS_ROOT="${OMPI_ALLOW_RUN_AS_ROOT:-1}"
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="${OMPI_ALLOW_RUN_AS_ROOT_CONFIRM:-1}"

# More ranks than cores are allowed, and two jobs at once must not be bound to the same cores.
# OMPI_*: Open MPI 4. PRTE_*: the same two settings in Open MPI 5.
export OMPI_MCA_rmaps_base_oversubscribe="${OMPI_MCA_rmaps_base_oversubscribe:-1}"
export OMPI_MCA_hwloc_base_binding_policy="${OMPI_MCA_hwloc_base_binding_policy:-none}"
# A rank that waits lets others work: without it two jobs at once, or more ranks than cores, crawl.
export OMPI_MCA_mpi_yield_when_idle="${OMPI_MCA_mpi_yield_when_idle:-1}"
export PRTE_MCA_rmaps_default_mapping_policy="${PRTE_MCA_rmaps_default_mapping_policy:-:oversubscribe}"
export PRTE_MCA_hwloc_default_binding_policy="${PRTE_MCA_hwloc_default_binding_policy:-none}"

# What mpirun has to tell its ranks goes through memory of its own. By default PMIx maps files of megabytes in $TMPDIR,
# and where these are refused (a full /tmp, ulimit -f) mpirun waits for ever before it starts a rank.
export PMIX_MCA_gds="${PMIX_MCA_gds:-hash}"

export MPIEXEC="${MPIEXEC:-mpiexec}"
