"""What the ways to solve a linear step take: seconds and memory, predicted from sizes alone.

The constants are those of the cost model of ``solver.method = "auto"``; ``make bench-interface`` measures them anew.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ddic.parallel.team import require_held

LARGEST_ARRAYS = {2: 12_800, 3: 2_187}
"""Unknowns of a subdomain, 80 x 80 or 8 x 8 x 8 cells, up to which S_s and its inverse are arrays (``DENSE_LIMIT`` in
``solvers/dual/preconditioner.py``), by dimension."""


def count_operations(n: float, dim: int) -> float:
    """Count a factor's operations by nested dissection, an unknown of n: of all n^1.5, of a volume n^2."""
    return float(np.sqrt(n)) if dim == 2 else n


def count_entries(n: float, dim: int) -> float:
    """Count a factor's entries by nested dissection, an unknown of n: of all n log n, of a volume n^(4/3)."""
    return float(np.log2(max(n, 2.0))) if dim == 2 else float(np.cbrt(n))


@dataclass(frozen=True)
class Growth:
    """Cost of an unknown of a problem: constant, and growing with the size of the problem.

    Attributes
    ----------
    constant, growing : float
        Seconds or bytes; the growing part for each of ``count_operations``, or of ``count_entries``.
    """

    constant: float
    growing: float

    def evaluate(self, count: float) -> float:
        """Evaluate it, an unknown."""
        return self.constant + self.growing * count


@dataclass(frozen=True)
class Factor:
    """Cost of a factorisation.

    Attributes
    ----------
    seconds, memory : Growth
        CPU seconds, growing with operations, and bytes, growing with entries.
    """

    seconds: Growth
    memory: Growth


@dataclass(frozen=True)
class MatchingCosts:
    """Costs of conjugate gradients with the matching preconditioner, an unknown.

    Attributes
    ----------
    set_up : float
        Seconds.
    iteration : Growth
        Seconds, growing with the cut-off wavelength in cells.
    n_iterations : float
        Of an inexact step, whatever that is.
    memory : float
        Bytes beside those of M and Kbar.
    """

    set_up: float
    iteration: Growth
    n_iterations: float
    memory: float


@dataclass(frozen=True)
class CostConstants:
    """What a machine takes for the parts of a linear step, an unknown; pairs are without and with regularization.

    Attributes
    ----------
    system_memory : float
        Bytes of M and Kbar.
    whole, local : pair of Factor
        Of A by MUMPS on one rank, forming it included, and of A_s by the package for subdomains.
    whole_solve, local_solve : float
        Seconds of a solve with each, an entry.
    parallel_factor : pair of float
        Power of the number of ranks by which the seconds of a rank fall.
    parallel_memory : float
        The same of bytes.
    interface, sparse_interface : pair of Factor
        Of S_s and its inverse, other subdomains all round: as arrays, and by a sparse factor, as large ones have it.
    coarse_set_up : Growth
        Seconds of modes and coarse matrix of two levels, growing with operations.
    dual_product : float
        Solves with A_s that an iteration of the interface problem is worth.
    one_level_iterations : pair of float
        Of an inexact step: where the cut-off wavelength is far below the side of a subdomain, and more for each side
        in it.
    two_level_iterations : float
        Of an inexact step.
    cg_set_up : float
        Seconds.
    cg_product : pair of float
        Seconds of an iteration of conjugate gradients.
    cg_product_calls : pair of float
        Seconds of an iteration whatever the number of unknowns: of a rank, and of each of its subdomains.
    cg_iterations : float
        Of an inexact step without regularization, and with the least.
    cg_iterations_by_square : float
        The same over the square of the cut-off wavelength in cells.
    matching : MatchingCosts or None
        Of conjugate gradients with the matching preconditioner; None where it was not measured.
    """

    system_memory: float
    whole: tuple[Factor, Factor]
    whole_solve: float
    parallel_factor: tuple[float, float]
    parallel_memory: float
    local: tuple[Factor, Factor]
    local_solve: float
    interface: tuple[Factor, Factor]
    sparse_interface: tuple[Factor, Factor]
    coarse_set_up: Growth
    dual_product: float
    one_level_iterations: tuple[float, float]
    two_level_iterations: float
    cg_set_up: float
    cg_product: tuple[float, float]
    cg_product_calls: tuple[float, float]
    cg_iterations: float
    cg_iterations_by_square: float
    matching: MatchingCosts | None = None


