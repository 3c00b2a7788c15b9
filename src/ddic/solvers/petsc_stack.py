"""PETSc's objects in the making: freed if their maker fails half-way, and all at once at the end."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Protocol, TypeVar


class Destroyable(Protocol):
    """A PETSc object, or what holds some."""

    def destroy(self) -> object:
        """Free it."""
        ...


T = TypeVar("T", bound=Destroyable)


class PetscStack(ExitStack):
    """Destroys what it keeps, last made first, when its ``with`` block ends.

    A constructor makes its objects inside a ``with`` block, so that an error on the way frees those already made, and
    ends with ``self._objects = stack.pop_all()``, which hands them to ``self._objects.close()``.
    Python's collector is not enough: it runs at different times on the ranks, so that petsc4py leaves parallel objects
    to a later clean-up.
    """

    def keep(self, thing: T) -> T:
        """Keep a thing.

        Parameters
        ----------
        thing : Destroyable
            Destroyed with the stack.

        Returns
        -------
        Destroyable
            The same.
        """
        self.callback(thing.destroy)
        return thing
