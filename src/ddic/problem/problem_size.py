"""How large a problem is: what the log says before it is solved."""

from __future__ import annotations

from dataclasses import dataclass

from ddic.case.schema import RegularizationSection
from ddic.functionals.half_amplitude import HalfAmplitudes, find_half_amplitudes
from ddic.parallel.team import Team
from ddic.problem.linear_solver import LinearSolver
from ddic.problem.reference_problem import ReferenceProblem
from ddic.problem.region_mesh import build_material


@dataclass(frozen=True)
class ProblemSize:
    """What is about to be solved.

    Attributes
    ----------
    n_unknowns : int
        Of the whole field.
    n_cells : int
        Cells of the mesh.
    n_pixels : int
        Pixels of the mesh that the reference images do not exclude.
    n_subdomains, n_ranks, n_interface : int
        Subdomains, MPI ranks, interface unknowns.
    dynamic_range : float
        max f - min f over the region, grey levels.
    eta : float
        Weight of the equilibrium gap, grey levels squared per pixel squared; 0 without.
    half_amplitudes : HalfAmplitudes or None
        Waves that a cut-off wavelength halves; None where there is none.
    """

    n_unknowns: int
    n_cells: int
    n_pixels: int
    n_subdomains: int
    n_ranks: int
    n_interface: int
    dynamic_range: float
    eta: float
    half_amplitudes: HalfAmplitudes | None = None


def measure_problem_size(team: Team, reference: ReferenceProblem, solver: LinearSolver) -> ProblemSize:
    """Count what is about to be solved; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    reference : ReferenceProblem
        What the reference images give.
    solver : LinearSolver
        Set up.

    Returns
    -------
    ProblemSize
        Sizes and weights.
    """
    region = reference.region
    ranges = team.gather_lists([r.own.measure_grey_range() for r in reference.references])
    lowest = min(low for low, _ in ranges)
    highest = max(high for _, high in ranges)
    return ProblemSize(region.n_field, region.n_cells, reference.n_pixels, region.n_subdomains, team.size,
                       solver.n_interface, highest - lowest, solver.assembly.eta,
                       describe_cut_off(reference.inputs.case.regularization))


def describe_cut_off(section: RegularizationSection | None) -> HalfAmplitudes | None:
    """Say what a cut-off wavelength means.

    Parameters
    ----------
    section : RegularizationSection or None
        Of the case.

    Returns
    -------
    HalfAmplitudes or None
        Pixels; None where no cut-off wavelength is given.
    """
    if section is None or section.cut_off_wavelength is None:
        return None
    if section.operator == "tikhonov":
        # 1 / (1 + (l_c / l)^2) of a wave of any direction is left.
        return HalfAmplitudes(section.cut_off_wavelength, section.cut_off_wavelength)
    return find_half_amplitudes(build_material(section), section.cut_off_wavelength)
