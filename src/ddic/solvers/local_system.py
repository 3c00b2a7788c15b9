"""What one subdomain brings to the linear step, and its A_s = M_s + eta Kbar_s^T Kbar_s, factorised once, solved often.

Also whether a factorised operator is singular and what to tell of it, and why PETSc could not factorise a matrix and
what to do about it. With one subdomain its factor is the linear step on the whole mesh: the oracle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from ddic.arrays import Array
from ddic.errors import DdicError, FactorizationError, SingularSubdomainError
from ddic.functionals.regularization import scale_rows, sum_column_squares
from ddic.parallel.field import Field
from ddic.partition.subdomain import Subdomain
from ddic.solvers.linear_step import AllowedError, StepResult
from ddic.solvers.petsc import LOCAL, PetscOwner, PetscStack, create_ksp, to_petsc_integers


@dataclass(frozen=True)
class LocalSystem:
    """What a subdomain brings to the linear step.

    Attributes
    ----------
    subdomain : Subdomain
        Its unknowns and interfaces.
    hessian : (n_unknowns, n_unknowns) csr_matrix
        M_s, of the unknowns of the field and then of its camera's motion, grey levels squared per pixel squared.
    stiffness : (n_field, n_unknowns) csr_matrix or None
        diag(w) T^T K T: interface rows are weighted, columns of a motion are zero. None without regularization.
    row_weights : (n_field,) array
        Weights w of interface rows (``interface_weights``), no unit.
    eta : float
        Weight of the equilibrium gap.
    projection : (n_field,) array, optional
        Diagonal of P: how much the equilibrium of each unknown counts, 0 to 1; by default all of it.
    """

    subdomain: Subdomain
    hessian: sparse.csr_matrix
    stiffness: sparse.csr_matrix | None
    row_weights: Array
    eta: float
    projection: Array | None = None

    @cached_property
    def controlled_stiffness(self) -> sparse.csr_matrix | None:
        """Kbar_s = P diag(w) T^T K T, Eq. 9 of [BP17], (n_field, n_unknowns); None without regularization."""
        if self.stiffness is None or self.projection is None:
            return self.stiffness
        return scale_rows(self.stiffness, self.projection)

    @cached_property
    def controlled_stiffness_transposed(self) -> sparse.csc_matrix | None:
        """Kbar_s^T; making the matrix anew takes longer than its product with a vector."""
        return None if self.controlled_stiffness is None else self.controlled_stiffness.T

    @property
    def operator(self) -> sparse.csr_matrix:
        """A_s = M_s + eta Kbar_s^T Kbar_s, Eq. 32 of [BP17], (n_unknowns, n_unknowns)."""
        if self.controlled_stiffness is None:
            return self.hessian
        kbar = self.controlled_stiffness
        return (self.hessian + self.eta * (kbar.T @ kbar)).tocsr()

    @property
    def diagonal(self) -> Array:
        """Diagonal of A_s, (n_unknowns,), without the product Kbar_s^T Kbar_s."""
        of_hessian = np.asarray(self.hessian.diagonal())
        if self.stiffness is None:
            return of_hessian
        factors = np.ones(self.stiffness.shape[0]) if self.projection is None else self.projection
        return np.asarray(of_hessian + self.eta * sum_column_squares(self.stiffness, factors))

    @property
    def without_motion(self) -> LocalSystem:
        """The same with the camera's motion held: the unknowns of the field alone."""
        if self.subdomain.motion is None:
            return self
        n = self.subdomain.n_field
        hessian = self.hessian[:n, :n].tocsr()
        stiffness = None if self.stiffness is None else self.stiffness[:, :n].tocsr()
        return replace(self, hessian=hessian, stiffness=stiffness)

    @property
    def motion_columns(self) -> Array:
        """N_s = M_s R_s: what the camera's motion does to the field's equations, (n_field, n_motion)."""
        n = self.subdomain.n_field
        return np.asarray(self.hessian[:n, n:].toarray())

    @property
    def motion_block(self) -> Array:
        """R_s^T M_s R_s of the camera's motion, (n_motion, n_motion)."""
        n = self.subdomain.n_field
        return np.asarray(self.hessian[n:, n:].toarray())

    def right_hand_side(self, b: Array, q: Array) -> Array:
        """Return b_s - eta Kbar_s^T Kbar_s q_s, grey levels squared per pixel, Eq. 24a of [BP17]."""
        if self.controlled_stiffness is None:
            return b
        return np.asarray(b - self.eta * (self.controlled_stiffness_transposed @ (self.controlled_stiffness @ q)))


