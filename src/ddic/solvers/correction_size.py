"""How large a correction is, on displacements of nodes, and when it is small enough to stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tolerances:
    """When Gauss-Newton stops: (|dq|/|q| <= relative or RMS dq <= rms) and no node moves by more than largest.

    Attributes
    ----------
    relative : float
        On |dq|/|q|, q without its affine part; no unit.
    rms : float
        On the RMS of dq over nodes, pixels.
    max_iterations : int
        Iterations after which it gives up.
    inexact : bool
        Whether linear steps are solved only as far as Gauss-Newton's progress asks, the last one to rms / 20.
    largest : float
        On dq at any node, pixels.
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
    rms : float
        RMS over nodes, pixels.
    largest : float
        Largest at any node, pixels.
    subdomain : int
        Where it is.
    """

    relative: float
    rms: float
    largest: float
    subdomain: int = 0

    @property
    def is_finite(self) -> bool:
        """Whether all are finite."""
        return bool(np.isfinite([self.rms, self.largest]).all())

    def is_below(self, tolerances: Tolerances) -> bool:
        """Tell whether Gauss-Newton may stop after this correction.

        Parameters
        ----------
        tolerances : Tolerances
            Limits.

        Returns
        -------
        bool
            Whether it may.
        """
        small_on_average = self.relative <= tolerances.relative or self.rms <= tolerances.rms
        return small_on_average and self.largest <= tolerances.largest

    def describe_stop(self, tolerances: Tolerances) -> str:
        """Say which limits it is below.

        Parameters
        ----------
        tolerances : Tolerances
            Limits, which it is below.

        Returns
        -------
        str
            For the log.
        """
        if self.rms <= tolerances.rms:
            average = f"RMS dq = {self.rms:.1e} px <= gauss_newton.rms_tolerance"
        else:
            average = f"|dq|/|q| = {self.relative:.1e} <= gauss_newton.tolerance"
        return (f"stopped at {average}; largest dq = {self.largest:.1e} px (subdomain {self.subdomain}) <= "
                "gauss_newton.largest_tolerance")


def measure_correction(team: Team, subdomains: Sequence[Subdomain], dq: Sequence[Array],
                       q: Sequence[Array]) -> CorrectionSize:
    """Measure a correction on displacements of nodes in the specimen's frame, every node counted once; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    subdomains : sequence of Subdomain
        Owned ones.
    dq, q : sequence of (n_unknowns,) array
        Correction, and unknowns before it, of each.

    Returns
    -------
    CorrectionSize
        No unit, and pixels.
    """
    measured = [_measure_nodes(subdomain, dq_s, q_s)
                for subdomain, dq_s, q_s in zip(subdomains, dq, q, strict=True)]
    of_correction, *of_field = team.ordered_sum([sums for sums, _ in measured])
    largest, subdomain = max(team.gather_lists([(most, s.index) for (_, most), s in zip(measured, subdomains,
                                                                                      strict=True)]))
    if not np.isfinite([of_correction, *of_field]).all():
        return CorrectionSize(np.inf, np.inf, np.inf, subdomain)
    n_nodes = of_field[0]
    remainder = _remove_affine_part(np.array(of_field))
    if remainder > 0:
        relative = float(np.sqrt(of_correction / remainder))
    else:
        relative = 0.0 if of_correction == 0 else np.inf
    return CorrectionSize(relative, float(np.sqrt(of_correction / n_nodes)), largest, subdomain)


def _measure_nodes(subdomain: Subdomain, dq: Array, q: Array) -> tuple[Array, float]:
    """A subdomain's share of |du|^2 and of the moments of u + du, (14,), and its largest |du| at a node."""
    share = 1.0 / subdomain.node_multiplicity
    nodes = subdomain.mesh.nodes
    before = subdomain.displacement(q).reshape(nodes.shape)
    after = subdomain.displacement(q + dq).reshape(nodes.shape)
    change_squared = ((after - before) ** 2).sum(axis=1)
    weighted = after * share[:, None]
    moments = [share.sum(), *(share @ nodes), *weighted.sum(axis=0),
               *((nodes * share[:, None]).T @ nodes)[np.triu_indices(2)], *(weighted.T @ nodes).ravel(),
               (weighted * after).sum()]
    return np.array([change_squared @ share, *moments]), float(np.sqrt(change_squared.max()))


def _remove_affine_part(moments: Array) -> float:
    """Sum over nodes of |u|^2 without what the best affine motion explains, pixels squared, from moments (13,)."""
    n, sum_x, sum_u = moments[0], moments[1:3], moments[3:5]
    xx, xy, yy = moments[5:8]
    spread = np.array([[xx, xy], [xy, yy]]) - np.outer(sum_x, sum_x) / n
    together = moments[8:12].reshape(2, 2) - np.outer(sum_u, sum_x) / n
    squares = moments[12] - sum_u @ sum_u / n
    # All nodes on a line, or one node: what cannot be told from a translation is none.
    explained = np.trace(together @ np.linalg.pinv(spread, rcond=1e-12, hermitian=True) @ together.T)
    return float(max(squares - explained, 0.0))
