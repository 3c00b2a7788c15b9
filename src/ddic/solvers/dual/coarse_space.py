"""The coarse space of the interface problem: low-energy modes of the subdomains, seen by the interface."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc
from scipy import linalg, sparse

from ddic.arrays import Array, IntArray
from ddic.kinematics.kinematics import Kinematics
from ddic.parallel.team import Team
from ddic.solvers.dual.dual_problem import DualProblem, LocalDual
from ddic.solvers.exchange import Exchange, ParallelEntries, average_chains, fetch_copies
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.petsc import PetscOwner, PetscStack, create_coarse_ksp, to_petsc_integers

INDEPENDENT = 1e-8
"""Singular value, relative to the largest, below which a subdomain's coarse vectors count as dependent: a larger one
gives a smaller coarse space."""

SHIFT = 1e-13
"""Share of the largest diagonal entry added to (subtracted from) the diagonal of the coarse matrix for jumps
(reactions). Coarse vectors of neighbours are dependent where they add up to a continuous field (exactly so for rigid
modes); such a combination is no interface vector at all, and the shift keeps the factorisation from breaking on it. A
larger one makes the coarse solution less exact."""

FEW, MANY, MOST = 12, 18, 26
"""Modes of a subdomain whose jumps and reactions are coarse vectors: many where it is stiff, most where a neighbour's
texture is unlike its own, few elsewhere. More save iterations (docs/solver.md) and make the coarse problem larger,
which is what limits the number of subdomains."""

STIFF = 25.0
"""A subdomain is stiff where any field that is not linear costs this many times the energy of a translation, which
texture alone holds: from a cut-off wavelength of some five times its size on. Soft fields of the whole then span many
subdomains, and are found only by coarse vectors that follow them more closely."""

UNLIKE = 10.0
"""Ratio of two neighbours' mean texture, grey levels squared per pixel squared, from which on they count as unlike."""

SchurProduct = Callable[[Array], Array]
"""S_s X from X, both (n interface unknowns, k)."""


@dataclass(frozen=True)
class CoarseColumns:
    """A subdomain's coarse vectors on its own interface unknowns.

    Attributes
    ----------
    vectors : (n interface unknowns, n vectors) array
        (C_s phi, 0) of its modes phi, then (0, eta Cbar_s Kbar_s phi), each set orthonormal.
    signs : (n vectors,) array
        Sign of the coarse matrix's diagonal at each: 1 for jumps, -1 for reactions.
    """

    vectors: Array
    signs: Array


@dataclass(frozen=True)
class CoarsePart:
    """What one subdomain brings to the coarse space.

    Attributes
    ----------
    local : LocalDual
        Its interface operators.
    assembly : (n ghost rows, n interface unknowns) csc_matrix
        E_s, scaled.
    multiply_schur : callable
        From X to S_s X.
    columns : CoarseColumns
        Its coarse vectors.
    """

    local: LocalDual
    assembly: sparse.csc_matrix
    multiply_schur: SchurProduct
    columns: CoarseColumns


def find_unlike_neighbours(problem: DualProblem) -> list[bool]:
    """Find the owned regularized subdomains of which a neighbour's texture is unlike their own; collective."""
    chains = []
    for local in problem.local_duals:
        jumps = local.system.subdomain.jumps
        texture = np.log(max(local.system.hessian.diagonal().mean(), 1e-300))
        chains.append((jumps, np.full(len(jumps.unknowns), texture)))
    copies, textures = fetch_copies(problem.team, problem.subdomains, chains)
    spreads = [average_chains(jumps, copies, textures)[1] for jumps, _ in chains]
    # Texture alone is weighted as it is where the local inverses are assembled.
    return [local.system.stiffness is not None and bool((spread > np.log(UNLIKE)).any())
            for local, spread in zip(problem.local_duals, spreads, strict=True)]


def build_coarse_columns(local: LocalDual, has_unlike_neighbour: bool) -> CoarseColumns:
    """Build a subdomain's coarse vectors from its modes: their traces and reactions make separate ones."""
    polynomials = _fit_polynomials(local.system.subdomain.kinematics, MOST + _EXTRA)
    n_modes = FEW
    if has_unlike_neighbour:
        n_modes = MOST
    elif _is_stiff(local.system, polynomials):
        n_modes = MANY
    traces = local.trace @ find_soft_modes(local, polynomials, n_modes)
    of_jumps, of_reactions = (_find_basis(part) for part in np.split(traces, [local.n_jumps]))
    signs = np.repeat([1.0, -1.0], [of_jumps.shape[1], of_reactions.shape[1]])
    return CoarseColumns(np.asarray(linalg.block_diag(of_jumps, of_reactions)), signs)


