"""The MPI part of bench/local_inverse.py: a subdomain with neighbours on all sides, alone on rank 0 of two.

Argument: JSON with "case", "elements" (per side of that subdomain), "ring" (elements across its neighbours, which
rank 1 holds) and "kind" (solver.local_inverse). Rank 0 prints one JSON line about itself.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.schema import Case, SolverSection
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.parallel.team import Team
from ddic.partition.connectivity import build_subdomains
from ddic.problem.assembly import Assembly, assemble, correlate, factorize, own_parts
from ddic.problem.inputs import Region, open_pair, region_gap_energies
from ddic.problem.linear_solver import linear_step
from ddic.problem.mesh_source import build_mesh

TEAM = Team(MPI.COMM_WORLD)
PAGE = resource.getpagesize()


def peak() -> int:
    """Largest resident memory of this process so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def resident() -> int:
    """Resident memory of this process, bytes."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * PAGE


def nine_parts(mesh: Mesh, elements: int, ring: int) -> NDArray[np.int64]:
    """Subdomain of each cell: 0 in the middle, 1 to 8 around it."""
    band = np.repeat([1, 0, 2], [ring, elements, ring])
    return (3 * band[:, None] + band).ravel()


def assembled(case: Case, elements: int, ring: int) -> Assembly:
    """The middle subdomain on rank 0, its neighbours on rank 1."""
    pair = open_pair(case)
    mesh = build_mesh(case, pair.reference.image.width, pair.reference.image.height)
    inside = np.ones(mesh.n_nodes, dtype=bool)
    inside[find_boundary_nodes(mesh)] = False
    subdomains = build_subdomains(mesh, nine_parts(mesh, elements, ring), np.repeat(inside, mesh.dim))
    subdomains = subdomains[:1] if TEAM.is_root else subdomains[1:]
    gap = region_gap_energies(case.regularization, mesh)
    region = Region(mesh.n_nodes, mesh.n_cells, mesh.n_dofs, 9, gap, mesh.mapping)
    parts = own_parts(subdomains, pair, case.correlation.spline_degree)
    return assemble(TEAM, parts, correlate(TEAM, parts), region, case.solver, case.regularization)


def main(job: dict[str, object]) -> None:
    case = Case.model_validate(job["case"])
    assembly = assembled(case, int(str(job["elements"])), int(str(job["ring"])))
    before = resident()
    operators = factorize(TEAM, assembly.systems, assembly.mean_diagonal)
    factorized = resident()
    solver = SolverSection(subdomains=9, preconditioner="two_level", local_inverse=str(job["kind"]), recycle=False)
    TEAM.comm.barrier()
    clock = time.perf_counter()
    step, _ = linear_step(TEAM, solver, assembly, operators)
    set_up = time.perf_counter() - clock
    highest = peak()
    rng = np.random.default_rng(TEAM.rank)
    zero = [np.zeros(s.hessian.shape[0]) for s in assembly.systems]
    clock = time.perf_counter()
    result = step.solve(zero, [s.hessian @ rng.normal(size=s.hessian.shape[0]) for s in assembly.systems])
    solve = time.perf_counter() - clock
    step.destroy()
    for operator in operators:
        operator.destroy()
    if TEAM.is_root:
        part = assembly.systems[0].subdomain
        print(json.dumps({
            "n_dofs": part.mesh.n_dofs, "n_interface": len(part.displacement.dofs) + len(part.reaction.dofs),
            "peak_bytes": highest, "before_factorization_bytes": before, "factorized_bytes": factorized,
            "set_up_seconds": set_up, "iterations": result.krylov_iterations,
            "seconds_per_iteration": solve / max(result.krylov_iterations, 1)}), flush=True)


main(json.loads(sys.argv[1]))
