"""Runs case files on all ranks and counts, by phase, what each rank computes and sends.

Arguments: a number of jobs, and case files. Ranks are shared out to so many jobs, which run at the same time and know
nothing of each other; {job} in a file's name is the number of the job. Each job runs each case several times: the first
run loads libraries and compiled kernels, the others count, and of them the least: other programs can only add. Rank 0
prints a JSON line per case and job: sizes, and for each phase and kind of work calls, messages, bytes and CPU seconds
of the job's rank 0, and the mean, smallest and largest over its ranks. CPU seconds are those of code that communicates
with nobody: on oversubscribed cores a rank that waits spins, which is no work.
"""

from __future__ import annotations

import functools
import json
import pickle
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from bench.support.coarse_record import record_coarse
from ddic.methods.run import run_case
from ddic.parallel.phases import Phase
from ddic.parallel.team import _EXCHANGED, Team
from ddic.parallel.workers import Workers
from ddic.problem.weighted_problem import ProblemSize
from ddic.separated.corrections import CorrectionRecord
from ddic.solvers.dual.coarse_space import CoarseSpace
from ddic.solvers.dual.dual_problem import DualSchurOperator
from ddic.solvers.dual.preconditioner import DualPreconditioner
from ddic.solvers.exchange import Exchange
from ddic.solvers.gauss_newton import IterationRecord

CALLS, MESSAGES, BYTES, CPU = range(4)
Booked = dict[tuple[str, str], list[float]]
"""By phase and kind: calls, messages, bytes, CPU seconds."""

N_COUNTED = 2
"""Runs of a case that count."""


class Ledger:
    """Calls, messages, bytes and CPU seconds by phase and kind, of this rank."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Begin afresh."""
        self.phase = "checks"
        self.entries: Booked = defaultdict(lambda: [0.0, 0.0, 0.0, 0.0])
        self.sizes: dict[str, float] = {}
        self._begun: tuple[str, float] | None = None

    def add(self, kind: str, *, messages: float = 0.0, n_bytes: float = 0.0, cpu: float = 0.0) -> None:
        """Book one call in the current phase."""
        entry = self.entries[self.phase, kind]
        for column, value in zip((CALLS, MESSAGES, BYTES, CPU), (1.0, messages, n_bytes, cpu), strict=True):
            entry[column] += value

    @contextmanager
    def working(self, kind: str) -> Iterator[None]:
        """Book the CPU seconds of what communicates with nobody; work inside of work counts once."""
        if self._begun is not None:
            yield
            return
        self._begin(kind)
        try:
            yield
        finally:
            self._end()

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Leave out of work that calls others what these and their answers take."""
        begun = self._begun
        self._end()
        try:
            yield
        finally:
            if begun is not None:
                self._begin(begun[0])

    def _begin(self, kind: str) -> None:
        self._begun = (kind, time.process_time())

    def _end(self) -> None:
        if self._begun is not None:
            kind, since = self._begun
            self._begun = None
            self.add(kind, cpu=time.process_time() - since)


LEDGER = Ledger()


class CountingListener:
    """Books into the phase that a run is in."""

    def frame(self, number: int, n_frames: int, image: str) -> None:
        """A frame of a series; nothing to book."""

    def phase(self, phase: Phase) -> None:
        """The phase that begins."""
        LEDGER.phase = phase

    def progress(self, share: float) -> None:
        """Nothing."""

    def note(self, line: str) -> None:
        """Nothing."""

    def problem_size(self, size: ProblemSize) -> None:
        """Note the sizes of the problem."""
        LEDGER.sizes |= {"n_dofs": size.n_unknowns, "n_cells": size.n_cells, "n_interface": size.n_interface,
                         "n_pixels": size.n_pixels}

    def iteration(self, record: IterationRecord) -> None:
        """Nothing."""

    def correction(self, record: CorrectionRecord) -> None:
        """Nothing."""


class CountingComm(MPI.Intracomm):
    """Python's collective calls and messages, with what they carry; PETSc's own are counted elsewhere."""

    # petsc4py knows a communicator by the module of its class.
    __module__ = "mpi4py.MPI"

    def allgather(self, sendobj: Any) -> list[Any]:
        """Everybody's object; booked: bytes of all."""
        found = super().allgather(sendobj)
        LEDGER.add("allgather", n_bytes=_size(found))
        return found

    def allreduce(self, sendobj: Any, op: MPI.Op | Callable[[Any, Any], Any] = MPI.SUM) -> Any:
        """A reduction of one small object."""
        LEDGER.add("allreduce", n_bytes=_size(sendobj))
        return super().allreduce(sendobj, op)

    def Allreduce(self, sendbuf: Any, recvbuf: Any, op: MPI.Op = MPI.SUM) -> None:
        """A reduction of an array."""
        LEDGER.add("allreduce", n_bytes=sendbuf.nbytes)
        super().Allreduce(sendbuf, recvbuf, op)

    def bcast(self, obj: Any, root: int = 0) -> Any:
        """An object from the root; booked: its bytes."""
        found = super().bcast(obj, root)
        LEDGER.add("bcast", n_bytes=_size(found))
        return found

    def scatter(self, sendobj: Any, root: int = 0) -> Any:
        """An object for each rank; booked: bytes of all on the root, of the own elsewhere."""
        found = super().scatter(sendobj, root)
        LEDGER.add("scatter", n_bytes=_size(found if sendobj is None else sendobj))
        return found

    def gather(self, sendobj: Any, root: int = 0) -> Any:
        """Objects to the root; booked: bytes of all on the root, of the own elsewhere."""
        found = super().gather(sendobj, root)
        LEDGER.add("gather", n_bytes=_size(sendobj if found is None else found))
        return found

    def send(self, obj: Any, dest: int, tag: int = 0) -> None:
        """A message."""
        LEDGER.add("message", messages=1, n_bytes=_size(obj))
        super().send(obj, dest, tag)

    def recv(self, buf: Any = None, source: int = MPI.ANY_SOURCE, tag: int = MPI.ANY_TAG,
             status: MPI.Status | None = None) -> Any:
        """A message; those of an exchange, which has no root, are booked by themselves."""
        found = super().recv(buf, source, tag, status)
        LEDGER.add("exchanged" if tag == _EXCHANGED else "message", messages=1, n_bytes=_size(found))
        return found

    def isend(self, obj: Any, dest: int, tag: int = 0) -> MPI.Request:
        """A message that is on its way."""
        LEDGER.add("message", messages=1, n_bytes=_size(obj))
        return super().isend(obj, dest, tag)


