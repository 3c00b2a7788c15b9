"""Steps that solve for dq of the whole region, Eq. 11 of [BP17]: by a Cholesky spread over ranks, or A never formed.

A = M + eta Kbar^T Kbar is a sum over the subdomains' parts. Conjugate gradients need no more than its products.
"""

from collections.abc import Callable, Sequence

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from ddic.arrays import Array, IntArray
from ddic.errors import ConvergenceError, FactorizationError, SingularSubdomainError, as_collective
from ddic.functionals.regularization import scale_rows, sum_column_squares
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.solvers.correction_size import measure_unit_size
from ddic.solvers.exchange import Exchange, ParallelEntries
from ddic.solvers.linear_step import AllowedError, StepResult
from ddic.solvers.local_system import LocalSystem, bound_lowest_eigenvalue, describe_singular
from ddic.solvers.petsc import ASSEMBLED, CONJUGATE_GRADIENT, PetscOwner, PetscStack, create_ksp


class WholeSystem(PetscOwner):
    """A = sum_s R_s^T M_s R_s + eta Kbar^T Kbar with Kbar = sum_s R_s^T Kbar_s R_s.

    R_s takes a subdomain's unknowns (of the field, and of its camera's motion) from those of the whole problem, which
    are numbered rank by rank. Vectors of values "here" are on all unknowns that this rank's subdomains have, (n_here,).

    Parameters
    ----------
    team, systems : Team, sequence of LocalSystem
        All ranks, which make it together; this rank's subdomains.

    Attributes
    ----------
    numbers : list of (n_unknowns,) arrays of int64
        Numbers of each subdomain's unknowns, rank by rank.
    n_owned : int
        How many of them this rank owns.
    exchange : Exchange
        Of values by these numbers.
    rows : list of EquilibriumRows
        Kbar_s whose rows add up to those of Kbar.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem]) -> None:
        self.systems = systems
        self._team = team
        with PetscStack() as stack:
            self._subdomains = [system.subdomain for system in systems]
            self.numbers, self.n_owned = _number_by_rank(team, self._subdomains)
            self.exchange = stack.keep(Exchange(team, self.n_owned, self.numbers))
            self._places = [np.searchsorted(self.exchange.ghosts, n) for n in self.numbers]
            self.rows = [EquilibriumRows(system) for system in systems]
            self._multiplicity = self.sum_over_subdomains([np.ones(len(n)) for n in self.numbers])
            self._objects = stack.pop_all()

    def average_copies(self, q: Field) -> Field:
        """Average what subdomains say of each unknown; collective."""
        return self.restrict(self.sum_over_subdomains(q) / self._multiplicity)

    def restrict(self, here: Array) -> Field:
        """Give each owned subdomain the values of its unknowns from those here."""
        return Field(self._team, self._subdomains, [here[places] for places in self._places])

    def add_up(self, values: Sequence[Array]) -> Array:
        """Add up values of each owned subdomain, (n_unknowns,), over this rank's subdomains: sums here, (n_here,)."""
        total = np.zeros(len(self.exchange.ghosts))
        for places, values_s in zip(self._places, values, strict=True):
            total[places] += values_s
        return total

    def sum_over_subdomains(self, values: Sequence[Array]) -> Array:
        """Add up values of each owned subdomain over the subdomains of all ranks: sums here, (n_here,); collective."""
        return self.exchange.sum_over_ranks(self.add_up(values))

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply y = A x: PETSc's callback, where this is the context of a shell matrix."""
        x_here = self.restrict(self.exchange.fetch_ghosts(x))
        gap = self._find_gap(x_here)
        products = []
        for system, rows, x_s, gap_s in zip(self.systems, self.rows, x_here, gap, strict=True):
            of_gap = system.eta * rows.multiply_transposed(gap_s)
            products.append(system.hessian @ x_s + of_gap)
        self.exchange.add_to_owners(self.add_up(products), y)

    def getDiagonal(self, _: PETSc.Mat, diagonal: PETSc.Vec) -> None:
        """Set a vector to A's diagonal, rows of Kbar on interfaces squared one by one, as is enough to precondition."""
        of_systems = [system.hessian.diagonal() + system.eta * rows.sum_squares()
                      for system, rows in zip(self.systems, self.rows, strict=True)]
        self.exchange.add_to_owners(self.add_up(of_systems), diagonal)

    def set_right_hand_side(self, right: PETSc.Vec, q: Field, b: Field, q_mean: Field) -> None:
        """Set a vector to sum_s R_s^T (b_s + M_s (q_s - qbar_s)) - eta Kbar^T Kbar qbar; collective.

        ``q_mean`` is qbar, the one field that takes the place of copies that differ.
        """
        gap = self._find_gap(q_mean)
        parts = []
        for system, rows, b_s, change_s, gap_s in zip(self.systems, self.rows, b, q - q_mean, gap, strict=True):
            of_gap = system.eta * rows.multiply_transposed(gap_s)
            parts.append(b_s + system.hessian @ change_s - of_gap)
        self.exchange.add_to_owners(self.add_up(parts), right)

    def find_correction(self, solution: PETSc.Vec, q: Field, q_mean: Field) -> Field:
        """Find dq by which q + dq is qbar of ``set_right_hand_side`` plus the solution everywhere; collective."""
        return q_mean + self.restrict(self.exchange.fetch_ghosts(solution)) - q

    def check_diagonal(self, operator: PETSc.Mat) -> None:
        """Raise SingularSubdomainError on all ranks where nothing holds an unknown: A's diagonal is not positive."""
        with PetscStack() as stack:
            diagonal = stack.keep(self.exchange.create_vector())
            operator.getDiagonal(diagonal)
            number, lowest = diagonal.min()
        if not lowest > 0:
            raise self.describe_singular(number)

    def describe_singular(self, number: int) -> SingularSubdomainError:
        """Describe that nothing holds an unknown, by the node that it displaces most; collective.

        ``number`` is that of the unknown, rank by rank; SingularSubdomainError is to be raised on all ranks.
        """
        nodes = [_find_node(subdomain, int(unknown))
                 for subdomain, numbers in zip(self._subdomains, self.numbers, strict=True)
                 for unknown in np.flatnonzero(numbers == number)]
        node = self._team.gather_lists(nodes)[0]
        place = ", ".join(f"{axis} {at:.0f}" for axis, at in zip(("column", "row", "plane"), node, strict=False))
        return as_collective(SingularSubdomainError(describe_singular(f"the region around {place}")))

    def _find_gap(self, x: Field) -> Field:
        """Kbar x, rows of interfaces complete."""
        if all(system.stiffness is None for system in self.systems):
            return Field.zero(self._team, self._subdomains)
        forces = [rows.multiply(x_s) for rows, x_s in zip(self.rows, x, strict=True)]
        return self.restrict(self.sum_over_subdomains(forces))


