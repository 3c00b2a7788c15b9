"""What all ranks do together: sums in a fixed order, shared decisions, shared errors, items sent on.

Errors as other ranks can receive them.

What a rank spends on waiting for others.
"""

from __future__ import annotations

import pickle
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.errors import DdicError, as_collective
from ddic.parallel.stop_request import StopRequest


def make_portable(error: Exception, rank: int) -> Exception:
    """Make an error that other ranks can receive; an unexpected one brings its traceback along as a note.

    Parameters
    ----------
    error : Exception
        Of this rank.
    rank : int
        Its number.

    Returns
    -------
    Exception
        The same, or what says the same where it cannot be pickled.
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

        Parameters
        ----------
        is_done : callable
            ``Test`` of an operation that was begun, or the like.
        """
        began = time.perf_counter()
        while not is_done():
            waited = time.perf_counter() - began
            if waited > AWAKE:
                time.sleep(min(SLEPT_SHARE * waited, LONGEST_SLEEP))


T = TypeVar("T")
Summable = TypeVar("Summable", int, float, NDArray[np.float64])

_SENT, _EXCHANGED = 1, 2
"""Tags that keep apart items sent one by one and those of an exchange."""


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
    """

    comm: MPI.Comm
    waiting: Waiting = field(default_factory=Waiting, compare=False, repr=False)
    stop: StopRequest = field(default_factory=StopRequest, compare=False, repr=False)

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
        """Run work on rank 0 and give every rank its result.

        Parameters
        ----------
        work : callable
            Runs on rank 0 alone; its result is pickled for the others.

        Returns
        -------
        T
            The result, on all ranks; copies of it on others than rank 0.

        Raises
        ------
        Exception
            What the work raises, on all ranks.
        """
        return self.broadcast(self.build_on_root(work))

    def build_on_root(self, work: Callable[[], T]) -> T | None:
        """Run work on rank 0 and leave its result there.

        Parameters
        ----------
        work : callable
            Runs on rank 0 alone.

        Returns
        -------
        T or None
            The result on rank 0, None elsewhere; ``require_held`` takes the None away where only rank 0 looks.

        Raises
        ------
        Exception
            What the work raises, on all ranks.
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
        """Run work on rank 0 and give each rank its item of the result.

        Parameters
        ----------
        work : callable
            Runs on rank 0 alone; returns one item per rank.

        Returns
        -------
        T
            This rank's item.

        Raises
        ------
        Exception
            What the work raises, on all ranks.
        """
        items = self.build_on_root(work)
        with self.waiting.counted():
            self._hear_from(0)
            item: T = self.comm.scatter(items, root=0)
        return item

    def together(self, work: Callable[[], T]) -> T:
        """Run work on every rank.

        Parameters
        ----------
        work : callable
            Runs on every rank, free of communication.

        Returns
        -------
        T
            This rank's own result.

        Raises
        ------
        Exception
            What the work of the lowest rank that fails raises, on all ranks.
        """
        result: Any = None
        error: Exception | None = None
        try:
            result = work()
        except Exception as caught:
            error = caught
        self.share_error(error)
        final: T = result
        return final

    def alike(self, work: Callable[[], T]) -> T:
        """Run work that every rank does alike, with collective operations inside it.

        Parameters
        ----------
        work : callable
            Whose errors follow from what all ranks know, and are the same on all of them.

        Returns
        -------
        T
            Its result.

        Raises
        ------
        DdicError
            What the work raises, on all ranks.
        """
        try:
            return work()
        except DdicError as error:
            raise as_collective(error) from error.__cause__

    def share_error(self, error: Exception | None) -> None:
        """Raise on all ranks what the lowest rank with an error brings.

        Parameters
        ----------
        error : Exception or None
            This rank's.

        Raises
        ------
        Exception
            Where a rank has one, on all ranks.
        """
        if error is None and self.size == 1:
            return
        with self.waiting.counted():
            self._meet()
            failed = self.comm.allreduce(self.size if error is None else self.rank, op=MPI.MIN)
        if failed < self.size:
            portable = None if error is None else make_portable(error, self.rank)
            raise as_collective(self.broadcast(portable, failed))

    def abort(self, code: int) -> None:
        """End the program on all ranks; not collective.

        Parameters
        ----------
        code : int
            The exit code.
        """
        self.comm.Abort(code)

    # --------------------------------------------------------------------------------------------------- sums, numbers

    def ordered_sum(self, values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Sum one array per owned subdomain over all subdomains, in their order.

        Parameters
        ----------
        values : sequence of arrays
            One of each owned subdomain, all of one shape.

        Returns
        -------
        array
            The sum on all ranks, of the same shape, which to the last bit does not depend on how subdomains are
            spread over ranks.
        """
        everything = self.gather_lists([np.asarray(v, dtype=np.float64) for v in values])
        return np.asarray(np.sum(np.stack(everything), axis=0))

    def sum(self, value: Summable) -> Summable:
        """Sum a number or an array over ranks.

        Parameters
        ----------
        value : int, float or array
            This rank's; an array has the same shape on all ranks.

        Returns
        -------
        int, float or array
            The sum, the same on all ranks; how it is rounded depends on their number (``ordered_sum`` does not).
        """
        return self._reduce(value, MPI.SUM)

    def maximum(self, value: Summable) -> Summable:
        """Find the largest number over ranks, entry by entry of an array.

        Parameters
        ----------
        value : int, float or array
            This rank's; an array has the same shape on all ranks.

        Returns
        -------
        int, float or array
            The largest, the same on all ranks.
        """
        return self._reduce(value, MPI.MAX)

    def offset(self, count: int) -> int:
        """Sum a count over the ranks below this one: where this rank's numbers begin.

        Parameters
        ----------
        count : int
            How many numbers this rank owns.

        Returns
        -------
        int
            How many the lower ranks own.
        """
        counts = self.gather_lists([count])
        return sum(counts[: self.rank])

    def _reduce(self, value: Summable, operation: MPI.Op) -> Summable:
        with self.waiting.counted():
            self._meet()
            if not isinstance(value, np.ndarray):
                result: Summable = self.comm.allreduce(value, op=operation)
                return result
            total = np.empty_like(value, order="C")
            self.comm.Allreduce(np.ascontiguousarray(value), total, op=operation)
            return total

    # --------------------------------------------------------------------------------------- items from rank to rank

    def broadcast(self, item: T | None, root: int = 0) -> T:
        """Give every rank what one of them holds.

        Parameters
        ----------
        item : T or None
            Looked at on the root alone; pickled.
        root : int
            The rank that holds it.

        Returns
        -------
        T
            The item, on all ranks: the very one on the root, copies elsewhere.
        """
        held: Any = item
        if self.size > 1:
            with self.waiting.counted():
                self._hear_from(root)
                copied = self.comm.bcast(item, root=root)
            # What pickling leaves out stays on the root.
            held = item if self.rank == root else copied
        result: T = held
        return result

    def gather_lists(self, items: Iterable[T]) -> list[T]:
        """Join the lists of all ranks.

        Parameters
        ----------
        items : iterable
            This rank's.

        Returns
        -------
        list
            All ranks' items in the order of ranks, on every rank.
        """
        if self.size == 1:
            return list(items)
        with self.waiting.counted():
            self._meet()
            gathered = self.comm.allgather(list(items))
        return [item for part in gathered for item in part]

    def gather_to(self, item: T, rank: int = 0) -> list[T] | None:
        """Collect an item of every rank on one of them.

        Parameters
        ----------
        item : T
            This rank's.
        rank : int
            Where they go.

        Returns
        -------
        list or None
            All ranks' items in the order of ranks, on that rank; None elsewhere.
        """
        with self.waiting.counted():
            self._meet()
            items: list[T] | None = self.comm.gather(item, root=rank)
        return items

    def exchange(self, items: Mapping[int, T]) -> dict[int, T]:
        """Send items to some ranks and receive what others send to this one; the rest hear nothing; collective.

        Parameters
        ----------
        items : mapping
            By rank that they go to.

        Returns
        -------
        dict
            By rank that they come from, in its order.
        """
        goes_to = np.zeros(self.size, np.int32)
        goes_to[list(items)] = 1
        n_coming = np.zeros(1, np.int32)
        with self.waiting.counted():
            self._meet()
            # No rank ends this sum before all have begun it, hence none mixes two exchanges.
            self.comm.Reduce_scatter_block(goes_to, n_coming)
            sends = [self.comm.isend((self.rank, item), dest=to, tag=_EXCHANGED) for to, item in items.items()]
            received: list[tuple[int, T]] = [self.comm.recv(tag=_EXCHANGED) for _ in range(int(n_coming[0]))]
            MPI.Request.waitall(sends)
        return dict(sorted(received, key=lambda pair: pair[0]))

    def send_from_root(self, item: T | None, to: int) -> T | None:
        """Move what rank 0 holds to another rank.

        Parameters
        ----------
        item : T or None
            Looked at on rank 0 alone.
        to : int
            The other rank, or 0.

        Returns
        -------
        T or None
            The item on that rank, None elsewhere.
        """
        if to == 0:
            return item
        with self.waiting.counted():
            if self.is_root:
                self.comm.send(item, dest=to, tag=_SENT)
            result: T | None = self.receive_message(0, _SENT) if self.rank == to else None
        return result

    def begin_send(self, item: object, to: int) -> MPI.Request:
        """Send an item to a rank without waiting until it arrives; not collective.

        Parameters
        ----------
        item : object
            Pickled at once, hence free to change.
        to : int
            The rank, which calls ``receive``.

        Returns
        -------
        MPI.Request
            For ``finish_sends``.
        """
        return self.comm.isend(item, dest=to, tag=_SENT)

    def finish_sends(self, requests: Iterable[MPI.Request]) -> None:
        """Wait until items have left; not collective.

        Parameters
        ----------
        requests : iterable
            What ``begin_send`` returned.
        """
        with self.waiting.counted():
            for request in requests:
                self.waiting.wait_until(request.Test)

    def receive(self, source: int) -> Any:
        """Wait for the next item that a rank sends to this one; not collective.

        Parameters
        ----------
        source : int
            The rank that calls ``begin_send``.

        Returns
        -------
        object
            The item.
        """
        with self.waiting.counted():
            return self.receive_message(source, _SENT)

    def receive_message(self, source: int, tag: int) -> Any:
        """Wait for a message and take it; not collective.

        Parameters
        ----------
        source : int
            The rank that sends it.
        tag : int
            Its kind.

        Returns
        -------
        object
            What was sent.
        """
        self.waiting.wait_until(lambda: self.comm.Iprobe(source, tag))
        return self.comm.recv(source=source, tag=tag)

    def wait_for_all(self) -> None:
        """Wait until every rank has come here."""
        with self.waiting.counted():
            self._meet()

    def _meet(self) -> None:
        """Wait until every rank has come here: then the operation that follows keeps none waiting."""
        if self.size > 1:
            self.waiting.wait_until(self.comm.Ibarrier().Test)

    def _hear_from(self, root: int) -> None:
        """Wait until one rank has come here, which does not wait for the others."""
        self.waiting.wait_until(self.comm.Ibcast(np.zeros(1, np.int8), root=root).Test)

    # -------------------------------------------------------------------------------------------------- smaller teams

    @contextmanager
    def of_this_node(self) -> Iterator[Team]:
        """Give the team of the ranks that share this rank's memory, and end it; its waiting counts as this team's."""
        with self.waiting.counted():
            self._meet()
            comm = self.comm.Split_type(MPI.COMM_TYPE_SHARED)
        try:
            yield Team(comm, self.waiting, self.stop)
        finally:
            comm.Free()


def require_held(item: T | None) -> T:
    """Return what this rank holds, for work on the rank that ``build_on_root``, ``gather_to``... gave it to.

    Parameters
    ----------
    item : T or None
        None on ranks that do not hold it.

    Returns
    -------
    T
        The item.

    Raises
    ------
    RuntimeError
        On a rank that does not hold it.
    """
    if item is None:
        raise RuntimeError("this rank holds nothing: another rank was given it")
    return item
