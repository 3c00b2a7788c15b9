"""One linear step of Gauss-Newton on random data: one domain, and the same cut into subdomains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import ndimage, sparse

from ddic.functionals.correlation import correlation
from ddic.functionals.elasticity import Material
from ddic.functionals.equilibrium_gap import controlled_stiffness
from ddic.images.sub_image import MaskedSource
from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import Mesh, mesh_from_cells
from ddic.mesh.topology import boundary_nodes
from ddic.parallel.distribution import split_evenly
from ddic.parallel.team import Team
from ddic.partition.connectivity import build_subdomains, node_sharing
from ddic.partition.split import split_by_blocks, split_by_metis
from ddic.partition.subdomain import Subdomain, Weighting, interface_weights
from ddic.solvers.dual.dual_step import DualSettings, DualStep
from ddic.solvers.dual.local_dual import LocalDual, local_dual
from ddic.solvers.exchange import Exchange
from ddic.solvers.linear_step import Leave, StepResult
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.monolithic import MonolithicStep
from support.pictures import source

CELL = 8.0


@dataclass(frozen=True)
class LinearStep:
    """The data of one linear step on the whole mesh.

    controlled: (n_dofs,); eta, 0 without regularization; q, b: (n_dofs,), random.
    stiffness_scale: factor of K, as another unit of Young's modulus would bring it.
    """

    mesh: Mesh
    image: MaskedSource
    controlled: NDArray[np.bool_]
    eta: float
    q: NDArray[np.float64]
    b: NDArray[np.float64]
    mean_diagonal: float
    stiffness_scale: float = 1.0

    @property
    def scale(self) -> float:
        """c, which gives Lambda and LambdaBar one unit."""
        return 1.0 if self.eta == 0 else float(1.0 / np.sqrt(self.eta * self.mean_diagonal))

    def system(self, subdomain: Subdomain, weights: NDArray[np.float64]) -> LocalSystem:
        """M_s and the weighted Kbar_s of one subdomain; weights: of its rows, (n_dofs,)."""
        part = correlation(subdomain.mesh, self.image, 3)
        if self.eta == 0:
            return LocalSystem(subdomain, part.hessian(), None, np.zeros(0), 0.0)
        weights = weights * subdomain.controlled
        kbar = controlled_stiffness(subdomain.mesh, part.kinematics, Material(), self.stiffness_scale * weights)
        return LocalSystem(subdomain, part.hessian(), kbar.tocsr(), weights, self.eta)


@cache
def linear_step(n: int = 16, wavelength: float | None = None) -> LinearStep:
    """n x n slightly distorted Q4 of 8 px; wavelength (px): where texture and mechanics count alike."""
    rng = np.random.default_rng(0)
    side = int(CELL * n) + 40
    noise = ndimage.gaussian_filter(rng.normal(size=(side, side)), 1.5)
    image = source(noise / noise.std() * 50 + 128)
    x, y = np.meshgrid(20.3 + CELL * np.arange(n + 1), 20.7 + CELL * np.arange(n + 1))
    nodes = np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(-1, 1, (x.size, 2))
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    mesh = mesh_from_cells(nodes, {Q4: np.stack([corner, corner + 1, corner + n + 2, corner + n + 1], axis=1)})
    inside = np.ones(mesh.n_nodes, dtype=bool)
    inside[boundary_nodes(mesh)] = False
    controlled = np.repeat(inside, 2) if wavelength else np.zeros(mesh.n_dofs, dtype=bool)
    part = correlation(mesh, image, 3)
    hessian = part.hessian()
    eta = 0.0
    if wavelength:
        wave = np.zeros(mesh.n_dofs)
        wave[::2] = np.cos(2 * np.pi * mesh.nodes[:, 1] / wavelength)
        force = controlled_stiffness(mesh, part.kinematics, Material(), controlled.astype(float)) @ wave
        eta = float(wave @ hessian @ wave / (force @ force))
    diagonal = hessian.diagonal()
    return LinearStep(mesh, image, controlled, eta, rng.normal(size=mesh.n_dofs),
                      diagonal * rng.normal(size=mesh.n_dofs), float(diagonal.mean()))


def split(mesh: Mesh, kind: str, n_subdomains: int) -> NDArray[np.int64]:
    """Blocks (a square number of them) or METIS."""
    side = round(n_subdomains**0.5)
    return split_by_blocks(mesh, (side, side)) if kind == "blocks" else split_by_metis(mesh, n_subdomains)


def one_domain_solution(problem: LinearStep, parts: NDArray[np.int64], weighting: Weighting) -> NDArray[np.float64]:
    """dq of the monolithic step; "paper" weights the interface rows of Kbar by 1/sqrt(m)."""
    whole = build_subdomains(problem.mesh, np.zeros(problem.mesh.n_cells, np.int64), problem.controlled)[0]
    m = np.repeat(node_sharing(problem.mesh, parts).multiplicity, 2)
    system = problem.system(whole, 1 / np.sqrt(m) if weighting == "paper" else np.ones(len(m)))
    operator = LocalOperator(system.operator, smallest_eigenvalue=0, where="whole mesh")
    try:
        return MonolithicStep(system, operator).solve([problem.q], [problem.b]).dq[0]
    finally:
        operator.destroy()


class Decomposed:
    """The same step cut into subdomains, of which this rank owns some; use it in a ``with`` statement."""

    def __init__(self, comm: MPI.Comm, problem: LinearStep, parts: NDArray[np.int64], weighting: Weighting) -> None:
        self.comm, self.problem = comm, problem
        everything = build_subdomains(problem.mesh, parts, problem.controlled)
        self.subdomains = [everything[s] for s in split_evenly(np.ones(len(everything)), comm.size)[comm.rank]]
        self.systems = [problem.system(s, interface_weights(s.dof_multiplicity, weighting)) for s in self.subdomains]
        self.operators = [LocalOperator(s.operator, smallest_eigenvalue=0, where="part") for s in self.systems]
        self.dofs = [s.dofs for s in self.subdomains]
        self._steps: list[DualStep] = []

    def __enter__(self) -> Decomposed:
        return self

    def __exit__(self, *_: object) -> None:
        for thing in (*self._steps, *self.operators):
            thing.destroy()

    def step(self, settings: DualSettings) -> DualStep:
        """The dual step on all ranks."""
        step = DualStep(Team(self.comm), self.systems, self.operators, self.problem.scale, settings)
        self._steps.append(step)
        return step

    def interface(self) -> tuple[Exchange, list[LocalDual]]:
        """The operators that the dual step is made of."""
        needed = [_rows(s) for s in self.subdomains]
        exchange = Exchange(self.comm, sum(s.n_owned_rows for s in self.subdomains), needed)
        return exchange, [local_dual(s, a, exchange.ghosts, self.problem.scale)
                          for s, a in zip(self.systems, self.operators, strict=True)]

    def solve(self, step: DualStep, b: NDArray[np.float64] | None = None, leave: Leave | None = None) -> StepResult:
        """Solve with the problem's q and b (or another b), a shared dof's b spread over its copies."""
        b = self.problem.b if b is None else b
        shares = [b[d] / s.dof_multiplicity for d, s in zip(self.dofs, self.subdomains, strict=True)]
        return step.solve([self.problem.q[d] for d in self.dofs], shares, leave)

    def relative_error(self, dq: Sequence[NDArray[np.float64]], reference: NDArray[np.float64]) -> float:
        """Largest difference over all ranks relative to the largest displacement."""
        largest = max(float(np.abs(x - reference[d]).max()) for x, d in zip(dq, self.dofs, strict=True))
        return float(Team(self.comm).comm.allreduce(largest, op=MPI.MAX) / np.abs(reference).max())

    def rms_error(self, dq: Sequence[NDArray[np.float64]], reference: NDArray[np.float64]) -> float:
        """RMS difference over nodes, every node counted once, pixels."""
        squares = sum(((x - reference[d])**2 / s.dof_multiplicity).sum()
                      for x, d, s in zip(dq, self.dofs, self.subdomains, strict=True))
        return float(np.sqrt(2 * self.comm.allreduce(squares, op=MPI.SUM) / len(reference)))


def _rows(subdomain: Subdomain) -> NDArray[np.int64]:
    interfaces = (subdomain.displacement, subdomain.reaction)
    return np.concatenate([np.concatenate([first + np.arange(m - 1) for first, m in
                                           zip(i.first_row, i.multiplicity, strict=True)] or [np.zeros(0, np.int64)])
                           for i in interfaces])


def dense(matrix: sparse.spmatrix) -> NDArray[np.float64]:
    """A sparse matrix as an array."""
    return np.asarray(matrix.toarray())
