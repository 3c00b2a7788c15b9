"""Anderson mixing: Gauss-Newton's next unknowns from its last few corrections.

A step q <- q + dq(q) with a constant M closes in at once wherever M is the true Jacobian, and slowly at the few nodes
where it is not. The last corrections tell how dq changes with q along the directions that matter there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.team import Team

Array = NDArray[np.float64]

DEPTH = 5
"""Differences of corrections that are kept. More of them cost memory, and mix in corrections of long ago."""

LEAST_SHARE = 1e-12
"""Share of the largest eigenvalue below which directions of the differences count as dependent."""


class AndersonMixing:
    """Mixes corrections with those before: q + dq - sum_k gamma_k (dq_k + ddq_k), |dq - sum_k gamma_k ddq_k| least.

    Parameters
    ----------
    team : Team
        All ranks.
    weights : sequence of (n_unknowns,) array
        Of the squared unknowns of each owned subdomain in the norm; copies of an unknown share its weight.
    """

    def __init__(self, team: Team, weights: Sequence[Array]) -> None:
        self._team, self._weights = team, weights
        self._last: tuple[list[Array], list[Array]] | None = None
        # (change of q, change of dq) between successive iterations, the oldest first.
        self._changes: list[tuple[list[Array], list[Array]]] = []
        self._last_norm = np.inf

    def forget(self) -> None:
        """Forget all corrections: what comes belongs to other equations."""
        self._last, self._changes, self._last_norm = None, [], np.inf

    def advance(self, q: Sequence[Array], dq: Sequence[Array]) -> list[Array]:
        """Return the next unknowns; collective."""
        if self._last is not None:
            before, dq_before = self._last
            self._changes.append(([a - b for a, b in zip(q, before, strict=True)],
                                  [a - b for a, b in zip(dq, dq_before, strict=True)]))
            del self._changes[:-DEPTH]
        self._last = [np.array(q_s) for q_s in q], [np.array(dq_s) for dq_s in dq]
        products = self._team.ordered_sum([self._multiply(place, dq_s).ravel() for place, dq_s in enumerate(dq)])
        gram = products.reshape(len(self._changes) + 1, -1)
        norm = float(np.sqrt(gram[-1, -1]))
        if norm > self._last_norm:
            # What was learnt comes from another part of the way: a plain step finds back.
            self._changes = []
        self._last_norm = norm
        gamma = np.zeros(0) if not self._changes else _solve(gram[:-1, :-1], gram[:-1, -1])
        mixed = [q_s + dq_s for q_s, dq_s in zip(q, dq, strict=True)]
        for share, (of_q, of_dq) in zip(gamma, self._changes, strict=True):
            mixed = [mixed_s - share * (a + b) for mixed_s, a, b in zip(mixed, of_q, of_dq, strict=True)]
        return mixed

    def _multiply(self, place: int, dq: Array) -> Array:
        """Products of a subdomain's changes of dq, and of dq itself, with each other, (n + 1, n + 1)."""
        vectors = np.array([*(of_dq[place] for _, of_dq in self._changes), dq])
        return np.asarray((vectors * self._weights[place]) @ vectors.T)


def _solve(gram: Array, right: Array) -> Array:
    """Least squares from normal equations, without directions that depend on others."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = np.linalg.pinv(gram * scale[:, None] * scale, rcond=LEAST_SHARE, hermitian=True)
    return np.asarray(scale * (scaled @ (scale * right)))
