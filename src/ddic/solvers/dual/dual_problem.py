"""The interface problem S_tot v = t_tot of all subdomains, Eq. 25-31 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain, rows_of
from ddic.solvers.dual.local_dual import LocalDual, add_motion_rows, build_local_dual
from ddic.solvers.dual.motion_preconditioner import sum_motion_scales
from ddic.solvers.dual.schur_operator import DualSchurOperator
from ddic.solvers.exchange import Exchange
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem


@dataclass(frozen=True)
class DualProblem:
    """The interface problem, spread over ranks.

    Attributes
    ----------
    systems : list of LocalSystem
        This rank's subdomains, motions of cameras held.
    exchange : Exchange
        Of interface rows, its owner.
    local_duals : list of LocalDual
        Of each of these subdomains.
    n_motion : int
        Number of unknowns of all cameras' motions.
    """

    systems: list[LocalSystem]
    exchange: Exchange
    local_duals: list[LocalDual]
    n_motion: int

    @property
    def team(self) -> Team:
        """The ranks."""
        return self.exchange.team

    @cached_property
    def operator(self) -> DualSchurOperator:
        """S_tot."""
        return DualSchurOperator(self.exchange, self.local_duals)

    @property
    def subdomains(self) -> list[Subdomain]:
        """Subdomains of this rank."""
        return [system.subdomain for system in self.systems]

    def set_right_hand_side(self, right: PETSc.Vec, free: Sequence[NDArray[np.float64]],
                            q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]]) -> None:
        """Set a vector to t_tot = sum_s G_s (u_s + free_s), Eq. 27 of [BP17]; collective.

        Rows of a camera's motion are (N_s^T free_s - R_s^T b_s) / kappa.

        Parameters
        ----------
        right : PETSc.Vec
            Overwritten.
        free : sequence of (n_field,) arrays
            A_s^-1 (b_s - eta Kbar_s^T Kbar_s u_s) of each owned subdomain.
        q : sequence of (n_unknowns,) arrays
            u_s, then the camera's motion.
        b : sequence of (n_unknowns,) arrays
            b_s.
        """
        fields = [q_s[:len(free_s)] + free_s for q_s, free_s in zip(q, free, strict=True)]
        total = self.operator.of_rank.sum_jumps(fields)
        for local, q_s, b_s in zip(self.local_duals, q, b, strict=True):
            if local.motion is not None:
                motion, n_field = local.motion, local.operator.n
                total[motion.rows] -= motion.columns.T @ q_s[:n_field] + b_s[n_field:] / motion.scale
        self.exchange.add_to_owners(total, right)

    def correct(self, free: Sequence[NDArray[np.float64]], multipliers: PETSc.Vec) -> list[NDArray[np.float64]]:
        """Correct the fields by the multipliers v, Eq. 24a of [BP17]; collective.

        Parameters
        ----------
        free : sequence of (n_field,) arrays
            The parts without multipliers, pixels.
        multipliers : PETSc.Vec
            v.

        Returns
        -------
        list of (n_field,) arrays
            du_s = free_s - A_s^-1 G_s^T v of each owned subdomain, pixels.
        """
        v = self.exchange.fetch_ghosts(multipliers)
        return [free_s - forced_s for free_s, forced_s in zip(free, self.operator.of_rank.solve_forces(v), strict=True)]

    def append_motion(self, du: Sequence[NDArray[np.float64]], multipliers: PETSc.Vec) -> list[NDArray[np.float64]]:
        """Append the corrections of cameras' motions to those of the fields; collective.

        Parameters
        ----------
        du : sequence of (n_field,) arrays
            Of each owned subdomain, pixels.
        multipliers : PETSc.Vec
            v, among which are kappa alpha.

        Returns
        -------
        list of (n_unknowns,) arrays
            dq_s, pixels.
        """
        v = self.exchange.fetch_ghosts(multipliers)
        return [du_s if local.motion is None else np.concatenate([du_s, v[local.motion.rows] / local.motion.scale])
                for du_s, local in zip(du, self.local_duals, strict=True)]

    def destroy(self) -> None:
        """Free PETSc's objects; local factors are their maker's."""
        self.exchange.destroy()


def build_dual_problem(team: Team, systems: Sequence[LocalSystem], operators: Sequence[LocalOperator],
                       scale: float) -> DualProblem:
    """Build the interface problem; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    systems : sequence of LocalSystem
        This rank's subdomains.
    operators : sequence of LocalOperator
        Their A_s factorised, motions of cameras held.
    scale : float
        c of ``build_local_dual``.

    Returns
    -------
    DualProblem
        The caller's to destroy.
    """
    subdomains = [system.subdomain for system in systems]
    scales = sum_motion_scales(team, systems)
    held_systems = [system.without_motion for system in systems]
    exchange = Exchange(team, sum(s.n_owned_rows for s in subdomains), _list_rows(subdomains))
    local_duals = []
    for system, held_system, operator in zip(systems, held_systems, operators, strict=True):
        field = build_local_dual(held_system, operator, exchange.ghosts, scale)
        local_duals.append(add_motion_rows(field, system, exchange.ghosts, scales))
    n_motion = sum(len(values) for values in scales.values())
    return DualProblem(held_systems, exchange, local_duals, n_motion)


def _list_rows(subdomains: Sequence[Subdomain]) -> list[NDArray[np.int64]]:
    """Numbers of the interface rows that subdomains take part in."""
    rows = []
    for subdomain in subdomains:
        rows += [rows_of(subdomain.jumps), rows_of(subdomain.reactions)]
        if subdomain.motion is not None:
            rows.append(subdomain.motion.rows)
    return rows
