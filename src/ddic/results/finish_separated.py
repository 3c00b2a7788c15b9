"""What follows the last correction of PGD-DIC: the residual image, and what it says."""

from __future__ import annotations

from ddic.inputs.cameras import Frame
from ddic.inputs.rectangle import choose_output_lines
from ddic.problem.separated_problem import SeparatedProblem
from ddic.results.separated_cells import evaluate_output_cells
from ddic.results.separated_measurement import SeparatedMeasurement
from ddic.separated.corrections import SeparatedSolution
from ddic.separated.pixel_bands import FramePixels


def finish_separated(problem: SeparatedProblem, frame: Frame, pixels: FramePixels, notes: tuple[str, ...],
                     solution: SeparatedSolution, failure: str = "") -> SeparatedMeasurement:
    """Compute the residual image and judge cells; collective.

    Parameters
    ----------
    problem : SeparatedProblem
        What was measured.
    frame : Frame
        The deformed image.
    pixels : FramePixels
        Of this rank.
    notes : tuple of str
        So far.
    solution : SeparatedSolution
        The displacement.
    failure : str, optional
        Why the displacement is no result; nothing where it converged.

    Returns
    -------
    SeparatedMeasurement
        Spread over ranks.
    """
    residual = pixels.compute_residual_rows(solution.field, solution.grey.gain, solution.grey.offset)
    lines = choose_output_lines(problem.inputs.case, problem.rectangle)
    cells = evaluate_output_cells(problem.team, lines, problem.reference, residual)
    notes = (*problem.inputs.notes, *notes, failure or solution.stop, *cells.notes)
    return SeparatedMeasurement(problem, frame, solution, cells, residual, notes, failure)
