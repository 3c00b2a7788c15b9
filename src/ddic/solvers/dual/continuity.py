"""One value per interface node from the subdomains' copies, Eq. 41 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.partition.incidence import copies_of
from ddic.partition.subdomain import Interface, Subdomain
from ddic.solvers.exchange import Exchange


@dataclass(frozen=True)
class ContinuousField:
    """Displacement of owned subdomains with interface copies averaged, and the largest jump before that.

    q: (n_dofs,) per owned subdomain, pixels; largest_jump: largest difference between copies, pixels.
    """

    q: list[NDArray[np.float64]]
    largest_jump: float


def average_copies(comm: MPI.Comm, subdomains: Sequence[Subdomain],
                   q: Sequence[NDArray[np.float64]]) -> ContinuousField:
    """Mean of the copies at every interface dof."""
    interfaces = [s.displacement for s in subdomains]
    exchange = Exchange(comm, sum(s.n_owned_copies for s in subdomains), [copies_of(i) for i in interfaces])
    mine = np.zeros(len(exchange.ghosts))
    for interface, q_s in zip(interfaces, q, strict=True):
        mine[np.searchsorted(exchange.ghosts, interface.first_copy + interface.position)] = q_s[interface.dofs]
    owned = exchange.new_vector()
    exchange.add_to_owners(mine, owned)
    copies = exchange.to_ghosts(owned)
    fields, largest = [], 0.0
    for interface, q_s in zip(interfaces, q, strict=True):
        mean, spread = _mean_and_spread(interface, exchange.ghosts, copies)
        averaged = np.array(q_s)
        averaged[interface.dofs] = mean
        fields.append(averaged)
        largest = max(largest, float(spread.max(initial=0.0)))
    owned.destroy()
    return ContinuousField(fields, float(comm.allreduce(largest, op=MPI.MAX)))


def _mean_and_spread(interface: Interface, numbers: NDArray[np.int64],
                     copies: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    ptr = np.concatenate([[0], np.cumsum(interface.multiplicity)])
    values = copies[np.searchsorted(numbers, copies_of(interface))]
    if len(values) == 0:
        return values, values
    mean = np.add.reduceat(values, ptr[:-1]) / interface.multiplicity
    return mean, np.maximum.reduceat(values, ptr[:-1]) - np.minimum.reduceat(values, ptr[:-1])
