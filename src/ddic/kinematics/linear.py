"""Kinematics given by a matrix: modes, fixed or tied components, any basis, nodes tied to a mesh they do not match."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.kinematics.kinematics import Kinematics, RegionKinematics
from ddic.kinematics.nodal import NodalKinematics, component_numbers
from ddic.mesh.mesh import Mesh

TOGETHER = 1e-12
"""Share of the mean diagonal of T^T T that is added to it: a subdomain may be too small to tell modes of the whole
region apart, whose sum is then shared out among them; a larger value changes fits that are well determined."""


@dataclass(frozen=True, eq=False)
class LinearKinematics(Kinematics):
    """Displacement u = T q with a sparse matrix T.

    Attributes
    ----------
    mesh : Mesh
        The subdomain's mesh.
    numbers : (n_unknowns,) array of int64
        Numbers of the unknowns in the whole problem.
    matrix : (mesh.n_dofs, n_unknowns) csr_matrix
        T, pixels per unit of an unknown.
    """

    mesh: Mesh
    numbers: IntArray
    matrix: sparse.csr_matrix

    @property
    def tangent(self) -> sparse.csr_matrix:
        """T, (mesh.n_dofs, n_unknowns)."""
        return self.matrix

    def displacement(self, unknowns: Array) -> Array:
        """Displace the mesh's nodes by u = T q."""
        return np.asarray(self.matrix @ unknowns)

    def fit(self, displacement: Array) -> Array:
        """Find the unknowns that fit a displacement in least squares."""
        return self._solve_normal_equations(self.matrix.T @ displacement)

    @cached_property
    def _solve_normal_equations(self) -> Callable[[Array], Array]:
        """From r to q with T^T T q = r, of small q where there are many."""
        normal = (self.matrix.T @ self.matrix).tocsc()
        diagonal = TOGETHER * float(normal.diagonal().mean()) * sparse.identity(normal.shape[0], format="csc")
        factor = linalg.splu((normal + diagonal).tocsc())

        def solve(right: Array) -> Array:
            first = factor.solve(right)
            # Gives back what the diagonal took where T^T T is regular.
            return np.asarray(first + factor.solve(right - normal @ first))

        return solve


@dataclass(frozen=True, eq=False)
class LinearRegion(RegionKinematics):
    """Displacement u = T q of the whole mesh.

    Attributes
    ----------
    mesh : Mesh
        The whole mesh.
    matrix : (mesh.n_dofs, n_unknowns) csr_matrix
        T, pixels per unit of an unknown; columns are independent, and as large as a displacement of about a pixel
        should one unit of each unknown be.

    Raises
    ------
    InputError
        Where it is no matrix, the shape is wrong, an entry is not finite, or an unknown displaces nothing.
    """

    mesh: Mesh
    matrix: sparse.csr_matrix

    def __post_init__(self) -> None:
        try:
            matrix = sparse.csr_matrix(self.matrix, dtype=np.float64)
        except (TypeError, ValueError) as error:
            kind = type(self.matrix).__name__
            raise InputError(f"kinematics: {kind} is no matrix of numbers; give an array or a sparse matrix with a row "
                             "for each component of each node") from error
        matrix.eliminate_zeros()
        if matrix.shape[0] != self.mesh.n_dofs:
            raise InputError(f"kinematics: the matrix has {matrix.shape[0]} rows, the mesh {self.mesh.n_dofs} "
                             f"displacements ({self.mesh.n_nodes} nodes); give a row for each component of each node, "
                             "node by node")
        if not np.isfinite(matrix.data).all():
            raise InputError("kinematics: the matrix has entries that are not finite")
        idle = np.flatnonzero(np.diff(matrix.tocsc().indptr) == 0)
        if len(idle):
            raise InputError(f"kinematics: unknown {idle[0]} displaces no node; leave its column out")
        object.__setattr__(self, "matrix", matrix)

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns."""
        return int(self.matrix.shape[1])

    def unknowns_at(self, nodes: IntArray) -> tuple[IntArray, IntArray]:
        """Find the unknowns that displace each of some nodes."""
        rows = self.matrix[component_numbers(nodes, self.mesh.dim)]
        by_component = np.diff(rows.indptr).reshape(len(nodes), self.mesh.dim)
        return rows.indices.astype(np.int64), by_component.sum(axis=1)

    def controlled(self, nodes: BoolArray) -> BoolArray:
        """Tell which unknowns are controlled: those that displace controlled nodes only.

        The generalised force of any other unknown has a part in the unknown forces of an edge.
        """
        free_components = np.repeat(~nodes, self.mesh.dim)
        touched = abs(self.matrix).T @ free_components.astype(np.float64)
        return np.asarray(touched == 0)

    def restrict(self, part: Mesh, node_ids: IntArray, numbers: IntArray) -> Kinematics:
        """Give a subdomain the rows and columns of T that concern it."""
        rows = self.matrix[component_numbers(node_ids, self.mesh.dim)]
        return LinearKinematics(part, numbers, rows[:, numbers].tocsr())


@dataclass(frozen=True, eq=False)
class TiedKinematics(LinearKinematics):
    """Displacement u = T q, q the displacements of free nodes and of masters.

    Attributes
    ----------
    matrix : (mesh.n_dofs, n_unknowns) csr_matrix
        T: 1 at free nodes, weights of the masters at slaves.
    inverse : (n_unknowns, mesh.n_dofs) csr_matrix
        Takes free nodes as they are, and the masters that fit the slaves in least squares.
    """

    inverse: sparse.csr_matrix

    def fit(self, displacement: Array) -> Array:
        """Find the unknowns that fit a displacement: free nodes as they are, masters in least squares."""
        return np.asarray(self.inverse @ displacement)


@dataclass(frozen=True, eq=False)
class TiedRegion(RegionKinematics):
    """Unknowns that are the displacements of some nodes, from which those of the others follow.

    Attributes
    ----------
    mesh : Mesh
        The whole mesh; its first nodes are those whose displacement is unknown.
    weights : (mesh.n_nodes, n_unknown_nodes) csr_matrix
        Displacement of each node from that of the unknown ones; rows add up to 1.
    """

    mesh: Mesh
    weights: sparse.csr_matrix

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns."""
        return int(self.weights.shape[1]) * self.mesh.dim

    def unknowns_at(self, nodes: IntArray) -> tuple[IntArray, IntArray]:
        """Find the unknowns that displace each of some nodes."""
        rows = self.weights[nodes]
        dim = self.mesh.dim
        unknown_nodes = rows.indices.astype(np.int64)
        n_unknown_nodes = np.diff(rows.indptr).astype(np.int64)
        return component_numbers(unknown_nodes, dim), dim * n_unknown_nodes

    def controlled(self, nodes: BoolArray) -> BoolArray:
        """Tell which unknowns are controlled: those of controlled nodes, whatever is tied to these."""
        n_unknown_nodes = self.weights.shape[1]
        return np.repeat(nodes[:n_unknown_nodes], self.mesh.dim)

    def restrict(self, part: Mesh, node_ids: IntArray, numbers: IntArray) -> Kinematics:
        """Give a subdomain its kinematics: nodal where none of its nodes is tied."""
        unknown_nodes = numbers[::self.mesh.dim] // self.mesh.dim
        if np.array_equal(unknown_nodes, node_ids):
            return NodalKinematics(part, numbers)
        weights = self.weights[node_ids][:, unknown_nodes]
        return tie(part, numbers, weights.tocsr())


