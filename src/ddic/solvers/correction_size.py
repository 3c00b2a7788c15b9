"""How large a correction is, on displacements of nodes, and when it is small enough to stop.

A node's correction is compared with what the images can tell of it: where its standard deviation is large, following it
to the last digit would follow noise. The size of a field is the RMS displacement of nodes in pixels, whatever the
unknowns mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain

KNOWN_PX = 0.02
"""Standard deviation of a node from which on its correction counts less, by KNOWN_PX / deviation, pixels: at a largest
correction of 0.001 px, a twentieth of the deviation is small. A smaller value adds to the node's noise."""

LEAST_SPREAD = 1e-12
"""Variance of nodes' places along a line, relative to that across it, up to which it is rounding. A larger value takes
a gradient for unknown that a narrow strip of nodes tells."""


@dataclass(frozen=True)
class Tolerances:
    """When Gauss-Newton stops: (|dq|/|q| <= relative or RMS dq <= rms) and no node moves by more than largest.

    A node whose standard deviation is known counts with dq KNOWN_PX / max(KNOWN_PX, deviation).

    Attributes
    ----------
    relative : float
        On |dq|/|q|, q without its affine part; no unit.
    rms, largest : float
        On the RMS of dq over nodes, and on dq at any node, pixels.
    max_iterations : int
        Iterations after which it gives up.
    inexact : bool
        Whether linear steps are solved only as far as Gauss-Newton's progress asks, the last one to rms / 20.
    """

    relative: float = 1e-3
    rms: float = 1e-4
    max_iterations: int = 50
    inexact: bool = True
    largest: float = 1e-3


@dataclass(frozen=True)
class CorrectionSize:
    """How large a correction is, on displacements of the mesh's nodes, every node counted once.

    Attributes
    ----------
    relative : float
        |dq|/|q + dq|, q + dq without its affine part: a field that moves with the specimen, turns and stretches with
        it, is no better known than one at rest. No unit.
    rms, largest : float
        RMS over nodes, and largest at any node, pixels.
    subdomain : int
        Where the largest is.
    known_rms : float
        RMS with each node's correction relative to what it can know (``Tolerances``), pixels.
    n_slow : int
        Nodes whose correction is above ``Tolerances.largest`` so.
    """

    relative: float
    rms: float
    largest: float
    subdomain: int
    known_rms: float
    n_slow: int

    @property
    def is_finite(self) -> bool:
        """Whether all are finite."""
        return bool(np.isfinite([self.rms, self.largest]).all())

    def is_below(self, tolerances: Tolerances) -> bool:
        """Tell whether Gauss-Newton may stop after this correction."""
        relative = self.relative * self.known_rms / self.rms if self.rms > 0 else 0.0
        return (relative <= tolerances.relative or self.known_rms <= tolerances.rms) and self.n_slow == 0

    def describe_stop(self, tolerances: Tolerances) -> str:
        """Say which limits it is below."""
        if self.known_rms <= tolerances.rms:
            average = f"RMS dq = {self.rms:.1e} px <= gauss_newton.rms_tolerance"
        else:
            average = f"|dq|/|q| = {self.relative:.1e} <= gauss_newton.tolerance"
        line = f"stopped at {average}; largest dq = {self.largest:.1e} px (subdomain {self.subdomain}) <= "
        if self.largest <= tolerances.largest:
            return line + "gauss_newton.largest_tolerance"
        return line + f"gauss_newton.largest_tolerance x the node's standard deviation / {KNOWN_PX} px"


def measure_correction(dq: Field, q: Field, weights: Sequence[Array] | None = None,
                       largest: float = np.inf) -> CorrectionSize:
    """Measure a correction on displacements of nodes in the specimen's frame, every node counted once; collective.

    ``dq`` is the correction and ``q`` the unknowns before it, ``weights`` are those of the nodes' corrections
    (``weigh_nodes``), (n_nodes,) of each owned subdomain, no unit, 1 by default; from the weighted correction
    ``largest``, pixels, on a node is slow.
    """
    after = (q + dq).displacements
    changes = _measure_ways(q.subdomains, q.displacements, after)
    if weights is None:
        weights = [np.ones(len(of_nodes)) for of_nodes in changes]
    sums = []
    for s, change, of_nodes, u in zip(q.subdomains, changes, weights, after, strict=True):
        known = of_nodes * change
        share = 1.0 / s.node_multiplicity
        of_change = [change**2 @ share, known**2 @ share, share[known > largest].sum()]
        sums.append(np.array([*of_change, *_sum_moments(s, u)]))
    of_correction, known_squares, n_slow, *of_field = q.team.ordered_sum(sums)
    most_by_subdomain = [(float(change.max()), s.index) for change, s in zip(changes, q.subdomains, strict=True)]
    most, subdomain = q.team.maximum(max(most_by_subdomain))
    n_nodes = of_field[0]
    if not np.isfinite([of_correction, *of_field]).all():
        return CorrectionSize(np.inf, np.inf, np.inf, subdomain, np.inf, round(n_nodes))
    remainder = _remove_affine_part(np.array(of_field))
    if remainder > 0:
        relative = float(np.sqrt(of_correction / remainder))
    else:
        relative = 0.0 if of_correction == 0 else np.inf
    # Sums of copies' shares may miss whole numbers by rounding.
    return CorrectionSize(relative, float(np.sqrt(of_correction / n_nodes)), most, subdomain,
                          float(np.sqrt(known_squares / n_nodes)), round(n_slow))


