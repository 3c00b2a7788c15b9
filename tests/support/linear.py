"""One linear step of Gauss-Newton on random data: one domain, and the same cut into subdomains."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from ddic.functionals.correlation import read_correlation
from ddic.functionals.regularization import Material, controlled_stiffness
from ddic.images.sub_image import MaskedSource
from ddic.kinematics.kinematics import RegionKinematics
from ddic.kinematics.nodal import NodalKinematics, NodalRegion
from ddic.mesh.cell_type import TET4
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.parallel.distribution import split_evenly
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.split import split_by_blocks, split_by_metis
from ddic.partition.subdomain import Subdomain, Weighting, interface_weights
from ddic.solvers.dual.dual_problem import DualProblem, LocalDual
from ddic.solvers.dual.dual_step import DualSettings, DualStep
from ddic.solvers.exchange import Exchange
from ddic.solvers.linear_step import AllowedError, LinearStep, StepResult
from ddic.solvers.local_system import LocalOperator, LocalSystem, MonolithicStep
from support.oracles import make_on_root
from support.pictures import source
from support.random_meshes import WAYS
from support.sharers import count_sharers

CELL = 8.0


@dataclass(frozen=True)
class StepProblem:
    """The data of one linear step on the whole mesh.

    region: its unknowns; controlled: (n_unknowns,); eta, 0 without regularization; q, b: (n_unknowns,), random.
    stiffness_scale: factor of K, as another unit of Young's modulus would bring it.
    """

    region: RegionKinematics
    image: MaskedSource
    controlled: NDArray[np.bool_]
    eta: float
    q: NDArray[np.float64]
    b: NDArray[np.float64]
    mean_diagonal: float
    stiffness_scale: float = 1.0

    @property
    def mesh(self) -> Mesh:
        """The whole mesh."""
        return self.region.mesh

    @property
    def scale(self) -> float:
        """c, which gives Lambda and LambdaBar one unit."""
        return 1.0 if self.eta == 0 else float(1.0 / np.sqrt(self.eta * self.mean_diagonal))

    def system(self, subdomain: Subdomain, weights: NDArray[np.float64]) -> LocalSystem:
        """M_s and the weighted Kbar_s of one subdomain; weights: of its rows, (n_field,)."""
        kinematics = subdomain.kinematics
        hessian = kinematics.project_matrix(read_correlation(subdomain.mesh, self.image, 3).assemble_hessian())
        if self.eta == 0:
            return LocalSystem(subdomain, hessian, None, np.zeros(0), 0.0)
        weights = weights * subdomain.controlled
        material = Material.default(subdomain.mesh.dim)
        kbar = controlled_stiffness(kinematics, material, self.stiffness_scale * weights)
        return LocalSystem(subdomain, hessian, kbar, weights, self.eta)

    def with_unknowns(self, region: RegionKinematics) -> StepProblem:
        """The same texture and mechanics with other unknowns, and a random q and b of theirs."""
        rng = np.random.default_rng(1)
        nodes = self.controlled.reshape(self.mesh.nodes.shape).all(axis=1)
        controlled = region.controlled(nodes) & (self.eta > 0)
        problem = replace(self, region=region, controlled=controlled)
        n = region.n_unknowns
        whole = build_subdomains(region, np.zeros(self.mesh.n_cells, np.int64), controlled)[0]
        diagonal = problem.system(whole, np.ones(n)).hessian.diagonal()
        return replace(problem, q=rng.normal(size=n), b=diagonal * rng.normal(size=n))


Kind = Literal["Q4", "Hex8", "Tet4"]
FIRST = {2: (20.3, 20.7), 3: (12.3, 12.7, 12.1)}
"""Where the cells begin, px, by dimension; as much is left beyond them."""


@cache
def linear_step(n: int = 16, wavelength: float | None = None, kind: Kind = "Q4") -> StepProblem:
    """n slightly distorted cells of 8 px along each axis; wavelength (px): where texture and mechanics count alike."""
    rng = np.random.default_rng(0)
    first = FIRST[2 if kind == "Q4" else 3]
    noise = ndimage.gaussian_filter(rng.normal(size=(int(CELL * n + 2 * first[0]),) * len(first)), 1.5)
    image = source(noise / noise.std() * 50 + 128)
    grid = GridLines(tuple(begin + CELL * np.arange(n + 1) for begin in first))
    nodes = grid.nodes + rng.uniform(-1, 1, (grid.n_nodes, grid.dim))
    cells = {TET4: grid.cells[:, WAYS].reshape(-1, 4)} if kind == "Tet4" else {grid.cell_type: grid.cells}
    mesh = build_mesh(nodes, cells)
    inside = np.ones(mesh.n_nodes, dtype=bool)
    inside[find_boundary_nodes(mesh)] = False
    controlled = np.repeat(inside, mesh.dim) if wavelength else np.zeros(mesh.n_dofs, dtype=bool)
    part = read_correlation(mesh, image, 3)
    hessian = part.assemble_hessian()
    eta = 0.0
    if wavelength:
        wave = np.zeros(mesh.n_dofs)
        wave[::mesh.dim] = np.cos(2 * np.pi * mesh.nodes[:, 1] / wavelength)
        whole = NodalKinematics(mesh, np.arange(mesh.n_dofs))
        force = controlled_stiffness(whole, Material.default(mesh.dim), controlled.astype(float)) @ wave
        eta = float(wave @ hessian @ wave / (force @ force))
    diagonal = hessian.diagonal()
    return StepProblem(NodalRegion(mesh), image, controlled, eta, rng.normal(size=mesh.n_dofs),
                      diagonal * rng.normal(size=mesh.n_dofs), float(diagonal.mean()))


def split(mesh: Mesh, kind: str, n_subdomains: int) -> NDArray[np.int64]:
    """Blocks (a square, or cubic, number of them) or METIS."""
    side = round(n_subdomains ** (1 / mesh.dim))
    return split_by_blocks(mesh, (side,) * mesh.dim) if kind == "blocks" else split_by_metis(mesh, n_subdomains)


def one_domain_solution(problem: StepProblem, parts: NDArray[np.int64], weighting: Weighting) -> NDArray[np.float64]:
    """dq of the monolithic step; "paper" weights the interface rows of Kbar by 1/sqrt(m); collective."""
    return make_on_root(lambda: _solve_one_domain(problem, parts, weighting))


def _solve_one_domain(problem: StepProblem, parts: NDArray[np.int64], weighting: Weighting) -> NDArray[np.float64]:
    whole = build_subdomains(problem.region, np.zeros(problem.mesh.n_cells, np.int64), problem.controlled)[0]
    m = count_sharers(problem.region, parts)
    system = problem.system(whole, 1 / np.sqrt(m) if weighting == "paper" else np.ones(len(m)))
    operator = LocalOperator(system.operator, smallest_eigenvalue=0, where="whole mesh")
    try:
        q = Field(Team.alone(), [whole], [problem.q])
        return MonolithicStep(system, operator).solve(q, q.with_parts([problem.b])).dq[0]
    finally:
        operator.destroy()


class Decomposed:
    """The same step cut into subdomains, of which this rank owns some; use it in a ``with`` statement."""

    def __init__(self, team: Team, problem: StepProblem, parts: NDArray[np.int64], weighting: Weighting) -> None:
        self.team, self.problem = team, problem
        everything = build_subdomains(problem.region, parts, problem.controlled)
        self.subdomains = [everything[s] for s in split_evenly(np.ones(len(everything)), team.size)[team.rank]]
        self.systems = [problem.system(s, interface_weights(s.multiplicity, weighting)) for s in self.subdomains]
        self.operators = [LocalOperator(s.operator, smallest_eigenvalue=0, where="part") for s in self.systems]
        self.numbers = [s.numbers for s in self.subdomains]
        self._held: list[DualStep | DualProblem] = []

    def __enter__(self) -> Decomposed:
        return self

    def __exit__(self, *_: object) -> None:
        for thing in (*self._held, *self.operators):
            thing.destroy()

    def step(self, settings: DualSettings) -> DualStep:
        """The dual step on all ranks."""
        step = DualStep(self.team, self.systems, self.operators, self.problem.scale, settings)
        self._held.append(step)
        return step

    def interface(self) -> tuple[Exchange, list[LocalDual]]:
        """The operators that the dual step is made of."""
        problem = self.dual_problem()
        return problem.exchange, problem.local_duals

    def dual_problem(self) -> DualProblem:
        """The interface problem, freed at the end."""
        problem = DualProblem(self.team, self.systems, self.operators, self.problem.scale)
        self._held.append(problem)
        return problem

    def solve(self, step: LinearStep, b: NDArray[np.float64] | None = None,
              allowed: AllowedError | None = None) -> StepResult:
        """Solve with the problem's q and b (or another b), a shared unknown's b spread over its copies."""
        b = self.problem.b if b is None else b
        shares = [b[d] / s.multiplicity for d, s in zip(self.numbers, self.subdomains, strict=True)]
        q = self.field(self.problem.q[d] for d in self.numbers)
        return step.solve(q, self.field(shares), allowed)

    def field(self, parts: Iterable[NDArray[np.float64]]) -> Field:
        """A field from its parts."""
        return Field(self.team, self.subdomains, parts)

    def relative_error(self, dq: Sequence[NDArray[np.float64]], reference: NDArray[np.float64]) -> float:
        """Largest difference over all ranks relative to the largest unknown."""
        largest = max(float(np.abs(x - reference[d]).max()) for x, d in zip(dq, self.numbers, strict=True))
        return float(self.team.maximum(largest) / np.abs(reference).max())

    def rms_error(self, dq: Sequence[NDArray[np.float64]], reference: NDArray[np.float64]) -> float:
        """RMS difference over nodes, every node counted once, pixels."""
        squares = 0.0
        for x, d, s in zip(dq, self.numbers, self.subdomains, strict=True):
            error = s.displacement(x - reference[d]).reshape(s.mesh.nodes.shape)
            squares += float((error**2 / s.node_multiplicity[:, None]).sum())
        return float(np.sqrt(self.team.sum(squares) / self.problem.mesh.n_nodes))


def dense(matrix: sparse.spmatrix) -> NDArray[np.float64]:
    """A sparse matrix as an array."""
    return np.asarray(matrix.toarray())
