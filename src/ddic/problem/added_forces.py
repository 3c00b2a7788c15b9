"""What b is given beside grey levels, so that a rotation of the region and cells that nothing holds cost nothing.

Linear elasticity knows the rotation of small angles only: the equilibrium gap is that of q - q_R, with the rigid motion
q_R nearest to q, and of forces R K R^T. Cells that are not shown and that nothing else holds are elastic matter.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray
from ddic.functionals.regularization import Material, integrate_cell_stiffness
from ddic.kinematics.cell_interpolation import interpolate_cells
from ddic.mesh.mesh import sum_about_nodes
from ddic.mesh.quality import measure_areas
from ddic.mesh.rotation import Rotation, fit_rotation
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.petsc import PetscStack
from ddic.solvers.whole_system import EquilibriumRows, WholeSystem

LEAST_ANGLE = 0.005
"""Angle, radians, up to which a rotation is left to linear elasticity, which takes it for a strain of 1e-5."""

STEP_ANGLE = 0.1
"""The stiffness is turned by whole multiples of this angle, radians, whatever the start was. A larger one makes forces
of strains less exact, by its half; a smaller one factorises more often."""

KEPT_STEPS = 0.6
"""Steps by which the region may turn on before the stiffness is turned along: more than half of one, so that noise does
not turn it to and fro."""

STIFFNESS = 1e-4
"""Young's modulus of filled cells, relative to the mean diagonal of M. They pull at the cells beside them: a larger
value moves these, a smaller one worsens the operators' condition."""

HELD = 1e-8
"""What the operator of filled cells has on its diagonal beyond their stiffness, relative to the mean diagonal of M: a
subdomain that is hidden altogether may move as a rigid body, and its operator must not be singular. Forces have nothing
of it, so that it costs iterations only; a larger value costs more of them, where hundreds of cells are hidden in a row.
"""


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """A rigid motion of the region.

    Attributes
    ----------
    rotation : Rotation
        R.
    centre, translation : (dim,) array
        Centre, and its displacement, pixels.
    """

    rotation: Rotation
    centre: Array
    translation: Array

    def evaluate(self, points: Array) -> Array:
        """Evaluate the displacement at points, (n, dim), pixels."""
        arms = points - self.centre
        return np.asarray(arms @ (self.rotation.matrix - np.eye(len(self.centre))).T + self.translation)


def choose_stiffness_rotation(now: Rotation, before: Rotation) -> Rotation:
    """Choose how to turn the stiffness where the region has turned so far; ``before`` itself if it is near."""
    # Not at every step's edge: two solutions might take turns.
    is_near = before.measure_turn(now) <= KEPT_STEPS * STEP_ANGLE
    rounded = now.round_to(STEP_ANGLE)
    # In space the nearest step may be farther.
    return before if is_near or np.array_equal(rounded.vector, before.vector) else rounded


def fit_rigid_motion(q: Field) -> RigidMotion:
    """Fit a rigid motion to the displacement of all nodes, each weighted by the area about it; collective."""
    sums = q.team.ordered_sum(q.map(_sum_moments))
    # 1 + dim + dim + dim^2 numbers are (dim + 1)^2.
    dim = round(np.sqrt(len(sums))) - 1
    total, first, moved, products = np.split(sums, [1, 1 + dim, 1 + 2 * dim])
    centre, moved_centre = first / total, moved / total
    # Of sum (x - x_mean) (X - X_mean)^T.
    spread = products.reshape(dim, dim) / total - np.outer(moved_centre, centre)
    return RigidMotion(Rotation.from_matrix(fit_rotation(spread)), centre, moved_centre - centre)


def _sum_moments(subdomain: Subdomain, q: Array) -> Array:
    """Of the nodes: their areas, and the sums of X, of x and of x X^T, ((dim + 1)^2,)."""
    mesh, nodes = subdomain.mesh, subdomain.mesh.nodes
    weights = sum_about_nodes(mesh, measure_areas(mesh) / np.diff(mesh.offsets))
    moved = nodes + subdomain.kinematics.displacement(q[:subdomain.n_field]).reshape(nodes.shape)
    return np.concatenate([[weights.sum()], weights @ nodes, weights @ moved,
                           ((moved * weights[:, None]).T @ nodes).ravel()])


@dataclass(frozen=True, eq=False)
class HeldRotation:
    """What lets a rotation of the region cost nothing.

    Attributes
    ----------
    team, systems : Team, sequence of LocalSystem
        All ranks, and the systems of owned subdomains.
    """

    team: Team
    systems: Sequence[LocalSystem]

    def compute_forces(self, q: Field) -> Field:
        """Compute eta Kbar^T Kbar q_R, which b has to be given for the gap to be that of q - q_R; collective.

        q_R is the rigid motion of ``q``. The forces add up over subdomains.
        """
        motion = fit_rigid_motion(q)
        change = motion.rotation.matrix - np.eye(len(motion.centre))
        of_fields = [(field * change).sum() / (field**2).sum() for field in _list_linear_fields(len(change))]
        shares = np.array([*motion.translation, *of_fields])
        return q.with_parts(np.asarray(forces @ shares) for forces in self._forces_of_fields)

    @cached_property
    def _forces_of_fields(self) -> list[Array]:
        """Forces of translations and of linear fields, (n_unknowns, n_fields); found once, collectively."""
        subdomains = [system.subdomain for system in self.systems]
        # Whatever the motion, its centre is the region's.
        centre = fit_rigid_motion(Field.zero(self.team, subdomains)).centre
        kbars = [EquilibriumRows(system).assemble() for system in self.systems]
        gaps = [kbar @ _fit_fields(s, centre) for s, kbar in zip(subdomains, kbars, strict=True)]
        with PetscStack() as stack:
            whole = stack.keep(WholeSystem(self.team, self.systems))
            # Of each field, rows of interfaces complete.
            complete = [whole.restrict(whole.sum_over_subdomains(of_field))
                        for of_field in zip(*(gap.T for gap in gaps), strict=True)]
        return [np.asarray(system.eta * (kbar.T @ np.column_stack(of_fields)))
                for system, kbar, *of_fields in zip(self.systems, kbars, *complete, strict=True)]