PLANE = CostConstants(
    system_memory=810.0,
    whole=(Factor(Growth(6.7e-06, 7.4e-09), Growth(1300.0, 0.0)),
           Factor(Growth(1.1e-05, 4.6e-08), Growth(3500.0, 71.0))),
    whole_solve=3e-08,
    parallel_factor=(0.63, 0.61),
    parallel_memory=0.87,
    local=(Factor(Growth(1.5e-06, 1.5e-08), Growth(1500.0, 40.0)),
           Factor(Growth(4.7e-06, 6.8e-08), Growth(2400.0, 180.0))),
    local_solve=2e-08,
    interface=(Factor(Growth(6.9e-06, 0.0), Growth(0.0, 0.0)), Factor(Growth(1.1e-05, 1.7e-07), Growth(0.0, 0.0))),
    sparse_interface=(Factor(Growth(3.7e-06, 2.7e-09), Growth(0.0, 0.0)),
                      Factor(Growth(1.5e-05, 8.4e-10), Growth(980.0, 0.0))),
    coarse_set_up=Growth(1.6e-05, 5.3e-08),
    dual_product=2.3,
    one_level_iterations=(2.0, 3.2),
    two_level_iterations=2.0,
    cg_set_up=5.6e-07,
    cg_product=(2.9e-08, 6.3e-08),
    cg_product_calls=(0.0, 3.1e-05),
    cg_iterations=12.0,
    cg_iterations_by_square=1.0,
)
"""Fitted on 26 November 2026 to runs of ``bench.interface_solvers`` with 10,000 to 250,000 unknowns on one and two
ranks of a shared two-core machine: seconds from 60,000 regularized unknowns on are within a quarter, memory a half."""

VOLUME = CostConstants(
    system_memory=1800.0,
    whole=(Factor(Growth(1.8e-05, 9.2e-10), Growth(2200.0, 170.0)),
           Factor(Growth(1.1e-04, 5.2e-09), Growth(14000.0, 430.0))),
    whole_solve=8.6e-08,
    parallel_factor=(0.47, 0.35),
    parallel_memory=0.66,
    local=(Factor(Growth(1.4e-05, 8.3e-10), Growth(7300.0, 170.0)),
           Factor(Growth(3.5e-05, 5.6e-09), Growth(11000.0, 820.0))),
    local_solve=5e-08,
    interface=(Factor(Growth(3.6e-05, 2.6e-08), Growth(0.0, 0.0)), Factor(Growth(1.7e-04, 3.3e-08), Growth(0.0, 0.0))),
    sparse_interface=(Factor(Growth(3.5e-05, 0.0), Growth(1900.0, 0.0)),
                      Factor(Growth(1.3e-04, 1.7e-09), Growth(0.0, 91.0))),
    coarse_set_up=Growth(1.7e-05, 0.0),
    dual_product=4.3,
    one_level_iterations=(1.8, 1.2),
    two_level_iterations=2.0,
    cg_set_up=9.5e-07,
    cg_product=(7.2e-08, 1.8e-07),
    cg_product_calls=(5.5e-05, 3.9e-05),
    cg_iterations=14.0,
    cg_iterations_by_square=1.9,
    matching=MatchingCosts(1.4e-05, Growth(3.1e-07, 5.2e-08), 16.0, 2800.0),
)
"""Fitted on 28 November 2026 in the same way to cubes of 15,000 and 47,000 unknowns, with "matching" of 108,000 too."""

