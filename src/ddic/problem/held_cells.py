"""Cells that mechanics hold pixels off what the images show.

Where a cut-off wavelength is long beside what the specimen does, equilibrium holds the field off. Grey levels of other
speckle say nothing of the way back, and drive the field to and fro; where the cell is seen does: it pulls with
M_e (u_seen - u), the force of a displacement as large in the linear theory of [LPHR11]. That grows up to the distance
that grey levels capture, and no further, as theirs does: a crack, which mechanics smear, would pull all about it along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.correlation import Residual
from ddic.functionals.grey_statistics import GreySums
from ddic.functionals.view import FrameView, View
from ddic.mesh.shapes import pad_cells
from ddic.problem.residual_limits import CAPTURED

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HeldCells:
    """Cells of a view that are held off, and where the frame shows them.

    Attributes
    ----------
    cells : (n,) int64 array
        Their numbers.
    shown_at : (n, 4, 2) array
        Displacement of their corners (``pad_cells``) there, pixels of the view's image.
    """

    cells: NDArray[np.int64]
    shown_at: Array

    @classmethod
    def none(cls) -> Self:
        """No cell is."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2)))

    def add(self, others: Self) -> Self:
        """Add those of others that are not among them."""
        is_new = ~np.isin(others.cells, self.cells)
        return type(self)(np.concatenate([self.cells, others.cells[is_new]]),
                          np.concatenate([self.shown_at, others.shown_at[is_new]]))


@dataclass(frozen=True, eq=False)
class PulledView:
    """A view with cells that are pulled to where they are seen.

    Attributes
    ----------
    view : View
        The view.
    held : HeldCells
        These cells.
    hessians : (n, 8, 8) array
        M_e of each, grey levels squared per pixel squared.
    """

    view: View
    held: HeldCells
    hessians: Array

    def pull(self, q: Array) -> Array:
        """Forces on the subdomain's unknowns, (n_unknowns,)."""
        correlation, kinematics = self.view.correlation, self.view.kinematics
        mesh, held = correlation.mesh, self.held
        u = kinematics.displacement(q).reshape(mesh.nodes.shape)[pad_cells(mesh)[held.cells]]
        away = held.shown_at - u
        distance = np.linalg.norm(away, axis=2).mean(axis=1)
        captured = away * (CAPTURED / np.maximum(distance, CAPTURED))[:, None, None]
        forces = np.zeros(correlation.interpolation.n_dofs)
        np.add.at(forces, correlation.interpolation.cell_dofs[held.cells],
                  np.einsum("cij,cj->ci", self.hessians, captured.reshape(len(held.cells), -1)))
        return self.view.weight * kinematics.project_vector(forces)

    def keep_others(self, residual: Residual) -> Residual:
        """Keep the residual of the other cells, as if these had no pixels."""
        moments, cell_sums = residual.moments.copy(), residual.cell_sums.values.copy()
        moments[self.held.cells] = 0.0
        cell_sums[self.held.cells] = 0.0
        return replace(residual, moments=moments, cell_sums=GreySums(cell_sums))


PulledViews = list[tuple[PulledView | None, ...]]
"""By owned subdomain and view; None where a view has none."""


def pull_view(view: FrameView, q: Array, held: HeldCells, *, follows: bool) -> PulledView | None:
    """Prepare the pull of a view's cells; None where none is held off."""
    if not len(held.cells):
        return None
    followed = view.view.with_moved_gradient(q) if follows else view.view
    is_held = np.zeros(followed.correlation.mesh.n_cells, dtype=bool)
    is_held[held.cells] = True
    hessians = followed.correlation.confine(is_held).compute_cell_hessians()
    return PulledView(view.view, held, hessians[held.cells])


def sum_pulls(pulled: PulledViews, q: Sequence[Array]) -> list[Array]:
    """Compute what b is given, (n_unknowns,) of each subdomain, grey levels squared per pixel."""
    return [np.sum([np.zeros(len(q_s)), *(view.pull(q_s) for view in of_views if view is not None)], axis=0)
            for of_views, q_s in zip(pulled, q, strict=True)]


def keep_other_cells(pulled: PulledViews, residuals: Sequence[tuple[Residual, ...]]) -> list[tuple[Residual, ...]]:
    """Keep the residuals of cells that are not pulled."""
    return [tuple(residual if view is None else view.keep_others(residual)
                  for view, residual in zip(of_views, of_subdomain, strict=True))
            for of_views, of_subdomain in zip(pulled, residuals, strict=True)]
