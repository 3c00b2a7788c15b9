"""Noise that a case's displacement is expected to carry, computed on one domain."""

from dataclasses import replace

import numpy as np

from ddic.arrays import BoolArray
from ddic.case.schema import Case, SolverSection
from ddic.inputs.cameras import open_cameras
from ddic.inputs.inputs import Inputs
from ddic.inputs.mesh_source import build_meshes
from ddic.io.image_file import open_image
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.reference_problem import build_whole_mesh, prepare_reference
from ddic.problem.weighted_problem import WeightedProblem
from ddic.solvers.local_system import MonolithicStep
from ddic.solvers.probing import estimate_noise_rms


def expected_noise(case: Case, sigma: float, nodes: BoolArray) -> float:
    """Predict the RMS displacement noise per component over chosen nodes, pixels, on one rank.

    Covariance 2 sigma^2 A^-1 M A^-1 with A = M + eta Kbar^T Kbar of the whole region. The case has absolute paths and
    one camera; ``sigma`` is the standard deviation of the camera noise of both images, grey levels; ``nodes`` are those
    of the mesh that are chosen, (n_nodes,). Raises InputError or SingularSubdomainError where the case cannot be set
    up.
    """
    cameras = open_cameras(case, open_image)
    image = cameras[0].reference.image
    inputs = Inputs(case, cameras, lambda: build_meshes(case, image.width, image.height))
    return estimate_nodal_noise(inputs, sigma, nodes)


def estimate_nodal_noise(inputs: Inputs, sigma: float, nodes: BoolArray | None = None) -> float:
    """Predict the RMS displacement noise per component of images and a mesh in memory, pixels, on one rank.

    Inputs are of one camera; ``sigma`` is the standard deviation of the camera noise of both images, grey levels.
    ``nodes`` are those chosen of the mesh before discontinuities cut it, (n_nodes,), all of them by default; phantom
    nodes do not count. Raises InputError or SingularSubdomainError where the problem cannot be set up.
    """
    team, clock = Team.alone(), PhaseClock()
    case = inputs.case.model_copy(update={"solver": SolverSection(method="monolithic")})
    inputs = replace(inputs, case=case)
    reference, _ = prepare_reference(team, inputs, build_whole_mesh(team, inputs), clock, lambda: None)
    problem = WeightedProblem(team, reference, clock)
    try:
        mesh = reference.subdomains[0].mesh
        whole, _ = inputs.build_mesh()
        counted = np.zeros(mesh.n_nodes, dtype=bool)
        counted[:whole.n_nodes] = True if nodes is None else nodes
        step, system = problem.solver.step, problem.solver.assembly.systems[0]
        if not isinstance(step, MonolithicStep):
            raise TypeError("the noise is predicted from the factor of the whole region")
        return estimate_noise_rms(system, step.operator, sigma, np.repeat(counted, mesh.dim))
    finally:
        problem.destroy()
