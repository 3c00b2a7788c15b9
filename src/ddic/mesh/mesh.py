"""The mesh: frozen arrays of nodes and cells, for any dimension and cell type; gradients of its shape functions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.mesh.cell_parts import CellParts, Outlines, find_offsets, join_cell_parts, join_parts
from ddic.mesh.cell_type import CELL_TYPES, FEWEST_MONOMIALS, CellType
from ddic.mesh.rotation import build_rotation


@dataclass(frozen=True)
class Similarity:
    """Mapping from mesh units to pixels, x_px = scale R(angle) S x_mesh + translation; S turns y over where asked for.

    Attributes
    ----------
    scale : float
        Pixels per mesh unit.
    angle : float
        Radians, positive from +x to +y; 0 in a volume.
    translation : tuple of float
        Pixels; empty for none.
    y_up : bool
        Whether y of the mesh points up, S = diag(1, -1), and not down as in the image, S = I; not in a volume.
    """

    scale: float = 1.0
    angle: float = 0.0
    translation: tuple[float, ...] = ()
    y_up: bool = False

    def get_axes(self, dim: int) -> Array:
        """Give the mesh's axes in the image as columns, R S, (dim, dim)."""
        if dim == 3:
            return np.eye(dim)
        rotation = build_rotation(self.angle)
        return rotation @ np.diag([1.0, -1.0]) if self.y_up else rotation

    def to_pixels(self, points: Array) -> Array:
        """Map points, (n, dim), from mesh units to pixels."""
        dim = points.shape[1]
        return np.asarray(self.scale * points @ self.get_axes(dim).T + np.array(self.translation or (0.0,) * dim))

    def map_vectors_to_mesh_units(self, vectors: Array) -> Array:
        """Map displacements, (n, dim), from pixels to mesh units."""
        return vectors @ self.get_axes(vectors.shape[1]) / self.scale


@dataclass(frozen=True, eq=False)
class CellsOfType:
    """The cells of one type in a mesh.

    Attributes
    ----------
    type : CellType
        Of all these cells.
    cells : (n,) int64 array
        Their numbers in the mesh, sorted.
    nodes : (n, type.n_nodes) int64 array
        Their nodes.
    """

    type: CellType
    cells: IntArray
    nodes: IntArray


