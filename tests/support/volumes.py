"""Volumes of waves that are known everywhere, before and after an affine deformation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.images.binned import ArraySource
from ddic.images.sub_image import MaskedSource
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh

GRADIENT = np.array([[0.010, 0.012, -0.008], [0.004, -0.006, 0.015], [0.002, -0.003, 0.007]])
"""Of a displacement whose six strains are unlike each other, no unit."""

TRANSLATION = np.array([0.6, -0.3, 0.4])
"""Of the volume's middle, pixels."""

N_WAVES = 40


def evaluate_waves(points: NDArray[np.float64], seed: int = 0) -> NDArray[np.float64]:
    """Grey levels of a sum of waves of 6 to 14 px at points, (n, 3): mean 128, standard deviation 40."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(N_WAVES, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    vectors = 2.0 * np.pi / rng.uniform(6.0, 14.0, N_WAVES)[:, None] * directions
    phases = rng.uniform(0.0, 2.0 * np.pi, N_WAVES)
    values = np.zeros(len(points))
    for vector, phase in zip(vectors, phases, strict=True):
        values += np.sin(points @ vector + phase)
    return np.asarray(128.0 + 40.0 * np.sqrt(2.0 / N_WAVES) * values)


def displace(points: NDArray[np.float64], size: int, gradient: NDArray[np.float64] = GRADIENT,
             translation: NDArray[np.float64] = TRANSLATION) -> NDArray[np.float64]:
    """The displacement at points, (n, 3), of a cube of voxels."""
    return np.asarray(translation + (points - (size - 1) / 2) @ gradient.T)


def make_pair(size: int, gradient: NDArray[np.float64] = GRADIENT,
              translation: NDArray[np.float64] = TRANSLATION) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """A cube before and after ``displace``, exact but for float32."""
    z, y, x = np.mgrid[:size, :size, :size].astype(np.float64)
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    middle = (size - 1) / 2
    origins = (points - translation - middle) @ np.linalg.inv(np.eye(3) + gradient).T + middle
    f, g = (evaluate_waves(at).reshape(size, size, size).astype(np.float32) for at in (points, origins))
    return f, g


def source(values: NDArray[np.float32]) -> MaskedSource:
    """A volume in memory."""
    return MaskedSource(ArraySource(Path("memory"), values))


def cube_mesh(low: float, high: float, n: int) -> Mesh:
    """Hex8, n along each axis of a cube from ``low`` to ``high``, pixels, with its sides' node sets."""
    grid = GridLines((np.linspace(low, high, n + 1),) * 3)
    mesh = grid.build_mesh()
    return Mesh(mesh.nodes, mesh.connectivity, mesh.offsets, mesh.types, node_sets=grid.sides)
