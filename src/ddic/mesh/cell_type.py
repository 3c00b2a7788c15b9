"""Cell types: all that the rest of the code asks of a kind of cell is in one object here.

The monomials (1, xi, eta, xi eta) on which all shape functions are written: what the pixel kernels sum over.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np

from ddic.arrays import Array

N_MONOMIALS = 4
"""Number of monomials, hence the most nodes that a cell may have."""


def evaluate_monomials(local: Array) -> Array:
    """Evaluate the monomials (1, xi, eta, xi eta).

    Parameters
    ----------
    local : (n, 2) array
        Points of the reference cell.

    Returns
    -------
    (n, 4) array
        The monomials at each point.
    """
    xi, eta = local[:, 0], local[:, 1]
    return np.stack([np.ones_like(xi), xi, eta, xi * eta], axis=1)


def differentiate_monomials(local: Array) -> Array:
    """Differentiate the monomials by (xi, eta).

    Parameters
    ----------
    local : (n, 2) array
        Points of the reference cell.

    Returns
    -------
    (n, 4, 2) array
        The derivatives of each monomial at each point.
    """
    xi, eta = local[:, 0], local[:, 1]
    zero, one = np.zeros_like(xi), np.ones_like(xi)
    by_xi = np.stack([zero, one, zero, eta], axis=1)
    by_eta = np.stack([zero, zero, one, xi], axis=1)
    return np.stack([by_xi, by_eta], axis=2)


@dataclass(frozen=True, eq=False)
class Quadrature:
    """A rule of integration over a reference cell.

    Attributes
    ----------
    points : (n_points, dim) array
        Points of the reference cell.
    weights : (n_points,) array
        Their weights, whose sum is the reference cell's area.
    """

    points: Array
    weights: Array


@dataclass(frozen=True, eq=False)
class CellType:
    """A kind of cell; two are the same only if they are one object.

    Attributes
    ----------
    name : str
        As the case file and reports call it.
    vtk : int
        Number of VTK's cell type, by which meshes and result files know it.
    meshio_name : str
        As meshio calls it.
    nodes : (n_nodes, dim) array
        Nodes of the reference cell; the corners of a plane cell follow each other, from +xi to +eta.
    shapes : (n_nodes, 4) array
        Coefficients of the shape functions N_a on the monomials (1, xi, eta, xi eta).
    quadrature : Quadrature
        Rule that integrates the stiffness of an affine cell exactly.
    facets : tuple of tuples of int
        Nodes of each facet (edges of a plane cell) in the cell's own order.
    triangles : tuple of tuples of int
        Nodes of the triangles that together are the cell, for plots.
    cells_around_node : float
        Mean number of cells around an inner node, by which a node's work is shared among its cells.
    """

    name: str
    vtk: int
    meshio_name: str
    nodes: Array
    shapes: Array
    quadrature: Quadrature
    facets: tuple[tuple[int, ...], ...]
    triangles: tuple[tuple[int, int, int], ...]
    cells_around_node: float

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return int(self.nodes.shape[1])

    @property
    def centre(self) -> Array:
        """Centre of the reference cell, (dim,)."""
        return np.asarray(self.nodes.mean(axis=0))

    @cached_property
    def slopes_at_centre(self) -> Array:
        """Derivatives dN_a / dxi_j at the centre, (n_nodes, dim)."""
        return np.asarray(self.differentiate_shapes(self.centre[None])[0])

    def evaluate_shapes(self, local: Array) -> Array:
        """Evaluate the shape functions.

        Parameters
        ----------
        local : (n, dim) array
            Points of the reference cell.

        Returns
        -------
        (n, n_nodes) array
            N_a at each point.
        """
        return evaluate_monomials(local) @ self.shapes.T

    def differentiate_shapes(self, local: Array) -> Array:
        """Differentiate the shape functions by the reference cell's coordinates.

        Parameters
        ----------
        local : (n, dim) array
            Points of the reference cell.

        Returns
        -------
        (n, n_nodes, dim) array
            dN_a / dxi_j at each point.
        """
        return np.asarray(np.einsum("am,pmj->paj", self.shapes, differentiate_monomials(local)))


T3 = CellType(
    name="T3",
    vtk=5,
    meshio_name="triangle",
    nodes=np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
    shapes=np.array([
        [1.0, -1.0, -1.0, 0.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
    ]),
    quadrature=Quadrature(points=np.array([[1 / 3, 1 / 3]]), weights=np.array([0.5])),
    facets=((0, 1), (1, 2), (2, 0)),
    triangles=((0, 1, 2),),
    cells_around_node=6.0,
)
"""Triangle of three nodes."""

_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])

Q4 = CellType(
    name="Q4",
    vtk=9,
    meshio_name="quad",
    nodes=_SQUARE,
    # N_a = (1 + xi_a xi) (1 + eta_a eta) / 4
    shapes=0.25 * evaluate_monomials(_SQUARE),
    # Gauss's four points: exact for squares of derivatives of a bilinear function.
    quadrature=Quadrature(points=_SQUARE / np.sqrt(3.0), weights=np.ones(4)),
    facets=((0, 1), (1, 2), (2, 3), (3, 0)),
    triangles=((0, 1, 2), (2, 3, 0)),
    cells_around_node=4.0,
)
"""Quadrilateral of four nodes."""

CELL_TYPES: Mapping[int, CellType] = MappingProxyType({kind.vtk: kind for kind in (T3, Q4)})
"""All cell types, by their VTK numbers."""