@dataclass(frozen=True, eq=False)
class Mesh:
    """Nodes and cells in pixel coordinates (x = column, y = row, pixel centres at integers).

    Attributes
    ----------
    nodes : (n_nodes, dim) float64 array
        Pixels.
    connectivity : (sum of nodes per cell,) int64 array
        The cells' nodes, one cell after the other.
    offsets : (n_cells + 1,) int64 array
        Cell e owns connectivity[offsets[e]:offsets[e + 1]].
    types : (n_cells,) uint8 array
        VTK numbers of the cells' types, keys of ``CELL_TYPES``.
    node_sets : mapping of str to (n,) array of int64
        Sorted node numbers by name.
    mapping : Similarity
        From the mesh file's units to pixels.
    parts : CellParts, optional
        Outlines of the cells that a discontinuity cut, each side of them a cell with nodes of its own.
    """

    nodes: Array
    connectivity: IntArray
    offsets: IntArray
    types: NDArray[np.uint8]
    node_sets: Mapping[str, IntArray] = field(default_factory=dict)
    mapping: Similarity = field(default_factory=Similarity)
    parts: CellParts | None = None

    def __repr__(self) -> str:
        kinds = ", ".join(f"{len(block.cells)} {block.type.name}" for block in self.cell_blocks)
        named = [name for name, nodes in self.node_sets.items() if len(nodes)]
        sets = f", node sets {', '.join(named)}" if named else ""
        return f"<ddic.Mesh: {self.n_nodes} nodes, {self.n_cells} cells ({kinds}){sets}>"

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return int(self.nodes.shape[1])

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return len(self.types)

    @property
    def n_dofs(self) -> int:
        """Number of the nodes' displacement components, node-major: dof = dim * node + component."""
        return self.nodes.size

    @cached_property
    def cells(self) -> IntArray:
        """Nodes of each cell, (n_cells, widest cell), padded with -1."""
        counts = np.diff(self.offsets)
        width = int(counts.max(initial=0))
        padded = np.full((self.n_cells, width), -1, dtype=np.int64)
        padded[np.arange(width) < counts[:, None]] = self.connectivity
        return padded

    def get_cell(self, cell: int) -> IntArray:
        """Give the nodes of a cell, in the cell's order."""
        return self.connectivity[self.offsets[cell]:self.offsets[cell + 1]]

    def find_cells_around(self, is_among: BoolArray) -> IntArray:
        """Find the cells with any of some nodes, (n_nodes,) whether it is one: sorted numbers."""
        any_is = np.logical_or.reduceat(is_among[self.connectivity], self.offsets[:-1])
        return np.flatnonzero(any_is).astype(np.int64)

    @cached_property
    def cell_blocks(self) -> tuple[CellsOfType, ...]:
        """The cells by type, in order of the types' VTK numbers."""
        blocks = []
        for number in np.unique(self.types):
            kind = CELL_TYPES[int(number)]
            members = np.flatnonzero(self.types == number).astype(np.int64)
            blocks.append(CellsOfType(kind, members, self.cells[members, :kind.n_nodes]))
        return tuple(blocks)

    @property
    def n_monomials(self) -> int:
        """Number of monomials that all its cells need, and of places for nodes in arrays of its cells."""
        return max(FEWEST_MONOMIALS, self.cells.shape[1])

    @cached_property
    def family(self) -> str:
        """Family of its cells' types, one for all."""
        (family,) = {block.type.family for block in self.cell_blocks}
        return family

    @property
    def whole_outlines(self) -> Outlines:
        """The polygon of each cell's nodes."""
        return Outlines(self.nodes, self.connectivity, self.offsets)

    @cached_property
    def outlines(self) -> Outlines:
        """What each cell covers: the polygon of its nodes, or its part of that."""
        return self.whole_outlines if self.parts is None else join_parts(self.whole_outlines, self.parts)

    @cached_property
    def centroids(self) -> Array:
        """Mean of the corners of each cell's outline, (n_cells, dim), pixels."""
        outlines = self.outlines
        sums = np.add.reduceat(outlines.corners[outlines.connectivity], outlines.offsets[:-1], axis=0)
        return np.asarray(sums / np.diff(outlines.offsets)[:, None])

    def find_cells_among(self, is_among: BoolArray) -> IntArray:
        """Find the cells whose nodes all are among some, (n_nodes,) whether it is one: sorted numbers."""
        all_are = np.logical_and.reduceat(is_among[self.connectivity], self.offsets[:-1])
        return np.flatnonzero(all_are).astype(np.int64)

    def create_submesh(self, cells: IntArray) -> tuple[Mesh, IntArray]:
        """Restrict the mesh to some of its cells, (n,), in a new order, and to their nodes.

        Beside the mesh, with the node sets that are left, come the sorted numbers of its nodes in this one.
        """
        kept = self.keep_cells(cells)
        node_ids, local = _number_used(kept.connectivity, self.n_nodes)
        sets = {name: np.flatnonzero(np.isin(node_ids, members)) for name, members in self.node_sets.items()}
        return replace(kept, nodes=self.nodes[node_ids], connectivity=local, node_sets=sets), node_ids

    def keep_cells(self, cells: IntArray) -> Mesh:
        """Keep some of the cells, numbered in this order, and all nodes."""
        padded = self.cells[cells]
        used = padded >= 0
        parts = None if self.parts is None else self.parts.restrict(cells)
        return replace(self, connectivity=padded[used], offsets=find_offsets(used.sum(axis=1)),
                       types=self.types[cells], parts=parts)


def build_mesh(nodes: Array, blocks: Mapping[CellType, IntArray] | Iterable[tuple[CellType, IntArray]],
               node_sets: Mapping[str, IntArray] | None = None, mapping: Similarity | None = None) -> Mesh:
    """Build a mesh from arrays of cells by type, (n, type.n_nodes), whose order its cells have.

    Nodes are (n_nodes, dim), pixels; node sets are sorted node numbers by name. Where no mapping is given, mesh units
    are pixels.
    """
    connectivity, counts, types = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)]
    for kind, block in blocks.items() if isinstance(blocks, Mapping) else blocks:
        connectivity.append(np.asarray(block, dtype=np.int64).ravel())
        counts.append(np.full(len(block), kind.n_nodes, dtype=np.int64))
        types.append(np.full(len(block), kind.vtk, dtype=np.uint8))
    return Mesh(
        np.ascontiguousarray(nodes, dtype=np.float64),
        np.concatenate(connectivity),
        find_offsets(np.concatenate(counts)),
        np.concatenate(types),
        dict(node_sets or {}),
        mapping or Similarity(),
    )


def join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Put meshes side by side into one, so that what is the same for each cell or node is done once for all.

    They are of one region: with one mapping, and cut by the same lines, or not at all. Nodes and cells of one come
    after those of the other; what two of them share is there twice. Node sets are those of the first.
    """
    first, *others = meshes
    if not others:
        return first
    first_nodes = np.cumsum([0, *(mesh.n_nodes for mesh in meshes)])[:-1]
    first_cells = np.cumsum([0, *(mesh.n_cells for mesh in meshes)])[:-1]
    cut = [(mesh.parts, number) for mesh, number in zip(meshes, first_cells, strict=True) if mesh.parts is not None]
    connectivity = [mesh.connectivity + number for mesh, number in zip(meshes, first_nodes, strict=True)]
    return replace(first, nodes=np.concatenate([mesh.nodes for mesh in meshes]),
                   connectivity=np.concatenate(connectivity),
                   offsets=find_offsets(np.concatenate([np.diff(mesh.offsets) for mesh in meshes])),
                   types=np.concatenate([mesh.types for mesh in meshes]),
                   parts=join_cell_parts(cut) if cut else None)


def _number_used(nodes: IntArray, n_nodes: int) -> tuple[IntArray, IntArray]:
    """Sorted numbers of the nodes that occur, and the place of each occurrence among them."""
    if len(nodes) < n_nodes:
        node_ids, places = np.unique(nodes, return_inverse=True)
        return node_ids, places.reshape(-1).astype(np.int64)
    # Marked, which takes time by the whole mesh's nodes, where a sort of this many takes more.
    is_used = np.zeros(n_nodes, dtype=bool)
    is_used[nodes] = True
    return np.flatnonzero(is_used).astype(np.int64), (np.cumsum(is_used) - 1)[nodes]


def pad_shapes(kind: CellType, n_monomials: int) -> Array:
    """Pad a cell type's shape coefficients to (n_monomials, n_monomials); rows of nodes that it has not are zero."""
    padded = np.zeros((n_monomials, n_monomials))
    padded[:kind.n_nodes, :kind.shapes.shape[1]] = kind.shapes
    return padded


