"""One linear step on a near mesh that does not match the far one, and the saddle point with multipliers it solves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
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
from ddic.mesh.structured import build_structured_mesh
from ddic.parallel.distribution import split_evenly
from ddic.parallel.field import Field
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.ties import Tying, tie_meshes
from ddic.problem.assembly import assemble
from ddic.problem.linear_solver import LinearSolver
from ddic.problem.reference_problem import ReferenceProblem, assemble_hessians, read_reference_views, weigh_cameras
from ddic.problem.region_mesh import build_region_mesh, scatter_region, split_region
from ddic.solvers.linear_step import LinearStep, StepResult
from ddic.solvers.petsc import PetscStack
from support.near_camera import RATIO, assemble_texture, evaluate_motion, set_up_over_box, speckle

Array = NDArray[np.float64]
Layout = Literal["island", "edge"]

FAR = (20.0, 20.0, 116.0, 116.0)
NEAR: dict[Layout, tuple[float, float, float, float]] = {
    "island": (44.0, 36.0, 84.0, 76.0), "edge": (60.0, 20.0, 100.0, 60.0)}
FAR_ELEMENT = 8.0
WEIGHTS = (1.0, 0.37)


@dataclass(frozen=True, eq=False)
class TiedStep:
    """The data of one linear step.

    mesh, tying: far and near mesh; q: (n_unknown_dofs,) and the motion, random; forces: of each camera on the nodes of
    its mesh, (n_dofs,), in its pixels, unweighted.
    """

    layout: Layout
    motion: MotionKind
    eta: float
    mesh: Mesh
    tying: Tying
    cameras: tuple[Camera, ...]
    q: Array
    forces: tuple[Array, Array]

    def case(self, **solver: Any) -> Case:
        """What asks for it; solver: keys of [solver], the dual method by default."""
        near = NearSection(reference=Path("f"), deformed=Path("g"), ratio=RATIO, offset=(0.0, 0.0),
                           mesh=MeshSection(structured=StructuredSection(region=NEAR[self.layout], element_size=3)))
        return Case(images=ImagesSection(reference=Path("f"), deformed=Path("g")), near=(near,),
                    mesh=MeshSection(structured=StructuredSection(region=FAR, element_size=FAR_ELEMENT)),
                    regularization=RegularizationSection(eta=self.eta, edge_wavelength=0) if self.eta else None,
                    solver=SolverSection(**{"method": "dual"} | solver))

@cache
def tied_step(layout: Layout, motion: MotionKind, near_element: float | None = 3.1, *, regularized: bool,
              cell: Literal["Q4", "T3"] = "Q4") -> TiedStep:
    """12 x 12 far cells, of which 5 x 5 make way for a near mesh of elements of another size (None: the same)."""
    far = build_structured_mesh(FAR, FAR_ELEMENT)
    low, high = np.array(NEAR[layout][:2]), np.array(NEAR[layout][2:])
    own = build_structured_mesh(NEAR[layout], near_element or FAR_ELEMENT, cell)
    mesh, tying = tie_meshes(far, {1: own})
    still = CameraSetup(identity(), "none", np.zeros(2), 1.0)
    cameras = (Camera(0, speckle(0, 140), still, None), _near_camera(low, high, motion))
    rng = np.random.default_rng(7)
    n = 2 * tying.n_unknown_nodes + cameras[1].setup.n_motion_unknowns
    forces = tuple(1e4 * rng.normal(size=mesh.n_dofs) for _ in range(2))
    # Where a wave of some 30 px has as much texture as mechanics.
    return TiedStep(layout, motion, 3e5 if regularized else 0.0, mesh, tying, cameras, rng.normal(size=n),
                    (forces[0], forces[1]))


def _near_camera(low: Array, high: Array, motion: MotionKind) -> Camera:
    """A camera whose image shows the box and some pixels around it, a little turned and tilted."""
    setup, side = set_up_over_box(low, high, motion, 0.05)
    return Camera(1, speckle(1, side), setup, None, has_own_mesh=True)


class TiedCut:
    """The step on the ranks of a communicator, as the method sets it up."""

    def __init__(self, team: Team, problem: TiedStep, **solver: Any) -> None:
        self.team, self.problem, self.case = team, problem, problem.case(**solver)
        inputs = Inputs(self.case, problem.cameras, lambda: (problem.mesh, problem.tying))
        whole = build_region_mesh(inputs)
        everything = scatter_region(Team.alone(), inputs, whole, split_region(whole, team.size))[0]
        self.subdomains = [everything[k] for k in split_evenly(np.ones(len(everything)), team.size)[team.rank]]
        # Subdomains at each mesh node, none of which is of two cameras.
        self.copies = np.zeros(problem.mesh.n_nodes)
        for subdomain in everything:
            self.copies[subdomain.node_ids] += 1
        views = read_reference_views(self.case, problem.cameras, self.subdomains)
        self.views = weigh_cameras(views, WEIGHTS)
        reference = ReferenceProblem(inputs, whole.describe(len(everything)), self.subdomains, views,
                                     assemble_hessians(team, views), 0, ())
        self.assembly = assemble(team, reference, WEIGHTS)

    @contextmanager
    def step(self) -> Iterator[LinearStep]:
        """The step that the case asks for."""
        with PetscStack() as stack:
            solver = stack.keep(LinearSolver(self.team, self.case, self.assembly, PhaseClock()))
            solver.set_up()
            yield solver.step

    def solve(self, step: LinearStep) -> StepResult:
        """Solve with the problem's q and forces, those of a shared mesh node spread over its copies."""
        q, b = [], []
        for s, (own, *_) in zip(self.subdomains, self.views, strict=True):
            q.append(self.problem.q[s.numbers])
            nodal = self.problem.forces[s.camera].reshape(-1, 2) / np.maximum(self.copies, 1)[:, None]
            b.append(own.weight * own.kinematics.project_vector(nodal[s.node_ids].ravel()))
        start = Field(self.team, self.subdomains, q)
        return step.solve(start, start.with_parts(b))

    def relative_error(self, dq: list[Array], reference: tuple[Array, Array]) -> float:
        """Largest difference of displacements of mesh nodes and motions, relative to the largest of them."""
        u, motion = reference
        largest = 0.0
        for x, s in zip(dq, self.subdomains, strict=True):
            found = s.displacement(x).reshape(-1, 2) - u.reshape(-1, 2)[s.node_ids]
            largest = max(largest, float(np.abs(found).max()))
            if s.motion is not None:
                largest = max(largest, float(np.abs(x[s.n_field:] - motion).max()))
        size = max(float(np.abs(u).max()), float(np.abs(motion).max()))
        return self.team.maximum(largest) / size


