"""A real foam, near and far with ratio 4, and what noise and sampling alone make its measurements err by.

The far images are the 4 x 4 means of full-resolution ones, the near images a part of these at full resolution; default
settings throughout.

Noise: both linear steps are written down for the whole mesh, without subdomains: noise n in the pictures gives the
forces b_c = G_c^T n_c of each camera, cov b_c = 2 sigma_c^2 M_c. With A = sum_c w_c T_c^T M_c T_c the joint field and
alpha err by A^-1 sum_c w_c T_c^T b_c, the near images alone by M_n^-1 b_n. The near pictures are the same in both, and
their noise enters once, by the difference of both operators; far elements show other pixels, hence other noise.

Sampling: full-resolution images shifted by whole pixels, then reduced. No image is interpolated to make these pairs,
none has noise but its rounding, and the displacement is known exactly: what remains of f - g(x + u) is what the far
camera's pixels do not tell, and so is the error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from bench.support.near_far_case import Pair, joint_case
from bench.support.runs import real_data
from ddic.case.loader import load_case
from ddic.functionals.correlation import Correlation, read_correlation, read_correlations
from ddic.images.binned import ArraySource
from ddic.images.camera import identity, similarity
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.inputs.cameras import Camera
from ddic.inputs.inputs import open_inputs
from ddic.io.result_reader import Result
from ddic.kinematics.camera import see_mesh
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team

RATIO, OFFSET = 4, (-358.5, -838.5)
REGION = (74, 10, 370, 530)
HOLES = ((159, 30, 73), (261, 179, 72), (153, 298, 72), (281, 405, 72), (222, 552, 68))


def foam_pairs() -> tuple[Pair, Pair]:
    """Find the images of both cameras."""
    folder = real_data() / "nearfar_foam"
    far, near = (Pair(folder / f"{name}_ref.tif", folder / f"{name}_def.tif", mapping) for name, mapping in (
        ("far", identity()), ("near", similarity(float(RATIO), 0.0, OFFSET))))
    return far, near


def foam_case(far: Pair, near: Pair, size: int, offset: tuple[int, int] = (0, 0), rest: str = "", *,
              use_far: bool = False) -> str:
    """Write a case with elements of one size, by default with nothing but default settings.

    Parameters
    ----------
    far, near : Pair
        Images.
    size : int
        Side of the elements, far px.
    offset : tuple of int
        By which the mesh begins further in, along x and y, far px.
    rest : str
        Further sections.
    use_far : bool
        Whether the far images measure the near camera's elements as well.

    Returns
    -------
    str
        TOML text.
    """
    holes = ", ".join(f"{{ center = [{x}, {y}], radius = {r} }}" for x, y, r in HOLES)
    region = [REGION[0] + offset[0], REGION[1] + offset[1], *REGION[2:]]
    mesh = f"[mesh.structured]\nregion = {region}\nelement_size = {size}\ncircles = [{holes}]\n"
    case = joint_case(far, near, mesh, rest)
    return case.replace("[[near]]\n", "[[near]]\nuse_far = true\n") if use_far else case


def name_pair(pair: Pair, folder: Path, name: str) -> Pair:
    """Name images of one camera that are to be written."""
    return Pair(folder / f"{name}_ref.tif", folder / f"{name}_def.tif", pair.mapping, pair.noise)


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
    """Propagate noise of the pictures through both measurements, without regularization."""
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


SETTLED = 1e-5
"""Largest correction, pixels, with which Gauss-Newton ends."""


@dataclass(frozen=True)
class ShiftError:
    """Errors of one pair.

    Attributes
    ----------
    shift : (2,) array
        Of the deformed image, full-resolution px along x and y.
    error : (n, 2) array
        Of the displacement of the nodes, full-resolution px.
    residual_std : float
        Of f - g(x + u), grey levels.
    predicted : float
        Vector RMS of the error, were the residual white noise: that of the covariance residual_std^2 M^-1.
    """

    shift: Array
    error: Array
    residual_std: float
    predicted: float


def measure_shifts(image: Array, mesh: Mesh, ratio: int, degree: int) -> Iterator[ShiftError]:
    """Measure all shifts by less than a far pixel but the one by nothing.

    Parameters
    ----------
    image : (height, width) array
        Full resolution, grey levels.
    mesh : Mesh
        In pixels of the reduced image without its first row and column, a pixel inside it.
    ratio : int
        Full-resolution px per far px.
    degree : int
        Of the spline.

    Yields
    ------
    ShiftError
        Of each shift.
    """
    reference = read_correlation(mesh, _source(_reduce(image[ratio:, ratio:], ratio)), degree)
    hessian = reference.assemble_hessian().tocsc()
    scatter = float(np.trace(splu(hessian).solve(np.eye(mesh.n_dofs)))) / mesh.n_nodes
    for place in range(1, ratio**2):
        down, right = divmod(place, ratio)
        shifted = _reduce(image[ratio - down:, ratio - right:], ratio)
        exact = np.tile([right / ratio, down / ratio], mesh.n_nodes)
        found, residual_std = _iterate(reference, DeformedSubImage(_source(shifted), degree), exact)
        error = ratio * (found - exact).reshape(-1, 2)
        yield ShiftError(np.array([right, down], dtype=float), error, residual_std,
                         ratio * residual_std * float(np.sqrt(scatter)))


def _reduce(image: Array, ratio: int) -> Array:
    """Means of squares, rounded to grey levels as the far images are."""
    height, width = (size // ratio for size in image.shape)
    squares = image[:height * ratio, :width * ratio].reshape(height, ratio, width, ratio)
    return np.asarray(np.rint(squares.mean(axis=(1, 3))))


def _source(image: Array) -> MaskedSource:
    return MaskedSource(ArraySource(Path("memory"), image.astype(np.float32)))


def _iterate(reference: Correlation, deformed: DeformedSubImage, start: Array) -> tuple[Array, float]:
    """Gauss-Newton from a start; the displacement, and the residual's standard deviation."""
    factor, q = splu(reference.assemble_hessian().tocsc()), start
    for _ in range(50):
        correction = factor.solve(reference.assemble_right_hand_side(reference.compute_residual(deformed, q)))
        q = q + correction
        if np.abs(correction).max() < SETTLED:
            return q, float(np.nanstd(reference.compute_residual_image(deformed, q)))
    raise RuntimeError("Gauss-Newton did not settle")
