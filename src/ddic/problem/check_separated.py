"""All inputs of a PGD-DIC case validated without measuring."""

from __future__ import annotations

from ddic.case.loader import LoadedCase
from ddic.case.schema import Case
from ddic.errors import InputError
from ddic.images.source import ImageSource
from ddic.problem.check_report import CheckReport, count_bits
from ddic.problem.inputs import Problems
from ddic.problem.rectangle import (
    Rectangle,
    check_rectangle,
    choose_controlled_lines,
    find_rectangle_of_case,
)
from ddic.problem.weighted_problem import describe_cut_off
from ddic.separated.band_sums import N_BANDS


def check_separated_case(loaded: LoadedCase, reference: ImageSource, problems: Problems) -> CheckReport:
    """Check the rectangle of a case with [pgd] and what refers to it.

    Parameters
    ----------
    loaded : LoadedCase
        The case file.
    reference : ImageSource
        The reference image.
    problems : Problems
        What was found before.

    Returns
    -------
    CheckReport
        What the inputs are.

    Raises
    ------
    InputError
        With the problems of all inputs, one line each.
    """
    rectangle: Rectangle | None = None
    with problems.gathered(loaded.path):
        rectangle = find_rectangle_of_case(loaded.case)
        check_rectangle(loaded.case, rectangle, reference.width, reference.height)
    problems.require_none()
    if rectangle is None:
        raise InputError(problems.lines)
    return _describe(loaded.case, reference, rectangle)


def _describe(case: Case, reference: ImageSource, rectangle: Rectangle) -> CheckReport:
    n_nodes = rectangle.along_x.n_nodes * rectangle.along_y.n_nodes
    n_cells = (rectangle.along_x.n_nodes - 1) * (rectangle.along_y.n_nodes - 1)
    of_x, of_y = (line.count_pixels() for line in (rectangle.along_x, rectangle.along_y))
    n_controlled = n_nodes
    section = case.regularization
    if section is None:
        n_controlled = 0
    elif section.operator == "equilibrium_gap":
        lines = choose_controlled_lines(section, rectangle)
        n_controlled = int(lines.x.sum()) * int(lines.y.sum())
    return CheckReport(
        image_size=(reference.width, reference.height),
        bits=count_bits(reference),
        n_nodes=n_nodes,
        n_cells=n_cells,
        n_dofs=2 * n_nodes,
        cell_counts={"Q4": n_cells},
        node_sets={},
        pixels_min=int(of_x.min() * of_y.min()),
        pixels_mean=float(of_x.mean() * of_y.mean()),
        n_controlled_dofs=2 * n_controlled,
        output=case.output.file,
        discontinuities=None,
        half_amplitudes=describe_cut_off(section),
        most_ranks=N_BANDS,
    )

