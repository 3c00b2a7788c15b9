"""Volumes of speckles, and of real snow, before and after a motion that is known everywhere."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh
from ddic.start.binned_pair import BinnedPair
from ddic.start.coarse_displacement import CoarseField, evaluate_at_nodes
from ddic.synth.fields import Affine, DisplacementField
from ddic.synth.render import Picture, Scene, render_pair
from ddic.synth.speckle import SpeckleTexture
from support.pictures import source

Numbers = tuple[float, ...]


def turn_and_stretch(side: int, axis: Numbers, degrees: float, strains: Numbers = (0.0, 0.0, 0.0),
                     shift: Numbers = (0.0, 0.0, 0.0)) -> Affine:
    """A stretch along the axes, then a rotation about an axis through a cube's middle, which moves by ``shift``."""
    turn = Rotation.from_rotvec(np.array(axis) / np.linalg.norm(axis) * degrees, degrees=True).as_matrix()
    gradient = turn @ np.diag(1.0 + np.array(strains)) - np.eye(3)
    return Affine(tuple(map(tuple, gradient.tolist())), shift, ((side - 1) / 2,) * 3)


@cache
def pair_of(field: DisplacementField, side: int, seed: int = 3) -> BinnedPair:
    """Cubes of speckles of 5 px, 8 bit, moved by ``field``."""
    pair = render_pair(Scene(SpeckleTexture(seed), field), Picture(side, side, depth=side))
    return BinnedPair(source(pair.reference), source(pair.deformed), 1)


def snow_of(field: Affine, file: Path) -> BinnedPair:
    """Snow, moved by an affine ``field``: what it is made of lies between voxels, by quintic splines."""
    values = tifffile.imread(file).astype(np.float64)
    points = np.indices(values.shape).reshape(3, -1)[::-1].T - np.array(field.center)
    origins = (points - field.vector) @ np.linalg.inv(np.eye(3) + np.array(field.matrix)).T + field.center
    moved = ndimage.map_coordinates(values, origins[:, ::-1].T, order=5, mode="reflect").reshape(values.shape)
    return BinnedPair(source(values), source(moved), 1)


def box_mesh(low: Numbers, high: Numbers, n: tuple[int, ...]) -> Mesh:
    """Hex8, n along each axis of a box."""
    return GridLines(tuple(np.linspace(*ends) for ends in zip(low, high, np.add(n, 1), strict=True))).build_mesh()


def find_errors(found: CoarseField, mesh: Mesh, field: DisplacementField) -> NDArray[np.float64]:
    """Distance of what was found from what is known, at each node, pixels."""
    return np.asarray(np.linalg.norm(evaluate_at_nodes(found, mesh) - field.displacement(mesh.nodes), axis=1))
