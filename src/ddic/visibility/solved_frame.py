"""Looks at a frame at some displacement, the field found with what was seen last, and which look is believed.

A look tells the frame's brightness, and what of it does not show the specimen. Cells and pixels come and go with the
field that they are judged by: they must come to rest. So must corrections that do not become smaller, but are far below
the noise of the field.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ddic.arrays import BoolArray
from ddic.errors import ConvergenceError
from ddic.functionals.view import View
from ddic.parallel.field import ByView, Field
from ddic.problem.held_cells import SHOWN
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.weighted_problem import WeightedProblem
from ddic.solvers.correction_size import CorrectionSize, Tolerances
from ddic.solvers.exchange import ContinuousField, average_copies
from ddic.solvers.gauss_newton import (
    PATIENCE,
    AndersonMixing,
    Correction,
    Model,
    Pause,
    Progress,
    Solution,
    run_gauss_newton,
)
from ddic.solvers.probing import estimate_response
from ddic.visibility.cell_errors import find_unmeasured_nodes
from ddic.visibility.exclusions import AT_END, AT_START, Exclusions, Limits, Rules, find_exclusions
from ddic.visibility.match_reference import ORDER, choose_correction, match_brightness, match_sharpness
from ddic.visibility.seen_cells import TypicalCell, find_standing_out, see_cells
from ddic.visibility.slow_nodes import SlowNodes, confine_to_slow_nodes, estimate_node_deviations

SAME_SPECKLE = 0.8
"""Least correlation coefficient of f and g of a cell that is seen where it is thought to be: where nothing is seen,
nothing stands out."""

ROUGHLY = 0.01
"""Correction of most nodes, pixels, from which on the field is good enough to look at the frame. A larger value looks
earlier, and takes what is still to be found for something foreign."""

MOST_MOVING, MOST_SLOW = 0.2, 0.05
"""Share of the nodes that may still move where a frame is looked at, and that may where only these are iterated on."""

MOST_TIMES = 10
"""Times that slow nodes are iterated alone before the others are taken along again."""

SHARE_OF_NOISE = 0.2
"""RMS of corrections that do not become smaller, relative to the noise of the field, up to which it counts as found. A
larger share adds to that noise."""

LARGEST_OF_NOISE = 4.0
"""The same of the largest correction of a node: nodes at a corner have several times the noise of others."""

MOST_ROUGH = 3
"""Looks at fields that are roughly found, if each shows something else; from the last of them on, what was excluded
stays so, unless clearly less is."""

SETTLED, SHRINKING = 5, 0.9
"""Looks after which nothing else is excluded, and share of the fewest pixels so far below which fewer are nevertheless:
pixels might come and go for ever."""


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
        are_shown = np.concatenate(self.is_shown.flat)
        n_shown, n_cells = self.whole.team.sum(np.array([are_shown.sum(), len(are_shown)], dtype=float))
        return float(n_shown / max(n_cells, 1.0))


def _see_frame(problem: WeightedProblem, whole: ResidualModel, q: Field, limits: Limits = AT_END,
               judged: Exclusions | None = None) -> SeenFrame:
    """See how a frame has to be corrected, and what of it does not show the specimen; collective.

    The case says whether that is wanted. ``whole`` is of all pixels that the frame shows, ``q`` where it is thought to
    show them. A residual is not believed from the displacement error of ``limits`` on, by default those of a field.
    ``judged`` is of an earlier look, from which is taken which cells are blank; by default this one judges. Raises
    ConvergenceError on all ranks where most of the frame does not show the specimen.
    """
    case, evaluation = problem.reference.inputs.case, whole.evaluate(q)
    # A blurred reference image has weaker ones.
    slopes = whole.views.map(View.measure_slopes) if whole.blurs else problem.slopes
    seen, sample, typical = see_cells(whole, evaluation, slopes)
    chosen = whole.correction
    if case.correlation.grey_correction == "auto":
        # Small cells about a tip do not tell their own.
        has_tips = any(line.tip_functions for line in case.discontinuity)
        chosen = choose_correction(whole.team, sample, typical, whole.correction, "global" if has_tips else "element")
    if chosen != whole.correction:
        whole = replace(whole, correction=chosen)
        if chosen == "element":
            whole = match_brightness(whole, seen, typical)
        evaluation = whole.evaluate(q)
        seen, _, typical = see_cells(whole, evaluation, slopes)
    corrected = typical
    if whole.correction == "none":
        corrected = {camera: replace(of_camera, gain=1.0, offset=0.0) for camera, of_camera in typical.items()}
    # They correlate and do not stand out.
    is_shown = whole.views.map(lambda view, cells: (cells.coefficient > SAME_SPECKLE)
                               & ~find_standing_out(cells, corrected[view.camera], SHOWN, case.dim), seen)
    if case.correlation.spoilt_pixels == "keep":
        excluded = Exclusions.of_reference(whole.views)
    else:
        rules = Rules(limits, whole.correction == "element", case.regularization is not None,
                      tuple(line.uncertainty for line in case.discontinuity if line.vertices is not None))
        excluded = find_exclusions(whole, q, seen, corrected, rules, judged)
    return SeenFrame(whole, evaluation, typical, excluded, is_shown)


def see_start(problem: WeightedProblem, whole: ResidualModel, q: Field) -> tuple[SeenFrame, tuple[str, ...]]:
    """See the same at a start, and blur the reference images as much as the frame is; collective.

    The case says whether either is wanted. Notes for the log come with what is seen; arguments are those of
    ``_see_frame``. Raises ConvergenceError on all ranks where the frame shows no pixel.
    """
    seen, inputs = _see_frame(problem, whole, q, AT_START), problem.reference.inputs
    if inputs.case.correlation.spoilt_pixels == "keep":
        return seen, ()
    matched, notes = match_sharpness(seen.whole, inputs.cameras, q, seen.typical)
    if not notes:
        return seen, notes
    # Blurred from the file, they are as bright as there.
    return _see_frame(problem, replace(matched, correction=whole.correction), q, AT_START), notes


@dataclass(frozen=True)
class SolvedFrame:
    """The field of a frame, and what it was found from.

    Attributes
    ----------
    field : ContinuousField
        Unknowns, one value for the copies of each (section 5.3.2 of [BP17]).
    solution : Solution
        Unknowns before that, and all iterations.
    seen : SeenFrame
        All pixels that the frame shows, and what of them was excluded.
    used : ResidualModel
        Of the others.
    notes : tuple of str
        What was renewed, and which linear step was replaced.
    is_evaluated : bool
        Whether what is seen was evaluated at the field.
    """

    field: ContinuousField
    solution: Solution
    seen: SeenFrame
    used: ResidualModel
    notes: tuple[str, ...]
    is_evaluated: bool = True


def begin_frame(seen: SeenFrame, used: ResidualModel, q: Field, notes: tuple[str, ...]) -> SolvedFrame:
    """Take a start for a field."""
    # Copies of an unknown may still differ: they are averaged after the first iterations, before anybody looks at them.
    return SolvedFrame(ContinuousField(q, 0.0), Solution(q, []), seen, used, notes, is_evaluated=False)


def solve_further(problem: WeightedProblem, solved: SolvedFrame, progress: Progress, *, roughly: bool) -> SolvedFrame:
    """Go on with Gauss-Newton, with the same operators; collective.

    Where all but a few nodes are found, these are iterated alone, and a pass over all pixels checks the others. It
    converges or not, and holds all iterations; ``roughly`` says whether to pause as soon as few nodes move by more than
    ROUGHLY. Raises ConvergenceError on all ranks where an iteration fails, with the last SolvedFrame.
    """
    systems, tolerances, used = problem.solver.assembly.systems, problem.tolerances, solved.used
    roughly &= tolerances.rms < ROUGHLY
    if roughly:
        tolerances = replace(tolerances, relative=0.0, rms=0.0, largest=ROUGHLY)
    elif solved.seen.typical[0].is_alike:
        # Of a rough field the residual is more than noise, and of unlike images it is none.
        used = replace(used, deviations=estimate_node_deviations(used, systems, solved.seen.typical[0].noise))
    # A rough field was a part of the way.
    n_spent = len(solved.solution.records) if solved.solution.paused is not None else 0
    if n_spent >= tolerances.max_iterations:
        return replace(solved, solution=replace(solved.solution, paused=None))
    tolerances = replace(tolerances, max_iterations=tolerances.max_iterations - n_spent)
    most_slow = (MOST_MOVING if roughly else MOST_SLOW) * problem.reference.region.n_nodes
    mixing = _prepare_mixing(problem)
    excludes = problem.reference.inputs.case.correlation.spoilt_pixels == "exclude"
    before = solved.solution
    found = replace(before, records=[])

    def run(model: Model, pause: Pause | None, mixing: AndersonMixing | None = mixing) -> Solution:
        on = replace(progress, n_before=len(before.records) + len(found.records), is_local=model is not used)
        went_on = run_gauss_newton(model, found.q, problem.step, tolerances, on, pause, mixing)
        return replace(went_on, records=[*found.records, *went_on.records])

    slow: SlowNodes | None = None

    def are_few_slow(correction: Correction) -> bool:
        nonlocal slow
        if correction.size.n_slow > most_slow:
            return False
        if not roughly:
            slow = confine_to_slow_nodes(used, correction, systems, tolerances)
        return roughly or slow is not None

    def settle() -> Solution:
        """Slow nodes alone and all nodes in turns, in the end all of them."""
        nonlocal found
        for _ in range(MOST_TIMES):
            found = run(used, are_few_slow)
            if found.paused is None or slow is None:
                return found
            mixing.forget()
            alone = run(slow, None)
            mixing.forget()
            if alone.converged:
                found = alone
            elif excludes:
                # A look at the frame may tell what drives them.
                return alone
            else:
                # Not so few: in much noise they drive others, and a front of those moves on by plain steps alone.
                found = replace(found, records=alone.records)
                return run(used, None, None)
        return run(used, None)

    try:
        found = settle()
    except ConvergenceError as error:
        error.last = _join(problem, solved, replace(error.last, records=[*found.records, *error.last.records]))
        raise
    if roughly and found.paused is not None and _is_found(found.paused.size, problem.tolerances):
        stop = found.paused.size.describe_stop(problem.tolerances)
        found = replace(found, stop=stop, converged=True, paused=None)
    return _join(problem, solved, found)


def _is_found(size: CorrectionSize, tolerances: Tolerances) -> bool:
    """Whether a correction of a rough field is small to the last digit already."""
    is_small = size.relative <= tolerances.relative or size.rms <= tolerances.rms
    return is_small and size.largest <= tolerances.largest


def _join(problem: WeightedProblem, solved: SolvedFrame, found: Solution) -> SolvedFrame:
    joined = replace(found, records=[*solved.solution.records, *found.records])
    field = average_copies(joined.q)
    notes = (*solved.notes, *problem.solver.release_notes())
    return replace(solved, field=field, solution=joined, notes=notes, is_evaluated=False)


def _prepare_mixing(problem: WeightedProblem) -> AndersonMixing:
    """Mix by what unknowns displace at nodes, each node counted once."""
    weights = []
    for subdomain in problem.reference.subdomains:
        of_unknowns = np.zeros(subdomain.n_unknowns)
        shares = np.repeat(1.0 / subdomain.node_multiplicity, subdomain.mesh.dim)
        of_unknowns[:subdomain.n_field] = subdomain.kinematics.tangent.power(2).T @ shares
        weights.append(of_unknowns)
    return AndersonMixing(weights)


def see_solved_frame(problem: WeightedProblem, solved: SolvedFrame, as_read: ResidualModel | None = None) -> SeenFrame:
    """See the frame at a field; collective.

    ``as_read`` is the same pixels, of which nothing has been said of brightness: a start that was off may have called
    for more correction than the field does. By default what was chosen is never taken back. Raises ConvergenceError on
    all ranks, with the SolvedFrame, where the frame does not show the specimen there.
    """
    before, q = solved.seen.whole, solved.field.q
    # Fields that are roughly found judge what is blank.
    judged = None if solved.solution.paused is not None else solved.seen.excluded
    try:
        if as_read is not None and before.correction != as_read.correction and not before.blurs:
            seen = _see_frame(problem, as_read, q, judged=judged)
            if ORDER.index(seen.whole.correction) < ORDER.index(before.correction):
                return seen
        return _see_frame(problem, before, q, judged=judged)
    except ConvergenceError as error:
        error.last = solved
        raise


def accept_noise(problem: WeightedProblem, used: ResidualModel, solution: Solution) -> Solution:
    """Accept a field whose corrections do not become smaller, if they are far below its noise; collective.

    Images of much noise, whose gradients are half noise too, never come to rest. The solution, which did not converge,
    comes back with the reason; the same where corrections are more than noise.
    """
    if problem.tolerances.max_iterations <= PATIENCE:
        # Fewer were asked for: nobody knows yet.
        return solution
    # Of the pixels that count: what hides others is no noise.
    evaluation = used.evaluate(solution.q)
    deviation = evaluation.grey[0].residual_std
    # Of a vector, as corrections are; the residual has the noise of both images.
    counted = [~is_unmeasured for is_unmeasured in find_unmeasured_nodes(problem, evaluation)]
    response = estimate_response(problem.team, problem.solver.assembly.systems, problem.solver.step, counted)
    # Were it white: a field in a wrong place leaves forces that are many times stronger, and would be taken for noise.
    noise = deviation * response.rms_per_grey
    last = solution.records[-1].size
    if not (last.rms <= SHARE_OF_NOISE * noise and last.largest <= LARGEST_OF_NOISE * noise):
        return solution
    stop = (f"stopped at RMS dq = {last.rms:.1e} px, largest dq = {last.largest:.1e} px, which do not become smaller: "
            f"a residual of {deviation:.1f} grey levels leaves an error of {noise:.1e} px RMS in the field")
    return replace(solution, stop=stop, converged=True)


class Looks:
    """Looks at a frame after the start's, and what of each is believed.

    Parameters
    ----------
    is_regularized : bool
        Whether mechanics hold nodes beside what is hidden.

    Attributes
    ----------
    number : int
        Of the last look.
    is_rough : bool
        Whether the next one is at a field that is roughly found.
    """

    def __init__(self, *, is_regularized: bool) -> None:
        self.number, self.is_rough, self._is_regularized = 0, True, is_regularized
        self._was_found, self._fewest = False, np.inf

    def choose(self, seen: SeenFrame, now: SeenFrame, q: Field, *, is_paused: bool) -> tuple[SeenFrame, bool]:
        """Choose what to go on with at some unknowns, and tell whether it is other than before; collective."""
        team = now.whole.team
        self.number += 1
        if is_paused and not self._is_regularized:
            # Nothing holds nodes beside what is hidden, and a rough field would be judged by what drags them there. It
            # tells the noise, though, and what only the start put elsewhere.
            self.is_rough = False
            return replace(now, excluded=seen.excluded.intersect(now.excluded)), True
        # Cells are found again one row after the other, each from its neighbours.
        n_excluded = now.excluded.count_pixels(now.whole)
        shrinks = n_excluded < SHRINKING * self._fewest
        self._fewest = min(self._fewest, n_excluded)
        excluded = now.excluded.keep_pulled(seen.excluded, now.whole, q)
        if (self._was_found or self.number >= MOST_ROUGH) and not shrinks:
            excluded = seen.excluded.join(excluded)
        is_other = (self.number < SETTLED or shrinks) and (
            now.whole.correction != seen.whole.correction or excluded.is_other_than(team, seen.excluded))
        self._was_found |= not is_paused
        self.is_rough = is_other and not self._was_found and self.number < MOST_ROUGH
        if is_other:
            return replace(now, excluded=excluded), True
        return replace(now, whole=seen.whole, excluded=seen.excluded.with_marks(now.excluded)), False
