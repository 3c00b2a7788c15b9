"""Exact pairs whose sides of given lines move apart, or that show Williams' field about a crack's tip; their errors."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise, product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import ddic
from ddic.fracture.crack_tip import evaluate_williams_series, find_kolosov_constant
from ddic.mesh.plane import is_inside_polygon, measure_distance
from ddic.synth.speckle import SpeckleTexture

Array = NDArray[np.float64]

SIZE, SMOKE_SIZE = 512, 200
"""Side of the images, pixels."""

MARGIN = 24
"""Edge without elements, pixels."""

ANGLE = np.deg2rad(27.0)
"""Of the straight line."""

SPECKLE = 1.6
"""Size of the speckles, times the reference size."""

SHEAR = 2e-4
"""Displacement along the straight line per distance from it: linear, which Q4 hold exactly."""

FAR = 1e4
"""Pixels by which a line's left side reaches beyond the image."""

BESIDE = 3.0
"""Distance, pixels, at which both sides of a line are looked up: beyond the band that does not count."""


@dataclass(frozen=True, eq=False)
class Opened:
    """Lines whose left sides move by a vector more than their right ones, on top of a linear displacement.

    Attributes
    ----------
    lines : tuple of (n, 2) array
        From edge to edge of the image, pixels.
    jumps : tuple of (2,) array
        Displacement of the left side less that of the right one, pixels.
    offset : (2,) array
        Displacement of everything, pixels.
    gradient : (2, 2) array
        Of the linear displacement about the first line's first vertex.
    """

    lines: tuple[Array, ...]
    jumps: tuple[Array, ...]
    offset: Array = field(default_factory=lambda: np.zeros(2))
    gradient: Array = field(default_factory=lambda: np.zeros((2, 2)))

    def displacement(self, points: Array, sides: Array | None = None) -> Array:
        """Displacement at points (n, 2) of the reference image, of their own sides or of given ones (n, n_lines)."""
        sides = self.find_sides(points) if sides is None else sides
        u = self.offset + (points - self.lines[0][0]) @ self.gradient.T
        for jump, side in zip(self.jumps, sides.T, strict=True):
            u = u + (side - 0.5)[:, None] * jump
        return np.asarray(u)

    def find_sides(self, points: Array) -> Array:
        """1 to the left of each line and 0 to the right, (n, n_lines)."""
        return np.stack([is_inside_polygon(points, _left_of(line)) for line in self.lines], axis=1).astype(float)

    def sections(self, opening: str) -> list[dict[str, Any]]:
        """The lines as a case has them."""
        return [{"vertices": line.tolist(), "opening": opening} for line in self.lines]


def straight_line(size: int, slip: float, shift: float = 0.0) -> Opened:
    """A line at 27 degrees through the middle, along which the sides slide.

    Parameters
    ----------
    size : int
        Side of the image, pixels.
    slip : float
        Pixels.
    shift : float
        Displacement of everything along x and y, pixels; without the shear then.

    Returns
    -------
    Opened
        The line.
    """
    tangent, normal = np.array([np.cos(ANGLE), np.sin(ANGLE)]), np.array([-np.sin(ANGLE), np.cos(ANGLE)])
    middle = np.array([size / 2 + 0.37, size / 2 - 0.21])
    line = np.stack([middle - 2 * size * tangent, middle + 2 * size * tangent])
    gradient = SHEAR * np.outer(tangent, normal) if slip else np.zeros((2, 2))
    return Opened((line,), (slip * tangent,), np.full(2, shift), gradient)


