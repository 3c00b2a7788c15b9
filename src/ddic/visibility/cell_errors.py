"""How far off each cell may be, by its residual beyond noise; nodes of which a frame says nothing; log lines."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.functionals.correlation import Residual
from ddic.functionals.view import View
from ddic.mesh.mesh import Mesh, pad_cells, sum_about_nodes
from ddic.parallel.distribution import find_quantile_of_all
from ddic.parallel.team import Team
from ddic.partition.split import join_pairs
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import find_displaced_nodes, find_unseen_unknowns
from ddic.problem.residual_model import Evaluation
from ddic.problem.weighted_problem import WeightedProblem
from ddic.visibility.exclusions import BLANK, HELD_OFF, MASKED, SPOILT, UNSEEN, Exclusions

DOUBTFUL_PX = 0.15
"""Error of a cell, pixels, from which on it is marked. A larger value marks fewer cells and lets larger errors pass."""

SIGNIFICANT = 4.0
"""Standard deviations by which the residual's variance must exceed the noise's. A larger value marks fewer cells."""


MOST_NOISY = 0.95
"""Share of the cells that show pixels from which on, where noise alone moves their nodes by more than DOUBTFUL_PX, no
field was found. Exact pairs that are blurred so much are off by 2 to 5 px; a fifth of the cells is so where it is off
by 0.4 px at most."""


@dataclass(frozen=True)
class CellErrors:
    """What the residual says about the cells of a subdomain.

    Attributes
    ----------
    equivalent : (n_cells,) array
        Displacement error that would leave the cell's residual beyond noise, pixels; nan where no pixel counts.
    doubtful : (n_cells,) bool array
        Where that is more than DOUBTFUL_PX and not explained by noise, or no pixel counts.
    """

    equivalent: Array
    doubtful: BoolArray


@dataclass(frozen=True)
class CellResiduals:
    """Residual and texture of the cells of a subdomain.

    Attributes
    ----------
    dim : int
        Of their mesh.
    camera : int
        That measures them.
    n_pixels : (n_cells,) array
        That count.
    variance : (n_cells,) array
        Mean square of f - a g(x + u) - b with each cell's own a and b, grey levels squared; nan without pixels.
    texture : (n_cells,) array
        Mean of |grad f|^2, grey levels squared per pixel squared.
    """

    dim: int
    camera: int
    n_pixels: Array
    variance: Array
    texture: Array


def measure_cell_residuals(view: View, hessian: sparse.csr_matrix, residual: Residual) -> CellResiduals:
    """Measure what the cells of a subdomain leave unexplained, whatever their brightness; free of communication.

    ``view`` is of the camera that measures the subdomain; ``hessian`` is its M, grey levels squared per pixel squared.
    """
    sums = residual.cell_sums
    _, squares = sums.sum_residual(*sums.fit_gain_and_offset())
    n = sums.n_pixels
    variance = np.where(n > 0, np.maximum(squares, 0.0) / np.maximum(n, 1.0), np.nan)
    return CellResiduals(view.correlation.mesh.dim, view.camera, n, variance, _measure_gradients(view, hessian))


def _measure_gradients(view: View, hessian: sparse.csr_matrix) -> Array:
    """Mean of |grad f|^2 about each cell: M holds it by node, since the shape functions of a cell sum to 1."""
    mesh = view.correlation.mesh
    # Spread evenly over the nodes of each cell.
    pixels = sum_about_nodes(mesh, view.count_pixels() / np.diff(mesh.offsets))
    energy = np.zeros(mesh.n_nodes)
    for axis in range(mesh.dim):
        translation = np.zeros(mesh.nodes.shape)
        translation[:, axis] = 1.0
        energy += (hessian @ translation.ravel()).reshape(mesh.nodes.shape)[:, axis]
    corners = pad_cells(mesh)
    of_cells, n_pixels = energy[corners].sum(axis=1), pixels[corners].sum(axis=1)
    return np.divide(of_cells, n_pixels, out=np.zeros(mesh.n_cells), where=n_pixels > 0)


def find_cell_errors(team: Team, residuals: Sequence[CellResiduals]) -> list[CellErrors]:
    """Express residuals as displacement errors, and mark cells that cannot be trusted; collective.

    An error e of unknown direction leaves a residual grad f . e, of mean square |grad f|^2 e^2 / dim. Most pixels
    are taken to be right: the median of each camera's variances, cells weighted by their pixels, is that of the noise.
    """
    noise = []
    # A rank may have none: PGD-DIC's cells are all on rank 0.
    for camera in range(team.maximum(max((of_cells.camera for of_cells in residuals), default=0)) + 1):
        mine = [of_cells for of_cells in residuals if of_cells.camera == camera]
        variances, n_pixels = (np.concatenate([np.zeros(0), *arrays]) for arrays in (
            [of_cells.variance for of_cells in mine], [of_cells.n_pixels for of_cells in mine]))
        measured = np.isfinite(variances)
        noise.append(find_quantile_of_all(team, variances[measured], n_pixels[measured]) or 0.0)
    return [_find_errors(of_cells, noise[of_cells.camera]) for of_cells in residuals]


def _find_errors(cells: CellResiduals, noise: float) -> CellErrors:
    excess = np.maximum(cells.variance - noise, 0.0)
    # Nothing was seen where there is no texture; a residual there is as wrong as can be.
    with np.errstate(divide="ignore", invalid="ignore"):
        equivalent = np.where(excess > 0, np.sqrt(cells.dim * excess / cells.texture), cells.variance * 0.0)
    spread = noise * np.sqrt(2.0 / np.maximum(cells.n_pixels, 1.0))
    doubtful = (equivalent > DOUBTFUL_PX) & (excess > SIGNIFICANT * spread)
    return CellErrors(equivalent, doubtful | (cells.n_pixels == 0))


def find_noisy_cells(mesh: Mesh, deviations: Array) -> BoolArray:
    """Find the cells with a node that noise moves by more than a cell may be off, as two of its standard deviations.

    ``deviations``, (n_nodes,), are those of each node's displacement, pixels.
    """
    return np.asarray((2.0 * deviations > DOUBTFUL_PX)[pad_cells(mesh)].any(axis=1))


def describe_lost_field(team: Team, are_noisy: Sequence[BoolArray], are_shown: Sequence[BoolArray]) -> str:
    """Say that noise alone moves nearly all cells too far for a field to be believed; collective.

    ``are_noisy`` is what ``find_noisy_cells`` finds, ``are_shown`` which cells have pixels that count, of owned
    subdomains. The text says what it is and what to do; it is empty where a field can be believed.
    """
    n_noisy = team.sum(sum(int((a & b).sum()) for a, b in zip(are_noisy, are_shown, strict=True)))
    n_shown = team.sum(sum(int(of_subdomain.sum()) for of_subdomain in are_shown))
    if n_noisy < MOST_NOISY * max(n_shown, 1):
        return ""
    return (f"the frame is so much less sharp than the reference that noise alone moves nodes of {n_noisy} of "
            f"{n_shown} cells by more than {DOUBTFUL_PX} px, and a wrong place leaves as little residual as the right "
            "one; take sharper images or larger elements")


def describe_doubtful_cells(team: Team, errors: Sequence[CellErrors]) -> tuple[tuple[str, ...], int]:
    """Say how many cells are doubtful, in a line, or none; and their number; collective."""
    counts = np.zeros(4)
    for of_cells in errors:
        is_off = of_cells.doubtful & (of_cells.equivalent > DOUBTFUL_PX)
        counts += [of_cells.doubtful.sum(), np.isnan(of_cells.equivalent).sum(), is_off.sum(), len(is_off)]
    n_doubtful, n_unseen, n_off, n_cells = team.sum(counts).astype(int).tolist()
    if not n_doubtful:
        return (), 0
    line = f"{n_doubtful} of {n_cells} cells are marked doubtful (cell field \"doubtful\")"
    reasons = {f"the residual of {n_off} is that of an error above {DOUBTFUL_PX} px": n_off,
               f"{n_unseen} hold no pixel that counts": n_unseen}
    told = "; ".join(reason for reason, n in reasons.items() if n)
    return (f"{line}: {told}" if told else line,), n_doubtful


def find_unmeasured_nodes(problem: WeightedProblem, evaluation: Evaluation) -> list[BoolArray]:
    """Find the nodes of owned subdomains that neither the pixels that count nor mechanics hold; collective."""
    subdomains = problem.reference.subdomains
    if problem.reference.inputs.case.regularization is not None:
        return [np.zeros(subdomain.mesh.n_nodes, dtype=bool) for subdomain in subdomains]
    n_pixels = evaluation.residuals.map(lambda residual: residual.cell_sums.n_pixels.astype(np.int64))
    free = find_unseen_unknowns(problem.team, subdomains, n_pixels)
    return [find_displaced_nodes(subdomain, np.isin(subdomain.kinematics.numbers, free)) for subdomain in subdomains]


MOST_PLACES = 3
"""Places that are named; the result file has all of them."""

OTHER_THAN_REFERENCE = "show something else than the reference"
REASONS = {SPOILT: f"{OTHER_THAN_REFERENCE} and are excluded", BLANK: "have no texture and are excluded",
           UNSEEN: "hold no or too few pixels that both images show and are excluded",
           MASKED: "hold no pixel of the reference image that counts, masked or saturated, and are excluded",
           HELD_OFF: "are held by the regularization beside where the images show them; a shorter "
                     "regularization.cut_off_wavelength follows these"}


@dataclass(frozen=True)
class MarkedCells:
    """The cells that one thing is said of.

    Attributes
    ----------
    state : int
        What is said: BLANK, SPOILT, UNSEEN, MASKED or HELD_OFF.
    n_cells : int
        How many they are.
    places : str
        Where they are, the largest places.
    """

    state: int
    n_cells: int
    places: str


def find_marked_cells(team: Team, subdomains: Sequence[Subdomain], excluded: Exclusions) -> list[MarkedCells]:
    """Find which cells are excluded or held off, and where; the same on all ranks, collective."""
    marked = []
    for state in REASONS:
        found = []
        for subdomain, states in zip(subdomains, excluded.cells, strict=True):
            boxes, nodes = bound_cells(subdomain.mesh, states[0] == state)
            found.append((boxes, subdomain.node_ids[nodes]))
        boxes, corners = (np.concatenate(parts) for parts in zip(*team.gather_lists(found), strict=True))
        if len(boxes):
            marked.append(MarkedCells(state, len(boxes), describe_places(boxes, corners)))
    return marked


def describe_exclusions(team: Team, marked: Sequence[MarkedCells], n_cells: int,
                        excluded: Exclusions) -> tuple[str, ...]:
    """Say for the log how many cells, of ``n_cells``, and pixels are excluded, why and where; collective."""
    lines = [f"{of_state.n_cells} of {n_cells} cells {REASONS[of_state.state]} (cell field \"excluded\"): "
             f"{of_state.places}" for of_state in marked]
    n_pixels = team.sum(sum(len(spots) for spots in excluded.pixels.flat))
    if n_pixels:
        lines.append(f"{n_pixels} pixels of other cells {OTHER_THAN_REFERENCE} and are excluded")
    return tuple(lines)


def bound_cells(mesh: Mesh, chosen: BoolArray) -> tuple[Array, IntArray]:
    """Bound some cells: lower and upper corners of their boxes, (n, 2, dim), pixels; and their nodes, a row each."""
    nodes = pad_cells(mesh)[chosen]
    corners = mesh.nodes[nodes]
    return np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1), nodes


def describe_places(boxes: Array, corners: IntArray) -> str:
    """Name the places that cells make which share nodes, the largest first.

    The cells' boxes, (n, 2, dim), are as ``bound_cells`` gives them, and so are the nodes, ``corners``.
    """
    _, nodes = np.unique(corners, return_inverse=True)
    cells = np.repeat(np.arange(len(boxes)), corners.shape[1])
    # Of cells and nodes.
    n_all = len(boxes) + int(nodes.max()) + 1
    place = join_pairs(cells, len(boxes) + nodes.ravel(), n_all)[:len(boxes)]
    n_places = int(place.max()) + 1
    members = np.bincount(place, minlength=n_places)
    named = []
    for k in np.argsort(-members, kind="stable")[:MOST_PLACES]:
        low, high = boxes[place == k, 0].min(axis=0), boxes[place == k, 1].max(axis=0)
        named.append(", ".join(f"{lines} {first:.0f} to {last:.0f}" for lines, first, last in
                               zip(("columns", "rows", "slices"), low, high, strict=False)))
    if n_places > MOST_PLACES:
        named.append(f"{n_places - MOST_PLACES} more places")
    return "; ".join(named)