def _number_by_rank(team: Team, subdomains: Sequence[Subdomain]) -> tuple[list[IntArray], int]:
    """Number the unknowns rank by rank, so that little but the interface is sent.

    An unknown belongs to its lowest subdomain. Returns each subdomain's numbers (n_unknowns,) and how many this rank
    owns.
    """
    numbers = [s.numbers for s in subdomains]
    is_owned = [s.owned for s in subdomains]
    n_owned = sum(int(owned.sum()) for owned in is_owned)
    first = team.offset(n_owned)
    # Of the numbers in the whole problem every rank owns an equal share, only to pass the new ones on.
    n_share = len(range(team.rank, team.sum(n_owned), team.size))
    with PetscStack() as stack:
        exchange = stack.keep(Exchange(team, n_share, numbers))
        owned_numbers = np.concatenate([n[owned] for n, owned in zip(numbers, is_owned, strict=True)])
        given = np.zeros(len(exchange.ghosts))
        given[np.searchsorted(exchange.ghosts, owned_numbers)] = first + np.arange(n_owned)
        everybodys = exchange.sum_over_ranks(given).astype(np.int64)
        return [everybodys[np.searchsorted(exchange.ghosts, n)] for n in numbers], n_owned


def _find_node(subdomain: Subdomain, unknown: int) -> Array:
    """The node that an unknown of a subdomain displaces most, (dim,), pixels; the first for a camera's motion."""
    nodes: Array = subdomain.mesh.nodes
    if unknown >= subdomain.n_field:
        return np.asarray(nodes[0])
    column = subdomain.kinematics.tangent[:, [unknown]].toarray().reshape(nodes.shape)
    return np.asarray(nodes[int(np.linalg.norm(column, axis=1).argmax())])


