"""A subdomain: its part of the mesh and what it shares with its neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh

Weighting = Literal["consistent", "paper"]


@dataclass(frozen=True)
class Interface:
    """Interface unknowns of one kind (displacement jumps or reactions) seen from one subdomain.

    A dof shared by m subdomains carries m - 1 rows, a chain over the subdomains in increasing order:
    row k is (copy k) - (copy k + 1), so that rows are non-redundant at cross points.

    A dof's rows and copies are numbered one after the other, over the whole mesh, independently of the
    number of ranks: those of subdomain 0's chains first (a chain belongs to its lowest subdomain).

    dofs: (n,) local dofs on the interface.
    multiplicity: (n,) number m of subdomains that share each.
    position: (n,) place of this subdomain in each chain, 0 <= position < m.
    first_row: (n,) number of each chain's first row; the others follow.
    first_copy: (n,) number of each chain's first copy; the others follow.
    """

    dofs: NDArray[np.int64]
    multiplicity: NDArray[np.int64]
    position: NDArray[np.int64]
    first_row: NDArray[np.int64]
    first_copy: NDArray[np.int64]


@dataclass(frozen=True)
class Subdomain:
    """One subdomain, self-contained: what a rank receives.

    index: its number; mesh: its cells; node_ids, cell_ids: numbers in the whole mesh.
    controlled: (n_dofs,) whether the whole mesh's equilibrium row of each dof is controlled (P of Eq. 11).
    interior: (n_nodes,) whether a node lies inside the whole mesh (not on its boundary).
    multiplicity: (n_nodes,) number of subdomains that share each node.
    displacement, reaction: the rows of C_s (Lambda) and of Cbar_s (LambdaBar).
    n_owned_rows, n_owned_copies: rows and copies of the chains that belong to this subdomain.
    """

    index: int
    mesh: Mesh
    node_ids: NDArray[np.int64]
    cell_ids: NDArray[np.int64]
    controlled: NDArray[np.bool_]
    interior: NDArray[np.bool_]
    multiplicity: NDArray[np.int64]
    displacement: Interface
    reaction: Interface
    n_owned_rows: int
    n_owned_copies: int

    @property
    def dofs(self) -> NDArray[np.int64]:
        """Numbers of its dofs in the whole mesh, (n_dofs,)."""
        dim = self.mesh.dim
        return (self.node_ids[:, None] * dim + np.arange(dim)).ravel()

    @property
    def dof_multiplicity(self) -> NDArray[np.int64]:
        """Number of subdomains that share each dof, (n_dofs,)."""
        return np.repeat(self.multiplicity, self.mesh.dim)


def interface_weights(dof_multiplicity: NDArray[np.int64], weighting: Weighting) -> NDArray[np.float64]:
    """Weights w of the interface rows of Kbar_s and of Cbar_s^T, (n_dofs,).

    "consistent": sqrt(m), which makes the decomposed solution the one-domain solution.
    "paper": 1, which makes it that of the one-domain problem with interface rows weighted 1/sqrt(m).
    """
    if weighting == "paper":
        return np.ones(len(dof_multiplicity))
    return np.sqrt(dof_multiplicity.astype(np.float64))
