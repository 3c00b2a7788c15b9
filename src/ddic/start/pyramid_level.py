"""One level of the coarse-graining pyramid: R-DIC on a square grid over binned images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

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
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.kinematics.discontinuities import Discontinuities
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import Raster, rasterize
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.build_subdomains import build_subdomains
from ddic.partition.subdomain import Subdomain
from ddic.problem.residual_model import ResidualModel
from ddic.problem.views import FrameViews, ReferenceViews
from ddic.solvers.correction_size import Tolerances
from ddic.solvers.gauss_newton import Progress, gauss_newton, stay_silent
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.monolithic import MonolithicStep
from ddic.start.coarse_grid import CELL, build_grid, locate_block_centre
from ddic.start.cut_field import CoarseField, evaluate_at_nodes
from ddic.start.level_mesh import LevelMesh, cut_grid, scale_to_pixels

CUT_OFF = 4.0 * CELL
"""Cut-off wavelength of a level, blocks. A larger value finds smoother fields, and strays less where texture is
poor."""

FREE_EDGE = 0.03
"""Weight of the equilibrium of the grid's edge relative to its inside. Cells at the edge may hold a few blocks only,
which do not determine all of their nodes; a thousandth of the energy does, and is nothing where there is texture. A
larger value stiffens the edge."""

DEGREE = 3
"""Of the splines between blocks."""

TOLERANCES = Tolerances(relative=1e-12, rms=0.01, max_iterations=30, largest=np.inf)
"""Of Gauss-Newton on a level: the RMS of a correction, in blocks, decides."""

SINGULAR = 1e-10
"""Lowest eigenvalue of a usable operator, relative to the mean diagonal of M. A larger value refuses more levels."""


@dataclass(frozen=True)
class BinnedPair:
    """An image pair binned over blocks of factor x factor pixels.

    Attributes
    ----------
    reference : MaskedSource
        The reference image, a pixel a block.
    deformed : MaskedSource
        The deformed image, a pixel a block.
    factor : int
        Side of a block, pixels.
    """

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
        return locate_block_centre(self.factor)


def correlate_level(pair: BinnedPair, mesh: Mesh, starts: Sequence[CoarseField], correction: GreyCorrection,
                    discontinuities: Discontinuities) -> CoarseField:
    """Correlate one level from the best of some starts.

    Parameters
    ----------
    pair : BinnedPair
        The images.
    mesh : Mesh
        The whole mesh, pixels.
    starts : sequence of GridField or CutField
        At least one, pixels; that of least residual is taken.
    correction : GreyCorrection
        Of grey levels.
    discontinuities : Discontinuities
        Lines that cut the level's grid, pixels.

    Returns
    -------
    GridField or CutField
        The displacement, pixels.

    Raises
    ------
    ConvergenceError
        Where Gauss-Newton does not converge.
    SingularSubdomainError
        Where the blocks do not determine the displacement.
    """
    region = scale_mesh(mesh, pair.factor)
    active = find_active_blocks(pair.reference, rasterize(region))
    if not active.any():
        raise SingularSubdomainError("no block of the region is usable: everything is masked")
    lines = discontinuities.scale(pair.centre, pair.factor)
    cells = cut_grid(build_grid(region, active), lines, active, DEGREE)
    in_pixels = scale_to_pixels(cells.mesh, pair.factor)
    candidates = [evaluate_at_nodes(start, in_pixels).ravel() / pair.factor for start in starts]
    displacement = _solve(_read_level(pair, cells, active, correction), candidates)
    return cells.make_field(displacement, pair.factor)


def scale_mesh(mesh: Mesh, factor: int) -> Mesh:
    """Scale a mesh from pixels to blocks.

    Parameters
    ----------
    mesh : Mesh
        Pixels.
    factor : int
        Side of a block, pixels.

    Returns
    -------
    Mesh
        The same cells, blocks.
    """
    nodes = (mesh.nodes - locate_block_centre(factor)) / factor
    return Mesh(nodes, mesh.connectivity, mesh.offsets, mesh.types)


def find_active_blocks(coarse: MaskedSource, raster: Raster) -> NDArray[np.uint8]:
    """Mark the blocks whose centre lies in the mesh and that are not masked.

    Parameters
    ----------
    coarse : MaskedSource
        A binned image.
    raster : Raster
        Of the mesh in blocks.

    Returns
    -------
    (rows, columns) array of uint8
        1 on active blocks, 0 elsewhere.
    """
    covered = raster.find_covered(coarse.image.width, coarse.image.height)
    usable = coarse.find_usable(coarse.extent)
    return covered if usable is None else covered & usable


@dataclass(frozen=True)
class _Level:
    """A level with its pixels, one subdomain that is the whole grid; lengths are blocks."""

    view: View
    subdomain: Subdomain
    model: ResidualModel
    row_weights: NDArray[np.float64]
    name: str


def _read_level(pair: BinnedPair, cells: LevelMesh, active: NDArray[np.uint8], correction: GreyCorrection) -> _Level:
    everywhere = np.ones(cells.kinematics.n_unknowns, dtype=bool)
    one_domain = np.zeros(cells.mesh.n_cells, dtype=np.int64)
    subdomain = build_subdomains(cells.kinematics, one_domain, everywhere, cells.interior)[0]
    row_weights = np.where(cells.kinematics.controlled(~cells.on_edge), 1.0, FREE_EDGE)
    correlation = read_correlation(cells.mesh, pair.reference, DEGREE)
    seen = active[pair.reference.extent.locate(correlation.reference.window)].copy()
    if correlation.reference.usable is not None:
        seen &= correlation.reference.usable
    # Blocks that are not active lie beside the mesh: neighbours' slopes are taken from them as they are.
    view = View(replace(correlation, reference=replace(correlation.reference, usable=seen)), subdomain.kinematics)
    frame_view = FrameView(view, DeformedSubImage(pair.deformed, DEGREE))
    views = FrameViews(ReferenceViews(subdomain, (view,)), (frame_view,))
    model = ResidualModel(Team.alone(), [views], correction)
    return _Level(view, subdomain, model, row_weights, f"pyramid level with blocks of {pair.factor} px")


def _solve(level: _Level, starts: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """R-DIC with cut-off wavelength CUT_OFF from the best start."""
    kinematics = level.subdomain.kinematics
    candidates = [kinematics.fit(start) for start in starts]
    q = candidates[0]
    if len(candidates) > 1:
        q = min(candidates, key=lambda candidate: _residual_rms(level.model, candidate))
    system = _regularize(level)
    smallest_eigenvalue = SINGULAR * float(system.hessian.diagonal().mean())
    operator = LocalOperator(system.operator, smallest_eigenvalue=smallest_eigenvalue, where=level.name)
    try:
        silent = Progress(PhaseClock(), stay_silent)
        solution = gauss_newton(level.model, [q], MonolithicStep(system, operator), TOLERANCES, silent)
    finally:
        operator.destroy()
    return kinematics.displacement(solution.q[0])


def _regularize(level: _Level) -> LocalSystem:
    """M and Kbar of the grid, with the weight of CUT_OFF; the edge counts little."""
    subdomain, of_nodes = level.subdomain, level.view.assemble_hessian()
    grid, interior = subdomain.mesh, subdomain.interior
    kbar = controlled_stiffness(subdomain.kinematics, Material(), level.row_weights)
    eta = 0.0
    if interior.any():
        texture = measure_texture_energies(grid.nodes, of_nodes, interior, CUT_OFF)
        gap = measure_gap_energies(grid, Material(), interior, CUT_OFF)
        eta = find_cut_off_weight(texture, gap)
    return LocalSystem(subdomain, level.view.project(of_nodes), kbar, level.row_weights, eta)


def _residual_rms(model: ResidualModel, q: NDArray[np.float64]) -> float:
    """Root mean square of a start's residual, grey levels; infinite where it leaves no pixel."""
    try:
        return model.evaluate([q]).grey[0].residual_rms
    except ConvergenceError:
        return np.inf
