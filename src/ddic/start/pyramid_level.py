"""One level of the coarse-graining pyramid: R-DIC on a square grid over binned images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.functionals.correlation import read_correlation
from ddic.functionals.elasticity import Material
from ddic.functionals.equilibrium_gap import (
    controlled_stiffness,
    find_cut_off_weight,
    measure_gap_energies,
    measure_texture_energies,
)
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.view import FrameView, View
from ddic.images.binned import ArraySource
from ddic.images.grid_field import GridField, fill_absent
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.raster import Raster, rasterize
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.build_subdomains import build_subdomains
from ddic.partition.subdomain import Subdomain
from ddic.problem.residual_model import ResidualModel
from ddic.problem.views import FrameViews, ReferenceViews
from ddic.solvers.gauss_newton import Progress, Tolerances, gauss_newton, stay_silent
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.monolithic import MonolithicStep

CELL = 16
"""Side of the grid's cells, blocks."""

CUT_OFF = 4.0 * CELL
FREE_EDGE = 0.03
"""Weight of the equilibrium of the grid's edge relative to its inside. Cells at the edge may hold a few blocks only,
which do not determine all of their nodes; a thousandth of the energy does, and is nothing where there is texture."""

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


def correlate_level(pair: BinnedPair, mesh: Mesh, starts: Sequence[GridField],
                    correction: GreyCorrection) -> GridField:
    """Correlate one level from the best of ``starts``; mesh is the whole mesh in pixels, fields are in pixels.

    Raises ConvergenceError or SingularSubdomainError.
    """
    coarse = scale_mesh(mesh, pair.factor)
    active = find_active_blocks(pair.reference, rasterize(coarse))
    if not active.any():
        raise SingularSubdomainError("no block of the region is usable: everything is masked")
    grid = _grid(coarse, active)
    candidates = [start.at(grid.mesh.nodes * pair.factor + pair.centre).ravel() / pair.factor for start in starts]
    q = _solve(pair, grid.mesh, active, candidates, correction)
    values = np.full((*grid.shape, 2), np.nan)
    values.reshape(-1, 2)[grid.numbers] = q.reshape(-1, 2) * pair.factor
    origin, spacing = grid.origin * pair.factor + pair.centre, grid.spacing * pair.factor
    return GridField((origin[0], origin[1]), (spacing[0], spacing[1]), fill_absent(values))


def scale_mesh(mesh: Mesh, factor: int) -> Mesh:
    """The mesh in blocks of factor x factor pixels."""
    nodes = (mesh.nodes - (factor - 1) / 2) / factor
    return Mesh(nodes, mesh.connectivity, mesh.offsets, mesh.types)


def find_active_blocks(coarse: MaskedSource, raster: Raster) -> NDArray[np.uint8]:
    """1 on the blocks whose centre lies in the mesh and that are not masked."""
    covered = raster.find_covered(coarse.image.width, coarse.image.height)
    usable = coarse.find_usable(coarse.extent)
    return covered if usable is None else covered & usable


def _solve(pair: BinnedPair, grid: Mesh, active: NDArray[np.uint8], starts: Sequence[NDArray[np.float64]],
           correction: GreyCorrection) -> NDArray[np.float64]:
    """R-DIC with cut-off wavelength CUT_OFF on one domain; lengths are blocks."""
    everywhere = np.ones(grid.n_dofs, dtype=bool)
    one_domain = np.zeros(grid.n_cells, dtype=np.int64)
    subdomain = build_subdomains(NodalRegion(grid), one_domain, everywhere)[0]
    region = MaskedSource(pair.reference.image, ArraySource(pair.reference.image.path, active.astype(np.float32)))
    view = View(read_correlation(grid, region, 3), subdomain.kinematics)
    reference = ReferenceViews(subdomain, (view,))
    frame_view = FrameView(view, DeformedSubImage(pair.deformed, 3))
    model = ResidualModel(Team.alone(), [FrameViews(reference, (frame_view,))], correction)
    q = starts[0]
    if len(starts) > 1:
        q = min(starts, key=lambda start: _residual_rms(model, start))
    system = _regularize(subdomain, view.assemble_hessian())
    operator = LocalOperator(system.operator,
                             smallest_eigenvalue=SINGULAR * float(system.hessian.diagonal().mean()),
                             where=f"pyramid level with blocks of {pair.factor} px")
    try:
        solution = gauss_newton(model, [q], MonolithicStep(system, operator), TOLERANCES,
                                Progress(PhaseClock(), stay_silent))
    finally:
        operator.destroy()
    return solution.q[0]


def _regularize(subdomain: Subdomain, hessian: sparse.csr_matrix) -> LocalSystem:
    """M and Kbar of the grid, with the weight of CUT_OFF; the edge counts little."""
    grid, interior = subdomain.mesh, subdomain.interior
    row_weights = np.repeat(np.where(interior, 1.0, FREE_EDGE), grid.dim)
    kbar = controlled_stiffness(subdomain.kinematics, Material(), row_weights)
    eta = 0.0
    if interior.any():
        texture = measure_texture_energies(grid.nodes, hessian, interior, CUT_OFF)
        eta = find_cut_off_weight(texture, measure_gap_energies(grid, Material(), interior, CUT_OFF))
    return LocalSystem(subdomain, hessian, kbar, row_weights, eta)


def _residual_rms(model: ResidualModel, q: NDArray[np.float64]) -> float:
    """Root mean square of a start's residual, grey levels; infinite where it leaves no pixel."""
    try:
        return model.evaluate([q]).grey[0].residual_rms
    except ConvergenceError:
        return np.inf


def _grid(mesh: Mesh, active: NDArray[np.uint8]) -> Grid:
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    counts = np.maximum(np.round((high - low) / CELL).astype(int), 1)
    xs, ys = (np.linspace(low[axis], high[axis], counts[axis] + 1) for axis in range(2))
    nodes = np.stack([a.ravel() for a in np.meshgrid(xs, ys)], axis=1)
    columns = counts[0] + 1
    corner = (np.arange(counts[1])[:, None] * columns + np.arange(counts[0])).ravel()
    full = build_mesh(nodes, {Q4: np.stack(
        [corner, corner + 1, corner + columns + 1, corner + columns], axis=1)})
    part, numbers = full.create_submesh(np.flatnonzero(rasterize(full).sum_by_cell(active) > 0))
    return Grid(part, numbers, (int(counts[1]) + 1, int(columns)), low, (high - low) / counts)
