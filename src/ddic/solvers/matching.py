"""A preconditioner for A = M + eta Kbar^T Kbar whose iterations hardly grow with the cut-off wavelength.

It matches A by the square of an operator of second order, as Pearson & Wathen (2012) do in optimal control:
|sqrt(eta) K x|^2 + |D x|^2 and |sqrt(eta) K x + D x|^2 differ by a factor of two at most where D^2 is M, here its lumped
blocks of nodes. On controlled unknowns B = sqrt(eta) K + D is inverted by multigrid. What is left are the others, c for
controlled and b for those at loaded edges: with E x_b = -B^-1 sqrt(eta) K_cb x_b, which decays inwards over the cut-off
wavelength, the energy is

    |w|^2 + x_b^T S x_b,   S = M_bb + 2 (D E)^T D E,   B x_c + sqrt(eta) K_cb x_b = w.

S is a function of the surface's mass: with N = D_b^-1 M_bb D_b^-1, D_b^2 what M_bb lumps to, whose eigenvalue 1 belongs to
smooth fields and 0 to rough ones, (D E)^T D E is near D_b DECAY / (1 - N + DECAY / t) D_b, t that of a translation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from petsc4py import PETSc
from scipy import sparse

from ddic.arrays import Array, BoolArray
from ddic.errors import InputError, as_collective
from ddic.functionals.regularization import scale_rows
from ddic.kinematics.nodal import NodalKinematics
from ddic.parallel.team import Team
from ddic.solvers.exchange import ParallelEntries
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.multigrid import Multigrid
from ddic.solvers.petsc import PetscOwner, PetscStack
from ddic.solvers.whole_system import WholeSystem

DECAY = 0.1
"""(D E)^T D E of fields that are rough along the surface. Half and twice as much change the iterations by a tenth."""

DEGREE = 5
"""Of the polynomial of N whose square is S^-1. A larger one is nearer, for a product with the surface's rows each."""

LEAST = 1e-3
"""Eigenvalue of a node's block, relative to the mean of all, up to which it is raised: without texture D would be
singular."""

BEFORE, AFTER = 2, 4
"""Steps of smoothing before and after coarse corrections: few leave more of x_b's forces on the rows near the surface,
which are large beside w. More cost products with B."""


class MatchingPreconditioner(PetscOwner):
    """Context of PETSc's shell preconditioner, symmetric and positive definite.

    Making it raises InputError on all ranks, where unknowns are no displacements of nodes.

    Parameters
    ----------
    team, whole : Team, WholeSystem
        All ranks, which make it together; A, regularized.
    """

    def __init__(self, team: Team, whole: WholeSystem) -> None:
        _require_nodes(team, whole.systems)
        controlled = _find_controlled(whole)
        with PetscStack() as stack:
            create = whole.exchange.create_vector
            self._controlled, self._others, self._right, self._inside, self._surface, self._scratch = (
                stack.keep(create()) for _ in range(6))
            whole.exchange.set_owned(self._controlled, controlled)
            whole.exchange.set_owned(self._others, 1.0 - controlled)
            ...
            self._objects = stack.pop_all()
