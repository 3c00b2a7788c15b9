"""Large problems without images on squares and cubes: a texture of random slopes, one tile of cells repeated over all.

The operator is all that counts here; a tile makes M cheap for millions of cells. Nodes and cells are
numbered row by row, so that a strip of rows, or a slab, is a contiguous range of unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.functionals.regularization import (
    Material,
    controlled_stiffness,
    find_cut_off_weight,
    measure_gap_energies,
    measure_texture_energies,
)
from ddic.kinematics.cell_interpolation import interpolate_cells
from ddic.kinematics.nodal import NodalKinematics
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_boundary_nodes

CELL = 16.0
TILES = {2: 64, 3: 16}
"""Cells along the side of a tile, by dimension."""
SAMPLES = 4
SLOPE = 10.0
"""Standard deviation of each component of grad f, grey/px; SAMPLES independent ones along each side of a cell."""


@dataclass(frozen=True)
class TiledProblem:
    """n x n square cells, or n x n x n cubes, of CELL px with the tiled texture.

    They are regularized at a cut-off wavelength (px; 0: not at all).
    """

    n: int
    wavelength: float
    dim: int = 2

    @property
    def n_dofs(self) -> int:
        """Unknowns of the whole mesh."""
        return int(self.dim * (self.n + 1) ** self.dim)

    @property
    def n_cells(self) -> int:
        """Cells of the whole mesh."""
        return int(self.n**self.dim)

    @property
    def _side(self) -> int:
        """Cells along the side of a tile."""
        return TILES[self.dim]

    @property
    def _material(self) -> Material:
        return Material.default(self.dim)

    def _place_in_tile(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Numbers in the tile of what lies at points, counted in cells, (n, dim)."""
        steps = self._side ** np.arange(self.dim)
        return np.asarray(np.floor(points).astype(np.int64) % self._side @ steps)

    @cached_property
    def tile(self) -> NDArray[np.float64]:
        """M_e of the tile's cells, (n_cells, n, n): sum over samples of N . grad f grad f^T . N."""
        cell, dim, n_cells = GridLines((np.arange(2.0),) * self.dim).cell_type, self.dim, self._side**self.dim
        slopes = np.random.default_rng(0).normal(scale=SLOPE, size=(n_cells, SAMPLES**dim, dim))
        at = 2 * (np.arange(SAMPLES) + 0.5) / SAMPLES - 1
        local = np.stack([along.ravel() for along in np.meshgrid(*[at] * dim)], axis=1)
        shapes = cell.evaluate_shapes(local)
        rows = np.einsum("sa,esc->esac", shapes, slopes).reshape(n_cells, SAMPLES**dim, -1)
        return np.asarray(rows.swapaxes(1, 2) @ rows * (CELL / SAMPLES) ** dim)

    def rows_of_cells(self, first: int, last: int) -> Mesh:
        """Cells of rows, or planes, first to last - 1."""
        line = CELL * np.arange(self.n + 1)
        return GridLines((line,) * (self.dim - 1) + (line[first:last + 1],)).build_mesh()

    def hessian(self, mesh: Mesh) -> sparse.csr_matrix:
        """M of some of the cells, whose places tell which cells of the tile they are."""
        return interpolate_cells(mesh).assemble_matrix(self.tile[self._place_in_tile(mesh.centroids / CELL)])

    def stiffness(self, mesh: Mesh, weights: NDArray[np.float64]) -> sparse.csr_matrix:
        """Kbar of some of the cells, rows weighted."""
        kinematics = NodalKinematics(mesh, np.arange(mesh.n_dofs))
        return controlled_stiffness(kinematics, self._material, weights)

    def controlled(self, mesh: Mesh) -> NDArray[np.bool_]:
        """Dofs of nodes inside the whole mesh, (n_dofs,)."""
        end = self.n * CELL
        inside = ((mesh.nodes > 0.5) & (mesh.nodes < end - 0.5)).all(axis=1)
        return np.repeat(inside, self.dim)

    def displacement(self, mesh: Mesh, seed: int = 1) -> NDArray[np.float64]:
        """A field for the right-hand side b = M u, pixels: a smooth one and 0.05 px from node to node."""
        x, y, *others = mesh.nodes.T
        rough = np.random.default_rng(seed).normal(scale=0.05, size=(self._side**self.dim, self.dim))
        size = self.n * CELL
        smooth = [np.sin(2 * np.pi * x / size) * y / size, np.cos(3 * np.pi * y / size),
                  *(np.sin(2 * np.pi * z / size) for z in others)]
        return np.asarray(np.column_stack(smooth) + rough[self._place_in_tile(mesh.nodes / CELL + 0.5)]).ravel()

    @cached_property
    def eta_and_diagonal(self) -> tuple[float, float]:
        """Weight eta of the cut-off wavelength and the mean of diag M, both of one tile."""
        mesh = replace(self, n=self._side).rows_of_cells(0, self._side)
        hessian = self.hessian(mesh)
        if self.wavelength == 0:
            return 0.0, float(hessian.diagonal().mean())
        interior = np.ones(mesh.n_nodes, dtype=bool)
        interior[find_boundary_nodes(mesh)] = False
        eta = find_cut_off_weight(measure_texture_energies(mesh.nodes, hessian, interior, self.wavelength),
                                  measure_gap_energies(mesh, self._material, interior, self.wavelength))
        return eta, float(hessian.diagonal().mean())

    def operator_rows(self, first: int, last: int) -> tuple[sparse.csr_matrix, NDArray[np.float64]]:
        """Rows of A = M + eta Kbar^T Kbar of the node rows first to last - 1, all columns, and of b = M u."""
        # A row of Kbar^T Kbar takes part in the equilibrium of neighbours, hence needs cells two rows away.
        low, high = max(first - 2, 0), min(last + 1, self.n)
        mesh = self.rows_of_cells(low, high)
        eta, _ = self.eta_and_diagonal
        hessian = self.hessian(mesh)
        wide = self.dim * (self.n + 1) ** (self.dim - 1)
        own = slice((first - low) * wide, (last - low) * wide)
        if eta == 0:
            return _widen(hessian[own], low * wide, self.n_dofs), (hessian @ self.displacement(mesh))[own]
        kbar = self.stiffness(mesh, self.controlled(mesh).astype(float))
        # Of the outermost node rows of a strip inside the mesh Kbar lacks cells; they do not reach the own rows.
        rows = hessian[own] + eta * (kbar[:, own].T @ kbar)
        return _widen(rows, low * wide, self.n_dofs), (hessian @ self.displacement(mesh))[own]


def _widen(rows: sparse.csr_matrix, first: int, n_columns: int) -> sparse.csr_matrix:
    """Rows of a strip's unknowns, of which the first has a number, over all columns."""
    entries = rows.tocoo()
    places = (entries.row, entries.col.astype(np.int64) + first)
    return sparse.coo_matrix((entries.data, places), shape=(rows.shape[0], n_columns)).tocsr()
