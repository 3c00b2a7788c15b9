"""A plastic law in the place of linear elasticity, Remark 1 of [BP17]: the gap K q becomes f_int(q, history).

Gauss-Newton then solves

    (M + eta Kbar^T Kbar) dq = b - eta Kbar^T P f_int(q),    Kbar = P K,

of which a linear step takes Kbar q in the place of P f_int by itself: b is given the difference. The history is that
of the frames that were measured. K stays that of elasticity, by which forces out of balance are weighed: with K_tan(q)
in its place, renewed wherever it changed, points at the yield stress took turns, and Gauss-Newton needed twenty times
the iterations for a field that was no better, or found none (docs/choosing.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array
from ddic.errors import InputError, as_collective
from ddic.functionals.plasticity import PlasticCells, PlasticLaw, PlasticState
from ddic.inputs.inputs import Inputs
from ddic.inputs.mesh_source import weigh_stiffness
from ddic.mesh.rotation import Rotation
from ddic.parallel.distribution import sum_shared_nodes
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.added_forces import fit_rigid_motion
from ddic.problem.linear_solver import LinearSolver
from ddic.solvers.exchange import average_copies
from ddic.solvers.linear_step import AllowedError, LinearStep, StepResult
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.whole_system import EquilibriumRows


class FollowedLaw:
    """What the material of owned subdomains has been through.

    Parameters
    ----------
    team, subdomains : Team, sequence of Subdomain
        All ranks, and this rank's subdomains, whose unknowns are displacements of nodes.
    law : PlasticLaw
        Of all cells.
    relative : sequence of (n_cells,) array
        Factor of the stresses of each cell, of each subdomain.
    """

    def __init__(self, team: Team, subdomains: Sequence[Subdomain], law: PlasticLaw,
                 relative: Sequence[Array]) -> None:
        self.team, self.subdomains = team, subdomains
        self._cells = [PlasticCells(subdomain.mesh, law, factors)
                       for subdomain, factors in zip(subdomains, relative, strict=True)]
        self._history = [PlasticState.none(cells.n_points) for cells in self._cells]

    def keep(self, q: Field) -> float:
        """Add a field that was found to the history, and give the share of all points that yield in it; collective."""
        found = [now for _, now in self._respond(q)[0]]
        counts = [np.array([(now.amount > before.amount).sum(), len(now.amount)], dtype=float)
                  for now, before in zip(found, self._history, strict=True)]
        self._history = found
        n_yielding, n_points = self.team.ordered_sum(counts)
        return float(n_yielding / n_points)

    def find_plastic_strains(self) -> list[Array]:
        """Find the mean equivalent plastic strain of each cell so far, (n_cells,) of each subdomain."""
        return [cells.average(state.amount) for cells, state in zip(self._cells, self._history, strict=True)]

    def compute_forces(self, systems: Sequence[LocalSystem], q: Field) -> Field:
        """Compute eta Kbar^T (Kbar q - P f_int(q)), which b is given; collective."""
        # Of one field: a step takes none of q's jumps from subdomain to subdomain for a gap.
        q = average_copies(q).q
        responses, rotation = self._respond(q)
        rows = [EquilibriumRows(system) for system in systems]
        gaps = []
        for system, of_system, (forces, _), q_s in zip(systems, rows, responses, q, strict=True):
            turned = rotation.apply(forces.reshape(-1, 2)).ravel()
            gap = of_system.multiply(q_s) - of_system.factors * system.row_weights * turned
            gaps.append(gap.reshape(-1, 2))
        complete = sum_shared_nodes(self.team, self.subdomains, gaps)
        return q.with_parts(system.eta * of_system.multiply_transposed(gap.ravel())
                            for system, of_system, gap in zip(systems, rows, complete, strict=True))

    def _respond(self, q: Field) -> tuple[list[tuple[Array, PlasticState]], Rotation]:
        """Forces, (n_dofs,), and states by a field without the region's rotation, and that; collective."""
        rotation = fit_rigid_motion(q).rotation
        found = []
        for cells, u, before in zip(self._cells, q.displacements, self._history, strict=True):
            nodes = cells.mesh.nodes
            turned_back = rotation.apply_inverse(nodes + u.reshape(nodes.shape)) - nodes
            found.append(cells.compute_forces(turned_back.ravel(), before))
        return found, rotation


def build_law(team: Team, inputs: Inputs, subdomains: Sequence[Subdomain]) -> FollowedLaw | None:
    """Build the law of a case's material; None where it is elastic. Raises InputError on all ranks."""
    case, section = inputs.case, inputs.case.regularization
    if section is None or section.yield_strain is None:
        return None
    if inputs.choose_kinematics is not None:
        raise as_collective(InputError("kinematics: plasticity (yield_strain) goes with displacements of nodes; leave "
                                       "one of them out"))
    law = PlasticLaw(section.poisson_ratio, section.yield_strain, section.hardening_ratio)
    return FollowedLaw(team, subdomains, law, [weigh_stiffness(case, subdomain.mesh) for subdomain in subdomains])


@dataclass(frozen=True, eq=False)
class LawStep(LinearStep):
    """Solves the linear steps of a material that follows a law, by those of linear elasticity.

    Attributes
    ----------
    law : FollowedLaw
        The law.
    solver : LinearSolver
        Of linear elasticity.
    """

    law: FollowedLaw
    solver: LinearSolver

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        """Solve for dq; collective."""
        return self.solver.step.solve(q, b + self.law.compute_forces(self.solver.assembly.systems, q), allowed)

    def forget(self) -> None:
        """Forget what earlier steps taught."""
        self.solver.step.forget()

    def destroy(self) -> None:
        """Do nothing: the solver frees its step."""