def tie(mesh: Mesh, numbers: IntArray, weights: sparse.csr_matrix) -> TiedKinematics:
    """Tie a subdomain's nodes to the nodes of its unknowns, whose numbers are those in the whole problem.

    Rows of ``weights``, (mesh.n_nodes, n_unknown_nodes), add up to 1. A row with one entry 1 is a free node; other rows
    are slaves, whose columns that no free node has must be independent.
    """
    axes = sparse.identity(mesh.dim, format="csr")
    matrix = sparse.kron(weights, axes).tocsr()
    inverse = sparse.kron(_fit_of_weights(weights), axes).tocsr()
    return TiedKinematics(mesh, numbers, matrix, inverse)


def _fit_of_weights(weights: sparse.csr_matrix) -> sparse.csr_matrix:
    """Unknown nodes from mesh nodes, (n_unknown_nodes, n_nodes): free ones as they are, masters by least squares."""
    n_nodes, n_unknown_nodes = weights.shape
    counts = np.diff(weights.indptr)
    free_nodes = np.flatnonzero(counts == 1)
    slaves = np.flatnonzero(counts > 1)

    # The free node of each unknown node; masters that are not nodes of this mesh have none.
    unknown_of_free = weights.indices[weights.indptr[free_nodes]]
    node_of = np.full(n_unknown_nodes, -1)
    node_of[unknown_of_free] = free_nodes
    masters = np.flatnonzero(node_of < 0)
    known = np.flatnonzero(node_of >= 0)

    take_free = _selection(known, node_of[known], (n_unknown_nodes, n_nodes))
    take_slaves = _selection(np.arange(len(slaves)), slaves, (len(slaves), n_nodes))
    place_masters = _selection(masters, np.arange(len(masters)), (n_unknown_nodes, len(masters)))

    # What the free nodes leave of the slaves' displacement is the masters'.
    weights_of_slaves = weights[slaves]
    left_to_masters = take_slaves - weights_of_slaves @ take_free
    fit_masters = sparse.csr_matrix(np.linalg.pinv(weights_of_slaves[:, masters].toarray()))
    return take_free + place_masters @ fit_masters @ left_to_masters


def _selection(rows: IntArray, columns: IntArray, shape: tuple[int, int]) -> sparse.csr_matrix:
    """1 at some places, 0 elsewhere."""
    ones = np.ones(len(rows))
    return sparse.csr_matrix((ones, (rows, columns)), shape=shape)
