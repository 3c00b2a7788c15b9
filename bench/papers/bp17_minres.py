"""Remark 8 of [BP17]: MINRES for the symmetric, indefinite S_tot, beside GMRES, on a small beam.

MINRES keeps three vectors where GMRES keeps all, and asks for a positive definite preconditioner. That of the paper is
as indefinite as S_tot. Two that are definite are made of its parts: |S_s|^-1, and the diagonal blocks of Eq. 38's
factors, a^-1 and (-d)^-1. Iterations are compared at one displacement error.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from petsc4py import PETSc

from bench.papers.compared import UNKNOWN, Compared
from bench.support.first_step import Curve, FirstStep, count_iterations, prepare_first_step
from bench.support.loaded_beam import SMALL_BEAM, prepare_beam
from ddic.case.loader import parse_case_text
from ddic.solvers.dual.dual_problem import DualProblem, LocalDual, PackedSymmetric
from ddic.solvers.dual.preconditioner import DualPreconditioner, Preconditioning, assemble_schur, build_preconditioner
from ddic.solvers.petsc import PetscStack

Array = NDArray[np.float64]

PLACE = "[BP17, Remark 8]"

WAVELENGTHS = (150.0, 600.0)
"""Cut-off wavelengths, pixels."""

TARGET = 1e-4
"""Displacement error at which iterations are compared."""

TOLERANCE, MOST_ITERATIONS, REPEATS = 1e-8, 2000, 3
"""Of a curve, on the norm that the solver looks at; of the timing."""

NAMES = {"gmres": "GMRES, no preconditioner", "minres": "MINRES, no preconditioner",
         "gmres_paper": "GMRES, block explicit inverse of [BP17]", "minres_paper": "MINRES, the same",
         "minres_absolute": "MINRES, S_s replaced by |S_s|",
         "minres_blocks": "MINRES, diagonal blocks a and -d of S_s alone"}


@dataclass(frozen=True)
class Solver:
    """A Krylov solver of the interface problem: PETSc's name, and its preconditioner."""

    kind: str
    preconditioner: Preconditioning | None

    def create(self, matrix: PETSc.Mat, most: int) -> PETSc.KSP:
        """Create PETSc's object, to be destroyed."""
        ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        ksp.setOperators(matrix)
        ksp.setType(self.kind)
        ksp.setTolerances(rtol=TOLERANCE, atol=1e-300, divtol=1e12, max_it=most)
        if self.kind == "fgmres":
            ksp.setGMRESRestart(most + 1)
        pc = ksp.getPC()
        if self.preconditioner is None:
            pc.setType(PETSc.PC.Type.NONE)
        else:
            pc.setType(PETSc.PC.Type.PYTHON)
            pc.setPythonContext(self.preconditioner)
        return ksp


@dataclass(frozen=True)
class Tried:
    """What a solver did: curve of iterates, PETSc's reason for its end, CPU seconds to TARGET, nan where not met."""

    curve: Curve
    reason: int
    seconds: float

    @property
    def iterations(self) -> int | None:
        """Iterations to TARGET; None where it was not met."""
        try:
            return count_iterations(self.curve, TARGET)
        except RuntimeError:
            return None


def measure(folder: Path, *, smoke: bool) -> list[Compared]:
    """Try all solvers at each cut-off wavelength, and draw how the displacement error falls."""
    files = prepare_beam(SMALL_BEAM, folder.parent / f"beam_{SMALL_BEAM.width}")
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    found: list[Compared] = []
    wavelengths = WAVELENGTHS[:1] if smoke else WAVELENGTHS
    for axes, wavelength in zip(np.atleast_1d(figure.subplots(1, len(wavelengths))), wavelengths, strict=True):
        text = files.write_case(wavelength, f'method = "dual"\nsubdomains = {SMALL_BEAM.subdomains}')
        first = prepare_first_step(parse_case_text(text, folder / "case.toml"), files.field)
        try:
            tried, n_interface = try_all(first)
        finally:
            first.destroy()
        _draw(axes, wavelength, tried)
        setting = (f"{SMALL_BEAM.text}, {first.problem.region.n_field} unknowns, {n_interface} at interfaces, l_c = "
                   f"{wavelength:g} px, first linear step, products with S_s as arrays")
        found += _list_rows(setting, tried)
    figure.savefig(folder / "bp17_minres.png", dpi=150)
    return found


def try_all(first: FirstStep) -> tuple[dict[str, Tried], int]:
    """Try all solvers on one interface problem; its number of unknowns comes as well."""
    with PetscStack() as stack:
        problem = stack.keep(first.create_interface())
        # Sets the arrays of S_s that products read, too.
        paper, _ = build_preconditioner(stack, problem, "paper", "dense")
        matrix = stack.keep(problem.exchange.create_matrix(problem.operator))
        right = stack.keep(problem.exchange.create_vector())
        free = first.solve_alone()
        problem.set_right_hand_side(right, free, first.q, first.b)

        def measure_error(multipliers: PETSc.Vec) -> float:
            return first.measure_error(problem.correct(free, multipliers))

        solvers = {"gmres": Solver("fgmres", None), "minres": Solver("minres", None),
                   "gmres_paper": Solver("fgmres", paper), "minres_paper": Solver("minres", paper),
                   "minres_absolute": Solver("minres", _build_definite(problem, invert_absolute)),
                   "minres_blocks": Solver("minres", _build_definite(problem, invert_diagonal_blocks))}
        return ({name: _try(solver, matrix, right, measure_error) for name, solver in solvers.items()},
                problem.exchange.n_global)


