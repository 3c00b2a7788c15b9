"""The cases of [PP12]: gradient noise on a clamped plate, translated or cracked, and speckle by elements of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

import ddic
from bench.support.opened_pair import Crack
from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.images.rigid import GridField
from ddic.synth.fields import Sinusoidal
from ddic.synth.render import Digitiser, Picture, Scene, render_pair
from ddic.synth.speckle import SpeckleTexture

Array = NDArray[np.float64]
Pair = tuple[NDArray[Any], NDArray[Any]]

SIZE, REGION, ELEMENT = 500, (98.0, 98.0, 402.0, 402.0), 16
"""Of the first example: side of the images, the region of 304 x 304 px, side of the elements; pixels."""

OCTAVES, PERSISTENCE = (24, 12, 6), 0.8
"""Cells of the texture's octaves, pixels, and the amplitude of each relative to the one before."""

CONTRAST, SPREAD = 100.0, 0.6
"""Grey levels about the mean, and argument of the hyperbolic tangent at one standard deviation."""

LARGEST_PX = 2.0
"""Largest displacement of the plate."""

ROUNDS = 100
"""Steps of the fixed point that finds where a pixel came from; the strain of the plate is below 0.05."""

CLOSE = 1e-11
"""Pixels: change of a place from step to step at which it is found; the two faces of a crack never are, inside it."""

KINDS = ("float", "16 bit", "8 bit", "8 bit, noise of 2")
"""How images are stored; noise in grey levels of 256."""


def evaluate_gradient_noise(points: Array, seed: int, octaves: Sequence[int] = OCTAVES) -> Array:
    """Evaluate Perlin's gradient noise, quintic blending, at points (n, 2): (n,), no unit."""
    random, total = np.random.default_rng(seed), np.zeros(len(points))
    for octave, cell in enumerate(octaves):
        n = 700 // cell + 6
        angles = random.uniform(0.0, 2.0 * np.pi, (n, n))
        gradients = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        # Displaced pixels may leave the image.
        at = (points + 60.0) / cell
        corner = np.floor(at).astype(int)
        inside = at - corner
        blend = inside**3 * (6 * inside**2 - 15 * inside + 10)
        values = []
        for dy in (0, 1):
            row = []
            for dx in (0, 1):
                of_corner = gradients[corner[:, 1] + dy, corner[:, 0] + dx]
                row.append((of_corner * (inside - (dx, dy))).sum(axis=1))
            values.append(row[0] + blend[:, 0] * (row[1] - row[0]))
        total += PERSISTENCE**octave * (values[0] + blend[:, 1] * (values[1] - values[0]))
    return total


@dataclass(frozen=True)
class Plate:
    """A finite element field of a plate clamped on its left side and pulled obliquely at its right one."""

    @cached_property
    def field(self) -> GridField:
        """Displacement at the nodes of the 16-px elements; constant beyond the region."""
        mesh = ddic.structured_mesh(REGION, ELEMENT)
        stiffness = assemble_stiffness(mesh, Material(0.3)).tocsc()
        x = mesh.nodes[:, 0]
        free = np.repeat(x > REGION[0] + 1e-6, 2)
        forces = np.zeros((mesh.n_nodes, 2))
        forces[x > REGION[2] - 1e-6] = (1.0, 0.6)
        u = np.zeros(mesh.n_dofs)
        u[free] = spsolve(stiffness[free][:, free], forces.ravel()[free])
        u *= LARGEST_PX / np.abs(u).max()
        order = np.lexsort((mesh.nodes[:, 0], mesh.nodes[:, 1]))
        n = round((REGION[2] - REGION[0]) / ELEMENT) + 1
        return GridField((REGION[0], REGION[1]), (ELEMENT, ELEMENT), u.reshape(-1, 2)[order].reshape(n, n, 2))

    def displacement(self, points: Array) -> Array:
        """Displacement at points (n, 2), pixels."""
        return self.field.at(points)


@dataclass(frozen=True)
class Uniform:
    """The same displacement everywhere.

    Attributes
    ----------
    shift : tuple of float
        u and v, pixels.
    """

    shift: tuple[float, float]

    def displacement(self, points: Array) -> Array:
        """Displacement at points (n, 2), pixels."""
        return np.broadcast_to(np.asarray(self.shift), points.shape)


