"""One linear step with near and far cameras on random data, and the saddle point that it solves.

That of Eq. 21 of [BP17] with the gap of the whole region, which equals Eq. 23 with the paper's weighting alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from ddic.case.schema import (
    Case,
    ImagesSection,
    MeshSection,
    NearSection,
    RegularizationSection,
    SolverSection,
    StructuredSection,
)
from ddic.functionals.regularization import Material, controlled_stiffness
from ddic.images.camera import identity
from ddic.inputs.cameras import Camera
from ddic.inputs.inputs import Inputs
from ddic.kinematics.camera import CameraSetup, MotionKind
from ddic.kinematics.nodal import NodalKinematics
from ddic.mesh.mesh import Mesh
from ddic.parallel.distribution import split_evenly
from ddic.parallel.field import Field
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.split import add_motions, keep_cameras_apart, split_by_blocks, split_by_camera, split_by_metis
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import assemble
from ddic.problem.linear_solver import LinearSolver
from ddic.problem.reference_problem import ReferenceProblem, assemble_hessians, read_reference_views, weigh_cameras
from ddic.problem.region_mesh import Region
from ddic.solvers.linear_step import LinearStep, StepResult
from ddic.solvers.petsc import PetscStack
from support.linear import StepProblem, linear_step
from support.near_camera import RATIO, assemble_texture, evaluate_motion, set_up_over_box, speckle

Layout = Literal["island", "edge", "two"]
Array = NDArray[np.float64]

# Columns and rows of cells, first and last, that each near camera sees of 12 x 12.
SEEN: dict[Layout, list[tuple[int, int, int, int]]] = {
    "island": [(4, 3, 9, 8)], "edge": [(7, 0, 11, 11)], "two": [(2, 3, 5, 9), (6, 3, 9, 8)]}
N = 12
WAVELENGTH = 32.0
WEIGHTS = (1.0, 0.37, 1.8)


@dataclass(frozen=True, eq=False)
class NearFarStep:
    """The data of one linear step.

    base: mesh, far image, controlled rows and eta (0 without regularization); labels: camera of each cell; cameras:
    the far one first; subdomains: all; q: unknowns of each subdomain, copies of a node differ; forces: b of each
    subdomain before each of its cameras, its own first, in that image's pixels, unweighted.
    """

    base: StepProblem
    labels: NDArray[np.int64]
    cameras: tuple[Camera, ...]
    subdomains: list[Subdomain]
    q: list[Array]
    forces: list[list[Array]]
    use_far: bool

    def case(self, **solver: Any) -> Case:
        """What asks for it; solver: keys of [solver], the dual method by default."""
        near = tuple(NearSection(reference=Path("f"), deformed=Path("g"), ratio=RATIO, offset=(0.0, 0.0),
                                 motion="translation", use_far=self.use_far) for _ in self.cameras[1:])
        mesh = MeshSection(structured=StructuredSection(region=(0, 0, 16, 16), element_size=8))
        regularization = RegularizationSection(eta=self.base.eta, edge_wavelength=0) if self.base.eta else None
        return Case(images=ImagesSection(reference=Path("f"), deformed=Path("g")), near=near, mesh=mesh,
                    regularization=regularization, solver=SolverSection(**{"method": "dual"} | solver))


@cache
def near_far_step(layout: Layout, kind: str, n_subdomains: int, motion: MotionKind, *, regularized: bool,
                  use_far: bool = False) -> NearFarStep:
    """12 x 12 cells, some before near cameras of three times the magnification, a little turned and tilted.

    kind: "blocks" (n_subdomains x 1 of them, cut where the camera changes) or "metis".
    """
    base = linear_step(N, WAVELENGTH if regularized else None)
    mesh = base.mesh
    column, row = np.arange(mesh.n_cells) % N, np.arange(mesh.n_cells) // N
    labels = np.zeros(mesh.n_cells, dtype=np.int64)
    cameras = [Camera(0, base.image, CameraSetup(identity(), "none", np.zeros(2), 1.0), None)]
    for number, (c0, r0, c1, r1) in enumerate(SEEN[layout], start=1):
        labels[(column >= c0) & (column <= c1) & (row >= r0) & (row <= r1)] = number
        cameras.append(replace(_near_camera(mesh, labels == number, motion, number), use_far=use_far))
    if kind == "blocks":
        parts = keep_cameras_apart(split_by_blocks(mesh, (n_subdomains, 1)), labels)
    else:
        parts = split_by_camera(labels, np.ones(mesh.n_cells), n_subdomains,
                                lambda cells, n: split_by_metis(mesh.create_submesh(cells)[0], n))
    subdomains = [replace(s, camera=int(labels[s.cell_ids[0]]))
                  for s in build_subdomains(base.region, parts, base.controlled)]
    subdomains = add_motions(subdomains, [s.camera for s in subdomains], [c.setup.n_motion_unknowns for c in cameras],
                             base.region.n_unknowns, sum(s.n_owned_rows for s in subdomains))
    rng = np.random.default_rng(7)
    motions = [rng.normal(size=c.setup.n_motion_unknowns) for c in cameras]
    q = [np.concatenate([rng.normal(size=s.n_field), motions[s.camera]]) for s in subdomains]
    forces = [[base.mean_diagonal * rng.normal(size=s.mesh.n_dofs) for _ in range(1 + bool(use_far and s.camera))]
              for s in subdomains]
    return NearFarStep(base, labels, tuple(cameras), subdomains, q, forces, use_far)


def _near_camera(mesh: Mesh, cells: NDArray[np.bool_], motion: MotionKind, seed: int) -> Camera:
    """A camera whose image shows these cells and 20 px around them."""
    nodes = mesh.create_submesh(np.flatnonzero(cells))[0].nodes
    setup, side = set_up_over_box(nodes.min(axis=0), nodes.max(axis=0), motion, 0.05 * seed)
    return Camera(seed, speckle(seed, side), setup, None)


class NearFarCut:
    """The step on the ranks of a communicator: their subdomains, as the method sets them up."""

    def __init__(self, team: Team, problem: NearFarStep, **solver: Any) -> None:
        self.team, self.problem, self.case = team, problem, problem.case(**solver)
        self.numbers = list(split_evenly(np.ones(len(problem.subdomains)), team.size)[team.rank])
        own = [problem.subdomains[k] for k in self.numbers]
        views = read_reference_views(self.case, problem.cameras, own)
        self.views = weigh_cameras(views, WEIGHTS)
        mesh = problem.base.mesh
        region = Region(mesh.n_nodes, mesh.n_cells, problem.base.region.n_unknowns, len(problem.subdomains), None,
                        mesh.mapping)
        inputs = Inputs(self.case, problem.cameras, lambda: (mesh, None))
        reference = ReferenceProblem(inputs, region, own, views, assemble_hessians(team, views), 0, ())
        self.assembly = assemble(team, reference, WEIGHTS)

    @contextmanager
    def step(self) -> Iterator[LinearStep]:
        """The step that the case asks for."""
        with PetscStack() as stack:
            solver = stack.keep(LinearSolver(self.team, self.case, self.assembly, PhaseClock()))
            solver.set_up()
            yield solver.step

    def solve(self, step: LinearStep) -> StepResult:
        """Solve with the problem's q and forces."""
        b = []
        for k, of_subdomain in zip(self.numbers, self.views, strict=True):
            parts = [view.weight * view.kinematics.project_vector(force)
                     for view, force in zip(of_subdomain, self.problem.forces[k], strict=True)]
            b.append(np.sum(parts, axis=0))
        q = Field(self.team, [self.problem.subdomains[k] for k in self.numbers],
                  [self.problem.q[k] for k in self.numbers])
        return step.solve(q, q.with_parts(b))

    def relative_error(self, dq: list[Array], reference: list[Array]) -> float:
        """Largest difference in any unknown over all ranks, relative to the largest unknown."""
        largest = max(float(np.abs(x - reference[k]).max()) for x, k in zip(dq, self.numbers, strict=True))
        return self.team.maximum(largest) / max(float(np.abs(x).max()) for x in reference)

    def motion_error(self, dq: list[Array], reference: list[Array]) -> float:
        """The same of the set-ups' motions alone, which are smaller than displacements."""
        n_dofs = [s.mesh.n_dofs for s in self.problem.subdomains]
        pairs = [(x[n_dofs[k]:], reference[k][n_dofs[k]:]) for x, k in zip(dq, self.numbers, strict=True)]
        largest = max(float(np.abs(a - b).max(initial=0.0)) for a, b in pairs)
        scale = max(float(np.abs(x[n:]).max(initial=0.0)) for x, n in zip(reference, n_dofs, strict=True))
        return self.team.maximum(largest) / scale