def _try(solver: Solver, matrix: PETSc.Mat, right: PETSc.Vec, measure_error: Callable[[PETSc.Vec], float]) -> Tried:
    with PetscStack() as stack:
        ksp = stack.keep(solver.create(matrix, MOST_ITERATIONS))
        solution, residual = stack.keep(right.duplicate()), stack.keep(right.duplicate())
        curve: Curve = []

        def watch(ksp: PETSc.KSP, iteration: int, _: float) -> None:
            multipliers = ksp.buildSolution()
            # The true residual: MINRES itself looks at a norm that its preconditioner makes.
            matrix.mult(multipliers, residual)
            residual.aypx(-1.0, right)
            curve.append((iteration, float(residual.norm() / right.norm()), measure_error(multipliers)))

        ksp.setMonitor(watch)
        solution.set(0.0)
        ksp.solve(right, solution)
        reason = int(ksp.getConvergedReason())
    tried = Tried(curve, reason, float("nan"))
    if tried.iterations is None:
        return tried
    return Tried(curve, reason, median(_time(solver, matrix, right, tried.iterations) for _ in range(REPEATS)))


def _time(solver: Solver, matrix: PETSc.Mat, right: PETSc.Vec, iterations: int) -> float:
    """CPU seconds of so many iterations, unwatched."""
    with PetscStack() as stack:
        ksp, solution = stack.keep(solver.create(matrix, max(iterations, 1))), stack.keep(right.duplicate())
        solution.set(0.0)
        begin = time.process_time()
        ksp.solve(right, solution)
        return time.process_time() - begin


Invert = Callable[[Array, int], Array]
"""From S_s and its number of unknowns with jumps to a positive definite array."""


def _build_definite(problem: DualProblem, invert: Invert) -> DualPreconditioner:
    """Build sum_s B_s X_s B_s^T with a positive definite X_s in place of S_s^-1."""
    def build(local: LocalDual) -> PackedSymmetric:
        return PackedSymmetric(invert(assemble_schur(local), local.n_jumps))

    locals_ = problem.local_duals
    return DualPreconditioner(problem.exchange, [local.incidence for local in locals_],
                              [build(local) for local in locals_])


def invert_absolute(schur: Array, _: int) -> Array:
    """Invert |S_s|, which has the absolute values of the eigenvalues of S_s."""
    values, vectors = np.linalg.eigh(schur)
    return np.asarray((vectors / np.abs(values)) @ vectors.T)


def invert_diagonal_blocks(schur: Array, n_jumps: int) -> Array:
    """Invert a and -d of Eq. 38 of [BP17], d = S^(lbar)(lbar) - b^T a^-1 b, without what couples them."""
    a, b = schur[:n_jumps, :n_jumps], schur[:n_jumps, n_jumps:]
    out = np.zeros_like(schur)
    out[:n_jumps, :n_jumps] = np.linalg.inv(a)
    out[n_jumps:, n_jumps:] = np.linalg.inv(b.T @ out[:n_jumps, :n_jumps] @ b - schur[n_jumps:, n_jumps:])
    return 0.5 * (out + out.T)


def _list_rows(setting: str, tried: dict[str, Tried]) -> list[Compared]:
    subject = f"the remark is about MINRES on S_tot; {UNKNOWN}"
    return [Compared(PLACE, f"{NAMES[name]}: iterations to a displacement error of {TARGET:g}", setting, subject,
                     _describe(one), _explain(name)) for name, one in tried.items()]


def _describe(one: Tried) -> str:
    if not one.curve:
        return f"ended by PETSc before the first iteration (reason {one.reason}): r^T P r is negative"
    iteration, residual, error = one.curve[-1]
    if one.iterations is None:
        return f"not met in {iteration}, which leave an error of {error:.1e} at a residual of {residual:.1e}"
    _, then, left = next(point for point in one.curve if point[0] == one.iterations)
    return (f"{one.iterations}, at a relative residual of {then:.1e} and an error of {left:.1e}; "
            f"{1e3 * one.seconds:.0f} CPU ms, {1e3 * one.seconds / max(one.iterations, 1):.2f} an iteration")


def _explain(name: str) -> str:
    return {"gmres": "", "gmres_paper": "",
            "minres": "the iterates of GMRES in exact arithmetic; rounding spoils the orthogonality that three vectors "
                      "do not restore",
            "minres_paper": "MINRES needs r^T P r > 0, and P is as indefinite as S_tot",
            "minres_absolute": "definite, so that P S_tot keeps eigenvalues of both signs; the paper's P, near "
                               "the inverse, brings them towards 1",
            "minres_blocks": "definite; without what couples jumps and reactions in S_s^-1"}[name]


def _draw(axes: Axes, wavelength: float, tried: dict[str, Tried]) -> None:
    """Displacement error over iterations."""
    for name, one in tried.items():
        if len(one.curve) > 1:
            style = "--" if name == "minres" else "-"
            axes.loglog([1 + k for k, *_ in one.curve], [error for *_, error in one.curve], style, label=NAMES[name])
    axes.axhline(TARGET, color="0.5", linewidth=0.8, linestyle=":")
    axes.set(xlabel="1 + iteration", ylabel="displacement error beside one domain", title=f"l_c = {wavelength:g} px")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="x-small")
