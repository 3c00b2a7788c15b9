"""The preconditioners of the interface problem: the block explicit inverse, Eq. 37-40 of [BP17], and one of two levels.

S_s^-1 of a subdomain is held as an array or, where it is large, as one sparse factor, S_s never formed. The two-level
preconditioner combines the scaled block inverse and a coarse space as A-DEF2. What builds the one that is asked for
stands below them.
"""

from collections.abc import Sequence
from typing import Literal, Protocol

import numpy as np
from petsc4py import PETSc
from scipy import linalg, sparse

from ddic.arrays import Array
from ddic.errors import SingularSubdomainError
from ddic.parallel.phases import PhaseClock
from ddic.partition.subdomain import scaled_incidence
from ddic.solvers.dual.coarse_space import (
    CoarseColumns,
    CoarsePart,
    CoarseSpace,
    build_coarse_columns,
    find_unlike_neighbours,
)
from ddic.solvers.dual.dual_problem import DualProblem, DualSchurOperator, LocalDual, PackedSymmetric, SumOverSubdomains
from ddic.solvers.exchange import Exchange, fetch_copies
from ddic.solvers.petsc import (
    INVERSE,
    PetscOwner,
    PetscStack,
    can_eliminate,
    create_ksp,
    eliminate,
    is_mumps_missing,
    to_petsc_integers,
)