def _find_basis(columns: Array) -> Array:
    """An orthonormal basis of the columns' span."""
    if columns.size == 0:
        return np.zeros((len(columns), 0))
    left, values, _ = linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, values > INDEPENDENT * values[0]])


class CoarseSpace(PetscOwner):
    """Z and the factorised coarse matrix Z^T S_tot Z, sparse and spread over ranks.

    PETSc options (prefix ``coarse_telescope_``): some ranks factorise the coarse matrix by MUMPS (LDL^T, indefinite).

    Parameters
    ----------
    team : Team
        All ranks; they make it together.
    exchange : Exchange
        Of interface rows.
    parts : sequence of CoarsePart
        This rank's subdomains.
    """

    def __init__(self, team: Team, exchange: Exchange, parts: Sequence[CoarsePart]) -> None:
        signs = np.concatenate([np.zeros(0), *(part.columns.signs for part in parts)])
        with PetscStack() as stack:
            self._z = stack.keep(_assemble_z(team, exchange, parts, len(signs)))
            products = self._multiply(team, exchange, parts, len(signs))
            self._ksp = stack.keep(self._factorize(team, products, signs))
            self._right = stack.keep(self._z.createVecRight())
            self._left = stack.keep(self._z.createVecRight())
            self._objects = stack.pop_all()

    @property
    def size(self) -> int:
        """Number of coarse vectors."""
        return int(self._z.getSize()[1])

    def correct(self, residual: PETSc.Vec, result: PETSc.Vec) -> None:
        """Add Z (Z^T S_tot Z)^-1 Z^T r to a result, both of interface rows; collective."""
        self._z.multTranspose(residual, self._right)
        self._ksp.solve(self._right, self._left)
        self._z.multAdd(self._left, result, result)

    def _multiply(self, team: Team, exchange: Exchange, parts: Sequence[CoarsePart], n_owned: int) -> ParallelEntries:
        """Z^T S_tot Z as the sum over subdomains of products with the columns that touch their interface."""
        products = ParallelEntries(team, n_owned, n_owned)
        touched, z_ghost = _fetch_rows(self._z, exchange.ghosts)
        for part in parts:
            z_local = (part.local.incidence.T @ z_ghost).tocsc()
            present = np.flatnonzero(np.diff(z_local.indptr))
            z_dense = z_local[:, present].toarray()
            products.add(touched[present], touched[present], z_dense.T @ part.multiply_schur(z_dense))
        return products

    @staticmethod
    def _factorize(team: Team, products: ParallelEntries, signs: Array) -> PETSc.KSP:
        """The coarse matrix, its diagonal shifted by the signs, factorised."""
        with PetscStack() as temporary, PetscStack() as stack:
            matrix = temporary.keep(products.create_matrix())
            diagonal = temporary.keep(matrix.getDiagonal())
            largest = diagonal.norm(PETSc.NormType.INFINITY)
            diagonal.setArray(diagonal.getArray() + SHIFT * largest * signs)
            matrix.setDiagonal(diagonal)
            matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            ksp = stack.keep(create_coarse_ksp(team.comm, matrix.getSize()[0]))
            # The solver holds the matrix from here on.
            ksp.setOperators(matrix)
            ksp.setFromOptions()
            ksp.setUp()
            stack.pop_all()
            return ksp


def _assemble_z(team: Team, exchange: Exchange, parts: Sequence[CoarsePart], n_owned: int) -> PETSc.Mat:
    """Z: all subdomains' coarse vectors, of which this rank owns some, on interface rows."""
    entries = ParallelEntries(team, exchange.n_owned, n_owned)
    first = team.offset(n_owned)
    for part in parts:
        touched = np.unique(part.assembly.tocoo().row)
        block = part.assembly[touched] @ part.columns.vectors
        columns = first + np.arange(block.shape[1])
        entries.add(exchange.ghosts[touched], columns, block)
        first += len(columns)
    return entries.create_matrix()