@cache
def saddle_point_solution(problem: NearFarStep, *, paper_weighting: bool = False) -> list[Array]:
    """dq of every subdomain by Eq. 21 of [BP17] with the gap of the whole region, one sparse LU.

    Unknowns are what each camera sees, v = u + R alpha before a near camera and u before the far one; alpha has no
    stiffness but its columns in the jumps: +R on rows oriented from near to far, -R from far to near. Where the far
    image is used under the near field as well, it sees v - R alpha. Interface rows of K add up over subdomains.
    """
    parts, mesh = problem.subdomains, problem.base.mesh
    first = np.concatenate([[0], np.cumsum([s.mesh.n_dofs for s in parts])])
    n_motion = [c.setup.n_motion_unknowns for c in problem.cameras]
    begin = first[-1] + np.concatenate([[0], np.cumsum(n_motion)])
    n = int(begin[-1])
    matrix, right = sparse.csr_matrix((n, n)), np.zeros(n)
    stiffness = sparse.csr_matrix((mesh.n_dofs, n))
    displacement, now = [], []
    for s, part in enumerate(parts):
        v = _selection(np.arange(first[s], first[s + 1]), n)
        motion = _selection(np.arange(begin[part.camera], begin[part.camera + 1]), n)
        rigid = sparse.csr_matrix(evaluate_motion(problem.cameras[part.camera].setup, part.mesh.nodes))
        u = v - rigid @ motion
        for camera, seen, force in zip((part.camera, 0), (v, u), problem.forces[s], strict=False):
            m, jacobian = assemble_texture(problem.cameras[camera], part.mesh)
            matrix = matrix + WEIGHTS[camera] * (seen.T @ m @ seen)
            right += WEIGHTS[camera] * (seen.T @ (jacobian.T @ force))
        if problem.base.eta:
            k = _stiffness(part.mesh)
            stiffness = stiffness + _selection(part.kinematics.numbers, mesh.n_dofs).T @ k @ v
        displacement.append(u)
        now.append(problem.q[s][:part.mesh.n_dofs])
    copies = np.concatenate([*now, np.zeros(n - first[-1])])
    if problem.base.eta:
        weights = problem.base.controlled / (np.sqrt(_sharing(problem)) if paper_weighting else 1.0)
        gap = sparse.diags(weights) @ stiffness
        matrix = matrix + problem.base.eta * (gap.T @ gap)
        right -= problem.base.eta * (gap.T @ (gap @ copies))
    jumps, jump_now = _jumps(problem, displacement, now)
    size = problem.base.mean_diagonal
    whole = sparse.bmat([[matrix / size, jumps.T], [jumps, None]]).tocsc()
    x = splu(whole).solve(np.concatenate([right / size, -jump_now]))[:n]
    return [np.concatenate([u @ x, x[begin[p.camera]: begin[p.camera + 1]]])
            for u, p in zip(displacement, parts, strict=True)]


