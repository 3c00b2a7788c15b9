"""Near cameras over a box of the specimen's frame, what they see of texture and how their set-ups move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from ddic.functionals.correlation import read_correlation
from ddic.images.camera import CameraMapping
from ddic.images.sub_image import MaskedSource
from ddic.inputs.cameras import Camera
from ddic.kinematics.camera import CameraSetup, MotionKind
from ddic.mesh.mesh import Mesh
from support.pictures import source

RATIO = 3.0  # pixels of a near camera in a pixel of the specimen's frame

Array = NDArray[np.float64]


def speckle(seed: int, side: int) -> MaskedSource:
    """A square image of smoothed noise."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(side, side)), 1.5)
    return source(noise / noise.std() * 50 + 128)


def set_up_over_box(low: Array, high: Array, motion: MotionKind, angle: float) -> tuple[CameraSetup, int]:
    """A camera over the box and some pixels around it, turned and a little tilted, and the side of its image."""
    centre, side = (low + high) / 2, int(RATIO * 1.2 * (high - low).max()) + 40
    c, s = RATIO * np.cos(angle), RATIO * np.sin(angle)
    about = np.array([[c, -s, side / 2], [s, c, side / 2], [2e-4, -1e-4, 1.0]])
    homography = about @ np.array([[1, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, 1.0]])
    mapping = CameraMapping(homography / homography[2, 2])
    return CameraSetup(mapping, motion, centre, float(np.linalg.norm(high - low)) / 2), side


def assemble_texture(camera: Camera, mesh: Mesh) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """M in displacements of the specimen's frame, unweighted, and d(pixels of the camera) / d(specimen's frame)."""
    mapping = camera.setup.mapping
    seen = Mesh(mapping.to_image(mesh.nodes), mesh.connectivity, mesh.offsets, mesh.types)
    jacobian = sparse.block_diag(list(mapping.jacobian(mesh.nodes))).tocsr()
    return (jacobian.T @ read_correlation(seen, camera.reference, 3).assemble_hessian() @ jacobian).tocsr(), jacobian


def evaluate_motion(setup: CameraSetup, nodes: Array) -> Array:
    """R: a pixel along x, one along y, and a turn from x towards y by 1 / length about the centre."""
    columns = np.zeros((nodes.size, 3))
    columns[0::2, 0] = columns[1::2, 1] = 1.0
    columns[0::2, 2] = -(nodes[:, 1] - setup.centre[1]) / setup.length
    columns[1::2, 2] = (nodes[:, 0] - setup.centre[0]) / setup.length
    return columns[:, :setup.n_motion_unknowns]
