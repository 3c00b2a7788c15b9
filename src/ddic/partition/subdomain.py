"""A subdomain: its part of the mesh and what it shares with its neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ddic.kinematics.tie import Tie
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

    index: its number; mesh: its cells; mesh_node_ids, cell_ids: numbers in the whole mesh of its nodes and cells;
    node_ids: numbers of its unknown nodes, the same but where a tie gives displacements of its mesh nodes from others.
    controlled: (n_dofs,) whether the whole mesh's equilibrium row of each dof is controlled (P of Eq. 11).
    interior: (n_nodes,) whether a node lies inside the whole mesh (not on its boundary).
    multiplicity: (n_nodes,) number of subdomains that share each node.
    displacement, reaction: the rows of C_s (Lambda) and of Cbar_s (LambdaBar).
    n_owned_rows, n_owned_copies: rows and copies of the chains that belong to this subdomain.
    camera: number of the camera whose pixels it has, 0 the first; shifts: unknowns of the motion of that camera's
    set-up, which all of its subdomains share (None where there are none). tie: None where mesh nodes are the unknown
    nodes.
    """

    index: int
    mesh: Mesh
    node_ids: NDArray[np.int64]
    mesh_node_ids: NDArray[np.int64]
    cell_ids: NDArray[np.int64]
    controlled: NDArray[np.bool_]
    interior: NDArray[np.bool_]
    multiplicity: NDArray[np.int64]
    displacement: Interface
    reaction: Interface
    n_owned_rows: int
    n_owned_copies: int
    camera: int = 0
    shifts: Shifts | None = None
    tie: Tie | None = None

    @property
    def nodes(self) -> NDArray[np.float64]:
        """Its unknown nodes, (n_nodes, dim), pixels."""
        return self.mesh.nodes if self.tie is None else self.tie.nodes

    @property
    def n_dofs(self) -> int:
        """Number of unknown displacements."""
        return self.nodes.size

    def on_mesh(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement of its mesh nodes (n_mesh_dofs,) from that of its unknown nodes (n_dofs,)."""
        return q if self.tie is None else np.asarray(self.tie.matrix @ q)

    @property
    def dofs(self) -> NDArray[np.int64]:
        """Numbers of its dofs in the whole mesh, (n_dofs,)."""
        dim = self.mesh.dim
        return (self.node_ids[:, None] * dim + np.arange(dim)).ravel()

    @property
    def dof_multiplicity(self) -> NDArray[np.int64]:
        """Number of subdomains that share each dof, (n_dofs,)."""
        return np.repeat(self.multiplicity, self.mesh.dim)

    @property
    def unknowns(self) -> NDArray[np.int64]:
        """Numbers of its dofs and of its camera's motion in the whole problem, (n_unknowns,)."""
        return self.dofs if self.shifts is None else np.concatenate([self.dofs, self.shifts.numbers])

    @property
    def unknown_multiplicity(self) -> NDArray[np.int64]:
        """Number of subdomains that share each unknown, (n_unknowns,)."""
        if self.shifts is None:
            return self.dof_multiplicity
        return np.concatenate([self.dof_multiplicity,
                               np.full(len(self.shifts.numbers), self.shifts.n_subdomains, dtype=np.int64)])

    @property
    def owned_unknowns(self) -> NDArray[np.bool_]:
        """Whether each unknown belongs to this subdomain, the lowest of those that share it, (n_unknowns,)."""
        owned = np.ones(len(self.unknowns), dtype=bool)
        owned[self.displacement.dofs[self.displacement.position > 0]] = False
        if self.shifts is not None:
            owned[self.n_dofs:] = self.shifts.owned
        return owned


@dataclass(frozen=True)
class Shifts:
    """Unknowns of the motion of a near-field set-up between its two pictures (alpha of Eq. 20 of [BP17]).

    numbers: (n_shifts,) after all dofs of the mesh; rows: (n_shifts,) of the interface problem, after all chains.
    n_subdomains: how many share them; owned: whether they belong to this subdomain.
    """

    numbers: NDArray[np.int64]
    rows: NDArray[np.int64]
    n_subdomains: int
    owned: bool


def interface_weights(dof_multiplicity: NDArray[np.int64], weighting: Weighting) -> NDArray[np.float64]:
    """Weights w of the interface rows of Kbar_s and of Cbar_s^T, (n_dofs,).

    "consistent": sqrt(m), which makes the decomposed solution the one-domain solution.
    "paper": 1, which makes it that of the one-domain problem with interface rows weighted 1/sqrt(m).
    """
    if weighting == "paper":
        return np.ones(len(dof_multiplicity))
    return np.sqrt(dof_multiplicity.astype(np.float64))
