"""Runs with slow iterations that go on, for signals to find them at it."""

from __future__ import annotations

from pathlib import Path

from support.commands import driven

FOUR = '[solver]\nmethod = "dual"\nsubdomains = 4\n'
ENDLESS = "[gauss_newton]\ntolerance = 1e-300\nrms_tolerance = 1e-300\nlargest_tolerance = 1e-300\n"
"""No correction is that small: without a signal the run goes on until corrections no longer become smaller."""

PATIENT = """
import os, time
from pathlib import Path
from ddic.parallel.stop_request import StopRequest
signs = Path({signs!r})
rank = os.environ.get("OMPI_COMM_WORLD_RANK", 0)
def note_signals(request):
    ordinary(request)
    # From here on: what imports MPI starts its threads.
    from mpi4py import MPI
    from ddic.problem.residual_model import ResidualModel
    linearize = ResidualModel.linearize
    def linearize_slowly(model, q):
        if model.team.comm == MPI.COMM_WORLD:  # not that of a start, which each rank finds alone
            (signs / f"iterating{{rank}}").touch()
            time.sleep({seconds})
        return linearize(model, q)
    ResidualModel.linearize = linearize_slowly
    (signs / f"pid{{rank}}").write_text(str(os.getpid()))
ordinary, StopRequest.note_signals = StopRequest.note_signals, note_signals
"""
"""Iterations that last, and files that say which process a rank is and that it iterates."""


def patient(folder: Path, seconds: float = 0.1, command: str = "run") -> list[str]:
    """Command that measures the folder's case.toml, with iterations of so many seconds."""
    return driven(PATIENT.format(signs=str(folder.parent), seconds=seconds), folder, command)
