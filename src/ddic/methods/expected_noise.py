"""Noise that a case's displacement is expected to carry, computed on one domain."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.schema import Case, SolverSection
from ddic.parallel.team import Team
from ddic.problem.assembly import assemble, correlate, factorize, own_parts
from ddic.problem.inputs import open_pair, share_out
from ddic.problem.mesh_source import build_mesh
from ddic.solvers.noise_floor import expected_noise_rms


def expected_noise(case: Case, sigma: float, nodes: NDArray[np.bool_]) -> float:
    """RMS displacement noise per component over chosen nodes, pixels, on one rank.

    sigma: standard deviation of the camera noise of both images, grey levels; nodes: (n_nodes,) of the mesh.
    Covariance 2 sigma^2 A^-1 M A^-1 with A = M + eta Kbar^T Kbar of the whole region.
    """
    alone = Team(MPI.COMM_SELF)
    case = case.model_copy(update={"solver": SolverSection(method="monolithic")})
    pair = open_pair(case)
    mesh = build_mesh(case, pair.reference.image.width, pair.reference.image.height)
    subdomains, region = share_out(alone, case, mesh)
    parts = own_parts(subdomains, pair, case.correlation.spline_degree)
    assembly = assemble(alone, parts, correlate(alone, parts), region, case.solver, case.regularization)
    operator = factorize(alone, assembly.systems, assembly.mean_diagonal)[0]
    try:
        return expected_noise_rms(assembly.systems[0], operator, sigma, np.repeat(nodes, mesh.dim))
    finally:
        operator.destroy()
