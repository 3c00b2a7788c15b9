"""What threads of linear algebra do while nobody needs them."""

from __future__ import annotations

import os

TIMEOUT = "18"
"""Binary logarithm of the processor's ticks that an idle thread of OpenBLAS waits busily before it sleeps: a tenth of a
millisecond. A larger value wakes it faster, which is not seen in a run; what OpenBLAS takes by itself was measured as
28, a tenth of a second after each product, in each of the three copies that numpy, scipy and PETSc bring."""


def prepare_idle_threads() -> None:
    """Have OpenBLAS's threads sleep soon after a product, unless the environment says otherwise.

    Call it before numpy is imported. As many threads share a product as before, so that no digit changes.
    """
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", TIMEOUT)