MEASURED = {2: PLANE, 3: VOLUME}
"""By dimension of the mesh."""

STARTED_PIXEL = 8e-8
"""Seconds of a pixel in the independent start: some three passes of 2.5e-8 s (bench/kernel_rates.py)."""

StepMethod = Literal["dual", "assembled", "conjugate_gradient", "matching", "monolithic"]


@dataclass(frozen=True)
class StepTask:
    """The linear steps that are to be made.

    Attributes
    ----------
    n_unknowns, n_cells : int
        Of the whole problem, and of the mesh.
    wavelength : float
        Cut-off wavelength over the side of a cell; 0 without regularization, infinite where it is not known.
    n_ranks, n_steps : int
        Ranks that make the steps together, and how many steps there are with the same operator.
    n_started : int
        Pixels of the region, over all frames, that the dual method's subdomains are first measured on by themselves; 0
        where they are not, or whatever the method.
    dim : int
        Of the mesh.
    """

    n_unknowns: int
    n_cells: int
    wavelength: float
    n_ranks: int
    n_steps: int
    n_started: int = 0
    dim: int = 2

    @property
    def constants(self) -> CostConstants:
        """What its parts take."""
        return MEASURED[self.dim]

    @property
    def is_regularized(self) -> bool:
        """Whether A has the equilibrium gap, whose rows reach two cells far."""
        return self.wavelength > 0

    @property
    def n_share(self) -> float:
        """Unknowns of a rank."""
        return self.n_unknowns / self.n_ranks


@dataclass(frozen=True)
class StepCandidate:
    """A way to make them.

    Attributes
    ----------
    method : StepMethod
        As a case calls it.
    n_subdomains : int
        Into which the mesh is split.
    preconditioner : {"none", "paper", "scaled", "two_level"}
        Of the dual method's interface problem.
    """

    method: StepMethod
    n_subdomains: int
    preconditioner: Literal["none", "paper", "scaled", "two_level"] = "scaled"

    def describe(self) -> str:
        """Describe it for the log: the method, with "dual" subdomains and preconditioner."""
        if self.method != "dual":
            return self.method
        return f"dual ({self.preconditioner}, subdomains: {self.n_subdomains})"


@dataclass(frozen=True)
class StepCosts:
    """What a candidate takes.

    Attributes
    ----------
    candidate : StepCandidate
        The way.
    set_up, step : float
        Seconds of a rank before the first step, and for a step.
    n_steps : int
        Steps.
    n_iterations : float
        Krylov iterations of a step; 0 of a direct one.
    memory : float
        Bytes of a rank, M and Kbar included.
    """

    candidate: StepCandidate
    set_up: float
    step: float
    n_steps: int
    n_iterations: float
    memory: float

    @property
    def seconds(self) -> float:
        """All seconds of a rank."""
        return self.set_up + self.n_steps * self.step

    def describe(self) -> str:
        """Describe them for the log: the candidate, seconds and memory."""
        return f"{self.candidate.describe()} {self.seconds:.2g} s, {self.memory / 2**30:.2g} GiB"


def predict_costs(task: StepTask, candidate: StepCandidate) -> StepCosts:
    """Predict what a candidate takes, seconds and bytes."""
    if candidate.method == "assembled":
        return _predict_assembled(task, candidate)
    if candidate.method == "conjugate_gradient":
        return _predict_conjugate_gradient(task, candidate)
    if candidate.method == "matching":
        return _predict_matching(task, candidate, require_held(task.constants.matching))
    # The monolithic step is the factor of the only subdomain, without an interface.
    return _predict_dual(task, candidate)


def find_shared_boundary(n_subdomains: int, dim: int) -> float:
    """Find which share of the boundaries of a square's or cube's subdomains lies between two: near 1 for many."""
    return 1.0 - 1.0 / float(n_subdomains ** (1 / dim))


