"""One solver of bench/interface_solvers.py in processes of its own: prints a JSON line from rank 0.

Argument: JSON with "solver", "n", "dim", "wavelength" (px), "per_subdomain" (elements a side; 0: one a rank),
"reference" (file).
Times are of set-up (everything after M and K, forming the operators included), of one solve, and, of ddic's own
methods, of another one that leaves as much error as a step of Gauss-Newton may ("inexact"): CPU and wall seconds of the
slowest rank; memory is the largest resident size of each rank, of the whole process.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from bench.support.coarse_record import record_coarse
from bench.support.step_problem import factorize
from bench.support.tiled_texture import TiledProblem
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.grid import GridLines
from ddic.parallel.distribution import scatter_subdomains
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.split import split_by_blocks, split_by_metis
from ddic.partition.subdomain import Subdomain, interface_weights
from ddic.problem.assembly import Assembly
from ddic.solvers.dual.dual_step import DualSettings, DualStep
from ddic.solvers.dual.preconditioner import Preconditioner
from ddic.solvers.gauss_newton import SHARE
from ddic.solvers.linear_step import AllowedError, LinearStep
from ddic.solvers.local_system import LocalOperator, LocalSystem
from ddic.solvers.matching import MatchingPreconditioner
from ddic.solvers.whole_system import AssembledStep, ConjugateGradientStep

DUAL: tuple[Preconditioner, ...] = ("paper", "scaled", "two_level")
"""Preconditioners of the dual solver."""
MOST_KRYLOV = 2000
CG_TOLERANCE = 1e-8
"""On |b - A x| / |b|; the displacement error that it leaves is reported beside that of the other solvers."""
PETSC = {
    "cholmod": {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "cholmod"},
    "gamg": {"ksp_type": "cg", "ksp_norm_type": "unpreconditioned", "pc_type": "gamg", "ksp_rtol": str(CG_TOLERANCE),
             "ksp_max_it": str(MOST_KRYLOV), "mg_levels_ksp_max_it": "4"},
    "hpddm": {"ksp_type": "cg", "ksp_norm_type": "unpreconditioned", "pc_type": "hpddm", "ksp_rtol": str(CG_TOLERANCE),
              "ksp_max_it": str(MOST_KRYLOV)},
}
"""Options (prefix bench_) of the solvers on the assembled operator. Four smoothing steps instead of GAMG's two:
A is of fourth order, and with two it took over a thousand iterations on 13 000 unknowns at l_c = 32 elements."""

LOW_RANK = {"assembled_mat_mumps_icntl_35": "2", "assembled_mat_mumps_cntl_7": "1e-8", "assembled_ksp_type": "cg",
            "assembled_ksp_rtol": str(CG_TOLERANCE)}
"""Options of a factor of MUMPS in blocks of low rank: a factor that drops what is below CNTL(7) is no exact inverse."""

Values = tuple[list[NDArray[np.int64]], list[NDArray[np.float64]]]
"""Numbers of unknowns and their values; what neighbours share may occur twice."""


class Laps:
    """CPU and wall seconds of named parts, of the slowest rank."""

    def __init__(self, team: Team) -> None:
        self._team = team
        self.seconds: dict[str, float] = {}

    def time(self, name: str, work: Callable[[], Any]) -> Any:
        """Run ``work`` between barriers."""
        self._team.comm.Barrier()
        cpu, wall = time.process_time(), time.perf_counter()
        result = work()
        spent = {f"{name}_cpu": time.process_time() - cpu}
        self._team.comm.Barrier()
        spent[f"{name}_wall"] = time.perf_counter() - wall
        for key, value in spent.items():
            self.seconds[key] = self._team.comm.allreduce(value, op=MPI.MAX)
        return result


def method(team: Team, problem: TiledProblem, solver: str, per_subdomain: int | None, laps: Laps,
           ) -> tuple[dict[str, Any], Values]:
    """One linear step as ddic's own method solves it, on METIS subdomains of squares and blocks of cubes."""
    count = max(round((problem.n / per_subdomain) ** problem.dim), 2) if per_subdomain else team.size
    blocks = (1,) * (problem.dim - 1) + (count,)
    if problem.dim == 3 and per_subdomain:
        blocks = (round(problem.n / per_subdomain),) * 3
        count = prod(blocks)

    def split() -> tuple[list[Any], NDArray[np.float64]]:
        mesh = problem.rows_of_cells(0, problem.n)
        # Boxes are split into blocks where nothing else is asked for.
        labels = split_by_metis(mesh, count) if problem.dim == 2 else split_by_blocks(mesh, blocks)
        # Equal cells, split evenly: equal costs.
        is_controlled = problem.controlled(mesh) & (problem.wavelength > 0)
        return build_subdomains(NodalRegion(mesh), labels, is_controlled), np.ones(count)

    subdomains = scatter_subdomains(team, split)
    eta, diagonal = problem.eta_and_diagonal
    systems, right, next_right = [], [], []
    for s in subdomains:
        systems.append(_system(problem, s, eta))
        right.append(systems[-1].hessian @ problem.displacement(s.mesh))
        next_right.append(systems[-1].hessian @ problem.displacement(s.mesh, seed=2))
    assembly = Assembly(systems, eta, diagonal)
    before = largest_resident()
    operators = laps.time("factorize", lambda: factorize(assembly) if solver in DUAL else [])
    step = laps.time("interface", lambda: make_step(team, solver, assembly, operators))
    n_interface = step.n_interface if isinstance(step, DualStep) else 0
    at_rest = Field.zero(team, subdomains)
    result = laps.time("solve", lambda: step.solve(at_rest, at_rest.with_parts(right)))
    # As Gauss-Newton asks for a step: no further than its own progress.
    later = laps.time("inexact", lambda: step.solve(at_rest, at_rest.with_parts(next_right),
                                                    AllowedError(rms=0.0, share=SHARE)))
    laps.seconds |= {f"setup_{k}": laps.seconds[f"factorize_{k}"] + laps.seconds[f"interface_{k}"]
                     for k in ("cpu", "wall")}
    step.destroy()
    for operator in operators:
        operator.destroy()
    found = {"n_subdomains": count, "n_interface": n_interface, "iterations": result.krylov_iterations,
             "inexact_iterations": later.krylov_iterations, "resident_before": before}
    return found, ([s.numbers for s in subdomains], list(result.dq))


