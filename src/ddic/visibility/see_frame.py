"""How a frame shows the specimen at some displacement: its brightness, and what of it does not show the specimen."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddic.arrays import BoolArray
from ddic.case.schema import Case
from ddic.functionals.view import CellSlopes, View
from ddic.inputs.cameras import Camera
from ddic.parallel.field import ByView, Field
from ddic.problem.held_cells import AT_END, AT_START, SHOWN, Limits
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.visibility.brightness import choose_correction, match_brightness
from ddic.visibility.exclusions import Exclusions, Rules, find_exclusions
from ddic.visibility.seen_cells import (
    SeenCells,
    TypicalCell,
    collect_cells,
    find_standing_out,
    find_typical_cell,
    measure_seen_cells,
)
from ddic.visibility.sharpness import match_sharpness

SAME_SPECKLE = 0.8
"""Least correlation coefficient of f and g of a cell that is seen where it is thought to be: where nothing is seen,
nothing stands out."""


@dataclass(frozen=True)
class SeenFrame:
    """How a frame shows the specimen.

    Attributes
    ----------
    whole : ResidualModel
        Of all pixels that it shows, with the correction of grey levels that they need.
    evaluation : Evaluation
        Of it.
    typical : mapping of int to TypicalCell
        What most cells are like, by camera.
    excluded : Exclusions
        What does not show the specimen.
    is_shown : ByView of (n_cells,) bool array
        Which cells are seen where they are thought to be.
    """

    whole: ResidualModel
    evaluation: Evaluation
    typical: Mapping[int, TypicalCell]
    excluded: Exclusions
    is_shown: ByView[BoolArray]

    def measure_shown_share(self) -> float:
        """Share of the cells that are seen where they are thought to be, each camera's counted; collective."""
        counts = np.array([sum(int(cells.sum()) for cells in self.is_shown.flat),
                           sum(len(cells) for cells in self.is_shown.flat)], dtype=float)
        n_shown, n_cells = self.whole.team.sum(counts)
        return float(n_shown / max(n_cells, 1.0))


def see_frame(case: Case, whole: ResidualModel, q: Field, slopes: ByView[CellSlopes],
              limits: Limits = AT_END, judged: Exclusions | None = None) -> SeenFrame:
    """See how a frame has to be corrected, and what of it does not show the specimen; collective.

    The case says whether that is wanted. ``whole`` is of all pixels that the frame shows, ``q`` where it is thought to
    show them, ``slopes`` are of the reference images. A residual is not believed from the
    displacement error of ``limits`` on, by default those of a field. ``judged`` is of an earlier look, from which is
    taken which cells are blank; by default this one judges. Raises ConvergenceError on all ranks where most of the
    frame does not show the specimen.
    """
    evaluation = whole.evaluate(q)
    if whole.blurs:
        # A blurred reference image has weaker ones.
        slopes = whole.views.map(View.measure_slopes)
    seen = measure_seen_cells(whole, evaluation, slopes)
    sample = collect_cells(whole, seen)
    typical = _find_typical_cells(sample)
    chosen = _choose(case, whole, sample, typical)
    if chosen.correction != whole.correction:
        whole = match_brightness(chosen, seen, typical) if chosen.correction == "element" else chosen
        evaluation = whole.evaluate(q)
        seen = measure_seen_cells(whole, evaluation, slopes)
        typical = _find_typical_cells(collect_cells(whole, seen))
    corrected = typical
    if whole.correction == "none":
        corrected = {camera: replace(of_camera, gain=1.0, offset=0.0) for camera, of_camera in typical.items()}
    # They correlate and do not stand out.
    is_shown = whole.views.map(lambda view, cells: (cells.coefficient > SAME_SPECKLE)
                               & ~find_standing_out(cells, corrected[view.camera], SHOWN), seen)
    if case.correlation.spoilt_pixels == "keep":
        excluded = Exclusions.nothing(whole.views)
    else:
        rules = Rules(limits, whole.correction == "element", case.regularization is not None,
                      tuple(line.uncertainty for line in case.discontinuity if line.vertices is not None))
        excluded = find_exclusions(whole, q, seen, corrected, rules, judged)
    return SeenFrame(whole, evaluation, typical, excluded, is_shown)


def see_start(case: Case, cameras: Sequence[Camera], whole: ResidualModel, q: Field,
              slopes: ByView[CellSlopes]) -> tuple[SeenFrame, tuple[str, ...]]:
    """See the same at a start, and blur the reference images as much as the frame is; collective.

    The case says whether either is wanted. Notes for the log come with what is seen; arguments are those of
    ``see_frame``. Raises ConvergenceError on all ranks where the frame shows no pixel.
    """
    seen = see_frame(case, whole, q, slopes, AT_START)
    if case.correlation.spoilt_pixels == "keep":
        return seen, ()
    matched, notes = match_sharpness(seen.whole, cameras, q, seen.typical)
    if not notes:
        return seen, notes
    # Blurred from the file, they are as bright as there.
    return see_frame(case, replace(matched, correction=whole.correction), q, slopes, AT_START), notes


def _find_typical_cells(sample: Mapping[int, SeenCells]) -> dict[int, TypicalCell]:
    return {camera: find_typical_cell(cells) for camera, cells in sample.items()}


def _choose(case: Case, whole: ResidualModel, sample: Mapping[int, SeenCells],
            typical: Mapping[int, TypicalCell]) -> ResidualModel:
    """The model with the correction of grey levels that the case asks for, or leaves to the pair."""
    if case.correlation.grey_correction != "auto":
        return whole
    # Small cells about a tip do not tell their own.
    has_tips = any(line.tip_functions for line in case.discontinuity)
    chosen = choose_correction(sample, typical, whole.correction, "global" if has_tips else "element")
    return replace(whole, correction=chosen)
