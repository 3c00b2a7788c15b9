"""What a subdomain's unknowns do to its mesh: the one way from unknowns to displacements and back."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.mesh.interpolation import interpolate
from ddic.mesh.mesh import Mesh


class Kinematics(ABC):
    """Displacement of the nodes of one subdomain's mesh from the subdomain's unknowns.

    A child says how unknowns displace nodes (`displacement`), the derivative of that (`tangent`) and how unknowns are
    found that fit a displacement (`fit`). Everything else in ddic knows unknowns by their numbers only: whatever they
    mean, they may be shared by subdomains, hence have multiplicities, owners and rows of C_s.

    Attributes
    ----------
    mesh : Mesh
        The mesh whose nodes move.
    numbers : (n_unknowns,) array of int64
        Numbers of the unknowns in the whole problem.
    """

    mesh: Mesh
    numbers: IntArray

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns."""
        return len(self.numbers)

    @property
    @abstractmethod
    def tangent(self) -> sparse.csr_matrix:
        """Derivative T of the displacement by the unknowns, (mesh.n_dofs, n_unknowns)."""

    @abstractmethod
    def displacement(self, unknowns: Array) -> Array:
        """Displace the mesh's nodes.

        Parameters
        ----------
        unknowns : (n_unknowns,) array
            Unknowns.

        Returns
        -------
        (mesh.n_dofs,) array
            Displacement of the nodes, node by node, pixels.
        """

    @abstractmethod
    def fit(self, displacement: Array) -> Array:
        """Find the unknowns whose displacement comes nearest to a given one.

        Parameters
        ----------
        displacement : (mesh.n_dofs,) array
            Displacement of the nodes, node by node, pixels.

        Returns
        -------
        (n_unknowns,) array
            Unknowns.
        """

    def at(self, points: Array, unknowns: Array) -> Array:
        """Interpolate the displacement anywhere in the mesh by its shape functions, never across a hole.

        Parameters
        ----------
        points : (n, dim) array
            Positions in the frame of ``mesh``, pixels.
        unknowns : (n_unknowns,) array
            Unknowns.

        Returns
        -------
        (n, dim) array
            Displacement, pixels; nan outside the mesh.
        """
        nodal = self.displacement(unknowns).reshape(self.mesh.nodes.shape)
        return interpolate(self.mesh, nodal, points)

    def hold_still(self) -> Kinematics:
        """Give the same without the motion of a camera among the unknowns.

        Returns
        -------
        Kinematics
            Itself, where there is no such motion.
        """
        return self

    def project_matrix(self, matrix: sparse.csr_matrix) -> sparse.csr_matrix:
        """Take a matrix on displacements of nodes to one on unknowns, T^T M T.

        Parameters
        ----------
        matrix : (mesh.n_dofs, mesh.n_dofs) csr_matrix
            Matrix on displacements of the nodes.

        Returns
        -------
        (n_unknowns, n_unknowns) csr_matrix
            Matrix on unknowns.
        """
        return (self.tangent.T @ matrix @ self.tangent).tocsr()

    def project_vector(self, vector: Array) -> Array:
        """Take a vector of forces on nodes to one of forces on unknowns, T^T b.

        Parameters
        ----------
        vector : (mesh.n_dofs,) array
            Forces on the nodes, node by node.

        Returns
        -------
        (n_unknowns,) array
            Forces on the unknowns.
        """
        return np.asarray(self.tangent.T @ vector)


class RegionKinematics(ABC):
    """Displacement of the nodes of the whole region's mesh from the unknowns of the whole problem.

    Cutting the mesh asks it which unknowns displace which nodes, and each subdomain's part of it. It is linear, so
    that a subdomain's part is made of rows and columns of one matrix.

    Attributes
    ----------
    mesh : Mesh
        The whole mesh.
    """

    mesh: Mesh

    @property
    @abstractmethod
    def n_unknowns(self) -> int:
        """Number of unknowns of the whole problem, motions of cameras apart."""

    @abstractmethod
    def unknowns_at(self, nodes: IntArray) -> tuple[IntArray, IntArray]:
        """Find the unknowns that displace each of some nodes.

        Parameters
        ----------
        nodes : (n,) array of int64
            Numbers of nodes of the whole mesh.

        Returns
        -------
        unknowns : (sum of counts,) array of int64
            Numbers of the unknowns, node after node; a number may stand twice at a node.
        counts : (n,) array of int64
            How many of them stand at each node.
        """

    @abstractmethod
    def controlled(self, nodes: BoolArray) -> BoolArray:
        """Tell which unknowns have a controlled row of equilibrium: P of Eq. 9 of [BP17].

        Parameters
        ----------
        nodes : (mesh.n_nodes,) array of bool
            Whether a node's equilibrium is controlled.

        Returns
        -------
        (n_unknowns,) array of bool
            Whether an unknown's is.
        """

    @abstractmethod
    def restrict(self, part: Mesh, node_ids: IntArray, numbers: IntArray) -> Kinematics:
        """Give a subdomain its kinematics.

        Parameters
        ----------
        part : Mesh
            The subdomain's mesh.
        node_ids : (part.n_nodes,) array of int64
            Numbers of its nodes in the whole mesh.
        numbers : (n,) array of int64
            Sorted numbers of the unknowns that displace these nodes.

        Returns
        -------
        Kinematics
            With these unknowns, in this order.
        """
