"""Pixels of a rectangle for PGD-DIC, on one rank, and random separated displacements."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.regularization import Material
from ddic.images.sub_image import DeformedSubImage, read_reference
from ddic.images.window import Window
from ddic.parallel.distribution import TeamSums
from ddic.parallel.team import Team
from ddic.separated.field import LineElements, SeparatedField, divide_rows, scale_modes
from ddic.separated.pixel_bands import FramePixels, ReferenceBands, cut_bands
from ddic.separated.separated_regularization import (
    ControlledLines,
    SeparatedOperator,
    build_equilibrium_gap,
)
from ddic.synth.fields import DisplacementField
from support.pictures import pair_of, source

Array = NDArray[np.float64]
T = TypeVar("T")


def build_zero_field(along_x: LineElements, along_y: LineElements) -> SeparatedField:
    """Build a field without modes, zero everywhere."""
    return SeparatedField(along_x, along_y, np.zeros((0, 2)), np.zeros((0, 2, along_x.n_nodes)),
                          np.zeros((0, 2, along_y.n_nodes)))


def lines(region: tuple[float, float, float, float], size: float) -> tuple[LineElements, LineElements]:
    """Lines of square elements."""
    x0, y0, x1, y1 = region
    return tuple(LineElements(np.linspace(a, b, max(1, round((b - a) / size)) + 1)) for a, b in ((x0, x1), (y0, y1)))


def reference_of(image: Array, region: tuple[float, float, float, float], size: float, *,
                 mask: NDArray[np.bool_] | None = None, degree: int = 3) -> ReferenceBands:
    """The reference image in a rectangle."""
    along_x, along_y = lines(region, size)
    read = source(image, mask)
    window = Window((along_x.pixels.start, along_y.pixels.start), (along_x.pixels.stop, along_y.pixels.stop))
    bands = cut_bands(read_reference(read, window, degree), along_x, divide_rows(along_y))
    return ReferenceBands(along_x, along_y, bands, read.extent, TeamSums(Team.alone(), 0))


def frame_of(displacement: DisplacementField, region: tuple[float, float, float, float], size: float, *,
             side: int = 192, mask: NDArray[np.bool_] | None = None,
             deformed_mask: NDArray[np.bool_] | None = None, degree: int = 3) -> FramePixels:
    """Both images of a known displacement in a rectangle."""
    pair = pair_of(displacement, side)
    reference = reference_of(pair.reference, region, size, mask=mask, degree=degree)
    return FramePixels(reference, DeformedSubImage(source(pair.deformed, deformed_mask), degree))


def random_field(along_x: LineElements, along_y: LineElements, n_modes: int, seed: int = 0,
                 size: float = 0.3) -> SeparatedField:
    """Products of random functions."""
    random = np.random.default_rng(seed)
    x = random.normal(size=(n_modes, 2, along_x.n_nodes))
    y = random.normal(size=(n_modes, 2, along_y.n_nodes))
    return scale_modes(along_x, along_y, size * x, y)


def weighted_gap(along_x: LineElements, along_y: LineElements, weight: float,
                 edge_weight: float = 0.0) -> SeparatedOperator:
    """The equilibrium gap of the inner nodes, and less of the others, times a weight."""
    inner = []
    for line in (along_x, along_y):
        rows = np.ones(line.n_nodes, dtype=bool)
        rows[[0, -1]] = False
        inner.append(rows)
    gap = build_equilibrium_gap(along_x, along_y, Material(), ControlledLines(*inner), edge_weight)
    return SeparatedOperator(gap.rows, gap.columns, weight * gap.x, gap.y)


def dense(bands: Array) -> Array:
    """A matrix from its diagonals."""
    width, n = len(bands) // 2, bands.shape[1]
    matrix = np.zeros((n, n))
    for k in range(-width, width + 1):
        for i in range(max(0, -k), min(n, n - k)):
            matrix[i, i + k] = bands[width + k, i]
    return matrix


def dense_operator(operator: SeparatedOperator) -> Array:
    """An operator on the grid's nodes, row by row, components fastest."""
    n = operator.x.shape[2] * operator.y.shape[2]
    matrix = np.zeros((n, 2, n, 2))
    for c, d, x, y in zip(operator.rows, operator.columns, operator.x, operator.y, strict=True):
        matrix[:, c, :, d] += np.kron(dense(y), dense(x))
    return matrix.reshape(2 * n, 2 * n)