_PROBES = 3
"""Inverse iterations: each brings the bound nearer to the lowest eigenvalue and costs a solve."""


def bound_lowest_eigenvalue(factor: PETSc.Mat, probe: PETSc.Vec) -> float:
    """Bound the lowest eigenvalue of a symmetric positive definite matrix from above by a few inverse iterations.

    The bound is in the matrix's unit, 0 where the iterations break down. ``probe`` is random and becomes the last
    iterate.
    """
    with PetscStack() as stack:
        solution = stack.keep(probe.duplicate())
        bound = np.inf
        for _ in range(_PROBES):
            probe.normalize()
            factor.solve(probe, solution)
            size = solution.norm()
            if not np.isfinite(size):
                return 0.0
            bound = 1.0 / size
            solution.copy(probe)
        return float(bound)


_SINGULAR = ": the operator is singular"


def describe_singular(where: str) -> str:
    """Write the message, with causes and remedies, that an operator is singular; ``where`` says what it belongs to."""
    return (f"{where}{_SINGULAR}, which means that the reference image has too little texture "
            "there, or too few pixels that are neither masked nor mapped outside the deformed image; use larger "
            "elements, leave the blank part out of the mesh, or give a longer regularization.cut_off_wavelength")


def describe_lost(message: str, reason: str) -> str:
    """Give such a message another reason: not the reference image, but what a frame shows of it."""
    return f"{message.partition(_SINGULAR)[0]}{_SINGULAR}: {reason}"


OUT_OF_MEMORY = 55
"""PETSc's number of the error."""

MISSING_PACKAGE = 92
"""PETSc's number of the error."""

ZERO_PIVOT = (71, 81)
"""PETSc's numbers of the error, of LU and of Cholesky."""


def describe_failure(error: PETSc.Error, where: str) -> DdicError:
    """Describe a failure of a factorisation by an error, to be raised, that says what the user can do.

    It is a singular operator, one that is too large, a missing solver package, or what PETSc says; ``where`` says what
    the matrix belongs to.
    """
    if error.ierr in ZERO_PIVOT:
        return SingularSubdomainError(describe_singular(where))
    said = str(error).strip().splitlines()[-1].removeprefix("[0] ")
    if error.ierr == OUT_OF_MEMORY:
        return FactorizationError(f"{where}: not enough memory to factorise its operator; give more solver.subdomains, "
                                  'start more ranks, or use solver.method = "conjugate_gradient"')
    if error.ierr == MISSING_PACKAGE:
        return FactorizationError(f"{where}: PETSc was built without the solver package that is asked for ({said}); "
                                  "choose another by -local_pc_factor_mat_solver_type mumps, or petsc")
    return FactorizationError(f"{where}: its operator could not be factorised, most often for want of memory: {said} "
                              f"(PETSc's error {error.ierr}); give more solver.subdomains or start more ranks")


_BLOCK_COLUMNS = 256
"""Most columns that are solved for at a time: more gain no speed."""

_BLOCK_BYTES = 2**24
"""Most memory of such a block, bytes."""