def _system(problem: TiledProblem, subdomain: Subdomain, eta: float) -> LocalSystem:
    """M_s and Kbar_s of a subdomain; without regularization M_s alone."""
    hessian = problem.hessian(subdomain.mesh)
    if eta == 0:
        return LocalSystem(subdomain, hessian, None, np.zeros(0), 0.0)
    weights = interface_weights(subdomain.multiplicity, "consistent") * subdomain.controlled
    return LocalSystem(subdomain, hessian, problem.stiffness(subdomain.mesh, weights), weights, eta)


def make_step(team: Team, solver: str, assembly: Assembly, operators: list[LocalOperator]) -> LinearStep:
    """Make ddic's own linear step.

    Parameters
    ----------
    team : Team
        Ranks.
    solver : str
        One of DUAL, "assembled", "low_rank", "conjugate_gradient" or "matching".
    assembly : Assembly
        The systems.
    operators : list of LocalOperator
        Local factors, of the dual solver.

    Returns
    -------
    LinearStep
        To be destroyed.
    """
    if solver == "low_rank":
        for key, value in LOW_RANK.items():
            PETSc.Options().setValue(key, value)
    if solver in ("assembled", "low_rank"):
        return AssembledStep(team, assembly.systems, assembly.smallest_eigenvalue)
    if solver in ("conjugate_gradient", "matching"):
        return ConjugateGradientStep(team, assembly.systems, DualSettings.tolerance, MOST_KRYLOV,
                                     MatchingPreconditioner if solver == "matching" else None)
    preconditioner = next(kind for kind in DUAL if kind == solver)
    settings = DualSettings(preconditioner, max_iterations=MOST_KRYLOV, recycle=False)
    return DualStep(team, assembly.systems, operators, assembly.reaction_scale, settings)


