"""FE-DIC and R-DIC by dual domain decomposition: the algorithm box of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case
from ddic.errors import ConvergenceError, first_of, on_all_ranks
from ddic.functionals.correlation import Residual
from ddic.kinematics.strain import inverted_cells
from ddic.mesh.mesh import Mesh
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.assembly import SINGULAR, assemble, correlate, own_parts, seen_parts
from ddic.problem.blank_subdomains import Correlated, with_texture
from ddic.problem.inputs import ImagePair, Region, cut, hand_out, open_shared_pair
from ddic.problem.linear_solver import linear_solver
from ddic.problem.mesh_source import build_mesh
from ddic.problem.setup_motion import SetupMotion
from ddic.problem.thread_note import thread_note
from ddic.results.listener import Listener, Setting
from ddic.solvers.dual.continuity import ContinuousField, average_copies
from ddic.solvers.gauss_newton import (
    GreyState,
    IterationRecord,
    OwnedPart,
    Tolerances,
    evaluate,
    gauss_newton,
)
from ddic.start.coarse_field import coarse_field, coarse_task, refine_independently


@dataclass(frozen=True)
class Measurement:
    """A measured field, spread over ranks, and how it was measured.

    parts: owned subdomains; field: their displacement, one value per interface node (Eq. 41 of [BP17]).
    pairs: of each camera; unknowns: of each owned subdomain, (n_unknowns,). residuals (of each view), grey (of each
    camera): grey levels at the solution; setting: sizes and weights; records: iterations. motions: of near-field
    set-ups; noise: of each camera, grey levels (empty with one camera).
    """

    region: Region
    pairs: tuple[ImagePair, ...]
    parts: list[OwnedPart]
    field: ContinuousField
    unknowns: list[NDArray[np.float64]]
    residuals: list[tuple[Residual, ...]]
    grey: tuple[GreyState, ...]
    setting: Setting
    records: list[IterationRecord]
    notes: tuple[str, ...]
    motions: tuple[SetupMotion, ...] = ()
    noise: tuple[float, ...] = ()


def dd_dic(team: Team, case: Case, listener: Listener, clock: PhaseClock) -> Measurement:
    """Measure the displacement between the images of a case on all ranks of ``team``.

    Raises InputError, SingularSubdomainError, ConvergenceError on all ranks.
    """
    correction = case.correlation.grey_correction
    with clock.phase(Phase.MESH):
        pair = open_shared_pair(team, case)
        mesh = _whole_mesh(team, case, pair)
    with clock.phase(Phase.START):
        find_coarse = coarse_task(team, case, pair, mesh)
        # Rank 0 splits the mesh while the last rank looks for the coarse field.
        whole, found = team.together(lambda: (None if mesh is None else cut(case, mesh, team.size), find_coarse()))
        subdomains, region = hand_out(team, whole)
        start = coarse_field(team, case, found, [s.mesh.nodes for s in subdomains])
    with clock.phase(Phase.READ):
        parts = team.together(lambda: own_parts(subdomains, pair, case.correlation.spline_degree, case.solver.threads))
        n_pixels = sum(team.gather_lists([part.view.correlation.n_usable_pixels for part in parts]))
        parts = team.together(lambda: seen_parts(parts, start.q))
    with clock.phase(Phase.ASSEMBLE):
        correlated = Correlated(parts, correlate(team, parts), region, start)
        if case.solver.method == "dual":
            correlated = with_texture(team, case, pair, mesh, correlated)
        parts, region, start = correlated.parts, correlated.region, correlated.start
        assembly = assemble(team, parts, correlated.hessians, region, case.solver, case.regularization)
    with clock.phase(Phase.INDEPENDENT_START):
        start = refine_independently(team, case, parts, assembly.systems, start, SINGULAR * assembly.mean_diagonal)
    notes = (*start.notes, *thread_note(team, case.solver.threads))
    for line in notes:
        listener.note(line)
    with linear_solver(team, case, assembly, clock) as (step, n_interface):
        setting = setting_of(team, region, parts, n_pixels, n_interface, assembly.eta)
        listener.setting(setting)
        solution = gauss_newton(team, parts, start.q, step, correction, tolerances_of(case), listener.iteration, clock)
    with clock.phase(Phase.FINISH):
        field = average_copies(team.comm, [part.subdomain for part in parts], solution.q)
        refuse_inverted_cells(team, parts, field)
        residuals, grey = evaluate(team, parts, field.q, correction)
    return Measurement(region, (pair,), list(parts), field, field.q, residuals, grey, setting, solution.records,
                       notes)


def _whole_mesh(team: Team, case: Case, pair: ImagePair) -> Mesh | None:
    """The whole mesh on rank 0, nothing elsewhere; an error there is raised on all ranks."""
    held: list[Mesh] = []
    image = pair.reference.image
    team.on_root(lambda: held.append(build_mesh(case, image.width, image.height)))
    return held[0] if held else None


def tolerances_of(case: Case) -> Tolerances:
    """When Gauss-Newton stops."""
    section = case.gauss_newton
    return Tolerances(section.tolerance, section.rms_tolerance, section.max_iterations, case.solver.inexact)


def refuse_inverted_cells(team: Team, parts: Sequence[OwnedPart], field: ContinuousField) -> None:
    """Raise ConvergenceError on all ranks where a field turns cells inside out, however small the last correction.

    Such a field is no displacement of matter.
    """
    found = team.gather_lists([part.subdomain.cell_ids[inverted_cells(part.subdomain.mesh, q)]
                               for part, q in zip(parts, field.q, strict=True)])
    cells = np.sort(np.concatenate(found))
    if len(cells):
        raise on_all_ranks(ConvergenceError(
            f"the measured field turns {len(cells)} elements inside out (numbers {first_of(cells)}): the images do not "
            "determine it; use larger elements or a longer regularization.cut_off_wavelength"))


def setting_of(team: Team, region: Region, parts: Sequence[OwnedPart], n_pixels: int, n_interface: int,
               eta: float) -> Setting:
    """Sizes and weights of what is about to be solved; collective."""
    def range_of(part: OwnedPart) -> tuple[float, float]:
        values = part.view.correlation.reference.values
        return float(values.min()), float(values.max())

    lows, highs = zip(*team.gather_lists([range_of(part) for part in parts]), strict=True)
    return Setting(region.n_dofs, region.n_cells, n_pixels, region.n_subdomains, team.size, n_interface,
                   max(highs) - min(lows), eta)
