"""Cuts a mesh and its unknowns into subdomains."""

import numpy as np

from ddic.arrays import BoolArray, IntArray
from ddic.kinematics.kinematics import RegionKinematics
from ddic.mesh.topology import find_boundary_nodes
from ddic.partition.sharing import OneRank, number_interfaces
from ddic.partition.subdomain import Subdomain, begin_subdomain


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
    return number_interfaces(subdomains, [s.controlled for s in subdomains], OneRank())


def cut_subdomains(kinematics: RegionKinematics, parts: IntArray, controlled: BoolArray,
                   interior: BoolArray) -> list[Subdomain]:
    """Cut subdomains as ``build_subdomains`` does, which do not know yet what they share with others."""
    subdomains = []
    for number, cells in enumerate(_group_by(parts, int(parts.max()) + 1)):
        mesh, node_ids = kinematics.mesh.create_submesh(cells)
        numbers = np.unique(kinematics.unknowns_at(node_ids)[0])
        subdomains.append(begin_subdomain(number, kinematics.restrict(mesh, node_ids, numbers), node_ids, cells,
                                          controlled[numbers], interior[node_ids]))
    return subdomains


def _group_by(labels: IntArray, n_groups: int) -> list[IntArray]:
    """Sorted places of each label, 0 to n_groups - 1."""
    order = np.argsort(labels, kind="stable")
    ends = np.cumsum(np.bincount(labels, minlength=n_groups))
    return [np.asarray(places, dtype=np.int64) for places in np.split(order, ends[:-1])]
