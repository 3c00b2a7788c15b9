"""Large square problems without images: a texture of random slopes, one tile of cells repeated over the mesh.

The operator is all that counts here; a tile makes M cheap for millions of cells. Nodes and cells are
numbered row by row, so that a strip of rows is a contiguous range of unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
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
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import find_boundary_nodes

CELL = 16.0
TILE = 64
SAMPLES = 4
SLOPE = 10.0
"""Standard deviation of both components of grad f, grey/px; SAMPLES x SAMPLES independent ones to a cell."""


@dataclass(frozen=True)
class TiledProblem:
    """n x n square cells of CELL px with the tiled texture, regularized at a cut-off wavelength (px; 0: not at all)."""

    n: int
    wavelength: float

    @property
    def n_dofs(self) -> int:
        """Unknowns of the whole mesh."""
        return 2 * (self.n + 1) ** 2

    @cached_property
    def tile(self) -> NDArray[np.float64]:
        """M_e of the tile's cells, (TILE^2, 8, 8): sum over samples of N . grad f grad f^T . N."""
        slopes = np.random.default_rng(0).normal(scale=SLOPE, size=(TILE**2, SAMPLES**2, 2))
        at = (np.arange(SAMPLES) + 0.5) / SAMPLES
        x, y = (a.ravel() for a in np.meshgrid(at, at))
        shapes = np.stack([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y])
        rows = np.einsum("as,esc->esac", shapes, slopes).reshape(TILE**2, SAMPLES**2, 8)
        return np.asarray(np.einsum("esi,esj->eij", rows, rows) * (CELL / SAMPLES) ** 2)

    def rows_of_cells(self, first: int, last: int) -> Mesh:
        """Cells of rows first to last - 1."""
        return build_structured_mesh((0.0, first * CELL, self.n * CELL, last * CELL), CELL)

    def hessian(self, mesh: Mesh) -> sparse.csr_matrix:
        """M of some of the cells, whose places tell which cells of the tile they are."""
        column, row = np.floor(mesh.centroids / CELL).astype(np.int64).T
        return interpolate_cells(mesh).assemble_matrix(self.tile[row % TILE * TILE + column % TILE])

    def stiffness(self, mesh: Mesh, weights: NDArray[np.float64]) -> sparse.csr_matrix:
        """Kbar of some of the cells, rows weighted."""
        kinematics = NodalKinematics(mesh, np.arange(mesh.n_dofs))
        return controlled_stiffness(kinematics, Material(), weights)

    def controlled(self, mesh: Mesh) -> NDArray[np.bool_]:
        """Dofs of nodes inside the whole mesh, (n_dofs,)."""
        end = self.n * CELL
        inside = ((mesh.nodes > 0.5) & (mesh.nodes < end - 0.5)).all(axis=1)
        return np.repeat(inside, 2)

    def displacement(self, mesh: Mesh, seed: int = 1) -> NDArray[np.float64]:
        """A field for the right-hand side b = M u, pixels: a smooth one and 0.05 px from node to node."""
        x, y = mesh.nodes.T
        rough = np.random.default_rng(seed).normal(scale=0.05, size=(TILE**2, 2))
        number = np.rint(mesh.nodes / CELL).astype(np.int64) % TILE
        size = self.n * CELL
        smooth = np.column_stack([np.sin(2 * np.pi * x / size) * y / size, np.cos(3 * np.pi * y / size)])
        return np.asarray(smooth + rough[number[:, 1] * TILE + number[:, 0]]).ravel()

    @cached_property
    def eta_and_diagonal(self) -> tuple[float, float]:
        """Weight eta of the cut-off wavelength and the mean of diag M, both of one tile."""
        mesh = build_structured_mesh((0.0, 0.0, TILE * CELL, TILE * CELL), CELL)
        hessian = self.hessian(mesh)
        if self.wavelength == 0:
            return 0.0, float(hessian.diagonal().mean())
        interior = np.ones(mesh.n_nodes, dtype=bool)
        interior[find_boundary_nodes(mesh)] = False
        eta = find_cut_off_weight(measure_texture_energies(mesh.nodes, hessian, interior, self.wavelength),
                                  measure_gap_energies(mesh, Material(), interior, self.wavelength))
        return eta, float(hessian.diagonal().mean())

    def operator_rows(self, first: int, last: int) -> tuple[sparse.csr_matrix, NDArray[np.float64]]:
        """Rows of A = M + eta Kbar^T Kbar of the node rows first to last - 1, all columns, and of b = M u."""
        # A row of Kbar^T Kbar takes part in the equilibrium of neighbours, hence needs cells two rows away.
        low, high = max(first - 2, 0), min(last + 1, self.n)
        mesh = self.rows_of_cells(low, high)
        eta, _ = self.eta_and_diagonal
        hessian = self.hessian(mesh)
        wide = 2 * (self.n + 1)
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
