"""FE-DIC and R-DIC by dual domain decomposition: the algorithm box of [BP17]."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case, SolverSection
from ddic.errors import InputError
from ddic.methods.assembly import SINGULAR, Assembly, assemble, factorize, own_part
from ddic.methods.inputs import ImagePair, Region, open_pair, read_region, share_out
from ddic.methods.start import coarse_field, refine_independently
from ddic.parallel.team import Team
from ddic.solvers.dual.continuity import ContinuousField, average_copies
from ddic.solvers.dual.step import DualSettings, DualStep
from ddic.solvers.gauss_newton import (
    GreyState,
    IterationRecord,
    OwnedPart,
    Report,
    Residual,
    Tolerances,
    evaluate,
    gauss_newton,
)
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.monolithic import MonolithicStep
from ddic.solvers.phases import PhaseClock
from ddic.solvers.step import Step


@dataclass(frozen=True)
class Measurement:
    """A measured field, spread over ranks, and how it was measured.

    parts: owned subdomains; field: their displacement, one value per interface node (Eq. 41 of [BP17]).
    residuals, grey: grey levels at the solution; dynamic_range: max f - min f over the region.
    eta: weight of the equilibrium gap; records: Gauss-Newton iterations; n_interface: interface unknowns.
    n_pixels: pixels of the mesh; grey.n_pixels of them counted.
    """

    region: Region
    pair: ImagePair
    parts: list[OwnedPart]
    field: ContinuousField
    residuals: list[Residual]
    grey: GreyState
    dynamic_range: float
    n_pixels: int
    eta: float
    n_interface: int
    records: list[IterationRecord]
    notes: tuple[str, ...]


def dd_dic(team: Team, case: Case, report: Report, note: Callable[[str], None], clock: PhaseClock) -> Measurement:
    """Measure the displacement between the images of a case on all ranks of ``team``.

    report, note: told of iterations and of other news; only rank 0's may speak.
    Raises InputError, SingularSubdomainError, ConvergenceError on all ranks.
    """
    correction = case.correlation.grey_correction
    with clock.phase("read"):
        pair = team.together(lambda: open_pair(case))
        width, height = pair.reference.image.width, pair.reference.image.height
        mesh = read_region(case, width, height) if team.is_root else None
        subdomains, region = share_out(team, case, mesh)
        parts = team.together(lambda: [own_part(s, pair, case.correlation.spline_degree) for s in subdomains])
    with clock.phase("assemble"):
        assembly = assemble(team, parts, region, case.solver, case.regularization)
    with clock.phase("start"):
        nodes = [s.mesh.nodes for s in subdomains]
        start = coarse_field(team, case, pair, mesh, nodes)
        start = refine_independently(team, case, parts, assembly.systems, start, SINGULAR * assembly.mean_diagonal)
        for line in start.notes:
            note(line)
    with clock.phase("factorize"):
        operators = factorize(team, assembly.systems, assembly.mean_diagonal)
    with clock.phase("interface set-up"):
        step, n_interface = linear_step(team, case.solver, assembly, operators)
    try:
        tolerances = Tolerances(case.gauss_newton.tolerance, case.gauss_newton.rms_tolerance,
                                case.gauss_newton.max_iterations)
        solution = gauss_newton(team, parts, start.q, step, correction, tolerances, report, clock)
    finally:
        step.destroy()
        for operator in operators:
            operator.destroy()
    with clock.phase("finish"):
        field = average_copies(team.comm, subdomains, solution.q)
        residuals, grey = evaluate(team, parts, field.q, correction)
        counts = team.ordered_sum([np.array(p.correlation.raster.pixel_counts.sum()) for p in parts])
    return Measurement(region, pair, list(parts), field, residuals, grey, _dynamic_range(team, parts), int(counts),
                       assembly.eta, n_interface, solution.records, start.notes)


def linear_step(team: Team, solver: SolverSection, assembly: Assembly,
                operators: Sequence[LocalOperator]) -> tuple[Step, int]:
    """The step of Gauss-Newton that a case asks for, and its number of interface unknowns."""
    if solver.method == "monolithic":
        if team.size > 1:
            raise InputError(f'solver.method: "monolithic" runs on one rank, not on {team.size}; use "dual"')
        return MonolithicStep(assembly.systems[0], operators[0]), 0
    settings = DualSettings(solver.preconditioner, solver.tolerance, solver.max_iterations)
    step = DualStep(team.comm, assembly.systems, operators, assembly.reaction_scale, settings)
    return step, step.n_interface


def _dynamic_range(team: Team, parts: Sequence[OwnedPart]) -> float:
    def extremes(part: OwnedPart) -> tuple[float, float]:
        values: NDArray[np.float32] = part.correlation.reference.values
        return float(values.min()), float(values.max())

    found = team.gather_lists([extremes(part) for part in parts])
    return max(high for _, high in found) - min(low for low, _ in found)
