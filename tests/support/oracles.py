"""What one rank makes for all of them, so that oracles are computed once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from mpi4py import MPI

T = TypeVar("T")
Item = TypeVar("Item")


def make_on_root(make: Callable[[], T]) -> T:
    """What rank 0 makes by itself, on all ranks; collective."""
    made: T = MPI.COMM_WORLD.bcast(make() if MPI.COMM_WORLD.rank == 0 else None)
    return made


def make_in_turn(make: Callable[[Item], T], items: Sequence[Item]) -> list[T]:
    """What is made of each item, every rank by itself of its share, on all ranks in order; collective."""
    rank, size = MPI.COMM_WORLD.rank, MPI.COMM_WORLD.size
    shares = MPI.COMM_WORLD.allgather([make(item) for item in items[rank::size]])
    return [shares[number % size][number // size] for number in range(len(items))]