def of_petsc(team: Team, problem: TiledProblem, solver: str, laps: Laps) -> tuple[dict[str, Any], Values]:
    """A on strips of rows over the ranks and a solver of PETSc."""
    edges = np.linspace(0, problem.n + 1, team.size + 1).astype(int)
    first, last = int(edges[team.rank]), int(edges[team.rank + 1])
    options = PETSc.Options()
    for key, value in PETSC[solver].items():
        options.setValue(f"bench_{key}", value)
    before = largest_resident()

    def set_up() -> tuple[PETSc.Mat, PETSc.KSP, NDArray[np.float64]]:
        rows, b = problem.operator_rows(first, last)
        csr = (rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data)
        local = rows.shape[0]
        matrix = PETSc.Mat().createAIJ(((local, problem.n_dofs), (local, problem.n_dofs)), bsize=problem.dim, csr=csr,
                                       comm=team.comm)
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        if solver in ("gamg", "hpddm"):
            set_rigid_modes(problem, matrix, first, last)
        ksp = PETSc.KSP().create(team.comm)
        ksp.setOptionsPrefix("bench_")
        ksp.setOperators(matrix)
        ksp.setFromOptions()
        ksp.setUp()
        return matrix, ksp, b

    matrix, ksp, b = laps.time("setup", set_up)
    x, right = matrix.createVecs()
    right.setArray(b)
    laps.time("solve", lambda: ksp.solve(right, x))
    if ksp.getConvergedReason() < 0:
        raise RuntimeError(f"{solver} did not converge in {ksp.getIterationNumber()} iterations")
    begin, end = x.getOwnershipRange()
    values = np.array(x.getArray(readonly=1))
    found = {"iterations": ksp.getIterationNumber() if "rtol" in str(PETSC[solver]) else 0,
             "resident_before": before}
    for thing in (ksp, matrix, x, right):
        thing.destroy()
    return found, ([np.arange(begin, end)], [values])


def set_rigid_modes(problem: TiledProblem, matrix: PETSc.Mat, first: int, last: int) -> None:
    """Rigid modes as near-null space: K, hence all but M of A, does not feel them."""
    line = np.arange(problem.n + 1.0)
    coordinates = matrix.createVecRight()
    nodes = GridLines((*[line] * (problem.dim - 1), line[first:last])).nodes
    coordinates.setArray(nodes.ravel() / problem.n)
    modes = PETSc.NullSpace().createRigidBody(coordinates)
    matrix.setNearNullSpace(modes)
    modes.destroy()
    coordinates.destroy()


def largest_resident() -> int:
    """Largest resident size of this process so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def compared(team: Team, problem: TiledProblem, field: Values, reference: Path, *, keep: bool) -> float | None:
    """Relative distance from the field kept in a file by a direct solver; ``keep``: write the file instead."""
    if keep:
        pieces = team.comm.gather(field, root=0)
        if pieces is not None:
            whole = np.empty(problem.n_dofs)
            for dofs, values in ((d, v) for piece in pieces for d, v in zip(*piece, strict=True)):
                whole[dofs] = values
            np.save(reference, whole)
        return None
    if not reference.is_file():
        return None
    whole = np.load(reference, mmap_mode="r")
    largest = max((float(np.abs(v - whole[d]).max()) for d, v in zip(*field, strict=True)), default=0.0)
    return float(team.comm.allreduce(largest, op=MPI.MAX) / np.abs(whole).max())


def main(argument: str) -> None:
    task = json.loads(argument)
    team = Team(MPI.COMM_WORLD)
    problem = TiledProblem(task["n"], task["wavelength"], task["dim"])
    laps = Laps(team)
    coarse: dict[str, float] = {}
    record_coarse(coarse.update)
    if task["solver"] in PETSC:
        found, field = of_petsc(team, problem, task["solver"], laps)
    else:
        found, field = method(team, problem, task["solver"], task["per_subdomain"], laps)
    # Before the comparison, which gathers fields that no solver needs.
    peaks = team.gather_lists([largest_resident()])
    before = team.gather_lists([found.pop("resident_before")])
    if coarse:
        coarse["coarse_factor_cpu_s"] = team.comm.allreduce(coarse["coarse_factor_cpu_s"], op=MPI.MAX)
    reference = Path(task["reference"])
    keep = task["solver"] in ("cholmod", "assembled") and not reference.is_file()
    difference = compared(team, problem, field, reference, keep=keep)
    if team.is_root:
        print(json.dumps({**found, **coarse, "n_dofs": problem.n_dofs, "difference": difference, **laps.seconds,
                          "peak_memory_bytes": peaks, "before_setup_bytes": before}), flush=True)


main(sys.argv[1])
