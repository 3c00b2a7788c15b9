"""How a frame shows the specimen at some displacement: its brightness, and what of it does not show the specimen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case
from ddic.functionals.view import CellSlopes
from ddic.inputs.cameras import Camera
from ddic.problem.held_cells import AT_END, AT_START, SHOWN, Limits
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.visibility.brightness import choose_correction, match_brightness
from ddic.visibility.exclusions import Exclusions
from ddic.visibility.seen_cells import (
    SeenCells,
    TypicalCell,
    collect_cells,
    find_standing_out,
    find_typical_cell,
    measure_seen_cells,
)
from ddic.visibility.sharpness import match_sharpness
from ddic.visibility.view_exclusions import Rules, find_exclusions

Array = NDArray[np.float64]

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
    is_shown : list of tuple of (n_cells,) bool array
        Which cells are seen where they are thought to be, of each owned subdomain and view.
    """

    whole: ResidualModel
    evaluation: Evaluation
    typical: Mapping[int, TypicalCell]
    excluded: Exclusions
    is_shown: list[tuple[NDArray[np.bool_], ...]]

    def measure_shown_share(self) -> float:
        """Share of the cells that are seen where they are thought to be, each camera's counted; collective."""
        shown = [of_view for of_subdomain in self.is_shown for of_view in of_subdomain]
        counts = np.array([sum(int(cells.sum()) for cells in shown), sum(len(cells) for cells in shown)], dtype=float)
        n_shown, n_cells = self.whole.team.sum(counts)
        return float(n_shown / max(n_cells, 1.0))


def see_frame(case: Case, whole: ResidualModel, q: Sequence[Array], slopes: Sequence[Sequence[CellSlopes]],
              limits: Limits = AT_END, judged: Exclusions | None = None) -> SeenFrame:
    """See how a frame has to be corrected, and what of it does not show the specimen; collective.

    The case says whether that is wanted. ``whole`` is of all pixels that the frame shows, ``q`` where it is thought to
    show them, ``slopes`` are of the reference images by subdomain and view. A residual is not believed from the
    displacement error of ``limits`` on, by default those of a field. ``judged`` is of an earlier look, from which is
    taken which cells are blank; by default this one judges. Raises ConvergenceError on all ranks where most of the
    frame does not show the specimen.
    """
    evaluation = whole.evaluate(q)
    slopes = measure_slopes(whole, slopes)
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
    is_shown = _find_shown_cells(whole, seen, corrected)
    if case.correlation.spoilt_pixels == "keep":
        excluded = Exclusions.nothing(whole.views)
    else:
        rules = Rules(limits, whole.correction == "element", case.regularization is not None,
                      tuple(line.uncertainty for line in case.discontinuity if line.vertices is not None))
        excluded = find_exclusions(whole, q, seen, corrected, rules, judged)
    return SeenFrame(whole, evaluation, typical, excluded, is_shown)


def measure_slopes(whole: ResidualModel, of_sharp: Sequence[Sequence[CellSlopes]]) -> Sequence[Sequence[CellSlopes]]:
    """Measure the slopes of the reference images that a frame is compared with; free of communication.

    Where no image was blurred they are ``of_sharp``, those of the images as they are; a blurred one has weaker ones.
    """
    if not whole.blurs:
        return of_sharp
    return [[view.view.measure_slopes() for view in of_subdomain.views] for of_subdomain in whole.views]


def see_start(case: Case, cameras: Sequence[Camera], whole: ResidualModel, q: Sequence[Array],
              slopes: Sequence[Sequence[CellSlopes]]) -> tuple[SeenFrame, tuple[str, ...]]:
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


def _find_shown_cells(whole: ResidualModel, seen: Sequence[Sequence[SeenCells]],
                      typical: Mapping[int, TypicalCell]) -> list[tuple[NDArray[np.bool_], ...]]:
    """Which cells correlate and do not stand out, (n_cells,), by subdomain and view."""
    return [tuple((cells.coefficient > SAME_SPECKLE) & ~find_standing_out(cells, typical[view.camera], SHOWN)
                  for view, cells in zip(of_subdomain.views, of_views, strict=True))
            for of_subdomain, of_views in zip(whole.views, seen, strict=True)]


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
