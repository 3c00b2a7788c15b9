"""What image noise makes of the difference between a joint near/far measurement and the near images measured alone.

Both linear steps are written down for the whole mesh, without subdomains: noise n in the pictures gives the forces
b_c = G_c^T n_c of each camera, cov b_c = 2 sigma_c^2 M_c. With A = sum_c w_c T_c^T M_c T_c the joint field and alpha
err by A^-1 sum_c w_c T_c^T b_c, the near images alone by M_n^-1 b_n. The near pictures are the same in both, and their
noise enters once, by the difference of both operators; far elements show other pixels, hence other noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from ddic.case.loader import load_case
from ddic.functionals.correlation import read_correlations
from ddic.inputs.cameras import Camera
from ddic.inputs.inputs import open_inputs
from ddic.io.result_reader import Result
from ddic.kinematics.camera import see_mesh
from ddic.parallel.team import Team

Array = NDArray[np.float64]

N_DRAWS = 20_000
"""Of the RMS of noise: its 95 % point is known to 1 %."""


@dataclass(frozen=True)
class DifferenceNoise:
    """Covariance of the difference's components, node by node, for one grey level of noise in one camera's pictures.

    Attributes
    ----------
    far, near : (2 n, 2 n) array
        Of noise in the far and in the near pictures, near px squared per grey level squared.
    alpha_far, alpha_near : (2, 2) array
        The same of alpha, far px squared per grey level squared.
    """

    far: Array
    near: Array
    alpha_far: Array
    alpha_near: Array

    def covariance(self, far_noise: float, near_noise: float) -> Array:
        """Give the covariance of the difference, (2 n, 2 n), near px squared; noise in grey levels."""
        return np.asarray(far_noise**2 * self.far + near_noise**2 * self.near)

    def alpha_covariance(self, far_noise: float, near_noise: float) -> Array:
        """Give the covariance of alpha, (2, 2), far px squared; noise in grey levels."""
        return np.asarray(far_noise**2 * self.alpha_far + near_noise**2 * self.alpha_near)


@dataclass(frozen=True)
class VectorRms:
    """How the vector RMS over nodes of normally distributed errors is distributed.

    Attributes
    ----------
    std : float
        Root of its mean square.
    draws : (N_DRAWS,) array
        Values of it, in ascending order.
    """

    std: float
    draws: Array

    def likely_below(self, share: float) -> float:
        """Give the value that it stays below with some probability."""
        return float(np.quantile(self.draws, share))

    def share_above(self, value: float) -> float:
        """Give the probability that it is larger than a value."""
        return float(np.mean(self.draws > value))


def predict_difference_noise(case_file: Path, joint: Result, weight: float) -> DifferenceNoise:
    """Propagate noise of the pictures through both measurements, without regularization.

    Parameters
    ----------
    case_file : Path
        Of the joint measurement: a far and a near camera whose mapping is a similarity without rotation.
    joint : Result
        Its result.
    weight : float
        Of the near camera, with which it was measured: (sigma_far / sigma_near)^2.

    Returns
    -------
    DifferenceNoise
        At the nodes of the near camera's elements, in the order of ``measured_alone``.
    """
    loaded = load_case(case_file)
    inputs, _ = open_inputs(Team.alone(), loaded)
    degree = loaded.case.correlation.spline_degree
    (far_hessian, see_far, _), (near_hessian, see_near, near_dofs) = (
        _look(joint, camera, degree) for camera in inputs.cameras)
    of_far = (see_far.T @ far_hessian @ see_far).tocsc()
    operator = splu((of_far + weight * see_near.T @ near_hessian @ see_near).tocsc())
    n = operator.shape[0]
    wanted = np.concatenate([near_dofs, [n - 2, n - 1]])
    # Rows of A^-1 of the wanted unknowns, as columns.
    rows = operator.solve(np.eye(n)[:, wanted])
    of_near = weight * (see_near @ rows)
    ratio = float(inputs.cameras[1].setup.mapping.homography[0, 0])
    alone = splu(near_hessian.tocsc()).solve(np.eye(len(near_dofs)))
    near_rows = ratio * of_near[:, :-2] - alone
    by_far = 2 * rows.T @ (of_far @ rows)
    return DifferenceNoise(ratio**2 * by_far[:-2, :-2], 2 * near_rows.T @ (near_hessian @ near_rows),
                           by_far[-2:, -2:], 2 * of_near[:, -2:].T @ (near_hessian @ of_near[:, -2:]))


def _look(joint: Result, camera: Camera, degree: int) -> tuple[sparse.csr_matrix, sparse.csr_matrix, NDArray[np.int64]]:
    """M of a camera in its own pixels, T from the field's unknowns and alpha, and the field's unknowns that it sees."""
    part, ids = joint.mesh.create_submesh(np.flatnonzero(joint.cell_data["Camera"] == camera.number))
    (correlation,), = read_correlations([see_mesh(part, camera.setup)], camera.reference, degree)
    dofs = (2 * ids[:, None] + np.arange(2)).ravel()
    n, n_field = len(dofs), joint.mesh.n_dofs
    field = sparse.csr_matrix((np.ones(n), (np.arange(n), dofs)), shape=(n, n_field))
    moves = 1.0 if camera.number else 0.0
    motion = sparse.csr_matrix(moves * np.tile(np.eye(2), (n // 2, 1)))
    ratio = float(camera.setup.mapping.homography[0, 0])
    return correlation.assemble_hessian(), (ratio * sparse.hstack([field, motion])).tocsr(), dofs


def draw_vector_rms(covariance: Array) -> VectorRms:
    """Draw the vector RMS over nodes of errors with a covariance.

    Parameters
    ----------
    covariance : (2 n, 2 n) array
        Of two components at n nodes, node by node.

    Returns
    -------
    VectorRms
        In the root of the covariance's unit.
    """
    # Of the square's mean, each eigenvector brings an independent part.
    powers = np.maximum(np.linalg.eigvalsh(covariance), 0.0) / (len(covariance) // 2)
    normal = np.random.default_rng(0).normal(size=(N_DRAWS, len(powers)))
    return VectorRms(float(np.sqrt(powers.sum())), np.sort(np.sqrt(normal**2 @ powers)))
