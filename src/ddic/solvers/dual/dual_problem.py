"""The interface problem S_tot v = t_tot, Eq. 25-31 of [BP17], S_tot a shell operator; what subdomains bring to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import linalg, sparse

from ddic.arrays import Array, IntArray
from ddic.functionals.regularization import scale_rows
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import rows_of, signed_incidence
from ddic.solvers.exchange import Exchange
from ddic.solvers.local_system import LocalOperator, LocalSystem


@dataclass(frozen=True)
class LocalDual:
    """A subdomain's operators on the interface: the product of Eq. 30-31 of [BP17] with the two blocks stacked.

    With v = (Lambda, LambdaBar / c), S_tot v = sum_s G_s A_s^-1 G_s^T v - H_s v, where
    G_s = [C_s ; c eta Cbar_s Kbar_s] = B_s T_s,  H_s = c^2 eta Cbar_s Cbar_s^T = B_s D_s B_s^T,
    T_s and D_s act on the subdomain's own interface unknowns (those with jumps first, then those with reactions), B_s
    is the signed incidence.

    Attributes
    ----------
    system, operator : LocalSystem and LocalOperator
        M_s and Kbar_s, and A_s factorised, both with the motion of the subdomain's camera held.
    incidence : (n ghost rows, n interface unknowns) csc_matrix
        B_s.
    trace : (n interface unknowns, n_field) csr_matrix
        T_s.
    compliance : (n interface unknowns,) array
        Diagonal of D_s, zero for jumps.
    jump : (n ghost rows, n_field) csc_matrix
        G_s.
    n_jumps : int
        Number of interface unknowns with jumps.
    motion : MotionRows, optional
        The rows of the motion of the subdomain's camera.
    """

    system: LocalSystem
    operator: LocalOperator
    incidence: sparse.csc_matrix
    trace: sparse.csr_matrix
    compliance: Array
    jump: sparse.csc_matrix
    n_jumps: int
    motion: MotionRows | None = None

    def multiply_schur(self, columns: Array) -> Array:
        """Multiply by S_s = T_s A_s^-1 T_s^T - D_s in blocks: no (n_field, k) array is held.

        S_tot is the sum of B_s S_s B_s^T, Eq. 34-35 of [BP17].
        """
        out = np.empty(columns.shape, order="F")
        step = self.operator.block
        for begin in range(0, columns.shape[1], step):
            block = columns[:, begin: begin + step]
            y = self.operator.solve_many(self.trace.T @ block)
            out[:, begin: begin + step] = self.trace @ y - self.compliance[:, None] * block
        return out


@dataclass(frozen=True)
class MotionRows:
    """Rows of the interface problem for the motion alpha of a near-field set-up, unknowns kappa alpha.

    With R_s the displacements that alpha makes and N_s = M_s R_s, alpha's equation N_s^T u_s + R_s^T M_s R_s alpha
    = R_s^T b_s, summed over subdomains, has the form of the others: G_s gains the rows N_s^T / kappa, H_s the block
    R_s^T M_s R_s / kappa^2. Where the near camera alone sees its subdomains, A_s^-1 N_s = R_s, since K R_s = 0: then
    C_s R_s are alpha's columns in Eq. 20 of [BP17], whose alpha has the other sign (1 from near to far, 0 within one
    side), and the block's part of S_tot vanishes.

    Attributes
    ----------
    rows : (n_motion,) array of int64
        Ghost rows.
    columns : (n_field, n_motion) array
        N_s / kappa.
    block : (n_motion, n_motion) array
        R_s^T M_s R_s / kappa^2.
    scale : (n_motion,) array
        kappa = sum_s diag R_s^T M_s R_s, which makes the rows' residuals pixels.
    """

    rows: IntArray
    columns: Array
    block: Array
    scale: Array


def build_local_dual(system: LocalSystem, operator: LocalOperator, ghosts: IntArray, scale: float,
                     motion: MotionRows | None) -> LocalDual:
    """Build a subdomain's interface operators; ``system`` is without the motion of its camera.

    Jumps and reactions are split into the assembly B_s and the trace T_s on its own interface, Eq. 33 of [BP17].
    ``ghosts`` are the sorted numbers of the rows that this rank takes part in. ``scale`` is
    c = 1 / sqrt(eta mean diag M), which gives both blocks of unknowns and of residuals one unit and keeps S_tot
    symmetric.
    """
    subdomain = system.subdomain
    jumps = subdomain.jumps
    trace = _select(jumps.unknowns, subdomain.n_field)
    incidence = signed_incidence(jumps, ghosts)
    compliance = np.zeros(len(jumps.unknowns))
    if system.controlled_stiffness is not None:
        reactions = subdomain.reactions
        weights = system.row_weights[reactions.unknowns]
        reaction_rows = system.controlled_stiffness[reactions.unknowns]
        weighted_rows = scale_rows(reaction_rows, scale * system.eta * weights)
        trace = sparse.vstack([trace, weighted_rows]).tocsr()
        incidence = sparse.hstack([incidence, signed_incidence(reactions, ghosts)], format="csc")
        compliance = np.concatenate([compliance, scale**2 * system.eta * weights**2])
    jump = incidence @ trace
    if motion is not None:
        place = _select(motion.rows, len(ghosts)).T
        jump = (jump + place @ sparse.csr_matrix(motion.columns.T)).tocsc()
    return LocalDual(system, operator, incidence, trace, compliance, jump, len(jumps.unknowns), motion)


def find_motion_rows(system: LocalSystem, ghosts: IntArray, scales: dict[int, Array]) -> MotionRows | None:
    """Find the rows of the motion of the subdomain's camera, where that moves: Eq. 21 of [BP17].

    ``system`` is with the motion of its camera, ``ghosts`` are as for ``build_local_dual``, ``scales`` is kappa of
    ``MotionRows``, (n_motion,), by camera.
    """
    unknowns = system.subdomain.motion
    if unknowns is None:
        return None
    scale = scales[system.subdomain.camera]
    rows = np.searchsorted(ghosts, unknowns.rows)
    return MotionRows(rows, system.motion_columns / scale, system.motion_block / np.outer(scale, scale), scale)


def _select(places: IntArray, size: int) -> sparse.csr_matrix:
    """The matrix that takes the entries at some places out of a vector, (n places, size)."""
    n = len(places)
    return sparse.csr_matrix((np.ones(n), places, np.arange(n + 1)), shape=(n, size))


def _list_places(sizes: Sequence[int]) -> list[slice]:
    """List where arrays of some sizes lie in all of them, one after the other."""
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(begin, end) for begin, end in pairwise(ends)]


class PackedSymmetric:
    """A symmetric array of which one triangle is held: what a product costs is to read it from memory.

    Parameters
    ----------
    array : (n, n) array of float32 or float64
        Its precision is that of products.
    """

    def __init__(self, array: Array | NDArray[np.float32]) -> None:
        self._n, self._dtype = len(array), array.dtype
        self._multiply, self._multiply_columns = linalg.get_blas_funcs(("spmv", "symm"), dtype=array.dtype)
        pack, self._unpack = linalg.get_lapack_funcs(("trttp", "tpttr"), dtype=array.dtype)
        # In Fortran's order, which of a symmetric array is its own.
        self._triangle, _ = pack(array.T)

    def apply(self, x: Array) -> Array:
        """Multiply a vector, (n,)."""
        if not len(x):
            # BLAS takes no empty array.
            return x.copy()
        return np.asarray(self._multiply(self._n, 1.0, self._triangle, x.astype(self._dtype)), dtype=np.float64)

    def apply_to_columns(self, columns: Array) -> Array:
        """Multiply columns, (n, k); for as long the array is held as a square."""
        if not columns.size:
            return columns.copy()
        square, _ = self._unpack(self._n, self._triangle)
        return np.asarray(self._multiply_columns(1.0, square, columns))

    def destroy(self) -> None:
        """Nothing to free: the array is Python's."""