def weigh_nodes(deviations: Sequence[Array]) -> list[Array]:
    """Weigh nodes' corrections by what can be known of them; deviations, (n_nodes,) each, in pixels."""
    return [KNOWN_PX / np.maximum(KNOWN_PX, of_nodes) for of_nodes in deviations]


def measure_node_corrections(dq: Field, q: Field) -> list[Array]:
    """Measure by how much a correction of q moves each node of each subdomain, (n_nodes,), pixels."""
    return _measure_ways(q.subdomains, q.displacements, (q + dq).displacements)


def _measure_ways(subdomains: Sequence[Subdomain], before: Sequence[Array], after: Sequence[Array]) -> list[Array]:
    """How far each node of each subdomain moves between two displacements, (n_nodes,), pixels."""
    return [np.asarray(np.linalg.norm((u_after - u_before).reshape(subdomain.mesh.nodes.shape), axis=1))
            for subdomain, u_before, u_after in zip(subdomains, before, after, strict=True)]


def _sum_moments(subdomain: Subdomain, displacement: Array) -> Array:
    """A subdomain's share of moments 1, x, u, x x, u x, |u|^2 of nodes' places and displacements, pixels."""
    share = 1.0 / subdomain.node_multiplicity
    nodes = subdomain.mesh.nodes
    u = displacement.reshape(nodes.shape)
    weighted = u * share[:, None]
    xx = (nodes * share[:, None]).T @ nodes
    return np.array([share.sum(), *(share @ nodes), *weighted.sum(axis=0), *xx.ravel(), *(weighted.T @ nodes).ravel(),
                     (weighted * u).sum()])


def _remove_affine_part(moments: Array) -> float:
    """Sum over nodes of |u|^2 without what the best affine motion explains, pixels squared, from ``_sum_moments``."""
    # There are 2 (1 + dim + dim^2).
    dim = {14: 2, 26: 3}[len(moments)]
    (n,), sum_x, sum_u, xx, ux, (uu,) = np.split(moments, np.cumsum([1, dim, dim, dim**2, dim**2]))
    spread = xx.reshape(dim, dim) - np.outer(sum_x, sum_x) / n
    together = ux.reshape(dim, dim) - np.outer(sum_u, sum_x) / n
    squares = uu - sum_u @ sum_u / n
    variances, axes = np.linalg.eigh(spread)
    # All nodes on a line, or one node: what cannot be told from a translation is none.
    is_wide = variances > LEAST_SPREAD * variances.max()
    explained = ((together @ axes[:, is_wide])**2 / variances[is_wide]).sum()
    return float(max(squares - explained, 0.0))


def measure_unit_size(team: Team, subdomains: Sequence[Subdomain]) -> float:
    """Measure by how much independent unknowns of size one displace nodes; collective.

    It is sqrt(mean of |t|^2 over the field's unknowns / number of nodes) with t the columns of the whole tangent: times
    the norm of a vector of unknowns about its RMS displacement over nodes, pixels; exactly that for nodal unknowns.
    """
    squares, n_nodes, n_unknowns = 0.0, 0.0, 0
    for subdomain in subdomains:
        row_sums = np.asarray(subdomain.kinematics.tangent.power(2).sum(axis=1))
        shares = 1.0 / subdomain.node_multiplicity
        squares += float(row_sums.reshape(subdomain.mesh.nodes.shape).sum(axis=1) @ shares)
        n_nodes += float(shares.sum())
        n_unknowns += int(subdomain.owned[:subdomain.n_field].sum())
    total = team.sum(np.array([squares, n_nodes, n_unknowns]))
    return float(np.sqrt(total[0] / total[2] / total[1]))
