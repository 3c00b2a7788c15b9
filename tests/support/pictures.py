"""Image pairs in memory and on disk, and square meshes on them."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.images.binned import ArraySource
from ddic.images.sub_image import MaskedSource
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.synth.fields import DisplacementField
from ddic.synth.render import Digitiser, ImagePair, Picture, Scene, render_pair
from ddic.synth.speckle import SpeckleTexture

SATURATION = 255.0


@cache
def pair_of(field: DisplacementField, side: int = 192, bit_depth: int = 32) -> ImagePair:
    """Square speckle images moved by ``field``; 32 bit means no rounding of grey levels."""
    return render_pair(Scene(SpeckleTexture(3), field), Picture(side, side, Digitiser(bit_depth)))


def source(values: NDArray[np.float32], mask: NDArray[np.bool_] | None = None, *,
           exclude_saturated: bool = False) -> MaskedSource:
    """An image in memory; mask: True where pixels count."""
    image = ArraySource(Path("memory"), np.asarray(values, dtype=np.float32), SATURATION)
    mask_image = None if mask is None else ArraySource(Path("mask"), mask.astype(np.float32))
    return MaskedSource(image, mask_image, SATURATION if exclude_saturated else None)


def square_mesh(low: float, high: float, element: float = 16.0) -> Mesh:
    """Q4 cells on the square from (low, low) to (high, high), pixels."""
    return build_structured_mesh((low, low, high, high), element)


def rms_error(q: NDArray[np.float64], nodes: NDArray[np.float64], field: DisplacementField) -> float:
    """RMS over nodes and components of the difference to the known field, pixels."""
    return float(np.sqrt(np.mean((q.reshape(nodes.shape) - field.displacement(nodes)) ** 2)))


def rms_error_at(result: Any, field: DisplacementField, points: NDArray[np.float64]) -> float:
    """RMS difference per component between a result and the known displacement at points (n, 2), pixels."""
    return float(np.sqrt(((result.at(points) - field.displacement(points))**2).mean()))
