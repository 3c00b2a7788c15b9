"""Which subdomains share which nodes, and the numbering of interface rows (C_s, Cbar_s)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.kinematics.tie import tie
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.partition.subdomain import Interface, Subdomain


@dataclass(frozen=True)
class NodeSharing:
    """Copies of nodes in subdomains, sorted by node and then subdomain.

    node, subdomain, position: (n_copies,); position counts a node's copies from 0.
    multiplicity: (n_nodes,) number of subdomains at each node.
    """

    node: NDArray[np.int64]
    subdomain: NDArray[np.int64]
    position: NDArray[np.int64]
    multiplicity: NDArray[np.int64]


@dataclass(frozen=True)
class Chains:
    """Numbering of the chains of both kinds (0 displacement, 1 reaction) over the whole mesh.

    first_row, first_copy: (2, n_dofs), -1 where a dof has no chain of that kind.
    owned_rows, owned_copies: (n_subdomains,).
    """

    first_row: NDArray[np.int64]
    first_copy: NDArray[np.int64]
    owned_rows: NDArray[np.int64]
    owned_copies: NDArray[np.int64]


def node_sharing(mesh: Mesh, parts: NDArray[np.int64], weights: sparse.csr_matrix | None = None) -> NodeSharing:
    """Find which subdomains share each node; parts (n_cells,) holds the subdomain of each cell.

    weights: (n_nodes, n_unknown_nodes), where some nodes are tied to others: a subdomain has the unknown nodes on which
    its mesh nodes depend.
    """
    n_subdomains = int(parts.max()) + 1
    owner = np.repeat(parts, np.diff(mesh.offsets))
    pairs = np.unique(mesh.connectivity * n_subdomains + owner)
    node, subdomain = pairs // n_subdomains, pairs % n_subdomains
    n_nodes = mesh.n_nodes
    if weights is not None:
        n_nodes = weights.shape[1]
        rows = weights[node]
        pairs = np.unique(rows.indices.astype(np.int64) * n_subdomains + np.repeat(subdomain, np.diff(rows.indptr)))
        node, subdomain = pairs // n_subdomains, pairs % n_subdomains
    multiplicity = np.bincount(node, minlength=n_nodes)
    first = np.concatenate([[0], np.cumsum(multiplicity)])[:-1]
    position = np.arange(len(node)) - first[node]
    return NodeSharing(node, subdomain, position, multiplicity)


def number_chains(sharing: NodeSharing, controlled: NDArray[np.bool_], n_subdomains: int) -> Chains:
    """Number rows and copies by owner, kind, node and component; controlled: (n_dofs,) rows kept by P."""
    n_dofs = len(controlled)
    dim = n_dofs // len(sharing.multiplicity)
    multiplicity = np.repeat(sharing.multiplicity, dim)
    lowest = np.zeros(len(sharing.multiplicity), dtype=np.int64)
    lowest[sharing.node[sharing.position == 0]] = sharing.subdomain[sharing.position == 0]
    shared = multiplicity > 1
    dof = np.concatenate([np.flatnonzero(shared), np.flatnonzero(shared & controlled)])
    kind = np.repeat([0, 1], [shared.sum(), (shared & controlled).sum()])
    owner = lowest[dof // dim]
    order = np.lexsort((dof, kind, owner))
    dof, kind, owner, m = dof[order], kind[order], owner[order], multiplicity[dof[order]]
    first_row = np.full((2, n_dofs), -1, dtype=np.int64)
    first_copy = np.full((2, n_dofs), -1, dtype=np.int64)
    first_row[kind, dof] = np.cumsum(m - 1) - (m - 1)
    first_copy[kind, dof] = np.cumsum(m) - m
    return Chains(first_row, first_copy,
                  np.bincount(owner, weights=m - 1, minlength=n_subdomains).astype(np.int64),
                  np.bincount(owner, weights=m, minlength=n_subdomains).astype(np.int64))


def build_subdomains(mesh: Mesh, parts: NDArray[np.int64], controlled: NDArray[np.bool_],
                     weights: sparse.csr_matrix | None = None) -> list[Subdomain]:
    """Cut a mesh into self-contained subdomains.

    parts: (n_cells,) subdomain of each cell, 0 to n - 1 without gaps.
    controlled: (n_dofs,) whether each dof's equilibrium row is controlled (P of Eq. 11 of [BP17]).
    weights: (n_nodes, n_unknown_nodes), where some nodes are tied to others; the unknown nodes come first.
    """
    n_subdomains = int(parts.max()) + 1
    sharing = node_sharing(mesh, parts, weights)
    chains = number_chains(sharing, controlled, n_subdomains)
    interior = np.ones(mesh.n_nodes, dtype=bool)
    interior[find_boundary_nodes(mesh)] = False
    cell_order = np.argsort(parts, kind="stable")
    cell_ends = np.cumsum(np.bincount(parts, minlength=n_subdomains))
    copy_order = np.argsort(sharing.subdomain, kind="stable")
    copy_ends = np.cumsum(np.bincount(sharing.subdomain, minlength=n_subdomains))
    subdomains = []
    for s in range(n_subdomains):
        cell_ids = np.sort(cell_order[cell_ends[s - 1] if s else 0: cell_ends[s]])
        copies = copy_order[copy_ends[s - 1] if s else 0: copy_ends[s]]
        position, node_ids = sharing.position[copies], sharing.node[copies]
        part, mesh_node_ids = mesh.submesh(cell_ids)
        dofs = (node_ids[:, None] * mesh.dim + np.arange(mesh.dim)).ravel()
        multiplicity = sharing.multiplicity[node_ids]
        displacement, reaction = (
            _interface(kind, dofs, np.repeat(multiplicity, mesh.dim), np.repeat(position, mesh.dim), chains)
            for kind in (0, 1)
        )
        subdomains.append(Subdomain(
            s, part, node_ids, mesh_node_ids, cell_ids, controlled[dofs], interior[node_ids], multiplicity,
            displacement, reaction, int(chains.owned_rows[s]), int(chains.owned_copies[s]),
            tie=None if np.array_equal(node_ids, mesh_node_ids) or weights is None
            else tie(mesh.nodes[node_ids], weights[mesh_node_ids][:, node_ids]),
        ))
    return subdomains


def _interface(kind: int, dofs: NDArray[np.int64], multiplicity: NDArray[np.int64],
               position: NDArray[np.int64], chains: Chains) -> Interface:
    local = np.flatnonzero(chains.first_row[kind, dofs] >= 0)
    return Interface(local, multiplicity[local], position[local],
                     chains.first_row[kind, dofs[local]], chains.first_copy[kind, dofs[local]])
