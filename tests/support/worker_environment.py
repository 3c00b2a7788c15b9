"""What MPI has told the parent of a worker of pytest-xdist is taken back: mpiexec would take the worker for a rank."""

from __future__ import annotations

import os

OF_MPI = ("PMIX_", "OMPI_MCA_ess", "OMPI_MCA_orte", "OMPI_MCA_pmix", "OMPI_APP_CTX")

if "PYTEST_XDIST_WORKER" in os.environ:
    for name in [name for name in os.environ if name.startswith(OF_MPI)]:
        del os.environ[name]
