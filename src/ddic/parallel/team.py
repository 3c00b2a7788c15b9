"""What all ranks do together: sums in a fixed order, shared decisions, shared errors, items sent on.

Also errors as other ranks can receive them, and what a rank spends on waiting for others.
"""

from __future__ import annotations

import pickle
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

from ddic.arrays import Array, IntArray
from ddic.errors import DdicError, as_collective
from ddic.parallel.stop_request import StopRequest


def make_portable(error: Exception, rank: int) -> Exception:
    """Make an error that other ranks can receive; an unexpected one brings its traceback along as a note.

    What cannot be pickled is replaced by an error that says the same.
    """
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


AWAKE = 2e-4
"""Seconds that a rank looks again and again before it sleeps between two looks. A larger value takes more of the
processor, a smaller one makes ranks that arrive together wait for one another's sleep."""

SLEPT_SHARE = 0.2
"""Time between two looks over that waited so far: by as much a wait may become longer."""

LONGEST_SLEEP = 2e-3
"""Between two looks, seconds. A larger value delays what others send through this rank."""


@dataclass
class Waiting:
    """CPU seconds that this rank has spent in a team's communication.

    Attributes
    ----------
    seconds : float
        So far.
    """

    seconds: float = 0.0

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Count the time spent inside."""
        began = time.process_time()
        try:
            yield
        finally:
            self.seconds += time.process_time() - began

    def wait_until(self, is_done: Callable[[], bool]) -> None:
        """Wait for others, mostly asleep: MPI's own operations turn in a loop, on a processor that others need.

        ``is_done`` is ``Test`` of an operation that was begun, or the like.
        """
        began = time.perf_counter()
        while not is_done():
            waited = time.perf_counter() - began
            if waited > AWAKE:
                time.sleep(min(SLEPT_SHARE * waited, LONGEST_SLEEP))


T = TypeVar("T")
Summable = TypeVar("Summable", int, float, Array)
Comparable = TypeVar("Comparable", int, float, Array, tuple[float, int])

_SENT, _EXCHANGED = 1, 2
"""Tags that keep apart items sent one by one and those of an exchange."""


Place = tuple[int, int]
"""Level and number of a group of terms: group i of level l holds the terms i 2^l to (i + 1) 2^l - 1."""

Groups = dict[Place, Array]
"""Sums of groups that wait for a neighbour; two neighbours become one group as soon as both are there."""


def sum_neighbours(first: int, terms: Iterable[Array]) -> Groups:
    """Add up arrays of one shape whose numbers follow each other from ``first``, as far as neighbours are there."""
    groups: Groups = {}
    for number, values in enumerate(terms, start=first):
        _add(groups, (0, number), values)
    return groups


def merge_groups(some: Groups, others: Groups) -> Groups:
    """Join groups of different terms, those that are neighbours added up."""
    groups = dict(some)
    for place, values in others.items():
        _add(groups, place, values)
    return groups


def sum_groups(groups: Groups) -> Array:
    """Sum the groups of all terms; one is left where the number of terms is a power of 2."""
    total, *others = (groups[place] for place in sorted(groups, key=lambda place: place[1] << place[0]))
    return sum(others, start=total)


def _add(groups: Groups, place: Place, values: Array) -> None:
    """Add a group's sum."""
    level, number = place
    neighbour = groups.pop((level, number ^ 1), None)
    if neighbour is None:
        groups[place] = values
        return
    first, second = (neighbour, values) if number % 2 else (values, neighbour)
    _add(groups, (level + 1, number // 2), first + second)


@dataclass(frozen=True)
class Team:
    """A communicator and all operations of several ranks that ddic allows itself outside PETSc.

    Every operation is collective unless it says otherwise: all ranks call it, in the same order. Work that a rank does
    inside one (``on_root``, ``build_on_root``, ``scatter_from_root``, ``together``) is free of communication; an error
    there is raised on all ranks, so that none is left waiting.

    Attributes
    ----------
    comm : MPI.Comm
        For PETSc's constructors; its own methods are called in ``ddic.parallel`` alone.
    waiting : Waiting
        What this rank has spent in the operations, by which a busy rank is told from one that waits for it.
    stop : StopRequest
        Whether this rank was asked to stop; ``is_stop_asked`` tells all ranks.
    beside : int
        Of one group among others: ranks that share this rank's memory; 0 where there are no groups.
    """

    comm: MPI.Comm
    waiting: Waiting = field(default_factory=Waiting, compare=False, repr=False)
    stop: StopRequest = field(default_factory=StopRequest, compare=False, repr=False)
    beside: int = field(default=0, compare=False, repr=False)

    @classmethod
    def world(cls) -> Team:
        """Return the team of all ranks that were started together."""
        return cls(MPI.COMM_WORLD)

    @classmethod
    def alone(cls) -> Team:
        """Return the team of this rank alone."""
        return cls(MPI.COMM_SELF)

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

    # ------------------------------------------------------------------------------------------------ work and errors

    def on_root(self, work: Callable[[], T]) -> T:
        """Run work on rank 0 and give every rank its result, pickled; raises on all ranks what the work raises."""
        return self.broadcast(self.build_on_root(work))

    def build_on_root(self, work: Callable[[], T]) -> T | None:
        """Run work on rank 0 and leave its result there, None elsewhere; raises on all ranks what the work raises.

        ``require_held`` takes the None away where only rank 0 looks.
        """
        outcome: T | None = None
        error: Exception | None = None
        if self.is_root:
            try:
                outcome = work()
            except Exception as caught:
                error = make_portable(caught, self.rank)
        error = self.broadcast(error)
        if error is not None:
            raise as_collective(error)
        return outcome

    def scatter_from_root(self, work: Callable[[], Sequence[T]]) -> T:
        """Run work on rank 0, whose errors all ranks raise, and give each rank its item of the result."""
        return self.scatter(self.build_on_root(work))

    def together(self, work: Callable[[], T]) -> T:
        """Run work, free of communication, on every rank, for its own result; all raise the lowest failing's error."""
        error: Exception | None = None
        try:
            result = work()
        except Exception as caught:
            error = caught
        # Does not return where there is no result.
        self.share_error(error)
        return result

    def alike(self, work: Callable[[], T]) -> T:
        """Run work that every rank does alike, with collective operations inside it.

        Its errors must follow from what all ranks know, and hence be the same on all of them: a DdicError that it
        raises is raised as one of all ranks.
        """
        try:
            return work()
        except DdicError as error:
            raise as_collective(error) from error.__cause__

    def share_error(self, error: Exception | None) -> None:
        """Raise on all ranks what the lowest rank with an error brings; nothing where all bring None."""
        if error is None and self.size == 1:
            return
        with self._all_here():
            failed = self.comm.allreduce(self.size if error is None else self.rank, op=MPI.MIN)
        if failed < self.size:
            portable = None if error is None else make_portable(error, self.rank)
            raise as_collective(self.broadcast(portable, failed))

    def abort(self, code: int) -> None:
        """End the program on all ranks with an exit code; not collective."""
        self.comm.Abort(code)

    # --------------------------------------------------------------------------------------------------- sums, numbers

    def ordered_sum(self, values: Sequence[Array]) -> Array:
        """Sum one array per owned subdomain, all of one shape, over all subdomains, in their order.

        The sum is that of all ranks and does not depend, to the last bit, on how subdomains are spread over ranks.
        """
        return self.sum_numbered(self.offset(len(values)), [np.asarray(v, dtype=np.float64) for v in values])

    def sum_numbered(self, first: int, terms: Iterable[Array]) -> Array:
        """Sum arrays, as ``ordered_sum`` does, of which this rank has those from number ``first`` on."""
        groups = sum_neighbours(first, terms)
        if self.size > 1:
            with self._all_here():
                # A tree of messages, each with the few groups that wait for a neighbour.
                groups = self.comm.allreduce(groups, op=merge_groups)
        return sum_groups(groups)

    def sum(self, value: Summable) -> Summable:
        """Sum a number, or an array of one shape on all ranks, over ranks; the same on all ranks.

        How the sum is rounded depends on their number (``ordered_sum`` does not).
        """
        return self._reduce(value, MPI.SUM)

    def maximum(self, value: Comparable) -> Comparable:
        """Find the largest number or tuple over ranks, entry by entry of an array of one shape; the same on all."""
        return self._reduce(value, MPI.MAX)

    def sum_below(self, counts: IntArray) -> IntArray:
        """Sum whole numbers, (n,) on all ranks, over the ranks below this one."""
        below = np.zeros(len(counts), np.int64)
        if self.size > 1:
            with self._all_here():
                MPI.Intracomm(self.comm).Exscan(np.asarray(counts, np.int64), below)
        # MPI leaves rank 0's undefined.
        return np.zeros_like(below) if self.is_root else below

    def offset(self, count: int) -> int:
        """Sum a count over the ranks below this one: where this rank's numbers begin."""
        return int(self.sum_below(np.array([count]))[0])

    def _reduce(self, value: T, operation: MPI.Op) -> T:
        with self._all_here():
            if not isinstance(value, np.ndarray):
                result: T = self.comm.allreduce(value, op=operation)
                return result
            total = np.empty_like(value, order="C")
            self.comm.Allreduce(np.ascontiguousarray(value), total, op=operation)
            return total

    # --------------------------------------------------------------------------------------- items from rank to rank

    def broadcast(self, item: T | None, root: int = 0) -> T:
        """Give every rank what one of them, the root, holds: the very item on the root, pickled copies elsewhere."""
        held: Any = item
        if self.size > 1:
            with self.waiting.counted():
                self._hear_from(root)
                copied = self.comm.bcast(item, root=root)
            # What pickling leaves out stays on the root.
            held = item if self.rank == root else copied
        result: T = held
        return result

    def scatter(self, items: Sequence[T] | None, root: int = 0) -> T:
        """Give each rank its item of what one of them, the root, holds, one a rank."""
        if self.size == 1 and items is not None:
            return items[0]
        with self.waiting.counted():
            self._hear_from(root)
            item: T = self.comm.scatter(items, root=root)
        return item

    def gather_lists(self, items: Iterable[T]) -> list[T]:
        """Join the lists of all ranks, in the order of ranks, on every rank."""
        if self.size == 1:
            return list(items)
        with self._all_here():
            gathered = self.comm.allgather(list(items))
        return [item for part in gathered for item in part]

    def gather_to(self, item: T, rank: int = 0) -> list[T] | None:
        """Collect an item of every rank on one of them, in the order of ranks; None on the others."""
        with self._all_here():
            items: list[T] | None = self.comm.gather(item, root=rank)
        return items

    def exchange(self, items: Mapping[int, T]) -> dict[int, T]:
        """Send items to some ranks and receive what others send to this one; the rest hear nothing; collective.

        ``items`` are by rank that they go to; the result is by rank that they come from, in its order.
        """
        received: list[tuple[int, T]] = []
        # No rank sends before all have come here, hence none mixes two exchanges.
        with self._all_here():
            sends = [self.comm.issend((self.rank, item), dest=to, tag=_EXCHANGED) for to, item in items.items()]
            all_sent: MPI.Request | None = None

            def has_all() -> bool:
                nonlocal all_sent
                while self.comm.Iprobe(tag=_EXCHANGED):
                    received.append(self.comm.recv(tag=_EXCHANGED))
                # A synchronous send ends once its item was received: when all ranks' have, nothing more can come.
                if all_sent is None and MPI.Request.Testall(sends):
                    all_sent = self.comm.Ibarrier()
                return all_sent is not None and bool(all_sent.Test())

            self.waiting.wait_until(has_all)
        return dict(sorted(received, key=lambda pair: pair[0]))

    def send_from_root(self, item: T | None, to: int) -> T | None:
        """Move what rank 0 holds to another rank, or leave it where that is 0; None on all others."""
        if to == 0:
            return item
        with self.waiting.counted():
            if self.is_root:
                self.comm.send(item, dest=to, tag=_SENT)
        return self.receive(0) if self.rank == to else None

    def begin_send(self, item: object, to: int, tag: int = _SENT) -> MPI.Request:
        """Send an item to a rank, which calls ``receive``, without waiting until it arrives; not collective.

        It is pickled at once, hence free to change. ``finish_sends`` takes the request; ``tag`` tells kinds of items
        apart.
        """
        with self.waiting.counted():
            return self.comm.isend(item, dest=to, tag=tag)

    def finish_sends(self, requests: Iterable[MPI.Request]) -> None:
        """Wait until the items of ``begin_send`` have left; not collective."""
        with self.waiting.counted():
            for request in requests:
                self.waiting.wait_until(request.Test)

    def receive(self, source: int, tag: int = _SENT) -> Any:
        """Wait for the next item of a kind that a rank sends to this one; not collective."""
        with self.waiting.counted():
            self.waiting.wait_until(lambda: self.comm.Iprobe(source, tag))
            return self.comm.recv(source=source, tag=tag)

    def wait_for_all(self) -> None:
        """Wait until every rank has come here."""
        with self._all_here():
            pass

    @contextmanager
    def _all_here(self) -> Iterator[None]:
        """Begin once every rank has come here, so that no operation keeps one waiting; counts as waiting to the end."""
        with self.waiting.counted():
            if self.size > 1:
                self.waiting.wait_until(self.comm.Ibarrier().Test)
            yield

    def _hear_from(self, root: int) -> None:
        """Wait until one rank has come here, which does not wait for the others."""
        self.waiting.wait_until(self.comm.Ibcast(np.zeros(1, np.int8), root=root).Test)

    # -------------------------------------------------------------------------------------------------- smaller teams

    @contextmanager
    def of_this_node(self) -> Iterator[Team]:
        """Give the team of the ranks that share this rank's memory, and end it; its waiting counts as this team's."""
        with self._all_here():
            comm = self.comm.Split_type(MPI.COMM_TYPE_SHARED)
        try:
            yield replace(self, comm=comm)
        finally:
            comm.Free()

    @contextmanager
    def in_groups(self, n_groups: int) -> Iterator[tuple[int, Team]]:
        """Split the ranks into groups of neighbours that work by themselves, and end them; collective.

        Gives the number of this rank's group and its team, whose waiting counts as this team's.
        """
        if n_groups == 1:
            yield 0, self
            return
        beside = self.count_beside()
        number = self.rank * n_groups // self.size
        with self._all_here():
            comm = self.comm.Split(number)
        try:
            yield number, replace(self, comm=comm, beside=beside)
        finally:
            comm.Free()

    def count_beside(self) -> int:
        """Count the ranks that share this rank's memory, it and those of other groups included; collective."""
        if self.beside:
            return self.beside
        with self.of_this_node() as node:
            return node.size


def require_held(item: T | None) -> T:
    """Return what this rank holds of ``build_on_root``, ``gather_to``...; raises RuntimeError on one that does not."""
    if item is None:
        raise RuntimeError("this rank holds nothing: another rank was given it")
    return item
