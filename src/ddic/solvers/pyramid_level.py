"""One level of the coarse-graining pyramid: R-DIC on a square grid over binned images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.errors import SingularSubdomainError
from ddic.functionals.correlation import GreyCorrection, correlation
from ddic.functionals.elasticity import Material
from ddic.functionals.equilibrium_gap import (
    controlled_stiffness,
    cut_off_weight,
    gap_energies,
    texture_energies,
)
from ddic.functionals.view import View
from ddic.images.binned import ArraySource
from ddic.images.grid_field import GridField, fill_absent
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.mesh.mesh import VTK_QUAD, Mesh, mesh_from_cells
from ddic.mesh.raster import Raster, rasterize
from ddic.parallel.team import Team
from ddic.partition.connectivity import build_subdomains
from ddic.solvers.gauss_newton import OwnedPart, Tolerances, gauss_newton, silent
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.monolithic import MonolithicStep
from ddic.solvers.phases import PhaseClock

CELL = 16
"""Side of the grid's cells, blocks."""

CUT_OFF = 4.0 * CELL
TOLERANCES = Tolerances(relative=1e-12, rms=0.01, max_iterations=30)
SINGULAR = 1e-10
"""Lowest eigenvalue of a usable operator, relative to the mean diagonal of M."""


@dataclass(frozen=True)
class BinnedPair:
    """An image pair binned over blocks of factor x factor pixels."""

    reference: MaskedSource
    deformed: MaskedSource
    factor: int

    @property
    def n_blocks(self) -> int:
        """Blocks of an image."""
        return self.reference.image.width * self.reference.image.height

    @property
    def centre(self) -> float:
        """Position of block 0's centre, pixels."""
        return (self.factor - 1) / 2


@dataclass(frozen=True)
class Grid:
    """Square cells that hold active blocks, within a regular grid over the region's bounding box.

    mesh: the cells, in blocks; numbers: its nodes in the full grid; shape: (rows, columns) of nodes.
    """

    mesh: Mesh
    numbers: NDArray[np.int64]
    shape: tuple[int, int]
    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]


def correlate_level(pair: BinnedPair, mesh: Mesh, start: GridField, correction: GreyCorrection) -> GridField:
    """Correlate one level from ``start``; mesh is the whole mesh in pixels, fields are in pixels.

    Raises ConvergenceError or SingularSubdomainError.
    """
    coarse = scaled_mesh(mesh, pair.factor)
    active = active_blocks(pair.reference, rasterize(coarse))
    if not active.any():
        raise SingularSubdomainError("no block of the region is usable: everything is masked")
    grid = _grid(coarse, active)
    q = start.at(grid.mesh.nodes * pair.factor + pair.centre).ravel() / pair.factor
    q = _solve(pair, grid.mesh, active, q, correction)
    values = np.full((*grid.shape, 2), np.nan)
    values.reshape(-1, 2)[grid.numbers] = q.reshape(-1, 2) * pair.factor
    origin, spacing = grid.origin * pair.factor + pair.centre, grid.spacing * pair.factor
    return GridField((origin[0], origin[1]), (spacing[0], spacing[1]), fill_absent(values))


def scaled_mesh(mesh: Mesh, factor: int) -> Mesh:
    """The mesh in blocks of factor x factor pixels."""
    nodes = (mesh.nodes - (factor - 1) / 2) / factor
    return Mesh(nodes, mesh.connectivity, mesh.offsets, mesh.types)


def active_blocks(coarse: MaskedSource, raster: Raster) -> NDArray[np.uint8]:
    """1 on the blocks whose centre lies in the mesh and that are not masked."""
    covered = raster.coverage(coarse.image.width, coarse.image.height)
    usable = coarse.usable(coarse.extent)
    return covered if usable is None else covered & usable


def _solve(pair: BinnedPair, grid: Mesh, active: NDArray[np.uint8], q: NDArray[np.float64],
           correction: GreyCorrection) -> NDArray[np.float64]:
    """R-DIC with cut-off wavelength CUT_OFF on one domain; lengths are blocks."""
    everywhere = np.ones(grid.n_dofs, dtype=bool)
    subdomain = build_subdomains(grid, np.zeros(grid.n_cells, dtype=np.int64), everywhere)[0]
    region = MaskedSource(pair.reference.image, ArraySource(pair.reference.image.path, active.astype(np.float32)))
    view = View(correlation(grid, region, 3), DeformedSubImage(pair.deformed, 3))
    part = OwnedPart(subdomain, (view,))
    hessian = view.hessian()
    rows = np.repeat(subdomain.interior, grid.dim).astype(np.float64)
    kbar = controlled_stiffness(grid, view.correlation.kinematics, Material(), rows)
    eta = 0.0
    if rows.any():
        texture = texture_energies(grid.nodes, hessian, subdomain.interior, CUT_OFF)
        eta = cut_off_weight(texture, gap_energies(grid, Material(), subdomain.interior, CUT_OFF))
    system = LocalSystem(subdomain, hessian, kbar, rows, eta)
    operator = LocalOperator(system.operator, smallest_eigenvalue=SINGULAR * float(hessian.diagonal().mean()),
                             where=f"pyramid level with blocks of {pair.factor} px")
    try:
        solution = gauss_newton(Team(MPI.COMM_SELF), [part], [q], MonolithicStep(system, operator), correction,
                                TOLERANCES, silent, PhaseClock())
    finally:
        operator.destroy()
    return solution.q[0]


def _grid(mesh: Mesh, active: NDArray[np.uint8]) -> Grid:
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    counts = np.maximum(np.round((high - low) / CELL).astype(int), 1)
    xs, ys = (np.linspace(low[axis], high[axis], counts[axis] + 1) for axis in range(2))
    nodes = np.stack([a.ravel() for a in np.meshgrid(xs, ys)], axis=1)
    columns = counts[0] + 1
    corner = (np.arange(counts[1])[:, None] * columns + np.arange(counts[0])).ravel()
    full = mesh_from_cells(nodes, {VTK_QUAD: np.stack(
        [corner, corner + 1, corner + columns + 1, corner + columns], axis=1)})
    part, numbers = full.submesh(np.flatnonzero(rasterize(full).counts_in(active) > 0))
    return Grid(part, numbers, (int(counts[1]) + 1, int(columns)), low, (high - low) / counts)
