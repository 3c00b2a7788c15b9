"""Cell types: all that the rest of the code asks of a kind of cell is in one object here.

The monomials on which all shape functions are written, (1, xi, eta, xi eta) in a plane and (1, xi, eta, zeta, xi eta,
xi zeta, eta zeta, xi eta zeta) in space: what the pixel kernels sum over. Linear cells in space need the first four.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np

from ddic.arrays import Array

EXPONENTS: Mapping[int, Array] = MappingProxyType({
    2: np.array([[0, 0], [1, 0], [0, 1], [1, 1]]),
    3: np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1]]),
})
"""Powers of the local coordinates in each monomial, by the number of space dimensions."""

FEWEST_MONOMIALS = 4
"""Monomials, hence places for nodes, that arrays of cells have at least."""


def evaluate_monomials(local: Array, n_monomials: int | None = None) -> Array:
    """Evaluate monomials at points of the reference cell.

    Parameters
    ----------
    local : (n, dim) array
        The points.
    n_monomials : int, optional
        The first so many; all by default.

    Returns
    -------
    (n, n_monomials) array
        phi_m at each point.
    """
    exponents = EXPONENTS[local.shape[1]][:n_monomials]
    return np.asarray(_take_powers(local, exponents).prod(axis=2))


def differentiate_monomials(local: Array, n_monomials: int | None = None) -> Array:
    """Differentiate monomials by each local coordinate.

    Parameters
    ----------
    local : (n, dim) array
        The points.
    n_monomials : int, optional
        The first so many; all by default.

    Returns
    -------
    (n, n_monomials, dim) array
        d phi_m / dxi_j at each point.
    """
    exponents = EXPONENTS[local.shape[1]][:n_monomials]
    # No power is above 1: a derivative loses the coordinate, or is 0 where there is none.
    powers = _take_powers(local, exponents)
    lowered = [np.delete(powers, axis, axis=2).prod(axis=2) * exponents[:, axis] for axis in range(local.shape[1])]
    return np.stack(lowered, axis=2)


def _take_powers(local: Array, exponents: Array) -> Array:
    """Each coordinate in each monomial, (n, n_monomials, dim): itself, or 1 where its power is 0."""
    return np.where(exponents == 1, local[:, None], 1.0)


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
    shapes : (n_nodes, n_monomials) array
        Coefficients of the shape functions N_a on the monomials.
    quadrature : Quadrature
        Rule that integrates the stiffness of an affine cell exactly.
    facets : tuple of tuples of int
        Nodes of each facet, one after the other around it: edges of a plane cell in the cell's own order, faces of a
        cell in space as seen from outside, to the left.
    corner_edges : tuple of tuples of int
        Nodes at the other ends of the edges that leave each node, ``dim`` of them, positively ordered.
    mirrored : tuple of int
        Its nodes in the order of a cell that a mirror has turned inside out.
    triangles : tuple of tuples of int
        Nodes of the triangles that together are a plane cell, for plots; none of a cell in space.
    cells_around_node : float
        Mean number of cells around an inner node, by which a node's work is shared among its cells.
    family : str
        Types whose pixels the same kernels sum, which know their monomials: a key of ``PIXEL_KERNELS``.
    """

    name: str
    vtk: int
    meshio_name: str
    nodes: Array
    shapes: Array
    quadrature: Quadrature
    facets: tuple[tuple[int, ...], ...]
    corner_edges: tuple[tuple[int, ...], ...]
    mirrored: tuple[int, ...]
    triangles: tuple[tuple[int, int, int], ...]
    cells_around_node: float
    family: str = "bilinear"

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return int(self.nodes.shape[1])

    @property
    def parts_of_squared_shape(self) -> float:
        """A cell over the integral of a node's squared shape function: 9 of a quadrangle, 6 of a triangle."""
        is_simplex = self.n_nodes == self.dim + 1
        return 0.5 * (self.dim + 1) * (self.dim + 2) if is_simplex else 3.0**self.dim

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
        return evaluate_monomials(local, self.shapes.shape[1]) @ self.shapes.T

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
        return np.asarray(np.einsum("am,pmj->paj", self.shapes, differentiate_monomials(local, self.shapes.shape[1])))


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
    corner_edges=((1, 2), (2, 0), (0, 1)),
    mirrored=(0, 2, 1),
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
    corner_edges=((1, 3), (2, 0), (3, 1), (0, 2)),
    mirrored=(0, 3, 2, 1),
    triangles=((0, 1, 2), (2, 3, 0)),
    cells_around_node=4.0,
)
"""Quadrilateral of four nodes."""

TET4 = CellType(
    name="Tet4",
    vtk=10,
    meshio_name="tetra",
    nodes=np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    shapes=np.array([
        [1.0, -1.0, -1.0, -1.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]),
    quadrature=Quadrature(points=np.array([[0.25, 0.25, 0.25]]), weights=np.array([1 / 6])),
    facets=((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    corner_edges=((1, 2, 3), (0, 3, 2), (3, 0, 1), (2, 1, 0)),
    mirrored=(0, 2, 1, 3),
    triangles=(),
    cells_around_node=23.0,
    family="trilinear",
)
"""Tetrahedron of four nodes."""

_CUBE = np.array([[-1.0, -1.0, -1.0], [1.0, -1.0, -1.0], [1.0, 1.0, -1.0], [-1.0, 1.0, -1.0],
                  [-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])

HEX8 = CellType(
    name="Hex8",
    vtk=12,
    meshio_name="hexahedron",
    nodes=_CUBE,
    # N_a = (1 + xi_a xi) (1 + eta_a eta) (1 + zeta_a zeta) / 8
    shapes=0.125 * evaluate_monomials(_CUBE),
    quadrature=Quadrature(points=_CUBE / np.sqrt(3.0), weights=np.ones(8)),
    facets=((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    corner_edges=((1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)),
    mirrored=(4, 5, 6, 7, 0, 1, 2, 3),
    triangles=(),
    cells_around_node=8.0,
    family="trilinear",
)
"""Hexahedron of eight nodes."""

CELL_TYPES: Mapping[int, CellType] = MappingProxyType({kind.vtk: kind for kind in (T3, Q4, TET4, HEX8)})
"""All cell types, by their VTK numbers."""