def dense_operators(problem: NearFarStep) -> tuple[Array, Array]:
    """A and M of the one field and the motions, of the mesh's dofs and then each camera's alpha, in that order."""
    mesh = problem.base.mesh
    begin = mesh.n_dofs + np.concatenate([[0], np.cumsum([c.setup.n_motion_unknowns for c in problem.cameras])])
    n = int(begin[-1])
    texture, stiffness = np.zeros((n, n)), np.zeros((mesh.n_dofs, n))
    for part in problem.subdomains:
        u = _selection(part.kinematics.numbers, n).toarray()
        v = u.copy()
        motion = slice(begin[part.camera], begin[part.camera + 1])
        v[:, motion] += evaluate_motion(problem.cameras[part.camera].setup, part.mesh.nodes)
        seen = [(part.camera, v), (0, u)][:1 + bool(problem.use_far and part.camera)]
        texture += sum(WEIGHTS[c] * (w.T @ (assemble_texture(problem.cameras[c], part.mesh)[0] @ w)) for c, w in seen)
        stiffness[part.kinematics.numbers] += _stiffness(part.mesh) @ u
    gap = stiffness[problem.base.controlled]
    return texture + problem.base.eta * gap.T @ gap, texture


def _jumps(problem: NearFarStep, displacement: list[sparse.csr_matrix],
           now: list[Array]) -> tuple[sparse.csr_matrix, Array]:
    """Rows of the differences between copies of a node, each to the next subdomain's, and what they are now."""
    places: dict[int, list[tuple[int, int]]] = {}
    for s, part in enumerate(problem.subdomains):
        for local, node in enumerate(part.node_ids):
            places.setdefault(int(node), []).append((s, local))
    rows, values = [], []
    for copies in places.values():
        for (a, i), (b, j) in pairwise(copies):
            for axis in range(2):
                rows.append(displacement[a][2 * i + axis] - displacement[b][2 * j + axis])
                values.append(now[a][2 * i + axis] - now[b][2 * j + axis])
    return sparse.vstack(rows).tocsr(), np.array(values)


def _sharing(problem: NearFarStep) -> Array:
    """Number of subdomains at each dof of the mesh."""
    counts = np.zeros(problem.base.mesh.n_dofs)
    for part in problem.subdomains:
        counts[part.kinematics.numbers] += 1
    return counts


def _stiffness(mesh: Mesh) -> sparse.csr_matrix:
    """K, (n_dofs, n_dofs)."""
    return controlled_stiffness(NodalKinematics(mesh, np.arange(mesh.n_dofs)), Material(), np.ones(mesh.n_dofs))


def _selection(places: NDArray[np.int64], n: int) -> sparse.csr_matrix:
    return sparse.csr_matrix((np.ones(len(places)), (np.arange(len(places)), places)), shape=(len(places), n))