class _LocalProduct(Protocol):
    """X_s, which acts on one subdomain's interface unknowns."""

    def apply(self, x: Array) -> Array:
        """Multiply a vector, (n interface unknowns,)."""


class SumOverSubdomains:
    """Products with sum_s B_s X_s B_s^T over a rank's subdomains, free of communication.

    Parameters
    ----------
    assemblies : sequence of (n ghost rows, n interface unknowns) csc_matrix
        B_s of each, at least one: signed incidence, or its scaled version.
    products : sequence of _LocalProduct
        X_s of each.
    """

    def __init__(self, assemblies: Sequence[sparse.csc_matrix], products: Sequence[_LocalProduct]) -> None:
        self._products = products
        self._places = _list_places([assembly.shape[1] for assembly in assemblies])
        # Side by side: to call a product with a small matrix takes longer than to compute it.
        self._assembly = sparse.hstack(assemblies, format="csc").tocsr()
        # Made once: making the matrix takes longer than its product with a vector.
        self._assembly_transposed = self._assembly.T

    def apply(self, v: Array) -> Array:
        """Multiply a vector, (n ghost rows,)."""
        on_interfaces = self._assembly_transposed @ v
        found = [product.apply(on_interfaces[place])
                 for product, place in zip(self._products, self._places, strict=True)]
        return np.asarray(self._assembly @ np.concatenate(found))


