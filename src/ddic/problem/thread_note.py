"""Whether the ranks of a node have cores enough for their threads."""

from __future__ import annotations

import os

from ddic.parallel.team import Team


def note_crowded_cores(team: Team, n_threads: int) -> tuple[str, ...]:
    """Write a line for the user where the ranks of a node have more threads than cores to run on; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    n_threads : int
        Of each rank. One is not remarked on: how many ranks there are is the user's choice.

    Returns
    -------
    tuple of str
        A line, or nothing.
    """
    if n_threads == 1:
        return ()
    with team.of_this_node() as node:
        cores = node.gather_lists([list_own_cores()])
    cores_of_node = frozenset[int]().union(*cores)
    nodes = team.gather_lists([(len(cores), len(cores_of_node))])
    n_ranks, n_cores = max(nodes, key=lambda found: found[0] / found[1])
    if n_ranks * n_threads <= n_cores:
        return ()
    return (f"threads: solver.threads = {n_threads} x {n_ranks} MPI ranks of a node = {n_ranks * n_threads} threads, "
            f"but these ranks may run on {n_cores} cores only: fewer threads are as fast",)


def list_own_cores() -> frozenset[int]:
    """List the cores that this process may run on: fewer than the node has where ranks are bound to cores.

    Returns
    -------
    frozenset of int
        Their numbers.
    """
    # Not every system tells.
    if hasattr(os, "sched_getaffinity"):
        return frozenset(os.sched_getaffinity(0))
    return frozenset(range(os.cpu_count() or 1))
