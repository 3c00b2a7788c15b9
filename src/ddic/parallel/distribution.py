"""Spread subdomains over ranks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ddic.errors import InputError
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain


def owners(n_subdomains: int, n_ranks: int) -> list[range]:
    """Contiguous, balanced ranges of subdomains, one per rank; raises InputError where a rank gets none."""
    if n_ranks > n_subdomains:
        raise InputError(f"{n_ranks} MPI ranks for {n_subdomains} subdomains: every rank needs at least one; "
                         f"start at most {n_subdomains} ranks or ask for more subdomains (solver.subdomains)")
    ends = np.cumsum([len(part) for part in np.array_split(np.arange(n_subdomains), n_ranks)])
    return [range(int(begin), int(end)) for begin, end in zip([0, *ends[:-1]], ends, strict=True)]


def distribute(team: Team, build: Callable[[], list[Subdomain]]) -> list[Subdomain]:
    """Build all subdomains on rank 0 and give each rank its own."""
    def share() -> list[list[Subdomain]]:
        subdomains = build()
        return [[subdomains[s] for s in part] for part in owners(len(subdomains), team.size)]

    return team.scatter_from_root(share)
