"""Cells that mechanics hold back from where the images show them.

Where a cut-off wavelength is long beside what the specimen does, equilibrium holds the field pixels off what the images
show. A residual of other speckle says nothing of the way back, but the start does, which the images bore out: there the
functional of these cells is expanded to second order, b = b_0 + M (q_0 - q), and pulls with the force that a
displacement as large would have in the linear theory of [LPHR11].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.functionals.view import FrameView
from ddic.mesh.shapes import pad_cells
from ddic.problem.exclusions import HELD_BACK, KEPT, SPOILT, Exclusions, exclude
from ddic.problem.linearized_cells import LinearizedCells, keep_residuals
from ddic.problem.residual_limits import AT_END
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.seen_cells import SeenCells, TypicalCell
from ddic.problem.standing_out import find_standing_out
from ddic.problem.views import FrameViews

Array = NDArray[np.float64]

DISPLACED = 0.5 * AT_END.cell
"""Distance from where a cell was seen, pixels, from which on mechanics may hold it back, and the error whose residual
it may have had there: starts are as precise, and what hides an eighth of a cell leaves more. A larger one leaves cells
to grey levels that say nothing of the way back."""

SAME_SPECKLE = 0.8
"""Correlation coefficient of f and g from which on a cell was seen at the start: where nothing is, nothing stands out.
A larger one leaves cells of little contrast to be excluded in place of held back."""

ByView = list[tuple[NDArray[np.bool_], ...]]
"""A flag a cell, (n_cells,), of each owned subdomain and view."""


@dataclass(frozen=True, eq=False)
class SeenStart:
    """What a frame shows where Gauss-Newton starts.

    Attributes
    ----------
    whole : ResidualModel
        Of all pixels.
    evaluation : Evaluation
        Of it.
    q : list of (n_unknowns,) array
        Where, of each owned subdomain.
    typical : mapping of int to TypicalCell
        What most cells are like there, by camera.
    is_shown : list of tuple of (n_cells,) bool array
        Cells that are seen where the start puts them.
    """

    whole: ResidualModel
    evaluation: Evaluation
    q: list[Array]
    typical: Mapping[int, TypicalCell]
    is_shown: ByView


def find_shown_cells(views: Sequence[FrameViews], seen: Sequence[Sequence[SeenCells]],
                     typical: Mapping[int, TypicalCell]) -> ByView:
    """Find the cells that are seen where a start puts them; free of communication.

    Parameters
    ----------
    views : sequence of FrameViews
        Owned subdomains.
    seen : sequence of sequence of SeenCells
        Cells of each subdomain and view, at the start.
    typical : mapping of int to TypicalCell
        By camera.

    Returns
    -------
    list of tuple of (n_cells,) bool array
        Which correlate and do not stand out.
    """
    return [tuple((cells.coefficient > SAME_SPECKLE) & ~find_standing_out(cells, typical[view.camera], DISPLACED)
                  for view, cells in zip(of_subdomain.views, of_views, strict=True))
            for of_subdomain, of_views in zip(views, seen, strict=True)]


def find_displaced_cells(start: SeenStart, q: Sequence[Array]) -> ByView:
    """Find the cells that were seen at the start and are no longer there; free of communication.

    Parameters
    ----------
    start : SeenStart
        Of the frame.
    q : sequence of (n_unknowns,) array
        Unknowns of each owned subdomain.

    Returns
    -------
    list of tuple of (n_cells,) bool array
        Which are off by more than DISPLACED.
    """
    return [tuple(is_shown & (_measure_distance(view, q_s, q_start) > DISPLACED)
                  for view, is_shown in zip(of_subdomain.views, of_views, strict=True))
            for of_subdomain, of_views, q_s, q_start in zip(start.whole.views, start.is_shown, q, start.q, strict=True)]


def find_held_cells(start: SeenStart, q: Sequence[Array], seen: Sequence[Sequence[SeenCells]]) -> ByView:
    """Find the cells that mechanics hold back; free of communication.

    Parameters
    ----------
    start : SeenStart
        Of the frame.
    q : sequence of (n_unknowns,) array
        Unknowns of each owned subdomain.
    seen : sequence of sequence of SeenCells
        Cells of each subdomain and view there.

    Returns
    -------
    list of tuple of (n_cells,) bool array
        Which were seen at the start, are no longer there, and stand out.
    """
    return [tuple(is_displaced & find_standing_out(cells, start.typical[view.camera], AT_END.cell)
                  for view, is_displaced, cells in zip(of_subdomain.views, *of_views, strict=True))
            for of_subdomain, *of_views in zip(start.whole.views, find_displaced_cells(start, q), seen, strict=True)]


def _measure_distance(view: FrameView, q: Array, q_start: Array) -> Array:
    """Mean distance of the displacements of each cell's nodes in the view's image, (n_cells,), pixels."""
    kinematics, mesh = view.view.kinematics, view.view.correlation.mesh
    off = (kinematics.displacement(q) - kinematics.displacement(q_start)).reshape(mesh.nodes.shape)
    return np.asarray(np.linalg.norm(off, axis=1)[pad_cells(mesh)].mean(axis=1))


def exclude_and_hold(model: ResidualModel, excluded: Exclusions, start: SeenStart | None) -> ResidualModel:
    """Exclude pixels and cells of a frame, and linearize what mechanics hold back; collective.

    Parameters
    ----------
    model : ResidualModel
        With all pixels that the frame shows.
    excluded : Exclusions
        Of its subdomains.
    start : SeenStart or None
        Of the frame; None where mechanics hold nothing back.

    Returns
    -------
    ResidualModel
        With what is left.
    """
    return linearize_held_cells(exclude(model, excluded), excluded, start)


def linearize_held_cells(model: ResidualModel, excluded: Exclusions, start: SeenStart | None) -> ResidualModel:
    """Expand the functional of cells that are held back about the start; collective.

    Parameters
    ----------
    model : ResidualModel
        Without what is excluded.
    excluded : Exclusions
        Which cells are held back.
    start : SeenStart or None
        Of the frame; None where mechanics hold nothing back.

    Returns
    -------
    ResidualModel
        M counts these cells as before.
    """
    if start is None or not excluded.has_held_back(model.team):
        return replace(model, linearized=None)
    started = replace(start.whole, follows=model.follows)
    alone = exclude(started, _exclude_others(excluded))
    held = excluded.held_back
    kept = replace(start.evaluation, residuals=keep_residuals(start.evaluation.residuals, held))
    b = started.assemble_right_hand_sides(kept, start.q)
    operators = model.team.together(lambda: [_assemble(of_subdomain, q_s, follows=model.follows)
                                             for of_subdomain, q_s in zip(alone.views, start.q, strict=True)])
    return replace(model, linearized=LinearizedCells(held, start.q, b, operators))


def _exclude_others(excluded: Exclusions) -> Exclusions:
    """Exclude all cells but those that are held back."""
    cells = [tuple(np.where(states == HELD_BACK, KEPT, SPOILT).astype(np.uint8) for states in of_subdomain)
             for of_subdomain in excluded.cells]
    return replace(excluded, cells=cells)


def _assemble(of_subdomain: FrameViews, q: Array, *, follows: bool) -> sparse.csr_matrix:
    """M_s of a subdomain's pixels that are shown, (n_unknowns, n_unknowns)."""
    total = sparse.csr_matrix((len(q), len(q)))
    for view in of_subdomain.views:
        shown = view.without_hidden(q)
        followed = shown.with_moved_gradient(q) if follows else shown
        total = total + view.view.project(followed.assemble_hessian())
    return sparse.csr_matrix(total)
