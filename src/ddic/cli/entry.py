"""Where the program begins, and what it takes for granted of the system: open streams, a clock, a folder to work in.

Also what threads of linear algebra do while nobody needs them, whether the address space that a process may use
(``ulimit -v``) is enough to start in, and imports without the garbage collector, which would go through modules again
and again and free none. What can fail before there is a command fails here, in one line.
"""

import gc
import os
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from ddic.cli.failures import failures_as_lines
from ddic.errors import DdicError, InputError
from ddic.parallel.stop_request import StopRequest


def main() -> None:
    """Run the command line."""
    _open_closed_streams()
    stop = StopRequest()
    if sys.argv[1:2] in (["run"], ["compare"], ["identify"], ["modes"]):
        # Before the imports of a second or two, in which a rank that a signal ends would leave the others waiting.
        stop.note_signals()
    with failures_as_lines(), imports_kept():
        from ddic.cli.app import command_line

    command_line(prog_name="ddic", obj=stop)


def _open_closed_streams() -> None:
    """Open standard streams that are closed onto nothing, before any file is opened.

    Python has none in their place, and the next file would take the number of one: what libraries print would go into
    it.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            # The system gives the lowest number that is free, which is this stream's.
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def require_surroundings() -> None:
    """Refuse a system in which libraries would fail in ways of their own: DdicError; call it before importing numpy."""
    _require_address_space()
    try:
        # At nanoseconds beyond 2262 Python's own modules fail when they are imported.
        time.time()
    except OverflowError as error:
        raise DdicError("the system's clock stands before 1678 or after 2261, of which Python cannot tell the time: "
                        "set it right (date)") from error
    try:
        # Neither names of files nor PETSc begin in a folder that was deleted.
        os.getcwd()
    except OSError as error:
        raise InputError(f"the working directory cannot be found ({error.strerror}): it was deleted or closed; change "
                         "to another one") from error
    prepare_idle_threads()


LEAST_BYTES = 1536 * 2**20
"""Address space below which nothing is begun. A run on small images takes 1.05 GiB, most of it libraries: with less
they fail in ways of their own, and OpenBLAS asks again and again, for ever, for memory that it does not get. A larger
value refuses limits that would do."""


def _require_address_space() -> None:
    """Refuse a limit on the address space that is too small to start in.

    Where there is a limit OpenBLAS gets one thread, unless the environment says otherwise: each reserves memory.
    """
    limit = _find_limit()
    if limit is None:
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if limit < LEAST_BYTES:
        raise DdicError(f"the address space of a process is limited to {limit / 2**20:.0f} MiB (ulimit -v), ddic needs "
                        f"{LEAST_BYTES / 2**20:.0f} MiB and what the images take: raise the limit")


TIMEOUT = "18"
"""Binary logarithm of the processor's ticks that an idle thread of OpenBLAS waits busily before it sleeps: a tenth of a
millisecond. A larger value wakes it faster, which is not seen in a run; what OpenBLAS takes by itself was measured as
28, a tenth of a second after each product, in each of the three copies that numpy, scipy and PETSc bring."""


def prepare_idle_threads() -> None:
    """Have OpenBLAS's threads sleep soon after a product, unless the environment says otherwise; no digit changes."""
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", TIMEOUT)


def prepare_workspaces() -> None:
    """Let each library of linear algebra take its workspace while there is room; without a limit do nothing.

    numpy, scipy and PETSc bring one each. OpenBLAS takes it at its first product, and loops for ever without.
    """
    if _find_limit() is None:
        return
    import numpy as np
    from petsc4py import PETSc
    from scipy.linalg import blas

    some = np.ones((64, 64), order="F")
    np.linalg.det(some @ some)
    blas.dgemm(1.0, some, some)
    matrix = PETSc.Mat().createDense((64, 64), array=some, comm=PETSc.COMM_SELF)
    product = matrix.matMult(matrix)
    product.destroy()
    matrix.destroy()


def _find_limit() -> int | None:
    """Bytes of address space that a process may have; None for no limit."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit


@contextmanager
def imports_kept() -> Iterator[None]:
    """Keep all that the block makes, and what was there before, until the program ends.

    Nothing of it is garbage, and neither is it looked for, later or at the end: a fifth of the time of the imports, a
    third of a second when the interpreter is taken down.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
