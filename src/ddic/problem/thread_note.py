"""Whether the ranks of a node have cores enough for their threads."""

from __future__ import annotations

import os

from ddic.parallel.team import Team


def thread_note(team: Team, n_threads: int) -> tuple[str, ...]:
    """A line for the user where the ranks of a node have more threads than cores to run on; collective.

    n_threads: of each rank. One thread a rank is not remarked on: how many ranks there are is the user's choice.
    """
    if n_threads == 1:
        return ()
    with team.of_this_node() as node:
        cores = node.gather_lists([own_cores()])
    nodes = team.gather_lists([(len(cores), len(frozenset[int]().union(*cores)))])
    n_ranks, n_cores = max(nodes, key=lambda found: found[0] / found[1])
    if n_ranks * n_threads <= n_cores:
        return ()
    return (f"threads: solver.threads = {n_threads} x {n_ranks} MPI ranks of a node = {n_ranks * n_threads} threads, "
            f"but these ranks may run on {n_cores} cores only: fewer threads are as fast",)


def own_cores() -> frozenset[int]:
    """Numbers of the cores that this process may run on: fewer than the node has where ranks are bound to cores."""
    # Not every system tells.
    if hasattr(os, "sched_getaffinity"):
        return frozenset(os.sched_getaffinity(0))
    return frozenset(range(os.cpu_count() or 1))