def _list_linear_fields(dim: int) -> list[Array]:
    """List matrices that R - I is made of: a dilation and a turn in the plane, each entry by itself in space."""
    if dim == 2:
        return [np.eye(2), np.array([[0.0, -1.0], [1.0, 0.0]])]
    return list(np.eye(dim * dim).reshape(-1, dim, dim))


def _fit_fields(subdomain: Subdomain, centre: Array) -> Array:
    """Unknowns of the translations, and of the linear fields of X - centre, (n_unknowns, n_fields)."""
    arms, dim = subdomain.mesh.nodes - centre, len(centre)
    fields = [np.tile(axis, (len(arms), 1)) for axis in np.eye(dim)]
    fields += [arms @ of_field.T for of_field in _list_linear_fields(dim)]
    of_field = np.column_stack([subdomain.kinematics.fit(field.ravel()) for field in fields])
    return np.vstack([of_field, np.zeros((subdomain.n_motion, len(fields)))])


@dataclass(frozen=True, eq=False)
class FilledCells:
    """Elastic energy of the cells that a frame does not show, less that of the region's rigid motion.

    Attributes
    ----------
    of_nodes : tuple of (n_dofs, n_dofs) csr_matrix
        Stiffness of the filled cells of each owned subdomain on displacements of nodes, not turned, grey levels
        squared per pixel squared.
    stiffness : tuple of (n_unknowns, n_unknowns) csr_matrix
        The same on unknowns, turned as far as the region had when the operators were assembled.
    held : float
        What their operators have on the diagonal beyond it, grey levels squared per pixel squared.
    """

    of_nodes: tuple[sparse.csr_matrix, ...]
    stiffness: tuple[sparse.csr_matrix, ...]
    held: float

    def assemble_operator(self, number: int) -> sparse.csr_matrix:
        """Assemble what the operator of an owned subdomain is given, (n_unknowns, n_unknowns).

        It is in grey levels squared per pixel squared, and positive on each unknown of filled cells; ``number`` counts
        owned subdomains.
        """
        stiffness = self.stiffness[number]
        is_filled = stiffness.diagonal() > 0
        return (stiffness + sparse.diags(self.held * is_filled)).tocsr()

    def compute_forces(self, q: Field) -> Field:
        """Compute the forces that b is given, grey levels squared per pixel; collective."""
        motion = fit_rigid_motion(q)

        def compute(subdomain: Subdomain, q_s: Array, of_nodes: sparse.csr_matrix) -> Array:
            forces = np.zeros(subdomain.n_unknowns)
            if of_nodes.nnz:
                nodes = subdomain.mesh.nodes
                field = subdomain.kinematics.displacement(q_s[:subdomain.n_field]).reshape(nodes.shape)
                rest = motion.rotation.apply_inverse(field - motion.evaluate(nodes))
                # Turned as the region is now: else the field would depend on where its operators were assembled.
                pull = motion.rotation.apply(-(of_nodes @ rest.ravel()).reshape(nodes.shape))
                forces[:subdomain.n_field] = subdomain.kinematics.project_vector(pull.ravel())
            return forces

        return q.map(compute, self.of_nodes)


def fill_cells(subdomains: Sequence[Subdomain], cells: Sequence[BoolArray], weight: float,
               rotation: Rotation) -> FilledCells:
    """Give cells without pixels an elastic energy; free of communication.

    ``cells``, (n_cells,), say which ones of each owned subdomain; ``weight`` is the mean diagonal of M, grey levels
    squared per pixel squared, ``rotation`` that by which the region has turned.
    """
    of_nodes = tuple(_assemble(subdomain, chosen, STIFFNESS * weight)
                     for subdomain, chosen in zip(subdomains, cells, strict=True))
    stiffness = tuple(_turn(subdomain, matrix, rotation)
                      for subdomain, matrix in zip(subdomains, of_nodes, strict=True))
    return FilledCells(of_nodes, stiffness, HELD * weight)


def _assemble(subdomain: Subdomain, chosen: BoolArray, modulus: float) -> sparse.csr_matrix:
    """On displacements of nodes, (n_dofs, n_dofs)."""
    n_dofs = subdomain.mesh.n_dofs
    if not chosen.any():
        return sparse.csr_matrix((n_dofs, n_dofs))
    of_cells = integrate_cell_stiffness(subdomain.mesh, Material.default(subdomain.mesh.dim))
    of_cells[~chosen] = 0.0
    stiffness: sparse.csr_matrix = interpolate_cells(subdomain.mesh).assemble_matrix(modulus * of_cells)
    return stiffness


def _turn(subdomain: Subdomain, of_nodes: sparse.csr_matrix, rotation: Rotation) -> sparse.csr_matrix:
    """The same on unknowns, R K R^T, (n_unknowns, n_unknowns)."""
    n_motion = subdomain.n_motion
    if not of_nodes.nnz:
        return sparse.csr_matrix((subdomain.n_unknowns, subdomain.n_unknowns))
    turn = sparse.kron(sparse.identity(subdomain.mesh.n_nodes), rotation.matrix).tocsr()
    of_field = subdomain.kinematics.project_matrix((turn @ of_nodes @ turn.T).tocsr())
    return sparse.block_diag([of_field, sparse.csr_matrix((n_motion, n_motion))]).tocsr() if n_motion else of_field
