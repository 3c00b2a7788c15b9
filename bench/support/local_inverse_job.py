"""The MPI part of bench/local_inverse.py: a subdomain with neighbours on all sides, alone on rank 0 of two.

Argument: JSON with "case", "elements" (per side of that subdomain), "ring" (elements across its neighbours, which
rank 1 holds) and "kind" (solver.local_inverse). Rank 0 prints one JSON line about itself.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from bench.support.step_problem import factorize, prepare_step
from ddic.case.schema import Case
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.solvers.dual.dual_step import DualSettings, DualStep
from ddic.solvers.dual.preconditioner import LocalInverseKind

TEAM = Team(MPI.COMM_WORLD)
PAGE = resource.getpagesize()


def peak() -> int:
    """Largest resident memory of this process so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def resident() -> int:
    """Resident memory of this process, bytes."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * PAGE


def nine_parts(elements: int, ring: int) -> NDArray[np.int64]:
    """Subdomain of each cell: 0 in the middle, 1 to 8 around it."""
    band = np.repeat([1, 0, 2], [ring, elements, ring])
    return np.asarray(3 * band[:, None] + band, dtype=np.int64).ravel()


def main(job: dict[str, Any]) -> None:
    """Set up the middle subdomain on rank 0 and its neighbours on rank 1, and solve once.

    Parameters
    ----------
    job : dict
        Of the command line.
    """
    case = Case.model_validate(job["case"])
    # The middle one first, as large as the others together: rank 0 gets it alone.
    assembly = prepare_step(TEAM, case, lambda mesh: nine_parts(job["elements"], job["ring"])).assemble()
    before = resident()
    operators = factorize(assembly)
    factorized = resident()
    kind: LocalInverseKind = job["kind"]
    TEAM.wait_for_all()
    clock = time.perf_counter()
    settings = DualSettings("two_level", recycle=False, local_inverse=kind)
    step = DualStep(TEAM, assembly.systems, operators, assembly.reaction_scale, settings)
    set_up = time.perf_counter() - clock
    highest = peak()
    rng = np.random.default_rng(TEAM.rank)
    zero = Field.zero(TEAM, [system.subdomain for system in assembly.systems])
    clock = time.perf_counter()
    b = zero.with_parts(s.hessian @ rng.normal(size=s.hessian.shape[0]) for s in assembly.systems)
    result = step.solve(zero, b)
    solve = time.perf_counter() - clock
    step.destroy()
    for operator in operators:
        operator.destroy()
    if TEAM.is_root:
        subdomain = assembly.systems[0].subdomain
        print(json.dumps({
            "n_dofs": subdomain.n_unknowns,
            "n_interface": len(subdomain.jumps.unknowns) + len(subdomain.reactions.unknowns),
            "peak_bytes": highest, "before_factorization_bytes": before, "factorized_bytes": factorized,
            "set_up_seconds": set_up, "iterations": result.krylov_iterations, "owned": len(assembly.systems),
            "seconds_per_iteration": solve / max(result.krylov_iterations, 1)}), flush=True)


main(json.loads(sys.argv[1]))
