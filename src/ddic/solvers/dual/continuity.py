"""One value per interface unknown from the subdomains' copies, section 5.3.2 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.team import Team
from ddic.partition.subdomain import Interface, Subdomain, copies_of
from ddic.solvers.exchange import Exchange
from ddic.solvers.petsc import PetscStack


@dataclass(frozen=True)
class ContinuousField:
    """Unknowns of owned subdomains with interface copies averaged, and the largest jump before that.

    Attributes
    ----------
    q : list of (n_unknowns,) arrays
        Of each owned subdomain, pixels.
    largest_jump : float
        Largest difference that the copies of an unknown make in a node's displacement, pixels.
    """

    q: list[NDArray[np.float64]]
    largest_jump: float


def average_copies(team: Team, subdomains: Sequence[Subdomain],
                   q: Sequence[NDArray[np.float64]]) -> ContinuousField:
    """Average the copies of every interface unknown, section 5.3.2 of [BP17]; collective.

    ``q``, (n_unknowns,) of each owned subdomain, pixels, are left as they are. The averages are equal, to the last bit,
    on all subdomains that share an unknown.
    """
    interfaces = [s.jumps for s in subdomains]
    with PetscStack() as stack:
        n_owned = sum(s.n_owned_copies for s in subdomains)
        exchange = stack.keep(Exchange(team, n_owned, [copies_of(i) for i in interfaces]))
        numbers = exchange.ghosts
        mine = np.zeros(len(numbers))
        for interface, q_s in zip(interfaces, q, strict=True):
            own_copies = interface.first_copy + interface.position
            mine[np.searchsorted(numbers, own_copies)] = q_s[interface.unknowns]
        copies = exchange.sum_over_ranks(mine)
    fields = []
    largest = 0.0
    for subdomain, interface, q_s in zip(subdomains, interfaces, q, strict=True):
        mean, spread = _mean_and_spread(interface, numbers, copies)
        averaged = np.array(q_s)
        averaged[interface.unknowns] = mean
        fields.append(averaged)
        # By how many pixels an unknown of size one displaces the node that it displaces most.
        reach = np.asarray(abs(subdomain.kinematics.tangent).max(axis=0).todense()).ravel()
        largest = max(largest, float((spread * reach[interface.unknowns]).max(initial=0.0)))
    return ContinuousField(fields, team.maximum(largest))


def _mean_and_spread(interface: Interface, numbers: NDArray[np.int64],
                     copies: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean, and largest less smallest, of the copies of each of a subdomain's interface unknowns."""
    values = copies[np.searchsorted(numbers, copies_of(interface))]
    if len(values) == 0:
        return values, values
    first = np.cumsum(interface.multiplicity) - interface.multiplicity
    mean = np.add.reduceat(values, first) / interface.multiplicity
    return mean, np.maximum.reduceat(values, first) - np.minimum.reduceat(values, first)