def _fetch_rows(matrix: PETSc.Mat, rows: IntArray) -> tuple[IntArray, sparse.csr_matrix]:
    """Rows of a parallel matrix that this rank asks for: the columns that occur, and the rows on these columns."""
    with PetscStack() as stack:
        numbers = to_petsc_integers(rows, "rows of the interface")
        wanted = stack.keep(PETSc.IS().createGeneral(numbers, comm=matrix.getComm()))
        part = stack.keep(matrix.createSubMatrix(wanted))
        indptr, indices, values = (np.array(a) for a in part.getValuesCSR())
    touched, columns = np.unique(indices, return_inverse=True)
    fetched = sparse.csr_matrix((values, columns.reshape(-1), indptr), shape=(len(rows), len(touched)))
    return touched.astype(np.int64), fetched


_SWEEPS = 2
"""Inverse iterations: more bring the block nearer to the eigenvectors, each for a solve with all its columns."""

_EXTRA = 4
"""Vectors beyond those wanted, which make the iteration converge faster."""


def find_soft_modes(local: LocalDual, polynomials: Array, n_modes: int) -> Array:
    """Find fields that move a subdomain's interface at the least energy, softest first: (n_field, n_modes or fewer).

    They solve T^T T phi = mu A_s phi, T the trace on unknowns with jumps, for the largest mu: what a force on the
    interface moves most, and T phi the eigenvectors of the jumps' block of S_s. Block inverse iteration from
    polynomials needs a few sweeps: smooth fields are nearly the modes sought, and a coarse space needs their span, not
    each of them. ``polynomials`` are (n_field, n_modes + _EXTRA or more).
    """
    # More modes than half the interface unknowns would make the coarse problem the interface problem.
    n_wanted = min(n_modes, max(local.n_jumps // 2, 1))
    trace = local.trace[:local.n_jumps]
    block = polynomials[:, :min(n_wanted + _EXTRA, len(polynomials))]
    for _ in range(_SWEEPS):
        block = local.operator.solve_many(trace.T @ (trace @ _orthonormalize(block)))
    block = _orthonormalize(block)
    moved = trace @ block
    rotation = linalg.eigh(moved.T @ moved, _multiply_energies(local.system, block))[1]
    return np.asarray(block @ rotation[:, :-n_wanted - 1:-1])


def _multiply_energies(system: LocalSystem, fields: Array) -> Array:
    """fields^T A_s fields, (k, k), without A_s."""
    energies = fields.T @ (system.hessian @ fields)
    if system.controlled_stiffness is not None:
        forces = system.controlled_stiffness @ fields
        energies += system.eta * (forces.T @ forces)
    return np.asarray(energies)


def _fit_polynomials(kinematics: Kinematics, n: int) -> Array:
    """Unknowns that fit n polynomials of rising degree in each component, (n_field, n)."""
    nodes = kinematics.mesh.nodes
    centred = nodes - nodes.mean(axis=0)
    x = centred / max(float(np.abs(centred).max()), 1e-300)
    dim = kinematics.mesh.dim
    fitted = np.empty((kinematics.n_unknowns, n))
    fields = [(exponents, component) for exponents in _list_exponents(dim, n) for component in range(dim)]
    for column, (exponents, component) in enumerate(fields[:n]):
        field = np.zeros(nodes.shape)
        field[:, component] = np.prod(x ** np.array(exponents), axis=1)
        fitted[:, column] = kinematics.fit(field.ravel())
    return fitted


def _is_stiff(system: LocalSystem, polynomials: Array) -> bool:
    """Whether the softest polynomial beyond the linear ones costs STIFF times the energy of a translation."""
    if system.controlled_stiffness is None:
        return False
    squares = (polynomials**2).sum(axis=0)
    forces = system.controlled_stiffness @ polynomials
    # Those at the interface are the cut's: the finer the elements, the larger.
    forces[system.subdomain.reactions.unknowns] = 0.0
    gaps = system.eta * (forces**2).sum(axis=0) / squares
    textures = (polynomials * (system.hessian @ polynomials)).sum(axis=0) / squares
    dim = system.subdomain.mesh.dim
    n_linear = dim * (dim + 1)
    return bool(gaps[n_linear:].min() > STIFF * textures[:dim].min())


def _list_exponents(dim: int, n: int) -> list[tuple[int, ...]]:
    """Exponents of at least n / dim monomials, lowest degree first."""
    found: list[tuple[int, ...]] = []
    degree = 0
    while dim * len(found) < n:
        found += [e for e in np.ndindex(*(degree + 1,) * dim) if sum(e) == degree]
        degree += 1
    return found


def _orthonormalize(block: Array) -> Array:
    """An orthonormal basis of the columns, (n, k)."""
    return np.asarray(linalg.qr(block, mode="economic")[0])