def _predict_assembled(task: StepTask, candidate: StepCandidate) -> StepCosts:
    """MUMPS's nested dissection."""
    n, known = task.n_unknowns, task.constants
    kind = known.whole[task.is_regularized]
    # The top of the elimination tree is no work for many.
    spread = task.n_ranks ** known.parallel_factor[task.is_regularized]
    entries = count_entries(n, task.dim)
    seconds = n * kind.seconds.evaluate(count_operations(n, task.dim)) / spread
    solve = n * known.whole_solve * entries / spread
    memory = n * kind.memory.evaluate(entries) / task.n_ranks**known.parallel_memory
    return StepCosts(candidate, seconds, solve, task.n_steps, 0.0, task.n_share * known.system_memory + memory)


def _predict_conjugate_gradient(task: StepTask, candidate: StepCandidate) -> StepCosts:
    """Iterations as the root of D^-1 A's condition number: the square of the cut-off wavelength in cells."""
    known = task.constants
    iterations = max(known.cg_iterations, known.cg_iterations_by_square * task.wavelength**2)
    n_own = -(-candidate.n_subdomains // task.n_ranks)
    of_rank, of_subdomain = known.cg_product_calls
    product = task.n_share * known.cg_product[task.is_regularized] + of_rank + n_own * of_subdomain
    return StepCosts(candidate, task.n_share * known.cg_set_up, iterations * product, task.n_steps, iterations,
                     task.n_share * known.system_memory)


def _predict_matching(task: StepTask, candidate: StepCandidate, known: MatchingCosts) -> StepCosts:
    n, iterations = task.n_share, known.n_iterations
    step = iterations * n * known.iteration.evaluate(task.wavelength)
    return StepCosts(candidate, n * known.set_up, step, task.n_steps, iterations,
                     n * (task.constants.system_memory + known.memory))


def _predict_dual(task: StepTask, candidate: StepCandidate) -> StepCosts:
    """CHOLMOD of each subdomain, S_s and its inverse, as many operations each as a factor, and few iterations."""
    n_subdomains, known = candidate.n_subdomains, task.constants
    n_own = -(-n_subdomains // task.n_ranks)
    n = task.n_unknowns / n_subdomains
    operations, entries = count_operations(n, task.dim), count_entries(n, task.dim)
    kind, alone = known.local[task.is_regularized], known.local[False]
    set_up = kind.seconds.evaluate(operations)
    memory = known.system_memory + kind.memory.evaluate(entries)
    started = 0.0
    if n_subdomains > 1:
        interface = (known.interface if n <= LARGEST_ARRAYS[task.dim] else known.sparse_interface)[task.is_regularized]
        shared = find_shared_boundary(n_subdomains, task.dim) if n <= LARGEST_ARRAYS[task.dim] else 1.0
        set_up += shared * interface.seconds.evaluate(operations)
        memory += shared * interface.memory.evaluate(entries)
        started = task.n_started / task.n_ranks * STARTED_PIXEL
        set_up += alone.seconds.evaluate(operations) if task.n_started else 0.0
    if candidate.preconditioner == "two_level":
        set_up += known.coarse_set_up.evaluate(operations)
    iterations = _count_dual_iterations(task, candidate)
    step = n_own * n * known.local_solve * entries * (1 + known.dual_product * iterations)
    return StepCosts(candidate, n_own * n * set_up + started, step, task.n_steps, iterations, n_own * n * memory)


def _count_dual_iterations(task: StepTask, candidate: StepCandidate) -> float:
    """GMRES iterations: with one level they grow with the cut-off wavelength over the side of a subdomain."""
    if candidate.n_subdomains == 1:
        return 0.0
    if candidate.preconditioner == "two_level":
        return task.constants.two_level_iterations
    side = (task.n_cells / candidate.n_subdomains) ** (1 / task.dim)
    # A wave longer than the region is as good as one of its length.
    longest = float(candidate.n_subdomains ** (1 / task.dim))
    few, by_wave = task.constants.one_level_iterations
    return float(few + by_wave * min(task.wavelength / side, longest))
