"""A field of the whole problem, of which each rank holds its own subdomains' parts, and what is kept for each view.

Code that knows one subdomain zips parts with subdomains: a ``Field`` is a sequence of its parts, a ``ByView`` one of
its rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from typing import Any, Generic, TypeVar, overload

import numpy as np

from ddic.arrays import Array
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain

T = TypeVar("T")
R = TypeVar("R")


class _BySubdomain(Sequence[T]):
    """One thing for each owned subdomain, in their order, never changed."""

    def __init__(self, parts: Iterable[T]) -> None:
        self.parts = tuple(parts)

    def __len__(self) -> int:
        return len(self.parts)

    @overload
    def __getitem__(self, place: int) -> T: ...

    @overload
    def __getitem__(self, place: slice) -> tuple[T, ...]: ...

    def __getitem__(self, place: int | slice) -> T | tuple[T, ...]:
        return self.parts[place]


class Field(_BySubdomain[Array]):
    """Unknowns, their changes or the forces on them: an array for each owned subdomain, in their order.

    Fields are never changed: operations make new ones. Those that are collective say so, and give all ranks the same to
    the last bit however subdomains are spread.

    Parameters
    ----------
    team : Team
        All ranks.
    subdomains : iterable of Subdomain
        Those that this rank owns.
    parts : iterable of (n_unknowns,) array
        Of each; (n_field,) where cameras' motions are left out.
    """

    # Else numpy would take the parts for rows of an array where its numbers multiply a field.
    __array_ufunc__ = None

    def __init__(self, team: Team, subdomains: Iterable[Subdomain], parts: Iterable[Array]) -> None:
        super().__init__(parts)
        self.team = team
        self.subdomains = tuple(subdomains)

    @classmethod
    def zero(cls, team: Team, subdomains: Sequence[Subdomain]) -> Field:
        """Give the field of a specimen at rest."""
        return cls(team, subdomains, [np.zeros(subdomain.n_unknowns) for subdomain in subdomains])

    def with_parts(self, parts: Iterable[Array]) -> Field:
        """Give another field of the same subdomains."""
        return Field(self.team, self.subdomains, parts)

    # ------------------------------------------------------------------------------------------------ linear algebra

    def __add__(self, other: Sequence[Array]) -> Field:
        return self.with_parts(a + b for a, b in zip(self, other, strict=True))

    def __sub__(self, other: Sequence[Array]) -> Field:
        return self.with_parts(a - b for a, b in zip(self, other, strict=True))

    def __mul__(self, factor: float) -> Field:
        return self.with_parts(factor * part for part in self)

    __rmul__ = __mul__

    def __truediv__(self, divisor: float) -> Field:
        return self.with_parts(part / divisor for part in self)

    def map(self, function: Callable[..., Array], *others: Sequence[Any]) -> Field:
        """Give the field of function(subdomain, part, ...), the rest being what others hold for the subdomain."""
        return self.with_parts(function(*of_subdomain)
                         for of_subdomain in zip(self.subdomains, self, *others, strict=True))

    def multiply(self, other: Sequence[Array]) -> float:
        """Form the inner product with another field, summed in the order of all subdomains; collective."""
        (total,) = self.team.ordered_sum([np.array([a @ b]) for a, b in zip(self, other, strict=True)])
        return float(total)

    def is_equal_to(self, other: Sequence[Array]) -> bool:
        """Tell all ranks whether another field is the same to the last bit; collective."""
        differ = any(not np.array_equal(a, b) for a, b in zip(self, other, strict=True))
        return not self.team.sum(int(differ))

    # ------------------------------------------------------------------------------------------------ at nodes

    @property
    def displacements(self) -> list[Array]:
        """Displacements of each subdomain's nodes in the specimen's frame, (mesh.n_dofs,), node by node, pixels."""
        return [subdomain.displacement(part) for subdomain, part in zip(self.subdomains, self, strict=True)]

    def measure_rms(self) -> float:
        """Measure the RMS displacement over nodes, each counted once: sqrt(mean of |u|^2), pixels; collective."""
        sums = []
        for subdomain, displacement in zip(self.subdomains, self.displacements, strict=True):
            u = displacement.reshape(subdomain.mesh.nodes.shape)
            shares = 1.0 / subdomain.node_multiplicity
            sums.append(np.array([(u**2 * shares[:, None]).sum(), shares.sum()]))
        total, n_nodes = self.team.ordered_sum(sums)
        return float(np.sqrt(total / n_nodes))


def multiply_fields(fields: Sequence[Field], weights: Sequence[Array]) -> Array:
    """Multiply fields with each other: their weighted inner products, (n_fields, n_fields), in order; collective."""
    products = []
    for *parts, of_unknowns in zip(*fields, weights, strict=True):
        vectors = np.array(parts)
        products.append((vectors * of_unknowns) @ vectors.T)
    return fields[0].team.ordered_sum(products)


class ByView(_BySubdomain[tuple[T, ...]], Generic[T]):
    """One thing for each view of each owned subdomain, in their order: pixels, residuals, cells that count...

    A view is what one camera sees of a subdomain. Like a field it is never changed.

    Parameters
    ----------
    rows : iterable of iterable
        Of each owned subdomain, by view.
    """

    def __init__(self, rows: Iterable[Iterable[T]]) -> None:
        super().__init__(tuple(row) for row in rows)

    @property
    def flat(self) -> tuple[T, ...]:
        """The things of all views, subdomain by subdomain."""
        return tuple(thing for row in self for thing in row)

    def map(self, function: Callable[..., R], *others: Sequence[Sequence[Any]]) -> ByView[R]:
        """Give function(thing, ...) of every view, the rest being what others hold for it."""
        return ByView([function(*of_view) for of_view in zip(*of_subdomain, strict=True)]
                      for of_subdomain in zip(self, *others, strict=True))

    def fill(self, of_subdomains: Sequence[R]) -> ByView[R]:
        """Give every view what its subdomain has: of a field, say, the subdomain's unknowns."""
        return ByView([thing] * len(row) for row, thing in zip(self, of_subdomains, strict=True))


def add_views(values: ByView[Array]) -> list[Array]:
    """Add up the views of each owned subdomain, in their order."""
    return [reduce(np.add, of_views) for of_views in values]