def sum_about_nodes(mesh: Mesh, of_cells: Array) -> Array:
    """Sum numbers of cells, (n_cells,), over the cells about each node, (n_nodes,)."""
    of_corners = np.repeat(of_cells, np.diff(mesh.offsets))
    return np.asarray(np.bincount(mesh.connectivity, of_corners, mesh.n_nodes), dtype=np.float64)


def pad_cells(mesh: Mesh) -> IntArray:
    """Pad the cells' nodes to (n_cells, n_monomials): one with fewer repeats its first, whose padded shape is zero."""
    cells = np.full((mesh.n_cells, mesh.n_monomials), -1, dtype=np.int64)
    cells[:, :mesh.cells.shape[1]] = mesh.cells
    first = cells[:, :1]
    return np.where(cells < 0, first, cells)


def compute_geometry(mesh: Mesh, cells: IntArray | slice = slice(None)) -> Array:
    """Find the map x = sum_m X_m phi_m(xi) from the reference cell to cells: X, (n, dim, n_monomials), pixels."""
    of_type = np.zeros((max(CELL_TYPES) + 1, mesh.n_monomials, mesh.n_monomials))
    for block in mesh.cell_blocks:
        of_type[block.type.vtk] = pad_shapes(block.type, mesh.n_monomials)
    coordinates = mesh.nodes[pad_cells(mesh)[cells]]
    return np.ascontiguousarray(np.einsum("eam,eac->ecm", of_type[mesh.types[cells]], coordinates))


def compute_shape_gradients(mesh: Mesh, block: CellsOfType, local: Array) -> tuple[Array, Array]:
    """Differentiate the shape functions of cells of one type by x, at points of the reference cell, (n_points, dim).

    Gives dN_a / dx_j, (n, n_points, n_nodes, dim), 1/px, and the determinant of the map's Jacobian, (n, n_points),
    square pixels.
    """
    coordinates = mesh.nodes[block.nodes]
    by_local = block.type.differentiate_shapes(local)
    n_points, k, dim = by_local.shape
    # jacobian[e, p, i, j] = dx_i / dxi_j = sum_a x_ai dN_a / dxi_j, one product for all points of a cell.
    at_all_points = coordinates.transpose(0, 2, 1) @ by_local.transpose(1, 0, 2).reshape(k, n_points * dim)
    inverse, det = invert_matrices(at_all_points.reshape(-1, dim, n_points, dim).transpose(0, 2, 1, 3))
    # Not by products of a matrix for each point, which are so small that calling for them takes most of the time.
    gradients = by_local[..., 0, None] * inverse[:, :, None, 0]
    for i in range(1, dim):
        gradients += by_local[..., i, None] * inverse[:, :, None, i]
    return gradients, det


def invert_matrices(matrices: Array) -> tuple[Array, Array]:
    """Invert many small matrices, (..., dim, dim), none of them singular, and give their determinants too.

    By the closed form, which is ten times as fast as a factorisation of each.
    """
    det = compute_determinants(matrices)
    if matrices.shape[-1] == 2:
        a, b = matrices[..., 0, 0], matrices[..., 0, 1]
        c, d = matrices[..., 1, 0], matrices[..., 1, 1]
        adjugate = np.stack([d, -b, -c, a], axis=-1).reshape(matrices.shape)
    else:
        first, second, third = (matrices[..., row, :] for row in range(3))
        adjugate = np.stack([np.cross(second, third), np.cross(third, first), np.cross(first, second)], axis=-1)
    return adjugate / det[..., None, None], det


def compute_determinants(matrices: Array) -> Array:
    """Compute the determinants of many matrices, (..., dim, dim), of two or three rows."""
    if matrices.shape[-1] == 2:
        return np.asarray(matrices[..., 0, 0] * matrices[..., 1, 1] - matrices[..., 0, 1] * matrices[..., 1, 0])
    first, second, third = (matrices[..., row, :] for row in range(3))
    return np.asarray((first * np.cross(second, third)).sum(axis=-1))
