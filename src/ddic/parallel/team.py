"""What all ranks do together: sums in a fixed order, shared decisions, shared errors."""

from __future__ import annotations

import pickle
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.errors import DdicError, on_all_ranks

T = TypeVar("T")


@dataclass
class Waiting:
    """CPU seconds that this rank has spent in a team's communication: MPI turns in a loop while it waits."""

    seconds: float = 0.0

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Count the time spent inside."""
        began = time.process_time()
        try:
            yield
        finally:
            self.seconds += time.process_time() - began


@dataclass(frozen=True)
class Team:
    """A communicator and the collective operations that ddic allows itself outside PETSc.

    waiting: what this rank has spent in them, by which a busy rank is told from one that waits for it.
    """

    comm: MPI.Comm
    waiting: Waiting = field(default_factory=Waiting, compare=False, repr=False)

    @property
    def rank(self) -> int:
        """Number of this rank."""
        return int(self.comm.Get_rank())

    @property
    def size(self) -> int:
        """Number of ranks."""
        return int(self.comm.Get_size())

    @property
    def is_root(self) -> bool:
        """Whether this is rank 0, which decides and reports."""
        return self.rank == 0

    def on_root(self, work: Callable[[], T]) -> T:
        """Run ``work`` on rank 0 and give every rank its result; an error there is raised on all ranks."""
        outcome = self._attempt_on_root(work)
        with self.waiting.counted():
            result: T = self.comm.bcast(outcome, root=0)
        return result

    def scatter_from_root(self, work: Callable[[], Sequence[T]]) -> T:
        """Run ``work`` on rank 0, which returns one item per rank, and give each rank its own."""
        items = self._attempt_on_root(work)
        with self.waiting.counted():
            item: T = self.comm.scatter(items, root=0)
        return item

    def together(self, work: Callable[[], T]) -> T:
        """Run ``work`` (free of communication) on every rank; an error on one rank is raised on all."""
        result: Any = None
        error: Exception | None = None
        try:
            result = work()
        except Exception as caught:
            error = _portable(caught, self.rank)
        with self.waiting.counted():
            failed = self.comm.allreduce(self.rank if error is not None else self.size, op=MPI.MIN)
        if failed < self.size:
            error = self.comm.bcast(error, root=failed)
            assert error is not None
            raise on_all_ranks(error)
        final: T = result
        return final

    def hand_over(self, item: T | None, to: int) -> T | None:
        """Give what rank 0 holds to another rank; None elsewhere."""
        if to == 0:
            return item
        with self.waiting.counted():
            if self.is_root:
                self.comm.send(item, dest=to)
            result: T | None = self.comm.recv(source=0) if self.rank == to else None
        return result

    def _attempt_on_root(self, work: Callable[[], T]) -> T | None:
        """Run ``work`` on rank 0 alone; its result there, None elsewhere, its error on all ranks."""
        outcome: T | None = None
        error: Exception | None = None
        if self.is_root:
            try:
                outcome = work()
            except Exception as caught:
                error = _portable(caught, self.rank)
        with self.waiting.counted():
            error = self.comm.bcast(error, root=0)
        if error is not None:
            raise on_all_ranks(error)
        return outcome

    def ordered_sum(self, values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Sum one array per owned subdomain over all subdomains, in their order.

        The result does not depend on how subdomains are spread over ranks, to the last bit.
        """
        with self.waiting.counted():
            parts = self.comm.allgather([np.asarray(v, dtype=np.float64) for v in values])
        everything = [v for part in parts for v in part]
        return np.asarray(np.sum(np.stack(everything), axis=0))

    def gather_lists(self, values: Sequence[T]) -> list[T]:
        """All ranks' items, in the order of ranks, on every rank."""
        with self.waiting.counted():
            gathered = self.comm.allgather(list(values))
        return [v for part in gathered for v in part]


def _portable(error: Exception, rank: int) -> Exception:
    """The error as other ranks can receive it; an unexpected one brings its traceback along as a note."""
    if isinstance(error, DdicError):
        return error
    error.add_note(f"on rank {rank}:\n{''.join(traceback.format_exception(error))}")
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        # Some exceptions cannot be rebuilt from their arguments, which would end the other ranks without a reason.
        stand_in = RuntimeError(f"{type(error).__name__}: {error}")
        stand_in.__notes__ = error.__notes__
        return stand_in
    return error