def render(field: Plate | Uniform | Crack, kind: str, size: int = SIZE, seed: int = 0,
           octaves: Sequence[int] = OCTAVES) -> Pair:
    """Draw both images of a displacement.

    Parameters
    ----------
    field : Plate, Uniform or Crack
        What moves how.
    kind : str
        One of KINDS.
    size : int
        Side of the images, pixels.
    seed : int
        Of the noise.
    octaves : sequence of int
        Of the texture: sides of their cells, pixels.

    Returns
    -------
    reference, deformed : (size, size) array
        Grey levels.
    """
    y, x = np.mgrid[0:size, 0:size].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    origins = points
    for _ in range(ROUNDS):
        before, origins = origins, points - field.displacement(origins)
        if np.abs(origins - before).max() < CLOSE:
            break
    level = SPREAD / evaluate_gradient_noise(points, 1, octaves).std()
    random = np.random.default_rng(seed)

    def draw(places: Array) -> NDArray[Any]:
        grey = 127.5 + CONTRAST * np.tanh(level * evaluate_gradient_noise(places, 1, octaves)).reshape(size, size)
        return store(grey, kind, random)

    return draw(points), draw(origins)


def store(grey: Array, kind: str, random: np.random.Generator) -> NDArray[Any]:
    """Store grey levels of 256 as one of KINDS."""
    if kind == "float":
        return np.asarray(grey, dtype=np.float32)
    if kind == "16 bit":
        return np.asarray(np.rint(257.0 * grey), dtype=np.uint16)
    noise = 2.0 if kind.endswith("of 2") else 0.0
    levels = np.clip(np.rint(grey + noise * random.standard_normal(grey.shape)), 0, 255)
    return np.asarray(levels, dtype=np.uint8)


def list_pixels(region: tuple[float, float, float, float] = REGION) -> Array:
    """Pixel centres of a region (n, 2)."""
    x, y = np.meshgrid(np.arange(region[0], region[2]), np.arange(region[1], region[3]))
    return np.column_stack([x.ravel(), y.ravel()])


def measure_rms(difference: Array, *, spread: bool = False) -> float:
    """RMS per component of differences (n, 2), or their standard deviation; pixels."""
    return float(np.sqrt(difference.var(axis=0).mean() if spread else (difference**2).mean()))


PUBLISHED: dict[str, Any] = {"update": False, "stop_at_noise": False, "rms_tolerance": 0.0}
"""The algorithm as it is published."""

COMPLETE: dict[str, Any] = {"stop_at_noise": False, "rms_tolerance": 1e-6, "tolerance": 1e-5}
"""Far beyond the noise: the displacement of Q4 elements."""


def measure_pgd(pair: Pair, element: float, pgd: dict[str, Any]) -> ddic.Result:
    """Measure the region of the example from a rigid translation.

    Parameters
    ----------
    pair : tuple of array
        The images.
    element : float
        Side of the elements, pixels.
    pgd : dict
        Keys of ``[pgd]``.

    Returns
    -------
    Result
        In memory.
    """
    return ddic.measure(pair, mesh={"structured": {"region": REGION, "element_size": element}}, pgd=pgd,
                        start={"pyramid": False})


WAVELENGTH = 64.0
"""Cut-off of elements of a pixel, pixels."""


def render_reference(size: int, kind: str) -> Pair:
    """Draw the reference texture with the reference field.

    Parameters
    ----------
    size : int
        Side of the images, pixels.
    kind : str
        As ``store`` takes it.

    Returns
    -------
    reference, deformed : (size, size) array
        Grey levels.
    """
    pair = render_pair(Scene(SpeckleTexture(0), Sinusoidal()), Picture(size, size, Digitiser(32)))
    random = np.random.default_rng(0)
    reference, deformed = (store(image.astype(float), kind, random) for image in (pair.reference, pair.deformed))
    return reference, deformed


def find_region(size: int, side: int) -> tuple[float, float, float, float]:
    """Place a square in the middle of an image: x0, y0, x1, y1, pixels."""
    first = float((size - side) // 2)
    return first, first, first + side, first + side


def measure_pixels(pair: Pair, side: int, regularization: dict[str, Any] | None = None, *, pyramid: bool = True,
                   **pgd: Any) -> ddic.Result:
    """Measure a square in the middle of the images by PGD-DIC with elements of a pixel.

    Parameters
    ----------
    pair : tuple of array
        The images.
    side : int
        Of the square, pixels.
    regularization : dict, optional
        Keys of ``[regularization]``; a cut-off wavelength of 64 px by default.
    pyramid : bool
        Whether one starts.
    **pgd : object
        Keys of ``[pgd]``.

    Returns
    -------
    Result
        In memory.
    """
    region = find_region(len(pair[0]), side)
    return ddic.measure(pair, mesh={"structured": {"region": region, "element_size": 1}}, pgd=pgd,
                        start={"pyramid": pyramid}, regularization=regularization or {"cut_off_wavelength": WAVELENGTH})
