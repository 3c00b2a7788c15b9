"""Who owns which number, and the neighbour exchange of values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.parallel.team import Team
from ddic.solvers.petsc import PetscStack, check_petsc_size, to_petsc_integers


class Exchange:
    """Numbers (interface rows, copies, unknowns) owned in contiguous ranges by ranks, with ghosts of neighbours.

    Only ranks that share a number exchange its value (PETSc's scatter).

    Parameters
    ----------
    team : Team
        All ranks; they make it together.
    n_owned : int
        How many numbers this rank owns; the ranges follow the order of the ranks.
    needed : sequence of (n,) arrays of int64
        Numbers that each owned subdomain takes part in.

    Attributes
    ----------
    ghosts : (n_ghosts,) array of int64
        All numbers that this rank takes part in, sorted.
    n_global : int
        How many numbers all ranks own.
    """

    def __init__(self, team: Team, n_owned: int, needed: Sequence[NDArray[np.int64]]) -> None:
        self.team = team
        self.n_owned = n_owned
        self.ghosts: NDArray[np.int64] = np.unique(np.concatenate([np.zeros(0, np.int64), *needed]))
        n_ghosts = len(self.ghosts)
        check_petsc_size(team.sum(n_owned), "unknowns of all ranks")
        numbers = to_petsc_integers(self.ghosts, "unknowns of all ranks")
        with PetscStack() as stack, PetscStack() as indices:
            self._owned = stack.keep(PETSc.Vec().createMPI((n_owned, PETSc.DETERMINE), comm=team.comm))
            self._ghost = stack.keep(PETSc.Vec().createSeq(n_ghosts, comm=PETSc.COMM_SELF))
            self.n_global = int(self._owned.getSize())
            source = indices.keep(PETSc.IS().createGeneral(numbers, comm=PETSc.COMM_SELF))
            target = indices.keep(PETSc.IS().createStride(n_ghosts, first=0, step=1, comm=PETSc.COMM_SELF))
            self._scatter = stack.keep(PETSc.Scatter().create(self._owned, source, self._ghost, target))
            self._objects = stack.pop_all()

    def destroy(self) -> None:
        """Free PETSc's objects."""
        self._objects.close()

    def create_vector(self) -> PETSc.Vec:
        """Create a zero vector of owned numbers over all ranks, the caller's to destroy."""
        vector = self._owned.duplicate()
        vector.set(0.0)
        return vector

    def fetch_ghosts(self, owned: PETSc.Vec) -> NDArray[np.float64]:
        """Fetch the values of all numbers that this rank takes part in, in the order of ``ghosts``; collective."""
        self._scatter.scatter(owned, self._ghost, addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        return np.array(self._ghost.getArray(readonly=1))

    def add_to_owners(self, ghosts: NDArray[np.float64], owned: PETSc.Vec) -> None:
        """Set a vector to the sum of what the ranks contribute, each in the order of ``ghosts``; collective."""
        self._ghost.setArray(ghosts)
        owned.set(0.0)
        self._scatter.scatter(self._ghost, owned, addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def sum_over_ranks(self, ghosts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum what the ranks contribute, in the order of ``ghosts``, and give each the sums of its own; collective."""
        with PetscStack() as stack:
            owned = stack.keep(self.create_vector())
            self.add_to_owners(ghosts, owned)
            return self.fetch_ghosts(owned)
