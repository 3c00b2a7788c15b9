"""Where corrections of a separated displacement begin: the coarse field, or an earlier result, as products."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ddic.arrays import Array
from ddic.images.rigid import GridField
from ddic.inputs.cameras import Frame, MeasuredCells
from ddic.io.result_reader import displacement_at
from ddic.parallel.team import require_held
from ddic.problem.separated_problem import Rectangle, SeparatedProblem
from ddic.separated.field import LineElements, SeparatedField, factorize_grid, scale_modes
from ddic.start.coarse_displacement import KeptResult
from ddic.start.coarse_field import CoarseSearch, prepare_search
from ddic.start.given_start import EarlierResult, GivenStart
from ddic.start.multilevel import MultilevelStart

KnownSeparatedStart = SeparatedField | GivenStart
"""A displacement to start from as it is, or one to go on from."""

LOSS_PX = 5e-3
"""RMS displacement of a start that may be lost when it is written as few products: less than it errs by. A
smaller value starts with more products, most of which hold noise."""

MOST_LINES = 129
"""Lines of each direction at whose crossings an earlier result on another mesh, or a field between matched features, is
looked up."""


def factorize_coarse_field(found: MultilevelStart, rectangle: Rectangle) -> SeparatedField:
    """Write a coarse field as products on the rectangle's elements.

    Interpolation between the nodes of its grid is a product itself, so that nothing is lost but small modes. Raises
    TypeError where the field is an earlier result's, which has products of its own or is looked up.
    """
    grid = found.require_field()
    if not isinstance(grid, GridField):
        return _factorize_values(grid.at, rectangle)
    x = _evaluate_hats(rectangle.along_x.nodes, grid.origin[0], grid.spacing[0], grid.values.shape[1])
    y = _evaluate_hats(rectangle.along_y.nodes, grid.origin[1], grid.spacing[1], grid.values.shape[0])
    return _decompose(grid.values, x, y, rectangle)


def _factorize_values(evaluate: Callable[[Array], Array], rectangle: Rectangle) -> SeparatedField:
    """Products of a displacement that is known at points, looked up at the crossings of a few lines."""
    lines = (rectangle.along_x, rectangle.along_y)
    coarse = [np.linspace(line.nodes[0], line.nodes[-1], min(line.n_nodes, MOST_LINES)) for line in lines]
    x, y = np.meshgrid(*coarse)
    values = evaluate(np.column_stack([x.ravel(), y.ravel()])).reshape(*x.shape, 2)
    hats = [_evaluate_hats(line.nodes, at[0], at[1] - at[0], len(at)) for line, at in zip(lines, coarse, strict=True)]
    return _decompose(values, hats[0], hats[1], rectangle)


def _evaluate_hats(places: Array, origin: float, spacing: float, n: int) -> Array:
    """Shape functions of a coarse line at places, (n, n_places); constant beyond its ends."""
    at = np.clip((places - origin) / spacing, 0, n - 1)
    return np.asarray(np.maximum(1.0 - np.abs(at - np.arange(n)[:, None]), 0.0))


def _decompose(values: Array, x: Array, y: Array, rectangle: Rectangle) -> SeparatedField:
    """Products of a displacement at the nodes of a coarse grid, interpolated by x (n_columns, n_x) and y."""
    n_rows, n_columns = values.shape[:2]
    coarse = factorize_grid(LineElements(np.arange(max(n_columns, 2), dtype=float)),
                            LineElements(np.arange(max(n_rows, 2), dtype=float)), _at_least_two(values), LOSS_PX)
    fine_x, fine_y = coarse.scaled_x[..., :n_columns] @ x, coarse.y[..., :n_rows] @ y
    return scale_modes(rectangle.along_x, rectangle.along_y, fine_x, fine_y)


def _at_least_two(values: Array) -> Array:
    """Values of a grid of two nodes or more along each side."""
    for axis in range(2):
        if values.shape[axis] == 1:
            values = np.repeat(values, 2, axis=axis)
    return values


def prepare_separated_search(problem: SeparatedProblem) -> CoarseSearch:
    """Prepare the search for a coarse field, for any number of frames; collective."""
    measured = None
    if problem.team.is_root:
        mesh = problem.rectangle.build_coarse_mesh()
        measured = [MeasuredCells(np.arange(mesh.n_cells), mesh, mesh)]
    return prepare_search(problem.team, problem.inputs, measured)


def find_separated_start(problem: SeparatedProblem, search: CoarseSearch, frame: Frame,
                         begin: KnownSeparatedStart | None) -> tuple[SeparatedField, tuple[str, ...]]:
    """Find where corrections begin, on the rectangle's elements, with notes where it comes from; collective.

    That is a coarse field, or an earlier result as the case says. ``begin`` is the displacement of an earlier frame,
    which is taken as it is; or one to go on from, in place of the case's. Raises InputError on all ranks where an
    earlier result is none.
    """
    if isinstance(begin, SeparatedField):
        return begin, ("start: an earlier frame",)
    if begin is not None:
        search = replace(search, given=begin)
    team, rectangle = problem.team, problem.rectangle
    found = require_held(search.find(frame, lambda: None)[1])[0]
    kept = found.field
    if isinstance(kept, KeptResult):
        return team.on_root(lambda: _convert(search.require_result(), kept, rectangle)), found.describe()
    return team.together(lambda: factorize_coarse_field(found, rectangle)), found.describe()


def _convert(earlier: EarlierResult, kept: KeptResult, rectangle: Rectangle) -> SeparatedField:
    """Products of an earlier result: its own, or of what it says at points."""
    result, beyond = earlier.result, kept.beyond
    if result.separated is not None and beyond is None:
        along_x, along_y, products = rectangle.along_x, rectangle.along_y, result.separated
        return scale_modes(along_x, along_y, products.along_x.evaluate(products.scaled_x, along_x.nodes),
                           products.along_y.evaluate(products.y, along_y.nodes))

    def evaluate(points: Array) -> Array:
        values, known = earlier.evaluate(points, points)
        if not known.all():
            # Between nodes that are all known there may be others that are not: a guess stands in.
            beside = points[~known]
            values[~known] = displacement_at(result, beside) if beyond is None else beyond.at(beside)
        return values

    return _factorize_values(evaluate, rectangle)