@cache
def multiplier_solution(problem: TiedStep) -> tuple[Array, Array]:
    """Displacement of all mesh nodes (n_dofs,) and the motion, by one sparse LU with a multiplier for each slave.

    The tie is what a quadrature of many points says of int psi_i (u_near - u_far) = 0, unknowns are those of all nodes;
    a controlled row adds to the forces on its node those on the slaves that move with it.
    """
    mesh, n_free = problem.mesh, 2 * problem.tying.n_unknown_nodes
    n_motion = problem.cameras[1].setup.n_motion_unknowns
    n = mesh.n_dofs + n_motion
    matrix, right = sparse.csr_matrix((n, n)), np.zeros(n)
    for number, camera in enumerate(problem.cameras):
        part, ids = mesh.create_submesh(np.flatnonzero(problem.tying.cameras == number))
        dofs = (ids[:, None] * 2 + np.arange(2)).ravel()
        m, jacobian = assemble_texture(camera, part)
        rigid = np.zeros((part.n_dofs, n_motion))
        if number:
            rigid = evaluate_motion(camera.setup, part.nodes)
        pick = sparse.csr_matrix((np.ones(len(dofs)), (np.arange(len(dofs)), dofs)), shape=(len(dofs), mesh.n_dofs))
        seen = sparse.hstack([pick, sparse.csr_matrix(rigid)])
        matrix = matrix + WEIGHTS[number] * (seen.T @ m @ seen)
        right += WEIGHTS[number] * (seen.T @ jacobian.T @ problem.forces[number].reshape(-1, 2)[ids].ravel())
    jumps = sparse.kron(sparse.csr_matrix(_jumps(problem)), sparse.identity(2)).tocsr()
    slaves = _solved(jumps, n_free)
    if problem.eta:
        k = controlled_stiffness(NodalKinematics(mesh, np.arange(mesh.n_dofs)), Material(), np.ones(mesh.n_dofs))
        inside = np.ones((n_free // 2, 2))
        inside[problem.tying.boundary[problem.tying.boundary < n_free // 2]] = 0.0
        gap = sparse.diags(inside.ravel()) @ slaves.T @ k
        gap = sparse.hstack([gap, sparse.csr_matrix((n_free, n_motion))])
        matrix = matrix + problem.eta * (gap.T @ gap)
        now = np.concatenate([slaves @ problem.q[:n_free], np.zeros(n_motion)])
        right -= problem.eta * (gap.T @ (gap @ now))
    size = float(np.abs(matrix.diagonal()).mean())
    constraint = sparse.hstack([jumps, sparse.csr_matrix((jumps.shape[0], n_motion))])
    whole = sparse.bmat([[matrix / size, constraint.T], [constraint, None]]).tocsc()
    x = splu(whole).solve(np.concatenate([right / size, np.zeros(jumps.shape[0])]))
    return x[:mesh.n_dofs], x[mesh.n_dofs: n]


def _solved(jumps: sparse.csr_matrix, n_free: int) -> sparse.csr_matrix:
    """Map from free dofs to all, the constraints solved for the slaves: (n_dofs, n_free)."""
    dense = jumps.toarray()
    return sparse.vstack([sparse.identity(n_free), sparse.csr_matrix(
        -np.linalg.solve(dense[:, n_free:], dense[:, :n_free]))]).tocsr()


def _jumps(problem: TiedStep) -> Array:
    """Rows of int psi_i (u_near - u_far), (n_slaves, n_nodes); of the corners, u_near - u_far there."""
    mesh, (x0, y0, x1, y1) = problem.mesh, NEAR[problem.layout]
    first = problem.tying.n_unknown_nodes
    rows = np.zeros((mesh.n_nodes - first, mesh.n_nodes))
    sides = [((x0, y0), (x0, y1)), ((x1, y0), (x1, y1)), ((x0, y1), (x1, y1)), ((x0, y0), (x1, y0))]
    far_nodes = np.unique(mesh.connectivity[np.repeat(problem.tying.cameras == 0, np.diff(mesh.offsets))])
    for begin, end in sides[:4 if problem.layout == "island" else 3]:
        a, span = np.array(begin), np.array(end) - np.array(begin)
        chains = []
        for nodes in (np.arange(first, mesh.n_nodes), far_nodes):
            t = (mesh.nodes[nodes] - a) @ span / (span @ span)
            distance = np.linalg.norm(a + t[:, None] * span - mesh.nodes[nodes], axis=1)
            on = (distance < 1e-9) & (np.abs(t - 0.5) < 0.5 + 1e-9)
            order = np.argsort(t[on])
            chains.append((nodes[on][order], t[on][order]))
        (near, at_near), (far, at_far) = chains
        for point, weight in zip(*_points(np.union1d(at_near, at_far)), strict=True):
            e = min(max(int(np.searchsorted(at_near, point)) - 1, 0), len(near) - 2)
            share = (point - at_near[e]) / (at_near[e + 1] - at_near[e])
            psi = [2 - 3 * share, 3 * share - 1]
            if e == 0 or e == len(near) - 2:
                psi = [0.0 if e == 0 else 1.0, 1.0 if e == 0 else 0.0]
            hats_near = np.zeros(mesh.n_nodes)
            hats_near[near[e]], hats_near[near[e + 1]] = 1 - share, share
            hats_far = np.zeros(mesh.n_nodes)
            f = min(max(int(np.searchsorted(at_far, point)) - 1, 0), len(far) - 2)
            s = (point - at_far[f]) / (at_far[f + 1] - at_far[f])
            hats_far[far[f]], hats_far[far[f + 1]] = 1 - s, s
            for k in range(2):
                rows[near[e + k] - first] += weight * psi[k] * (hats_near - hats_far)
        for k in (0, -1):
            rows[near[k] - first] = 0.0
            rows[near[k] - first, [near[k], far[k]]] = 1.0, -1.0
    return rows


def _points(cuts: Array) -> tuple[Array, Array]:
    """Three Gauss points between neighbouring cuts, and their weights."""
    place, weight = np.polynomial.legendre.leggauss(3)
    wide = [(low, high) for low, high in pairwise(cuts) if high - low > 1e-12]
    return (np.concatenate([low + (high - low) * (place + 1) / 2 for low, high in wide]),
            np.concatenate([(high - low) / 2 * weight for low, high in wide]))
