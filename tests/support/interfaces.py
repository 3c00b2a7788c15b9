"""The interface of a partition as one matrix, and its numbering checked against who shares what."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ddic.partition.subdomain import Subdomain, signed_incidence


def stack_jumps(subdomains: list[Subdomain]) -> NDArray[np.float64]:
    """All C_s side by side, the rows of reactions being zero."""
    n_rows = sum(s.n_owned_rows for s in subdomains)
    blocks = []
    for s in subdomains:
        c = np.zeros((n_rows, s.n_field))
        c[:, s.jumps.unknowns] = signed_incidence(s.jumps, np.arange(n_rows)).toarray()
        blocks.append(c)
    return np.hstack(blocks)


def check_numbering(subdomains: list[Subdomain], sharers: Mapping[int, list[int]],
                    controlled: NDArray[np.bool_]) -> None:
    """Check that an unknown of m subdomains has m - 1 rows and m copies, numbered by owner, kind and unknown."""
    rows: list[tuple[int, int, bool, int]] = []
    copies: list[tuple[int, int, bool, int]] = []
    for is_reaction in (False, True):
        chains: dict[int, set[tuple[int, int, int]]] = defaultdict(set)
        for s in subdomains:
            interface = s.reactions if is_reaction else s.jumps
            numbers = s.numbers[interface.unknowns]
            assert numbers.tolist() == [k for k in s.numbers
                                        if len(sharers[k]) > 1 and (controlled[k] or not is_reaction)]
            for place, number in enumerate(numbers):
                assert interface.position[place] == sharers[number].index(s.index)
                chains[int(number)].add((int(interface.multiplicity[place]), int(interface.first_row[place]),
                                         int(interface.first_copy[place])))
        for number, seen in chains.items():
            ((m, first_row, first_copy),) = seen  # every subdomain sees the same chain
            assert m == len(sharers[number])
            owner = sharers[number][0]
            rows += [(first_row + k, owner, is_reaction, number) for k in range(m - 1)]
            copies += [(first_copy + k, owner, is_reaction, number) for k in range(m)]
    for numbered, owned in ((rows, [s.n_owned_rows for s in subdomains]),
                            (copies, [s.n_owned_copies for s in subdomains])):
        numbered.sort()
        assert [number for number, *_ in numbered] == list(range(len(numbered)))
        # By owner, then kind, then unknown: each owner's numbers follow each other.
        assert [rest for _, *rest in numbered] == sorted(rest for _, *rest in numbered)
        assert np.bincount([owner for _, owner, *_ in numbered], minlength=len(owned)).tolist() == owned
