"""Finite element kinematics: the unknowns are the displacements of the nodes."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.kinematics.kinematics import Kinematics, RegionKinematics
from ddic.mesh.mesh import Mesh


@dataclass(frozen=True, eq=False)
class NodalKinematics(Kinematics):
    """Unknowns that are the displacements of the mesh's nodes, node by node.

    Attributes
    ----------
    mesh : Mesh
        The subdomain's mesh.
    numbers : (mesh.n_dofs,) array of int64
        Numbers of the unknowns in the whole problem.
    """

    mesh: Mesh
    numbers: IntArray

    @property
    def tangent(self) -> sparse.csr_matrix:
        """The identity, (mesh.n_dofs, mesh.n_dofs)."""
        return sparse.identity(self.n_unknowns, format="csr")

    def displacement(self, unknowns: Array) -> Array:
        """Give back the unknowns."""
        return unknowns

    def fit(self, displacement: Array) -> Array:
        """Give back the displacement."""
        return displacement

    # T is the identity: a product with it would cost as much as the pixels of a small element.
    def project_matrix(self, matrix: sparse.csr_matrix) -> sparse.csr_matrix:
        """Give back the matrix, as `Kinematics.project_matrix` does for an identity."""
        return matrix

    def project_vector(self, vector: Array) -> Array:
        """Give back the vector, as `Kinematics.project_vector` does for an identity."""
        return vector


@dataclass(frozen=True, eq=False)
class NodalRegion(RegionKinematics):
    """Unknowns that are the displacements of all nodes: component c of node n is unknown dim n + c.

    Attributes
    ----------
    mesh : Mesh
        The whole mesh.
    """

    mesh: Mesh

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns."""
        return self.mesh.n_dofs

    def unknowns_at(self, nodes: IntArray) -> tuple[IntArray, IntArray]:
        """Find the components of some nodes' displacements."""
        return component_numbers(nodes, self.mesh.dim), np.full(len(nodes), self.mesh.dim)

    def controlled(self, nodes: BoolArray) -> BoolArray:
        """Tell which unknowns are controlled: all components of controlled nodes."""
        return np.repeat(nodes, self.mesh.dim)

    def restrict(self, part: Mesh, node_ids: IntArray, numbers: IntArray) -> NodalKinematics:
        """Give a subdomain its kinematics."""
        return NodalKinematics(part, numbers)


def component_numbers(nodes: IntArray, dim: int) -> IntArray:
    """Number the components of nodes' displacements, (n dim,): component c of node k is number dim k + c."""
    return np.asarray((nodes[:, None] * dim + np.arange(dim)).ravel(), dtype=np.int64)
