"""A preconditioner for A = M + eta Kbar^T Kbar whose iterations hardly grow with the cut-off wavelength.

It matches A by the square of an operator of second order, as Pearson & Wathen (2012) do in optimal control:
|sqrt(eta) K x|^2 + |D x|^2 and |sqrt(eta) K x + D x|^2 differ by a factor of two at most where D^2 is M, here its
lumped blocks of nodes. On controlled unknowns B = sqrt(eta) K + D is inverted by Chebyshev's polynomial, nearly: what
it leaves of B x counts, not of x, which is why cycles of multigrid in its place take more iterations. What is left are
the others, c for controlled and b for those at loaded edges: with x_c = E x_b = -B^-1 sqrt(eta) K_cb x_b, which decays
inwards over the cut-off wavelength, the energy is

    |w|^2 + x_b^T S x_b,   S = M_bb + 2 (D E)^T D E,   w = B x_c + sqrt(eta) K_cb x_b.

S is a function of the surface's mass: with N = D_b^-1 M_bb D_b^-1, D_b^2 what M_bb lumps to, whose eigenvalue 1 belongs
to smooth fields and 0 to rough ones, (D E)^T D E is near D_b ROUGH / (1 - N + ROUGH / t) D_b, t that of a translation.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import acosh, ceil

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from ddic.arrays import Array, BoolArray
from ddic.parallel.team import Team
from ddic.solvers.exchange import ParallelEntries
from ddic.solvers.petsc import PetscOwner, PetscStack
from ddic.solvers.whole_system import WholeSystem

LEFT = 0.3
"""What the polynomial leaves of forces on controlled unknowns, times the condition number of B: rough forces that it
leaves of smooth ones count as much more. A larger value takes iterations, a smaller one products."""

LOWEST = 4.0
"""Eigenvalue of B over its diagonal from which on the polynomial inverts it, over that of a translation: a region held
at its edges has few below."""

N_POWERS, ABOVE = 20, 1.1
"""Products with B from which its largest eigenvalue is told, and how far above what they tell it may be."""

ROUGH = 0.1
"""(D E)^T D E of fields that are rough along the surface. Half and twice as much change the iterations by a tenth."""

DEGREE = 5
"""Of the polynomial of N whose square is S^-1. A larger one is nearer, for a product with the surface's mass each."""

LEAST = 0.1
"""Eigenvalue of a node's block, relative to the mean of all, up to which it is raised: where a mask leaves no texture D
would be singular, and far from what holds such a node in A. With 0.3 a region without a mask takes a fifth more
iterations, with 0.001 one whose surface is masked takes ten times as many, or does not converge."""