def mesh_inside(size: int, element: int, cell: Literal["Q4", "T3"] = "Q4") -> ddic.Mesh:
    """Mesh a square image but for its edge.

    Parameters
    ----------
    size : int
        Side of the image, pixels.
    element : int
        Side of the elements, pixels.
    cell : str
        Type of the elements.

    Returns
    -------
    Mesh
        Of whole elements.
    """
    side = element * ((size - 2 * MARGIN) // element)
    return ddic.structured_mesh((MARGIN, MARGIN, MARGIN + side, MARGIN + side), element, cell=cell)


def _left_of(line: Array) -> Array:
    """Polygon of what lies to the left of a line: on the side of -y where it runs along +x."""
    along = line[-1] - line[0]
    away = FAR * np.array([along[1], -along[0]]) / np.linalg.norm(along)
    return np.vstack([line, line[-1] + away, line[0] + away])


def render(opened: Opened, size: int, noise: float = 0.0, seed: int = 0, *, speckle: float = SPECKLE,
           bits: int = 16) -> tuple[NDArray[Any], NDArray[Any]]:
    """Draw both images.

    Parameters
    ----------
    opened : Opened
        What moves how.
    size : int
        Side of the images, pixels.
    noise : float
        Standard deviation, grey levels of 256.
    seed : int
        Of the noise.
    speckle : float
        Size of the speckles, times the reference size.
    bits : int
        8 or 16.

    Returns
    -------
    reference, deformed : (size, size) uint8 or uint16 array
        Between sides that part, the deformed image shows the nearer one.
    """
    texture, random = SpeckleTexture(3, size_factor=speckle), np.random.default_rng(seed)
    y, x = np.mgrid[0:size, 0:size].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    # In the gap between sides that part, the nearer one; where they overlap, any.
    origins = _find_origins(opened, points, opened.find_sides(points - opened.offset))
    for sides in product((0.0, 1.0), repeat=len(opened.lines)):
        of_sides = np.broadcast_to(sides, (len(points), len(sides)))
        there = _find_origins(opened, points, of_sides)
        is_own = (opened.find_sides(there) == of_sides).all(axis=1)
        origins[is_own] = there[is_own]
    return (picture(texture, points, bits, noise * random.standard_normal(len(points))).reshape(size, size),
            picture(texture, origins, bits, noise * random.standard_normal(len(points))).reshape(size, size))


def _find_origins(opened: Opened, points: Array, sides: Array) -> Array:
    """Where points of the deformed image came from, all being of given sides."""
    origins = points - opened.offset
    for _ in range(5):
        # The displacement is linear on each side, and small: this converges by its gradient.
        origins = points - opened.displacement(origins, sides)
    return origins


def picture(texture: SpeckleTexture, origins: Array, bits: int, noise: Array) -> NDArray[Any]:
    """Draw an image.

    Parameters
    ----------
    texture : SpeckleTexture
        What is seen.
    origins : (n, 2) array
        Where each pixel came from, row by row.
    bits : int
        8 or 16.
    noise : (n,) array
        Grey levels of 256.

    Returns
    -------
    (n,) uint8 or uint16 array
        Grey levels.
    """
    brightest = 2**bits - 1
    grey = brightest * (texture.grey(origins[:, 0], origins[:, 1]) + noise / 255)
    digits = np.clip(np.rint(grey), 0, brightest)
    return np.asarray(digits, dtype=np.uint16 if bits > 8 else np.uint8)


def scatter_points(mesh: ddic.Mesh) -> NDArray[np.float64]:
    """Scatter points all over a rectangular mesh, (n, 2), pixels."""
    return np.random.default_rng(0).uniform(mesh.nodes.min(axis=0), mesh.nodes.max(axis=0), (20000, 2))


def find_field_error(result: ddic.Result, opened: Opened, *, spread: bool = False) -> float:
    """Compare the displacement with the known one at points all over the mesh.

    Parameters
    ----------
    result : Result
        What was measured.
    opened : Opened
        What is known.
    spread : bool
        Whether the mean difference is left out.

    Returns
    -------
    float
        RMS difference per component, or its standard deviation, pixels.
    """
    points = scatter_points(result.mesh)
    error = result.at(points) - opened.displacement(points)
    error = error[np.isfinite(error).all(axis=1)]
    return float(error.std(axis=0).mean()) if spread else float(np.sqrt((error**2).mean()))


def find_opening_error(result: ddic.Result, opened: Opened) -> float:
    """Compare the opening with the known one along all lines.

    Parameters
    ----------
    result : Result
        What was measured.
    opened : Opened
        What is known.

    Returns
    -------
    float
        RMS length of the difference, pixels.
    """
    differences = []
    for number, line in enumerate(opened.lines):
        on_line, normals = _walk(line)
        apart = result.at(on_line + BESIDE * normals) - result.at(on_line - BESIDE * normals)
        known = opened.displacement(on_line + BESIDE * normals) - opened.displacement(on_line - BESIDE * normals)
        is_clear = np.isfinite(apart).all(axis=1)
        for other, second in enumerate(opened.lines):
            if other != number:
                is_clear &= measure_distance(on_line, second) > 3 * BESIDE
        differences.append((apart - known)[is_clear])
    return float(np.sqrt((np.concatenate(differences) ** 2).sum(axis=1).mean()))


def _walk(line: Array) -> tuple[Array, Array]:
    """Points along a polyline, some pixels from its bends, and unit normals there."""
    points, normals = [], []
    for start, end in pairwise(line):
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        shares = np.arange(3 * BESIDE, length - 3 * BESIDE, 1.0)
        points.append(start + shares[:, None] * along)
        normals.append(np.broadcast_to([-along[1], along[0]], (len(shares), 2)))
    return np.concatenate(points), np.concatenate(normals)


ORDERS = np.array([1, 2])
ROUNDS = 80
"""Steps of the fixed point that finds where a pixel came from; the strain is below 0.1 beyond 2 px of the tip."""


@dataclass(frozen=True, eq=False)
class Crack:
    """A crack; the factors are over the shear modulus.

    Attributes
    ----------
    tip : (2,) array
        Pixels.
    angle : float
        Radians.
    opening_factor, sliding_factor : float
        K_I / mu and K_II / mu, px^(1/2).
    t_stress : float
        T / mu.
    """

    tip: Array = field(default_factory=lambda: np.array([500.3, 520.7]))
    angle: float = float(np.deg2rad(17.0))
    opening_factor: float = 0.2
    sliding_factor: float = 0.0
    t_stress: float = 1e-3

    @property
    def along(self) -> Array:
        """Direction ahead of the tip."""
        return np.array([np.cos(self.angle), np.sin(self.angle)])

    def displacement(self, points: Array) -> Array:
        """Williams' field at points (n, 2), plane stress, nu = 0.3; pixels."""
        axes = np.stack([self.along, [-self.along[1], self.along[0]]])
        root = 2 * np.sqrt(2 * np.pi)
        coefficients = [self.opening_factor / root, self.t_stress / 8, -self.sliding_factor / root, 0.0]
        terms = evaluate_williams_series((points - self.tip) @ axes.T, ORDERS, find_kolosov_constant(0.3, "stress"))
        return np.asarray(terms @ coefficients @ axes)


def render_crack(crack: Crack, size: int, noise: float, seed: int = 0) -> tuple[NDArray[Any], NDArray[Any]]:
    """Draw both images, 16 bit, reference speckle.

    Parameters
    ----------
    crack : Crack
        What opens.
    size : int
        Side of the images, pixels.
    noise : float
        Standard deviation, grey levels of 256.
    seed : int
        Of the speckle and the noise.

    Returns
    -------
    reference, deformed : (size, size) uint16 array
        In the gap between the faces, the deformed image shows anything.
    """
    texture, random = SpeckleTexture(3 + seed), np.random.default_rng(seed)
    y, x = np.mgrid[0:size, 0:size].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    origins, moving = points.copy(), np.arange(len(points))
    for _ in range(ROUNDS):
        # Most pixels come to rest within some steps, those about the tip never do.
        before = origins[moving]
        origins[moving] = points[moving] - crack.displacement(before)
        moving = moving[(origins[moving] != before).any(axis=1)]
    return (picture(texture, points, 16, noise * random.standard_normal(len(points))).reshape(size, size),
            picture(texture, origins, 16, noise * random.standard_normal(len(points))).reshape(size, size))