class DualSchurOperator:
    """Context of the shell matrix: S_tot v = sum_s G_s A_s^-1 G_s^T v - H_s v, Eq. 26 of [BP17].

    The matrix is symmetric and quasi-definite. Its blocks, Eq. 27a-c, are never formed: a product takes one local solve
    per subdomain or, where ``set_arrays`` has given S_s, one product with that, which is several times smaller than the
    factor. A subdomain's matrices are small: to call a product takes longer than to compute it. So there is one product
    with a sparse matrix for all of a rank.

    Parameters
    ----------
    exchange : Exchange
        Of interface rows.
    local_duals : sequence of LocalDual
        This rank's subdomains, at least one.
    """

    def __init__(self, exchange: Exchange, local_duals: Sequence[LocalDual]) -> None:
        self.exchange = exchange
        self._local_duals = local_duals
        self._fields = _list_places([local.operator.n for local in local_duals])
        self._jump = sparse.hstack([local.jump for local in local_duals], format="csc").tocsr()
        self._jump_transposed = self._jump.T.tocsr()
        incidence = sparse.hstack([local.incidence for local in local_duals], format="csc").tocsr()
        compliance = sparse.diags(np.concatenate([local.compliance for local in local_duals]))
        self._compliance = (incidence @ compliance @ incidence.T).tocsr()
        self._by_arrays: SumOverSubdomains | None = None

    def set_arrays(self, arrays: Sequence[PackedSymmetric]) -> None:
        """Multiply by S_s of each of this rank's subdomains from now on, none of whose cameras moves."""
        self._by_arrays = SumOverSubdomains([local.incidence for local in self._local_duals], arrays)

    def mult(self, _: PETSc.Mat | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply y = S_tot x, x multipliers: PETSc's callback."""
        v = self.exchange.fetch_ghosts(x)
        self.exchange.add_to_owners(self.apply_own(v), y)

    multTranspose = mult

    def apply_own(self, v: Array) -> Array:
        """Sum G_s A_s^-1 G_s^T v - H_s v over this rank's subdomains, Eq. 30-31 of [BP17]; free of communication."""
        if self._by_arrays is not None:
            return self._by_arrays.apply(v)
        y = np.concatenate(self.solve_forces(v))
        out = np.asarray(self._jump @ y - self._compliance @ v)
        for local in self._local_duals:
            if local.motion is not None:
                out[local.motion.rows] -= local.motion.block @ v[local.motion.rows]
        return out

    def solve_forces(self, v: Array) -> list[Array]:
        """Find what multipliers v, (n ghost rows,), do to the fields: A_s^-1 G_s^T v of each subdomain, (n_field,)."""
        forces = self._jump_transposed @ v
        return [local.operator.solve(forces[place])
                for local, place in zip(self._local_duals, self._fields, strict=True)]

    def sum_jumps(self, fields: Sequence[Array]) -> Array:
        """Sum what fields y_s, (n_field,), contribute to the rows: sum of G_s y_s, (n ghost rows,)."""
        return np.asarray(self._jump @ np.concatenate(fields))


def sum_motion_scales(team: Team, systems: Sequence[LocalSystem]) -> dict[int, Array]:
    """Sum kappa = sum_s diag R_s^T M_s R_s, (n_motion,), (grey levels / px)^2, by camera that moves; collective."""
    mine = [(system.subdomain.camera, system.motion_block.diagonal())
            for system in systems if system.subdomain.motion is not None]
    scales: dict[int, Array] = {}
    for camera, diagonal in team.gather_lists(mine):
        scales[camera] = scales.get(camera, 0.0) + diagonal
    return scales


class DualProblem:
    """The interface problem, spread over ranks.

    Parameters
    ----------
    team, systems : Team, sequence of LocalSystem
        All ranks, which make it together; this rank's subdomains.
    operators : sequence of LocalOperator
        Their A_s factorised, motions of cameras held; they stay their maker's to destroy.
    scale : float
        c of ``build_local_dual``.

    Attributes
    ----------
    exchange : Exchange
        Of interface rows, its owner.
    local_duals : list of LocalDual
        Of each of these subdomains.
    operator : DualSchurOperator
        S_tot.
    n_motion : int
        Number of unknowns of all cameras' motions.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem], operators: Sequence[LocalOperator],
                 scale: float) -> None:
        self.team = team
        self.subdomains = [system.subdomain for system in systems]
        scales = sum_motion_scales(team, systems)
        self.n_motion = sum(len(values) for values in scales.values())
        rows = []
        for subdomain in self.subdomains:
            rows += [rows_of(subdomain.jumps), rows_of(subdomain.reactions)]
            if subdomain.motion is not None:
                rows.append(subdomain.motion.rows)
        self.exchange = Exchange(team, sum(s.n_owned_rows for s in self.subdomains), rows)
        self.local_duals = []
        for system, operator in zip(systems, operators, strict=True):
            motion = find_motion_rows(system, self.exchange.ghosts, scales)
            held = system.without_motion
            self.local_duals.append(build_local_dual(held, operator, self.exchange.ghosts, scale, motion))
        self.operator = DualSchurOperator(self.exchange, self.local_duals)

    def set_right_hand_side(self, right: PETSc.Vec, free: Field, q: Field, b: Field) -> None:
        """Set a vector to t_tot = sum_s G_s (u_s + free_s), Eq. 27d-e of [BP17]; collective.

        Rows of a camera's motion are (N_s^T free_s - R_s^T b_s) / kappa. Of each owned subdomain, ``free`` is
        A_s^-1 (b_s - eta Kbar_s^T Kbar_s u_s), (n_field,); ``q`` is u_s, then the camera's motion.
        """
        fields = [q_s[:len(free_s)] + free_s for q_s, free_s in zip(q, free, strict=True)]
        total = self.operator.sum_jumps(fields)
        for local, q_s, b_s in zip(self.local_duals, q, b, strict=True):
            if local.motion is not None:
                motion, n_field = local.motion, local.operator.n
                total[motion.rows] -= motion.columns.T @ q_s[:n_field] + b_s[n_field:] / motion.scale
        self.exchange.add_to_owners(total, right)

    def correct(self, free: Field, multipliers: PETSc.Vec) -> Field:
        """Correct by the multipliers v: du_s = free_s - A_s^-1 G_s^T v, pixels, Eq. 24a of [BP17]; collective."""
        v = self.exchange.fetch_ghosts(multipliers)
        return free - self.operator.solve_forces(v)

    def append_motion(self, du: Field, multipliers: PETSc.Vec) -> Field:
        """Append the corrections of cameras' motions, pixels, of which the multipliers hold kappa alpha; collective."""
        v = self.exchange.fetch_ghosts(multipliers)
        return du.with_parts(
            du_s if local.motion is None else np.concatenate([du_s, v[local.motion.rows] / local.motion.scale])
            for du_s, local in zip(du, self.local_duals, strict=True))

    def destroy(self) -> None:
        """Free PETSc's objects; local factors are their maker's."""
        self.exchange.destroy()