def _size(thing: Any) -> int:
    return len(pickle.dumps(thing, protocol=pickle.HIGHEST_PROTOCOL))


def book_cpu(owner: type, name: str, kind: str) -> None:
    """Book the CPU seconds of a method that communicates with nobody."""
    method = getattr(owner, name)

    @functools.wraps(method)
    def timed(*arguments: Any, **keys: Any) -> Any:
        with LEDGER.working(kind):
            return method(*arguments, **keys)

    setattr(owner, name, timed)


def book_argument(owner: type, name: str, kind: str) -> None:
    """Book the CPU seconds of the work that a method is given first."""
    method = getattr(owner, name)

    @functools.wraps(method)
    def timed(self: Any, work: Callable[[], Any], *arguments: Any) -> Any:
        def booked() -> Any:
            with LEDGER.working(kind):
                return work()

        return method(self, booked, *arguments)

    setattr(owner, name, timed)


def leave_out(owner: type, name: str) -> None:
    """Do not book what a method takes by itself: it waits for others."""
    method = getattr(owner, name)

    @functools.wraps(method)
    def timed(*arguments: Any, **keys: Any) -> Any:
        with LEDGER.waiting():
            return method(*arguments, **keys)

    setattr(owner, name, timed)


def book_exchange(name: str) -> None:
    """Book messages and bytes that a neighbour exchange brings to this rank, or takes from it on the way back."""
    method = getattr(Exchange, name)

    @functools.wraps(method)
    def counted(self: Exchange, *arguments: Any) -> Any:
        neighbours, rows = _foreign(self)
        LEDGER.add("exchange", messages=neighbours, n_bytes=8 * rows)
        return method(self, *arguments)

    setattr(Exchange, name, counted)


