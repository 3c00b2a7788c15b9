"""Which linear step is fastest for a case that leaves it open (``solver.method = "auto"``)."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import ceil, prod

from ddic.case.schema import SolverSection
from ddic.inputs.inputs import Inputs, SolverChoice
from ddic.io.text_files import read_partition
from ddic.parallel.node import measure_available_memory
from ddic.parallel.team import Team
from ddic.problem.region_mesh import RegionSizes, compute_cut_off_wavelength
from ddic.solvers.petsc import ASSEMBLED, COARSE_FACTOR, is_mumps_missing
from ddic.solvers.step_costs import StepCandidate, StepCosts, StepTask, predict_costs

STEPS_OF_FRAME = 5
"""Linear steps of a frame: four of Gauss-Newton and one of the noise floor, as most measurements have. More of them
favour factors."""

OF_MEMORY = 0.8
"""Share of the memory at hand that may be planned with: predictions are that far off."""

PIXEL_BYTES = {2: 24, 3: 8}
"""Memory of a pixel by dimension: f, of images its gradient, g's coefficients, and windows that reach beyond the mesh;
of volumes of 16 bit, bytes take half."""

SIDES = {2: (20, 40, 80), 3: (6, 8, 10)}
"""Cells along a side of a subdomain, by dimension, among which the dual method chooses, beside one subdomain a rank."""

FEWEST_FOR_TWO_LEVELS = 8
"""Subdomains from which on a coarse space is a candidate."""

ITERATIVE = ("conjugate_gradient", "matching")
"""Methods by conjugate gradients, of which the number of iterations is a guess."""

LEAST_LIMIT = 100
"""Iterations that these are given at least."""

OF_PREDICTED = 4
"""Times the predicted iterations that they are given where nothing can take their place."""

OF_DUAL = {"weighting": "consistent", "preconditioner": "auto", "recycle": True, "local_inverse": "auto"}
"""Keys that only the interface problem asks, with their defaults: who gives another value wants it."""


def choose_solver(team: Team, inputs: Inputs, measure_sizes: Callable[[], RegionSizes]) -> Inputs:
    """Choose method, number of subdomains and preconditioner where the case leaves them open; collective.

    Inputs whose case says the method stay as they are; otherwise their case says it now. ``measure_sizes`` is called on
    rank 0 only. Raises InputError on all ranks, where a partition file cannot be read.
    """
    if inputs.case.solver.method != "auto":
        return inputs
    memory = measure_available_memory(team)
    choice = team.on_root(lambda: weigh_candidates(inputs, measure_sizes(), team.size, memory))
    return replace(inputs, case=choice.case, choice=choice, notes=(*inputs.notes, choice.note))


def weigh_candidates(inputs: Inputs, sizes: RegionSizes, n_ranks: int, memory: int) -> SolverChoice:
    """Weigh what can solve the linear steps of a region; free of communication.

    Of the candidates that fit into ``memory``, the bytes that each rank may still take, the one with the least
    predicted seconds is chosen; where none does, the one that takes the least memory.
    """
    case, task = inputs.case, _describe_task(inputs, sizes, n_ranks)
    costs = sorted((predict_costs(task, candidate) for candidate in _list_candidates(inputs, sizes, task)),
                   key=lambda found: found.seconds)
    room = OF_MEMORY * (memory - PIXEL_BYTES[task.dim] * sizes.work / n_ranks)
    fitting = [found for found in costs if found.memory <= room]
    chosen = fitting[0] if fitting else min(costs, key=lambda found: found.memory)
    limit = _limit_iterations(chosen, fitting, case.solver)
    solver = _state(case.solver, chosen, limit)
    note = _describe(task, chosen, [found for found in costs if found is not chosen], room)
    return SolverChoice(case, case.model_copy(update={"solver": solver}), note, limit)


def _describe_task(inputs: Inputs, sizes: RegionSizes, n_ranks: int) -> StepTask:
    wavelength = compute_cut_off_wavelength(inputs.case) / sizes.cell_size
    n_frames = inputs.case.solver.frames or inputs.n_frames
    n_steps = STEPS_OF_FRAME * n_frames
    is_started = inputs.case.start.independent and len(inputs.cameras) == 1
    n_started = int(sizes.work) * n_frames if is_started else 0
    return StepTask(sizes.n_unknowns, sizes.n_cells, wavelength, n_ranks, n_steps, n_started, inputs.case.dim)


def _list_candidates(inputs: Inputs, sizes: RegionSizes, task: StepTask) -> Iterator[StepCandidate]:
    """What can solve the case."""
    solver = inputs.case.solver
    given = count_given_subdomains(solver, sizes.n_whole_cells)
    fewest = given or max(task.n_ranks, len(inputs.cameras))
    # Where parts of the mesh must stay together, more subdomains than there must be may not be possible.
    yield from _list_dual(solver, task, fewest, may_be_more=given is None and sizes.is_plain)
    if _is_dual_wanted(solver):
        return
    if not is_mumps_missing(ASSEMBLED):
        yield StepCandidate("assembled", fewest)
    if fewest == 1:
        # The dual method with one subdomain by its simpler name.
        yield StepCandidate("monolithic", 1)
    if _are_iterations_predictable(inputs, sizes):
        yield StepCandidate("conjugate_gradient", fewest)
        if task.is_regularized and task.constants.matching is not None:
            yield StepCandidate("matching", fewest)


def _list_dual(solver: SolverSection, task: StepTask, fewest: int, *, may_be_more: bool) -> Iterator[StepCandidate]:
    counts = {fewest} if fewest > 1 or _is_dual_wanted(solver) else set()
    if may_be_more:
        wanted = (ceil(task.n_cells / side**task.dim / task.n_ranks) * task.n_ranks for side in SIDES[task.dim])
        counts |= {count for count in wanted if count > fewest}
    for count in sorted(counts):
        if solver.preconditioner != "auto":
            yield StepCandidate("dual", count, solver.preconditioner)
            continue
        yield StepCandidate("dual", count)
        if task.is_regularized and count >= FEWEST_FOR_TWO_LEVELS and not is_mumps_missing(COARSE_FACTOR):
            yield StepCandidate("dual", count, "two_level")


def count_given_subdomains(solver: SolverSection, n_cells: int) -> int | None:
    """Count the subdomains that a case gives for a mesh without cut cells; None where it gives no number."""
    if solver.blocks is not None:
        return prod(solver.blocks)
    if solver.partition_file is not None:
        return int(read_partition(solver.partition_file, n_cells).max()) + 1
    return solver.subdomains


def _is_dual_wanted(solver: SolverSection) -> bool:
    """Whether the case gives what the dual method alone asks for."""
    return any(getattr(solver, key) != value for key, value in OF_DUAL.items())


def _are_iterations_predictable(inputs: Inputs, sizes: RegionSizes) -> bool:
    """Whether sizes tell the condition number of D^-1 A.

    They do not where unknowns are of several kinds, slivers are cut off cells, or eta is given, whose cut-off
    wavelength the texture tells.
    """
    section = inputs.case.regularization
    return sizes.is_plain and (section is None or section.eta is None)


def _state(solver: SolverSection, chosen: StepCosts, limit: int | None) -> SolverSection:
    """The section that says what was chosen; a number of subdomains stays as it was given."""
    candidate = chosen.candidate
    changes: dict[str, object] = {"method": candidate.method}
    if candidate.method == "dual":
        changes["preconditioner"] = candidate.preconditioner
        if solver.partition in ("auto", "metis"):
            changes["subdomains"] = candidate.n_subdomains
    if candidate.method in ITERATIVE and limit is None:
        changes["max_iterations"] = max(solver.max_iterations, ceil(OF_PREDICTED * chosen.n_iterations))
    return solver.model_copy(update=changes)


def _limit_iterations(chosen: StepCosts, fitting: list[StepCosts], solver: SolverSection) -> int | None:
    """Iterations of a step that cost as much as factorising instead; None without iterations or a factor."""
    factors = [found for found in fitting if found.candidate.method == "assembled"]
    if chosen.candidate.method not in ITERATIVE or not factors:
        return None
    as_long = factors[0].seconds / chosen.step * chosen.n_iterations
    return min(solver.max_iterations, ceil(max(as_long, LEAST_LIMIT)))


def _describe(task: StepTask, chosen: StepCosts, others: list[StepCosts], room: float) -> str:
    """One line: what was chosen for what, and what each other method would take."""
    if task.wavelength == float("inf"):
        mechanics = "eta given"
    else:
        mechanics = f"l_c of {task.wavelength:.3g} cells" if task.is_regularized else "no regularization"
    best: dict[str, str] = {}
    for found in others:
        best.setdefault(found.candidate.method, found.describe() + _describe_lack(found, room))
    best.pop(chosen.candidate.method, None)
    against = f"; {'; '.join(best.values())}" if best else ""
    return (f'solver.method = "auto" takes {chosen.describe()}{_describe_lack(chosen, room)}, as predicted for '
            f"{task.n_unknowns} unknowns, {mechanics}, {task.n_steps} steps, ranks: {task.n_ranks}{against}")


def _describe_lack(found: StepCosts, room: float) -> str:
    """Memory is said where it is short: it is another one at each run."""
    return "" if found.memory <= room else f" (does not fit into {max(room, 0.0) / 2**30:.2g} GiB)"
