"""How much memory each rank may still take."""

from __future__ import annotations

import os
import resource
from pathlib import Path

from ddic.parallel.team import Team

_SYSTEM = Path("/proc/meminfo")
_OF_PROCESS = Path("/proc/self/statm")
_GROUPS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current"),
           Path("/sys/fs/cgroup/memory.stat"))
"""Limit, use and use by kind of the control group in which a container, or a job of a batch system, runs."""


def measure_available_memory(team: Team) -> int:
    """Measure the memory that each rank may still take where all take as much; collective.

    Parameters
    ----------
    team : Team
        All ranks.

    Returns
    -------
    int
        Bytes, the same on all ranks: the least of what a node has left over its ranks, and of what a limit of the rank
        itself (``ulimit -v``) leaves.
    """
    with team.of_this_node() as node:
        share = read_available_memory() // node.size
    return -team.maximum(-min(share, _read_own_limit()))


def read_available_memory() -> int:
    """Read what this machine has left, or the control group that this process runs in.

    Returns
    -------
    int
        Bytes.
    """
    left = _read_fields(_SYSTEM).get("MemAvailable:", 0) * 1024
    if not left:
        # Not Linux: what there is at all.
        left = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return min(left, _read_group_limit(left))


def _read_group_limit(otherwise: int) -> int:
    """What the control group leaves, bytes; ``otherwise`` where there is no limit, or no such group."""
    limit, current, kinds = _GROUPS
    try:
        allowed, used = limit.read_text(encoding="ascii").strip(), int(current.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return otherwise
    if allowed == "max":
        return otherwise
    # Pages of files that are not in use count as used, and are given up when memory is wanted.
    return max(int(allowed) - used + _read_fields(kinds).get("inactive_file", 0), 0)


def _read_own_limit() -> int:
    """What the limit of this process's address space leaves, bytes."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return 2**62
    try:
        used = int(_OF_PROCESS.read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        used = 0
    return max(limit - used, 0)


def _read_fields(path: Path) -> dict[str, int]:
    """The first number of each line of a file, by the word before it; nothing where there is no such file."""
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except OSError:
        return {}
    words = [line.split() for line in lines]
    return {line[0]: int(line[1]) for line in words if len(line) > 1 and line[1].isdigit()}