class EquilibriumRows:
    """Kbar_s without the weights of interface rows, so that its rows add up over subdomains to Kbar.

    The coupled subdomains minimise (1/m) |sum_s (Kbar_s q_s)_i|^2 at an unknown of m of them: consistent weights
    sqrt(m) make that the row of the whole region, the paper's weight 1 leaves that row over sqrt(m).
    Products take the system's own stiffness: a matrix of other rows would be as large as M.

    Parameters
    ----------
    system : LocalSystem
        Its field has Kbar_s; without regularization, all rows are empty.

    Attributes
    ----------
    factors : (n_field,) array
        Of the rows of the system's stiffness, no unit.
    """

    def __init__(self, system: LocalSystem) -> None:
        n_field, n_unknowns = system.subdomain.n_field, system.subdomain.n_unknowns
        # diag(w) T^T K T, and factors of its rows.
        self._stiffness = sparse.csr_matrix((n_field, n_unknowns)) if system.stiffness is None else system.stiffness
        self.factors = 1.0 / np.sqrt(system.subdomain.multiplicity)
        if system.projection is not None:
            self.factors = self.factors * system.projection
        # Kept: making the matrix anew takes longer than its product with a vector.
        self._transposed = self._stiffness.T

    def multiply(self, x: Array) -> Array:
        """Compute Kbar_s x, x in pixels; 0 for a camera's motion: it displaces no matter, so is in no equilibrium."""
        product = np.zeros(len(x))
        np.multiply(self.factors, self._stiffness @ x, out=product[:len(self.factors)])
        return product

    def multiply_transposed(self, gap: Array) -> Array:
        """Compute Kbar_s^T times a value of each unknown, forces, (n_unknowns,), without those of a camera's motion."""
        return np.asarray(self._transposed @ (self.factors * gap[:len(self.factors)]))

    def sum_squares(self) -> Array:
        """Sum the squares of each unknown's column: the diagonal of Kbar_s^T Kbar_s, (n_unknowns,)."""
        return sum_column_squares(self._stiffness, self.factors)

    def assemble(self) -> sparse.csr_matrix:
        """Form the square matrix, for who needs more than its products; rows of a camera's motion are zero."""
        n_field, n_unknowns = self._stiffness.shape
        no_equilibrium = sparse.csr_matrix((n_unknowns - n_field, n_unknowns))
        return sparse.vstack([scale_rows(self._stiffness, self.factors), no_equilibrium]).tocsr()


ZERO_PIVOT = -10
"""MUMPS's INFOG(1) for a matrix that is numerically singular."""