class Preconditioning(Protocol):
    """Context of a shell preconditioner."""

    def apply(self, pc: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply y = P x to residuals x: PETSc's callback."""


class SparseInverse(PetscOwner):
    """S_s^-1 through [[A_s, -T_s^T], [-T_s, D_s]] (y, x) = (0, -r), whose x is S_s^-1 r.

    The first row gives y = A_s^-1 T_s^T x, the second then S_s x = r. With A_s eliminated what is left is -S_s, so that
    by Sylvester's law the matrix has as many negative eigenvalues as -S_s: one for each interface unknown with a jump,
    none for a reaction. That inertia is checked, as Cholesky checks the blocks of the dense inverse: raises
    SingularSubdomainError where S_s is singular.

    PETSc options (prefix ``inverse_``): factorised by MUMPS (LDL^T); another package must tell the inertia too.

    Parameters
    ----------
    local : LocalDual
        The subdomain's A_s, T_s and D_s.
    """

    def __init__(self, local: LocalDual) -> None:
        self._n_field = local.operator.n
        with PetscStack() as stack:
            saddle_point = stack.keep(_build_saddle_point(local))
            ksp = stack.keep(create_ksp(PETSc.COMM_SELF, INVERSE))
            ksp.setOperators(saddle_point)
            ksp.setFromOptions()
            self._left = stack.keep(saddle_point.createVecLeft())
            self._right = stack.keep(saddle_point.createVecRight())
            self._right.set(0.0)
            # A failure here is one of memory, hence PETSc's own error: MUMPS goes on past null pivots and counts them.
            ksp.setUp()
            self._factor = stack.keep(ksp.getPC().getFactorMatrix())
            self._check_inertia(local.n_jumps)
            self._objects = stack.pop_all()

    def _check_inertia(self, n_negative: int) -> None:
        """Raise SingularSubdomainError where the factor has not so many negative eigenvalues, or some that are zero."""
        if self._factor.getInertia()[:2] != (n_negative, 0):
            raise SingularSubdomainError(SINGULAR_INTERFACE)

    def apply(self, r: Array) -> Array:
        """Apply S_s^-1 to r, (n interface unknowns,)."""
        self._right.getArray()[self._n_field:] = -r
        self._factor.solve(self._right, self._left)
        return np.array(self._left.getArray(readonly=1)[self._n_field:])


SINGULAR_INTERFACE = ("the interface problem of a subdomain is singular to rounding; use larger subdomains, or a "
                      "shorter regularization.cut_off_wavelength")


def _build_saddle_point(local: LocalDual) -> PETSc.Mat:
    """The upper triangle of [[A_s, -T_s^T], [-T_s, D_s]] as PETSc's symmetric matrix."""
    n = len(local.compliance)
    # Unknowns with jumps have zeros in D_s, which must be stored: PETSc wants all diagonal entries.
    corner = sparse.csr_matrix((local.compliance, (np.arange(n), np.arange(n))), shape=(n, n))
    matrix = sparse.triu(local.system.operator, format="csr")
    upper = sparse.bmat([[matrix, -local.trace.T], [None, corner]], format="csr")
    upper.sort_indices()
    csr = (to_petsc_integers(upper.indptr, "entries of a subdomain's interface problem"),
           to_petsc_integers(upper.indices, "unknowns of a subdomain's interface problem"), upper.data)
    return PETSc.Mat().createSBAIJ(upper.shape, 1, csr=csr, comm=PETSc.COMM_SELF)


SINGULAR_PIVOT = 1e-14
"""Pivot of Cholesky, relative to the diagonal entry that it is what is left of, below which it is rounding: some tens
of the precision of a number."""


ELIMINATED_FROM = 256
"""Interface unknowns, a subdomain of 16 x 16 cells, from which on eliminating A_s takes less time than solving with it
for each of them: MUMPS's own set-up takes a millisecond."""


def assemble_schur(local: LocalDual) -> Array:
    """Assemble S_s = T_s A_s^-1 T_s^T - D_s of one subdomain, symmetric, Eq. 36 of [BP17].

    With A_s eliminated from the saddle point of ``SparseInverse``, -S_s is left: of large subdomains in a third of the
    time of as many solves with A_s as there are interface unknowns.
    """
    if can_eliminate() and len(local.compliance) >= ELIMINATED_FROM:
        with PetscStack() as stack:
            return -eliminate(stack.keep(_build_saddle_point(local)), local.operator.n)
    schur = local.multiply_schur(np.eye(len(local.compliance)))
    return np.asarray(0.5 * (schur + schur.T))


def invert_by_blocks(schur: Array, n_jumps: int) -> Array:
    """Invert S_s by blocks, Eq. 38-40 of [BP17] with the misprints of Eq. 38 put right.

    With a = S^ll, of size ``n_jumps``, b = S^l(lbar), d = S^(lbar)(lbar) - b^T a^-1 b the inverse is
    [[a^-1 + a^-1 b d^-1 b^T a^-1, -a^-1 b d^-1], [-d^-1 b^T a^-1, d^-1]]; a and -d are positive definite. Raises
    SingularSubdomainError where a or -d is not, to rounding.
    """
    n = n_jumps
    a_inverse = _invert_definite(schur[:n, :n])
    if n == len(schur):
        return a_inverse
    b = schur[:n, n:]
    ab = a_inverse @ b
    d_inverse = -_invert_definite(b.T @ ab - schur[n:, n:])
    out = np.empty_like(schur)
    out[:n, n:] = -ab @ d_inverse
    out[n:, :n] = out[:n, n:].T
    out[:n, :n] = a_inverse - out[:n, n:] @ ab.T
    out[n:, n:] = d_inverse
    return out


def _invert_definite(matrix: Array) -> Array:
    """The inverse of a symmetric positive definite matrix; raises SingularSubdomainError."""
    # LAPACK prints that it is given none.
    if not len(matrix):
        return matrix
    try:
        factor = linalg.cho_factor(matrix, lower=True)
    except linalg.LinAlgError as error:
        raise SingularSubdomainError(SINGULAR_INTERFACE) from error
    # Whether the pivot of a null vector comes out negative is rounding's choice.
    pivots = factor[0].diagonal() ** 2
    if (pivots <= SINGULAR_PIVOT * matrix.diagonal()).any():
        raise SingularSubdomainError(SINGULAR_INTERFACE)
    # A third of the operations that the columns of the identity would take; only one triangle is written.
    inverse, _ = linalg.lapack.dpotri(factor[0], lower=True)
    below = np.tril(inverse, -1)
    return np.asarray(below + below.T + np.diag(inverse.diagonal()))


LocalInverse = PackedSymmetric | SparseInverse
"""S_s^-1 of one subdomain."""


class DualPreconditioner:
    """Context of PETSc's shell preconditioner: P r = sum_s B_s S_s^-1 B_s^T r, Eq. 37 of [BP17].

    Parameters
    ----------
    exchange : Exchange
        Of interface rows.
    assemblies : sequence of (n ghost rows, n interface unknowns) csc_matrix
        B_s of each of this rank's subdomains: signed incidence, or its scaled version.
    inverses : sequence of LocalInverse
        S_s^-1 of each.
    """

    def __init__(self, exchange: Exchange, assemblies: Sequence[sparse.csc_matrix],
                 inverses: Sequence[LocalInverse]) -> None:
        self._exchange = exchange
        self.inverses = inverses
        self._sum = SumOverSubdomains(assemblies, inverses)

    def apply(self, _: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply y = P x to residuals x: PETSc's callback."""
        self._exchange.add_to_owners(self.apply_own(self._exchange.fetch_ghosts(x)), y)

    applyTranspose = apply

    def apply_own(self, r: Array) -> Array:
        """Sum B_s S_s^-1 B_s^T r, (n ghost rows,), over this rank's subdomains; free of communication."""
        return self._sum.apply(r)


LocalInverseKind = Literal["auto", "dense", "sparse"]

DENSE_ARRAYS = 5
"""Arrays of the size of S_s at the peak of the dense way: S_s, its inverse, and those of ``invert_by_blocks``."""

DENSE_LIMIT = 2**26
"""Bytes that the dense way of one subdomain may take: 1295 interface unknowns, some 80 x 80 elements with neighbours
all round. bench/local_inverse.py finds the array faster in an iteration and slower to set up at 50 x 50 and 100 x 100
elements, with the same memory within 30 MiB; the limit lies between, where several subdomains a rank stay cheap."""


def is_dense(n_interface: int, kind: LocalInverseKind) -> bool:
    """Tell whether S_s and its inverse are to be arrays: always without MUMPS, which makes the sparse factor."""
    if kind == "auto":
        if is_mumps_missing(INVERSE):
            return True
        return 8 * DENSE_ARRAYS * n_interface**2 <= DENSE_LIMIT
    return kind == "dense"


def build_schur_pair(local: LocalDual, kind: LocalInverseKind) -> tuple[PackedSymmetric | None, LocalInverse]:
    """Build S_s, and its inverse, as arrays, or of the inverse alone a sparse factor; "auto" asks their size.

    The inverse is the caller's to destroy. As an array it is of single precision: a preconditioner needs no more, as
    long as the Krylov solver forms solutions from what it was given (FGMRES does, GMRES would apply it once more in the
    end). Raises SingularSubdomainError where S_s is singular.
    """
    if not is_dense(len(local.compliance), kind):
        return None, SparseInverse(local)
    schur = assemble_schur(local)
    inverse = invert_by_blocks(schur, local.n_jumps)
    return PackedSymmetric(schur), PackedSymmetric(inverse.astype(np.float32))


class TwoLevelPreconditioner:
    """Context of PETSc's shell preconditioner: y = (I - Q S) P r + Q r, Q = Z (Z^T S Z)^-1 Z^T (A-DEF2).

    One application is one of P, one of S and one coarse solve. S Z, which would save the product, takes more memory
    than all of the rest, and as much time.

    Parameters
    ----------
    operator, one_level, coarse : DualSchurOperator, DualPreconditioner, CoarseSpace
        S, P and Q.
    """

    def __init__(self, operator: DualSchurOperator, one_level: DualPreconditioner, coarse: CoarseSpace) -> None:
        self._operator = operator
        self._one_level = one_level
        self._coarse = coarse

    def apply(self, pc: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply y = P x + Q (x - S P x) to residuals x: PETSc's callback."""
        self._one_level.apply(pc, x, y)
        with PetscStack() as stack:
            left = stack.keep(x.duplicate())
            self._operator.mult(None, y, left)
            left.aypx(-1.0, x)
            self._coarse.correct(left, y)


class MotionPreconditioner(PetscOwner):
    """Context of PETSc's shell preconditioner for [[S, B], [B^T, -D]] (Lambda, alpha), from P for S alone.

    alpha = (B^T P B + D)^-1 (B^T P r - r_alpha), Lambda = P (r - B alpha): exact where P = S^-1. The rows of alpha are
    the last ones, all on one rank; P takes and gives zeros there.

    Parameters
    ----------
    operator : DualSchurOperator
        Is applied to alpha's columns here, by all ranks together.
    inner : Preconditioning
        P, likewise.
    n_motion : int
        Number of unknowns alpha of all set-ups.
    """

    def __init__(self, operator: DualSchurOperator, inner: Preconditioning, n_motion: int) -> None:
        self._team = operator.exchange.team
        self._inner = inner
        self._n = n_motion
        columns, products, block = [], [], []
        with PetscStack() as stack:
            unit, column, solved, self._right = (stack.keep(operator.exchange.create_vector()) for _ in range(4))
            self._here = _find_last_rows(unit, n_motion)
            for alpha in np.eye(n_motion):
                unit.set(0.0)
                self._put(unit, alpha)
                operator.mult(None, unit, column)
                block.append(-self._take(column))
                self._put(column, np.zeros(n_motion))
                inner.apply(None, column, solved)
                columns.append(np.array(column.getArray()))
                products.append(np.array(solved.getArray()))
            self._columns = np.stack(columns, axis=1)
            self._products = np.stack(products, axis=1)
            self._small = self._team.sum(self._columns.T @ self._products) + np.stack(block, axis=1)
            self._objects = stack.pop_all()

    def apply(self, pc: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the preconditioner to x = (r, r_alpha), which gives y = (Lambda, alpha): PETSc's callback."""
        given = self._take(x)
        x.copy(self._right)
        self._put(self._right, np.zeros(self._n))
        self._inner.apply(pc, self._right, y)
        projected = self._team.sum(self._columns.T @ y.getArray(readonly=1))
        alpha = np.linalg.solve(self._small, projected - given)
        y.setArray(y.getArray(readonly=1) - self._products @ alpha)
        self._put(y, alpha)

    def _take(self, vector: PETSc.Vec) -> Array:
        """Alpha's rows of a vector, on all ranks; collective."""
        mine = np.zeros(self._n)
        if self._here is not None:
            mine[:] = vector.getArray(readonly=1)[self._here]
        return self._team.sum(mine)

    def _put(self, vector: PETSc.Vec, values: Array) -> None:
        """Overwrite alpha's rows of a vector."""
        if self._here is not None:
            vector.getArray()[self._here] = values


def _find_last_rows(vector: PETSc.Vec, n: int) -> slice | None:
    """Where this rank holds the last n rows of a vector; None where another rank does."""
    first, end = vector.getOwnershipRange()
    begin = vector.getSize() - n
    return slice(begin - first, end - first) if end > begin else None


Preconditioner = Literal["none", "paper", "scaled", "two_level"]

OF_COLUMNS = 0.3
"""Share of the set-up that the coarse vectors take, a guess for what shows progress."""


def build_preconditioner(stack: PetscStack, problem: DualProblem, kind: Preconditioner,
                         local_inverse: LocalInverseKind, clock: PhaseClock | None = None,
                         ) -> tuple[Preconditioning | None, CoarseSpace | None]:
    """Build the preconditioner that is asked for, and the coarse space of one of two levels; collective.

    Rows of cameras' motions are eliminated; ``stack`` keeps what must be destroyed. Raises SingularSubdomainError on
    all ranks.
    """
    if kind == "none":
        return None, None
    clock = clock or PhaseClock()
    locals_ = problem.local_duals
    assemblies = [local.incidence for local in locals_] if kind == "paper" else _scale_assemblies(problem)
    # Before the inverses: what finds the modes is large, and gone when these are made.
    columns = _find_columns(problem, clock) if kind == "two_level" else []

    def build_pairs() -> list[tuple[PackedSymmetric | None, LocalInverse]]:
        pairs = []
        for local in clock.note_each(locals_):
            schur, inverse = build_schur_pair(local, local_inverse)
            # One by one: where a later one is singular, those before are freed.
            pairs.append((schur, stack.keep(inverse)))
        return pairs

    pairs = problem.team.together(build_pairs)
    arrays = [schur for schur, _ in pairs if schur is not None]
    if len(arrays) == len(locals_) and not problem.n_motion:
        problem.operator.set_arrays(arrays)
    one_level = DualPreconditioner(problem.exchange, assemblies, [inverse for _, inverse in pairs])
    context: Preconditioning = one_level
    coarse = None
    if kind == "two_level":
        parts = [CoarsePart(local, assembly, local.multiply_schur if schur is None else schur.apply_to_columns,
                            columns_s)
                 for local, assembly, (schur, _), columns_s in zip(locals_, assemblies, pairs, columns, strict=True)]
        coarse = stack.keep(CoarseSpace(problem.team, problem.exchange, parts))
        context = TwoLevelPreconditioner(problem.operator, one_level, coarse)
    if problem.n_motion:
        context = stack.keep(MotionPreconditioner(problem.operator, context, problem.n_motion))
    return context, coarse


def _find_columns(problem: DualProblem, clock: PhaseClock) -> list[CoarseColumns]:
    """Coarse vectors of each owned subdomain; collective."""
    unlike = find_unlike_neighbours(problem)
    return problem.team.together(lambda: [
        build_coarse_columns(local, is_unlike)
        for local, is_unlike in zip(clock.note_each(problem.local_duals, end=OF_COLUMNS), unlike, strict=True)])


def _scale_assemblies(problem: DualProblem) -> list[sparse.csc_matrix]:
    """(B D^-1 B^T)^-1 B D^-1 per subdomain, D the copies' stiffness diag A_s (1 for reactions)."""
    chains = []
    for local in problem.local_duals:
        jumps, reactions = local.system.subdomain.jumps, local.system.subdomain.reactions
        stiffness = local.system.diagonal[jumps.unknowns]
        chains.append([(jumps, stiffness), (reactions, np.ones(len(reactions.unknowns)))])
    copies, weights = fetch_copies(problem.team, problem.subdomains, [pair for both in chains for pair in both])
    rows = problem.exchange.ghosts
    return [sparse.hstack([scaled_incidence(interface, weights, copies, rows) for interface, _ in both], format="csc")
            for both in chains]
