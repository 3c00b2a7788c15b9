"""Cuts a mesh and its unknowns into subdomains."""

import numpy as np

from ddic.arrays import BoolArray, IntArray
from ddic.kinematics.kinematics import RegionKinematics
from ddic.mesh.topology import find_boundary_nodes
from ddic.partition.sharing import OneRank, connect_subdomains
from ddic.partition.subdomain import NO_CHAINS, Subdomain


def build_subdomains(kinematics: RegionKinematics, parts: IntArray, controlled: BoolArray,
                     interior: BoolArray | None = None) -> list[Subdomain]:
    """Cut a mesh and its unknowns into self-contained subdomains, all of them, by number.

    ``parts`` is the subdomain of each cell, 0 to n - 1 without gaps; ``controlled`` says whether each unknown's
    equilibrium row is controlled (P of Eq. 9 of [BP17]), and Kbar has a row for it. ``interior`` are the nodes at which
    texture is weighed against mechanics, (n_nodes,); by default those that are not on the mesh's boundary.
    """
    if interior is None:
        interior = np.ones(kinematics.mesh.n_nodes, dtype=bool)
        interior[find_boundary_nodes(kinematics.mesh)] = False
    subdomains = cut_subdomains(kinematics, parts, controlled, interior)
    return connect_subdomains(subdomains, [s.controlled for s in subdomains], OneRank())


def cut_subdomains(kinematics: RegionKinematics, parts: IntArray, controlled: BoolArray,
                   interior: BoolArray) -> list[Subdomain]:
    """Cut subdomains as ``build_subdomains`` does, which do not know yet what they share with others."""
    subdomains = []
    for number, cells in enumerate(_group_by(parts, int(parts.max()) + 1)):
        mesh, node_ids = kinematics.mesh.create_submesh(cells)
        numbers = np.unique(kinematics.unknowns_at(node_ids)[0])
        subdomains.append(Subdomain(
            index=number, mesh=mesh, node_ids=node_ids, cell_ids=cells,
            kinematics=kinematics.restrict(mesh, node_ids, numbers),
            controlled=controlled[numbers],
            interior=interior[node_ids],
            node_multiplicity=np.ones(len(node_ids), np.int64),
            multiplicity=np.ones(len(numbers), np.int64),
            jumps=NO_CHAINS, reactions=NO_CHAINS, n_owned_rows=0, n_owned_copies=0))
    return subdomains


def _group_by(labels: IntArray, n_groups: int) -> list[IntArray]:
    """Sorted places of each label, 0 to n_groups - 1."""
    order = np.argsort(labels, kind="stable")
    ends = np.cumsum(np.bincount(labels, minlength=n_groups))
    return [np.asarray(places, dtype=np.int64) for places in np.split(order, ends[:-1])]