class AssembledStep(PetscOwner):
    """Solves Eq. 11 of [BP17] for all subdomains at once, by a factor of A.

    PETSc options (prefix ``assembled_``): Cholesky by MUMPS. Making it raises SingularSubdomainError or
    FactorizationError on all ranks.

    Parameters
    ----------
    team, systems : Team, sequence of LocalSystem
        All ranks, which make it together; this rank's subdomains.
    smallest_eigenvalue : float
        Below it A counts as singular, grey levels squared per pixel squared.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem], smallest_eigenvalue: float) -> None:
        with PetscStack() as stack:
            self._whole = stack.keep(WholeSystem(team, systems))
            self._matrix = stack.keep(_assemble(team, self._whole))
            self._left = stack.keep(self._whole.exchange.create_vector())
            self._right = stack.keep(self._whole.exchange.create_vector())
            self._ksp = stack.keep(create_ksp(team.comm, ASSEMBLED))
            self._factorize(team.rank, smallest_eigenvalue)
            self._objects = stack.pop_all()

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        """Solve for dq; where copies of an unknown differ in q, q + dq is one field, as of the dual step."""
        q_mean = self._whole.average_copies(q)
        self._whole.set_right_hand_side(self._right, q, b, q_mean)
        self._ksp.solve(self._right, self._left)
        return StepResult(self._whole.find_correction(self._left, q, q_mean))

    def forget(self) -> None:
        """Do nothing: no step teaches another."""

    def _factorize(self, seed: int, smallest_eigenvalue: float) -> None:
        """Factorise A and refuse it where it is singular."""
        # Not left to MUMPS, which says no more than that a pivot is zero.
        self._whole.check_diagonal(self._matrix)
        self._ksp.setOperators(self._matrix)
        self._ksp.setFromOptions()
        self._ksp.setUp()
        with PetscStack() as stack:
            factor = stack.keep(self._ksp.getPC().getFactorMatrix())
            self._check_memory(factor)
            self._left.setArray(np.random.default_rng(seed).standard_normal(self._left.getLocalSize()))
            lowest = bound_lowest_eigenvalue(factor, self._left)
        # A factor that broke down at a zero pivot solves to infinity, hence counts as singular too.
        if not lowest > smallest_eigenvalue:
            self._left.abs()
            raise self._whole.describe_singular(self._left.max()[0])

    def _check_memory(self, factor: PETSc.Mat) -> None:
        """Raise where MUMPS failed for another reason than a zero pivot."""
        if self._ksp.getPC().getFactorSolverType() != "mumps":
            return
        code = factor.getMumpsInfog(1)
        if code < 0 and code != ZERO_PIVOT:
            raise as_collective(FactorizationError(
                f"MUMPS could not factorise the assembled operator (INFOG(1) = {code}, INFOG(2) = "
                f"{factor.getMumpsInfog(2)}), most often for want of memory; start more ranks or use "
                'solver.method = "dual"'))


def _assemble(team: Team, whole: WholeSystem) -> PETSc.Mat:
    """Assemble A of Eq. 11 of [BP17]: rows of Kbar are complete before they are squared."""
    rows = ParallelEntries(team, whole.n_owned, whole.n_owned)
    entries = ParallelEntries(team, whole.n_owned, whole.n_owned)
    for system, of_system, numbers in zip(whole.systems, whole.rows, whole.numbers, strict=True):
        entries.add_sparse(numbers, numbers, system.hessian)
        rows.add_sparse(numbers, numbers, of_system.assemble())
    kbar_rows = rows.sum_owned_rows()
    touched, places = np.unique(kbar_rows.indices, return_inverse=True)
    kbar_touched = sparse.csr_matrix((kbar_rows.data, places.reshape(-1), kbar_rows.indptr),
                                     shape=(kbar_rows.shape[0], len(touched)))
    columns = touched.astype(np.int64)
    squared = (kbar_touched.T @ kbar_touched).tocsr()
    entries.add_sparse(columns, columns, whole.systems[0].eta * squared)
    matrix = entries.create_matrix()
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    return matrix


LOOK_EVERY = 4
"""Iterations between two estimates of the extreme eigenvalues: fewer estimate more often, more may iterate too long."""

OF_ALLOWED = 0.1
"""Share of the allowed error that is left: ten more iterations cost less than one more pass over the pixels. A larger
share iterates less and leaves more error."""


class ConjugateGradientStep(PetscOwner):
    """Solves Eq. 11 of [BP17] for all subdomains at once by conjugate gradients, by default preconditioned by diag(A).

    Nothing is factorised: two products with Kbar_s and one with M_s an iteration, whose number grows with the cut-off
    wavelength where another preconditioner does not prevent it. PETSc options (prefix ``cg_``): ``-cg_ksp_monitor``,
    ``-cg_ksp_type``... Making it raises SingularSubdomainError on all ranks, where an unknown is held by nothing.

    Parameters
    ----------
    team, systems : Team, sequence of LocalSystem
        All ranks, which make it together; this rank's subdomains.
    tolerance : float
        On the relative error, by |e|/|dq| <= cond(D^-1 A) |z|/|z_0| with z = D^-1 times the residual, D the
        preconditioner's operator.
    max_iterations : int
        Most iterations of one step.
    precondition : callable, optional
        Makes the context of PETSc's shell preconditioner, which is this step's to destroy; collective.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem], tolerance: float, max_iterations: int,
                 precondition: Callable[[Team, WholeSystem], PetscOwner] | None = None) -> None:
        self._tolerance = tolerance
        self._unit_size = measure_unit_size(team, [system.subdomain for system in systems])
        with PetscStack() as stack:
            self._whole = stack.keep(WholeSystem(team, systems))
            self._matrix = stack.keep(self._whole.exchange.create_matrix(self._whole))
            self._matrix.setOption(PETSc.Mat.Option.SPD, True)
            self._left = stack.keep(self._whole.exchange.create_vector())
            self._right = stack.keep(self._whole.exchange.create_vector())
            self._residual = stack.keep(self._whole.exchange.create_vector())
            self._preconditioned = stack.keep(self._whole.exchange.create_vector())
            self._ksp = stack.keep(create_ksp(team.comm, CONJUGATE_GRADIENT))
            self._configure(max_iterations)
            if precondition is not None:
                self._ksp.getPC().setType(PETSc.PC.Type.PYTHON)
                self._ksp.getPC().setPythonContext(stack.keep(precondition(team, self._whole)))
            self._ksp.setUp()
            self._objects = stack.pop_all()
        self.forget()

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        """Solve for dq, with an estimate of its error; where copies of an unknown differ in q, q + dq is one field.

        The last solution is taken up again where that helps, as it does when one step is asked for more exactly. Raises
        ConvergenceError on all ranks, where ``max_iterations`` are not enough.
        """
        q_mean = self._whole.average_copies(q)
        self._whole.set_right_hand_side(self._right, q, b, q_mean)
        size = self._preconditioned_norm(self._right)
        # What the last solution leaves of it.
        self._matrix.mult(self._left, self._residual)
        self._residual.aypx(-1.0, self._right)
        begun = self._preconditioned_norm(self._residual)
        if not begun < size:
            self._left.set(0.0)
            begun = size
        self._ksp.setConvergenceTest(self._make_test(size, begun, allowed))
        self._ksp.setConvergenceHistory(reset=True)
        self._ksp.solve(self._right, self._left)
        iterations = int(self._ksp.getIterationNumber())
        norm = float(self._ksp.getResidualNorm())
        if self._ksp.getConvergedReason() < 0:
            raise as_collective(ConvergenceError(
                f"conjugate gradients did not converge in {iterations} iterations (relative "
                f"residual {norm / (size or 1.0):.1e}): the cut-off wavelength is too long for "
                'them, or nothing holds a part of the region; use solver.method = "dual", or raise '
                "solver.max_iterations"))
        history = np.array(self._ksp.getConvergenceHistory()) / (size or 1.0)
        dq = self._whole.find_correction(self._left, q, q_mean)
        return StepResult(dq, iterations, history, self._estimate_error(norm))

    def forget(self) -> None:
        """Forget the last solution, and the bounds of the eigenvalues that earlier steps found."""
        self._left.set(0.0)
        # Of D^-1 A, from all iterations so far.
        self._largest, self._lowest = 1.0, 1.0

    def _configure(self, max_iterations: int) -> None:
        """Set up the Krylov solver."""
        self._ksp.setOperators(self._matrix)
        self._ksp.setTolerances(max_it=max_iterations)
        self._ksp.setInitialGuessNonzero(True)
        self._ksp.setComputeSingularValues(True)
        self._ksp.setConvergenceHistory(length=max_iterations + 2, reset=True)
        self._ksp.setFromOptions()
        self._whole.check_diagonal(self._matrix)

    def _preconditioned_norm(self, vector: PETSc.Vec) -> float:
        """|D^-1 vector|."""
        self._ksp.getPC().apply(vector, self._preconditioned)
        return float(self._preconditioned.norm())

    def _estimate_error(self, norm: float) -> float:
        """RMS over nodes of dq's error, pixels, from |D^-1 r|: A e = r, hence over the lowest eigenvalue of D^-1 A."""
        return norm / self._lowest * self._unit_size

    def _make_test(self, size: float, begun: float,
                   allowed: AllowedError | None) -> Callable[[PETSc.KSP, int, float], int]:
        """PETSc's test of convergence; size, begun: |D^-1 r| of the right-hand side and of the first guess."""

        def test(ksp: PETSc.KSP, iteration: int, norm: float) -> int:
            if not np.isfinite(norm):
                return int(PETSc.KSP.ConvergedReason.DIVERGED_NANORINF)
            if iteration % LOOK_EVERY:
                return 0
            if iteration:
                largest, lowest = ksp.computeExtremeSingularValues()
                self._largest = max(self._largest, largest)
                self._lowest = min(self._lowest, lowest)
            condition = self._largest / self._lowest
            if norm <= self._tolerance * size / condition:
                return int(PETSc.KSP.ConvergedReason.CONVERGED_RTOL)
            if allowed is None or iteration == 0:
                return 0
            error = OF_ALLOWED * max(allowed.rms, allowed.share * self._estimate_error(begun))
            return int(PETSc.KSP.ConvergedReason.CONVERGED_ATOL) if self._estimate_error(norm) <= error else 0

        return test