def _foreign(exchange: Exchange) -> tuple[int, int]:
    """How many ranks own ghosts of this one, and how many ghosts they own."""
    vector = exchange.create_vector()
    ranges = np.asarray(vector.getOwnershipRanges())
    mine = int(vector.getComm().getRank())
    vector.destroy()
    owner = np.searchsorted(ranges, exchange.ghosts, side="right") - 1
    return len(np.unique(owner[owner != mine])), int((owner != mine).sum())


def keep_sizes(sizes: dict[str, float]) -> None:
    """Keep sizes of the problem with what this case has booked."""
    LEDGER.sizes |= sizes


def book_corrections() -> None:
    """Book the CPU seconds of coarse corrections; only on one rank are these all work and no waiting."""
    correct = CoarseSpace.correct

    def timed(self: CoarseSpace, residual: Any, result: Any) -> None:
        begin = time.process_time()
        correct(self, residual, result)
        LEDGER.add("coarse correction", cpu=time.process_time() - begin)

    # setattr, because a method is replaced on purpose.
    setattr(CoarseSpace, "correct", timed)  # noqa: B010


def main(n_jobs: int, case_files: list[str]) -> None:
    book_argument(Team, "together", "together")
    book_argument(Team, "build_on_root", "on rank 0")
    # The rank that seeks the start, and the parts of it that it deals out.
    book_argument(Workers, "run", "together")
    leave_out(Workers, "map")
    book_cpu(Workers, "_attempt", "together")
    book_cpu(DualSchurOperator, "apply_own", "S_s")
    book_cpu(DualPreconditioner, "apply_own", "P_s")
    book_exchange("fetch_ghosts")
    book_exchange("add_to_owners")
    record_coarse(keep_sizes)
    book_corrections()
    world = MPI.COMM_WORLD
    job = world.rank * n_jobs // world.size
    of_job = world.Split(job, world.rank)
    team = Team(CountingComm(of_job))
    for case_file in case_files:
        path = Path(case_file.format(job=job))
        counted, walls = [], []
        for run in range(1 + N_COUNTED):
            if team.is_root:
                # To give up the pages of an older result takes rank 0 as long as that is large.
                path.with_suffix(".vtkhdf").unlink(missing_ok=True)
            # All jobs crowd the machine together.
            world.Barrier()
            LEDGER.clear()
            begin = time.perf_counter()
            summary = run_case(team, path, CountingListener())
            if run:
                counted.append(dict(LEDGER.entries))
                walls.append(time.perf_counter() - begin)
        everything = of_job.gather((least(counted), LEDGER.sizes), root=0)
        record = None if everything is None else {
            "case": path.stem, "n_ranks": team.size, "n_jobs": n_jobs, "wall_s": min(walls), **everything[0][1],
            "n_subdomains": summary.n_subdomains, "iterations": summary.iterations,
            "krylov_iterations": list(summary.krylov_iterations), "memory_bytes": list(summary.peak_memory_bytes),
            "entries": joined(everything)}
        for found in world.gather(record, root=0) or ():
            if found is not None:
                print(json.dumps(found), flush=True)


def least(counted: list[Booked]) -> Booked:
    """The least of several runs of the same."""
    return {key: np.min([run.get(key, [0.0] * 4) for run in counted], axis=0).tolist() for key in counted[0]}


def joined(everything: list[tuple[Booked, dict[str, float]]]) -> list[dict[str, Any]]:
    """Entries of all ranks: rank 0's, mean, smallest and largest, each of calls, messages, bytes, CPU."""
    keys = sorted({key for entries, _ in everything for key in entries})
    out = []
    for phase, kind in keys:
        table = np.array([entries.get((phase, kind), [0.0] * 4) for entries, _ in everything])
        out.append({"phase": phase, "kind": kind, "rank_0": table[0].tolist(), "mean": table.mean(axis=0).tolist(),
                    "smallest": table.min(axis=0).tolist(), "largest": table.max(axis=0).tolist()})
    return out


main(int(sys.argv[1]), sys.argv[2:])