class MatchingPreconditioner(PetscOwner):
    """Context of PETSc's shell preconditioner, symmetric and positive definite.

    Parameters
    ----------
    team, whole : Team, WholeSystem
        All ranks, which make it together; A, regularized, of unknowns that all displace nodes.
    """

    def __init__(self, team: Team, whole: WholeSystem) -> None:
        self._team, self._whole = team, whole
        subdomains = [system.subdomain for system in whole.systems]
        self._dim = subdomains[0].mesh.dim
        with PetscStack() as stack:
            self._given, self._result = (stack.keep(whole.exchange.create_vector()) for _ in range(2))
            self._controlled = self._add_up(s.controlled / s.multiplicity for s in subdomains) > 0.5
            self._coupling = stack.keep(self._cut_stiffness(columns_controlled=False).create_matrix())
            texture = self._measure_texture()
            root = find_roots(self._lump(self._controlled), texture)
            self._operator = stack.keep(self._assemble_operator(root))
            self._work = [stack.keep(self._operator.createVecRight()) for _ in range(4)]
            self._inverse_diagonal = stack.keep(self._operator.createVecRight())
            self._operator.getDiagonal(self._inverse_diagonal)
            self._interval = self._find_interval(root, self._inverse_diagonal.getArray())
            self._inverse_diagonal.reciprocal()
            surface_root = find_roots(self._lump(~self._controlled), texture)
            self._surface_scale = np.linalg.inv(surface_root)
            self._surface_mass = stack.keep(self._assemble_surface_mass())
            self._coefficients = find_polynomial(self._measure_extension(root, surface_root))
            self._objects = stack.pop_all()

    def apply(self, _: PETSc.PC, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Set the solution to the displacement of least energy under these forces: PETSc's callback."""
        forces = np.array(right.getArray(readonly=1))
        w = self._solve_inside(np.where(self._controlled, forces, 0.0))
        self._given.setArray(w)
        self._coupling.multTranspose(self._given, self._result)
        surface = self._solve_surface(np.where(self._controlled, 0.0, forces - self._result.getArray()))
        solution.setArray(self._solve_inside(w - self._multiply(self._coupling, surface)) + surface)

    def _solve_inside(self, forces: Array) -> Array:
        """B^-1 times forces on controlled unknowns, nearly; the others' are 0 and stay so."""
        lowest, highest = self._interval
        middle, half = (highest + lowest) / 2, (highest - lowest) / 2
        # PETSc's vectors, in place: with arrays they take half as long as the products.
        rest, step, solution, product = self._work
        rest.setArray(forces)
        step.pointwiseMult(self._inverse_diagonal, rest)
        step.scale(1 / middle)
        step.copy(solution)
        ratio = half / middle
        for _ in range(self._degree):
            self._operator.mult(step, product)
            rest.axpy(-1.0, product)
            before, ratio = ratio, 1 / (2 * middle / half - ratio)
            product.pointwiseMult(self._inverse_diagonal, rest)
            step.axpby(2 * ratio / half, before * ratio, product)
            solution.axpy(1.0, step)
        return np.array(solution.getArray())

    @property
    def _degree(self) -> int:
        """Of the polynomial: as the root of the condition number, hence as the cut-off wavelength over the elements."""
        lowest, highest = self._interval
        left = LEFT * lowest / highest
        return ceil(acosh(1 / left) / acosh((highest + lowest) / (highest - lowest))) - 1

    def _find_interval(self, root: Array, diagonal: Array) -> tuple[float, float]:
        """Smallest and largest eigenvalue of B over its diagonal, about: of a translation, and by powers."""
        diagonals = np.array([np.trace(root, axis1=1, axis2=2)[self._controlled[::self._dim]].sum(),
                              diagonal[self._controlled].sum()])
        of_texture, of_all = self._team.ordered_sum([diagonals])
        if of_all == 0:
            # Nothing is controlled, and only zeros are given.
            return 1.0, 2.0
        values = np.random.default_rng(self._team.rank).standard_normal(len(self._controlled)) * self._controlled
        energies = np.array([0.0, 1.0])
        for _ in range(N_POWERS):
            forces = self._multiply(self._operator, values)
            energies = self._team.ordered_sum([np.array([values @ forces, values @ (values * diagonal)])])
            values = forces / diagonal / np.sqrt(energies[1])
        highest = ABOVE * energies[0] / energies[1]
        return float(min(LOWEST * of_texture / of_all, highest / 2)), float(highest)

    def _solve_surface(self, forces: Array) -> Array:
        """S^-1 times forces on the other unknowns, nearly."""
        values = multiply_blocks(self._surface_scale, forces)
        for _ in range(2):
            values = self._evaluate_polynomial(values)
        return multiply_blocks(self._surface_scale, values)

    def _evaluate_polynomial(self, values: Array) -> Array:
        """The polynomial of N times values."""
        highest, *others = self._coefficients[::-1]
        result: Array = highest * values
        for coefficient in others:
            of_mass = self._multiply(self._surface_mass, multiply_blocks(self._surface_scale, result))
            result = multiply_blocks(self._surface_scale, of_mass) + coefficient * values
        return result

    def _multiply(self, matrix: PETSc.Mat, values: Array) -> Array:
        self._given.setArray(values)
        matrix.mult(self._given, self._result)
        return np.array(self._result.getArray())

    def _add_up(self, parts: Iterable[Array]) -> Array:
        """Add up values of each subdomain, (n_unknowns,), on the unknowns that this rank owns, (n_owned,)."""
        self._whole.exchange.add_to_owners(self._whole.add_up(list(parts)), self._given)
        return np.array(self._given.getArray())

    def _lump(self, chosen: BoolArray) -> Array:
        """Blocks that chosen rows and columns of M lump to, (n_owned_nodes, dim, dim)."""
        columns = []
        for component in np.eye(self._dim):
            self._given.setArray(np.where(chosen, np.tile(component, len(chosen) // self._dim), 0.0))
            ones = self._whole.restrict(self._whole.exchange.fetch_ghosts(self._given))
            sums = self._add_up(s.hessian @ x for s, x in zip(self._whole.systems, ones, strict=True))
            columns.append(np.where(chosen, sums, 0.0).reshape(-1, self._dim))
        return np.stack(columns, axis=2)

    def _measure_texture(self) -> float:
        """Mean eigenvalue of the blocks that M lumps to."""
        traces = np.trace(self._lump(np.ones_like(self._controlled)), axis1=1, axis2=2)
        total, n_unknowns = self._team.ordered_sum([np.array([traces.sum(), len(self._controlled)])])
        return float(total / n_unknowns)

    def _cut_stiffness(self, *, columns_controlled: bool) -> ParallelEntries:
        """sqrt(eta) K of controlled rows, and columns that are, or that are not."""
        entries = ParallelEntries(self._team, self._whole.n_owned, self._whole.n_owned)
        for system, rows, numbers in zip(self._whole.systems, self._whole.rows, self._whole.numbers, strict=True):
            controlled = system.subdomain.controlled
            # As the rows: so B is symmetric whatever their weights.
            of_columns = controlled * rows.factors * system.row_weights if columns_controlled else ~controlled
            cut = scale(rows.assemble(), np.sqrt(system.eta) * controlled, of_columns)
            entries.add_sparse(numbers, numbers, cut)
        return entries

    def _assemble_operator(self, root: Array) -> PETSc.Mat:
        """B, on the other unknowns D alone."""
        entries = self._cut_stiffness(columns_controlled=True)
        owned = self._team.offset(self._whole.n_owned) + np.arange(self._whole.n_owned)
        nodes = np.arange(len(root) + 1)
        entries.add_sparse(owned, owned, sparse.bsr_matrix((root, nodes[:-1], nodes)).tocsr())
        return entries.create_matrix(symmetric_blocks=self._dim)

    def _assemble_surface_mass(self) -> PETSc.Mat:
        """M_bb."""
        entries = ParallelEntries(self._team, self._whole.n_owned, self._whole.n_owned)
        for system, numbers in zip(self._whole.systems, self._whole.numbers, strict=True):
            others = ~system.subdomain.controlled
            entries.add_sparse(numbers, numbers, scale(system.hessian, others, others))
        return entries.create_matrix()

    def _measure_extension(self, root: Array, surface_root: Array) -> float:
        """T = |D E x|^2 / |D_b x|^2 of a translation x; 0 where all unknowns are controlled."""
        translation = np.where(self._controlled, 0.0, 1.0)
        inside = self._solve_inside(self._multiply(self._coupling, translation))
        of_inside, of_surface = multiply_blocks(root, inside), multiply_blocks(surface_root, translation)
        squares, whole = self._team.ordered_sum([np.array([of_inside @ of_inside, of_surface @ of_surface])])
        return float(squares / whole) if whole else 0.0


def scale(matrix: sparse.csr_matrix, of_rows: Array | BoolArray, of_columns: Array | BoolArray) -> sparse.csr_matrix:
    """Multiply the rows and columns of a matrix by factors, (n,) each; entries that become 0 go."""
    rows, columns = (sparse.diags(factors.astype(np.float64)) for factors in (of_rows, of_columns))
    scaled = (rows @ matrix @ columns).tocsr()
    scaled.eliminate_zeros()
    return scaled


def multiply_blocks(blocks: Array, values: Array) -> Array:
    """Multiply each node's block, (n_nodes, dim, dim), with its values of all, (n_nodes dim,)."""
    return np.asarray(np.einsum("nij,nj->ni", blocks, values.reshape(blocks.shape[:2])).ravel())


def find_roots(blocks: Array, mean: float) -> Array:
    """Square roots of blocks, made symmetric, (n_nodes, dim, dim); those that are small beside the mean are raised."""
    values, vectors = np.linalg.eigh((blocks + blocks.swapaxes(1, 2)) / 2)
    return np.asarray(vectors * np.sqrt(np.maximum(values, LEAST * mean))[:, None, :] @ vectors.swapaxes(1, 2))


def find_polynomial(extension: float) -> Array:
    """Coefficients, from the lowest, of the polynomial of N whose square is near D_b S^-1 D_b; ``extension`` is t."""
    if extension == 0:
        return np.ones(1)

    def find_inverse_root(mass: Array) -> Array:
        of_inside = ROUGH / (1 - mass + ROUGH / extension)
        return np.asarray(1 / np.sqrt(mass + 2 * of_inside))

    # Through as many values as it has coefficients, where Chebyshev's polynomial is extreme: both ends are among them.
    masses = (1 + np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)) / 2
    return np.linalg.solve(np.vander(masses, increasing=True), find_inverse_root(masses))