class LocalOperator(PetscOwner):
    """Sparse Cholesky of one symmetric positive definite matrix through PETSc; free of communication.

    Making it raises SingularSubdomainError where the matrix is not positive definite, or singular to the extent of
    ``smallest_eigenvalue``, and FactorizationError where memory or a solver package is missing.

    PETSc options (prefix ``local_``): ``-local_pc_factor_mat_solver_type`` cholmod (default where PETSc has it), mumps,
    petsc.

    Parameters
    ----------
    matrix : (n, n) csr_matrix
        Symmetric.
    smallest_eigenvalue : float
        Below it the matrix counts as singular, in its own unit.
    where : str
        What to call it in the error.

    Attributes
    ----------
    n : int
        Number of unknowns.
    """

    def __init__(self, matrix: sparse.csr_matrix, *, smallest_eigenvalue: float, where: str) -> None:
        # Not left to the factorisation, which writes lines of its own about a matrix that holds nothing.
        if not (matrix.diagonal() > 0).all():
            raise SingularSubdomainError(describe_singular(where))
        self.n = int(matrix.shape[0])
        csr = (to_petsc_integers(matrix.indptr, f"{where}: entries of its operator"),
               to_petsc_integers(matrix.indices, f"{where}: unknowns"), matrix.data)
        with PetscStack() as stack, PetscStack() as temporary:
            petsc_matrix = temporary.keep(PETSc.Mat().createAIJ(matrix.shape, csr=csr, comm=PETSc.COMM_SELF))
            petsc_matrix.setOption(PETSc.Mat.Option.SPD, True)
            ksp = temporary.keep(create_ksp(PETSc.COMM_SELF, LOCAL))
            ksp.setOperators(petsc_matrix)
            ksp.setFromOptions()
            try:
                ksp.setUp()
            except PETSc.Error as error:
                raise describe_failure(error, where) from error
            # All that is kept: solves do not ask for the matrix.
            self._factor = stack.keep(ksp.getPC().getFactorMatrix())
            self._left = stack.keep(petsc_matrix.createVecLeft())
            self._right = stack.keep(petsc_matrix.createVecRight())
            self._right.setArray(np.random.default_rng(0).standard_normal(self.n))
            if not bound_lowest_eigenvalue(self._factor, self._right) > smallest_eigenvalue:
                raise SingularSubdomainError(describe_singular(where))
            self._objects = stack.pop_all()

    def solve(self, right: Array) -> Array:
        """Solve A x = right for one right-hand side, (n,)."""
        self._right.setArray(right)
        self._factor.solve(self._right, self._left)
        return np.array(self._left.getArray(readonly=1))

    @property
    def block(self) -> int:
        """Number of columns to solve for at a time: enough for speed, few enough that a block stays below 16 MiB."""
        return max(1, min(_BLOCK_COLUMNS, _BLOCK_BYTES // (8 * self.n)))

    def solve_many(self, right: Array) -> Array:
        """Solve A X = right, (n, k), a block of columns at a time; X comes in Fortran's order."""
        solution = np.empty((self.n, right.shape[1]), order="F")
        for begin in range(0, right.shape[1], self.block):
            columns = np.asfortranarray(right[:, begin: begin + self.block])
            # Whole columns in Fortran's order are contiguous: PETSc writes into the result itself.
            target = solution[:, begin: begin + self.block]
            with PetscStack() as stack:
                b = stack.keep(PETSc.Mat().createDense(columns.shape, array=columns, comm=PETSc.COMM_SELF))
                x = stack.keep(PETSc.Mat().createDense(columns.shape, array=target, comm=PETSc.COMM_SELF))
                b.assemble()
                x.assemble()
                self._factor.matSolve(b, x)
        return solution


class MonolithicStep:
    """Solves Eq. 11 of [BP17] directly; also one subdomain's independent step, where it is alone.

    Parameters
    ----------
    system : LocalSystem
        Of the only subdomain.
    operator : LocalOperator
        The factor of its A_s, which stays its maker's to destroy.
    """

    def __init__(self, system: LocalSystem, operator: LocalOperator) -> None:
        self._system = system
        self.operator = operator

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        """Solve for the only subdomain's dq; the step is direct: without an error, whatever is ``allowed``."""
        dq = self.operator.solve(self._system.right_hand_side(b[0], q[0]))
        return StepResult(q.with_parts([dq]))

    def forget(self) -> None:
        """Do nothing: no step teaches another."""

    def destroy(self) -> None:
        """Nothing to free: the factor belongs to whoever made it."""
