"""Who owns which interface row, and the neighbour exchange of row values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc


class Exchange:
    """Numbers (interface rows, or copies) owned in contiguous ranges by ranks, with ghosts of neighbours.

    Only ranks that share a number exchange its value (PETSc's scatter).
    """

    def __init__(self, comm: MPI.Comm, n_owned: int, needed: Sequence[NDArray[np.int64]]) -> None:
        """Set up the exchange.

        n_owned: how many numbers this rank owns; the ranges follow the order of the ranks.
        needed: numbers that each owned subdomain takes part in.
        ``ghosts`` are all of them, sorted; ``n_global`` counts the numbers of all ranks.
        """
        self.comm, self.n_owned = comm, n_owned
        self.ghosts: NDArray[np.int64] = np.unique(np.concatenate([np.zeros(0, np.int64), *needed]))
        self._owned = PETSc.Vec().createMPI((n_owned, PETSc.DETERMINE), comm=comm)
        self.n_global = int(self._owned.getSize())
        self._ghost = PETSc.Vec().createSeq(len(self.ghosts), comm=PETSc.COMM_SELF)
        index = self.ghosts.astype(PETSc.IntType)
        source = PETSc.IS().createGeneral(index, comm=PETSc.COMM_SELF)
        target = PETSc.IS().createStride(len(index), first=0, step=1, comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(self._owned, source, self._ghost, target)
        source.destroy()
        target.destroy()

    def destroy(self) -> None:
        """Free PETSc's objects."""
        for thing in (self._scatter, self._owned, self._ghost):
            thing.destroy()

    def new_vector(self) -> PETSc.Vec:
        """A zero vector of owned rows over all ranks."""
        vector = self._owned.duplicate()
        vector.set(0.0)
        return vector

    def to_ghosts(self, owned: PETSc.Vec) -> NDArray[np.float64]:
        """Values of all rows that this rank takes part in, in the order of ``ghosts``."""
        self._scatter.scatter(owned, self._ghost, addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        return np.array(self._ghost.getArray(readonly=1))

    def add_to_owners(self, ghosts: NDArray[np.float64], owned: PETSc.Vec) -> None:
        """Set ``owned`` to the sum over ranks of their contributions."""
        self._ghost.setArray(ghosts)
        owned.set(0.0)
        self._scatter.scatter(self._ghost, owned, addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
