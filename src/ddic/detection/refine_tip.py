"""A tip moved along its line until Williams' series about it fits the images best.

The series' coefficients and the place of the tip are found together by Gauss-Newton on the residual: integrated digital
image correlation. Elements would not tell: with tip functions some pixels beside the tip, they leave hardly
more of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.detection.refine_line import BELIEVED, UncertainLine, compute_residuals
from ddic.errors import ConvergenceError
from ddic.fracture.crack_tip import evaluate_williams_series
from ddic.functionals.line_band import BAND
from ddic.images.window import Window
from ddic.kinematics.tip_functions import Tip
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import measure_distance
from ddic.mesh.quality import measure_cell_size
from ddic.mesh.topology import find_boundary_nodes
from ddic.start.coarse_displacement import CutField
from ddic.start.independent import Images

ORDERS = np.array([1, 3, 4, 5, 6, 7])
"""n of the terms r^(n/2) of the series, of which the first ones are the stress intensity factors. Those of a rigid
motion and of constant strain, n = 0 and 2, are among the affine terms."""

N_AFFINE = 6
"""Affine terms, which take up what the camera adds too: it may come nearer and turn."""

_FIRST = np.array([N_AFFINE, N_AFFINE + len(ORDERS)])
"""Places of the coefficients of r^(1/2), of the opening mode and of the sliding one."""

SINGULAR = np.array([-1])
"""n of the term by which the first one changes where the tip moves: more singular than any crack."""

ROOM = 0.9
"""Share of the distance to the next edge, bend or other line up to which the series is fitted: it holds no farther."""

LARGEST_ELEMENTS, LARGEST_PX, LEAST_PX = 4.0, 100.0, 24.0
"""Radius up to which the series is fitted. A larger one tells more, takes longer, and depends more on what the specimen
is; with a smaller one than the last, pixels, no tip should be looked for."""

INNER = 3.0
"""Pixels about the tip that do not count: there, materials do not stretch as the series does."""

SAME_TIP, MOST_MOVES = 0.05, 20
"""Pixels: a tip that moves by no more has been found; times that it is moved, two to five are usual."""


@dataclass(frozen=True)
class TipMove:
    """Where the pixels about a tip say that it lies.

    Attributes
    ----------
    ahead : float
        Of where it is given, along its line, pixels.
    deviation : float
        Standard deviation of that by noise, pixels.
    """

    ahead: float
    deviation: float


def find_tip_move(images: Images, mesh: Mesh, start: CutField, tip: Tip, line: UncertainLine, kappa: float) -> TipMove:
    """Find how far the tip of a line is off along it, which is as uncertain as the line.

    The series starts from ``start``, pixels; the region's mesh is not cut; ``kappa`` is Kolosov's constant. Raises
    ConvergenceError where no tip is found.
    """
    deviation = line.deviation
    radius, _ = choose_radius(mesh, tip, line)
    disk = _Disk.list_pixels(images, tip, radius, kappa)
    coefficients, ahead = disk.fit(start, min(measure_cell_size(mesh), radius / 2)), 0.0
    for _ in range(MOST_MOVES):
        of_terms, step, variance = disk.correct(coefficients, ahead, deviation)
        coefficients = coefficients + of_terms
        ahead += float(np.clip(step, -deviation, deviation))
        if abs(ahead) > radius / 2:
            break
        if abs(step) <= SAME_TIP:
            if not disk.is_as_good(coefficients, ahead, start, measure_cell_size(mesh)):
                break
            return TipMove(ahead, float(np.sqrt(variance)))
    raise ConvergenceError("about the tip, Williams' series does not fit the images")


def choose_radius(mesh: Mesh, tip: Tip, line: UncertainLine) -> tuple[float, str]:
    """Choose the radius of the disk about a tip in which its series holds, pixels; and say what it ends at."""
    vertices = line.vertices
    edge = mesh.nodes[find_boundary_nodes(mesh)]
    last, before = (0, 1) if tip.vertex == 0 else (-1, -2)
    others = [float(measure_distance(tip.position[None], other)[0]) for other in line.others]
    limits = {"the mesh's edge": ROOM * float(np.linalg.norm(edge - tip.position, axis=1).min()),
              "the line's next vertex": ROOM * float(np.linalg.norm(vertices[last] - vertices[before])),
              "another line": ROOM * min(others, default=np.inf),
              f"{LARGEST_ELEMENTS:g} elements": LARGEST_ELEMENTS * measure_cell_size(mesh),
              "the most that is fitted": LARGEST_PX}
    limit = min(limits, key=lambda name: limits[name])
    return limits[limit], limit


@dataclass(frozen=True, eq=False)
class _Disk:
    """Pixels about a tip as it is given, beside its line and what is ahead of it.

    Where they lie in the crack's frame, and the gradient of f there, both (n, 2) and along its axes, which are rows.
    """

    images: Images
    pixels: IntArray
    local: Array
    gradient: Array
    axes: Array
    radius: float
    kappa: float

    @classmethod
    def list_pixels(cls, images: Images, tip: Tip, radius: float, kappa: float) -> _Disk:
        axes = np.stack([tip.ahead, [-tip.ahead[1], tip.ahead[0]]])
        low, high = np.floor(tip.position - radius).astype(int), np.ceil(tip.position + radius).astype(int) + 1
        extent = images.reference.extent
        window = Window.between(low, high).grow(1).intersection(extent)
        f = images.reference.image.read(window).astype(np.float64)
        rows, columns = np.indices(f.shape)
        pixels = np.column_stack([columns.ravel() + window.x0, rows.ravel() + window.y0])
        local = (pixels - tip.position) @ axes.T
        gradient = np.stack(np.gradient(f)[::-1], axis=-1).reshape(-1, 2) @ axes.T
        kept = (np.hypot(*local.T) <= radius) & (np.abs(local[:, 1]) > BAND[images.degree])
        return cls(images, pixels[kept], local[kept], gradient[kept], axes, radius, kappa)

    def fit(self, start: CutField, beyond: float) -> Array:
        """Coefficients by which the affine terms and the first ones follow a field beyond a distance from the tip."""
        u = start.at(self.pixels.astype(np.float64)) @ self.axes.T
        counted = np.isfinite(u).all(axis=1) & (np.hypot(*self.local.T) >= beyond)
        coefficients = np.zeros(N_AFFINE + 2 * len(ORDERS))
        used = [*range(N_AFFINE), *_FIRST]
        terms = self.evaluate_terms(coefficients, 0.0)[0][counted][:, :, used]
        coefficients[used] = np.linalg.lstsq(terms.reshape(-1, len(used)), u[counted].ravel(), rcond=None)[0]
        return coefficients

    def evaluate_terms(self, coefficients: Array, ahead: float) -> tuple[Array, Array]:
        """Displacements of a unit of each term, (n, 2, n_terms), and what a move of the tip changes, (n, 2, 1).

        Both in the crack's frame, with lengths in the series over the radius.
        """
        places = (self.local - (ahead, 0.0)) / self.radius
        powers = np.column_stack([np.ones(len(places)), places])
        affine = (powers[:, None, :, None] * np.eye(2)[:, None, :]).reshape(-1, 2, N_AFFINE)
        # What turns and stretches all about the tip does so with what the crack adds.
        stretch = np.eye(2) + coefficients[2:N_AFFINE].reshape(2, 2).T / self.radius
        series = stretch @ evaluate_williams_series(places, ORDERS, self.kappa)
        singular = stretch @ evaluate_williams_series(places, SINGULAR, self.kappa)
        # d/dx of r^(1/2) is half of r^(-1/2); those of the other terms are among the terms.
        of_move = -singular @ coefficients[_FIRST] / (2 * self.radius)
        return np.concatenate([affine, series], axis=2), of_move[:, :, None]

    def is_as_good(self, coefficients: Array, ahead: float, field: CutField, beyond: float) -> bool:
        """Whether the series leaves no more residual than a measured field does beyond a distance from the tip.

        That has many more unknowns: a series that is as good is that of the specimen. Of another one, a specimen that
        is not elastic say, the tip would be moved to where it is nearest to what it is not.
        """
        terms, _ = self.evaluate_terms(coefficients, ahead)
        of_series = compute_residuals(self.images, self.pixels, terms @ coefficients @ self.axes)
        of_field = compute_residuals(self.images, self.pixels, field.at(self.pixels.astype(np.float64)))
        counted = np.isfinite(of_series) & np.isfinite(of_field) & (np.hypot(*self.local.T) >= beyond)
        # What is far off in either says little of the others.
        most = BELIEVED**2 * float(np.median(of_field[counted] ** 2)) / 0.6745**2
        series, measured = (np.minimum(residual[counted] ** 2, most).sum() for residual in (of_series, of_field))
        return bool(series <= measured)

    def correct(self, coefficients: Array, ahead: float, uncertainty: float) -> tuple[Array, float, float]:
        """One step of Gauss-Newton from coefficients and a place of the tip, itself known to a standard deviation.

        That is, corrections of the coefficients and of the place, and the variance of the place by noise.
        """
        terms, of_move = self.evaluate_terms(coefficients, ahead)
        residual = compute_residuals(self.images, self.pixels, terms @ coefficients @ self.axes)
        counted = np.isfinite(residual) & (np.hypot(self.local[:, 0] - ahead, self.local[:, 1]) > INNER)
        if counted.sum() < LEAST_PX**2:
            raise ConvergenceError("too few pixels about the tip count")
        variance = max((float(np.median(np.abs(residual[counted]))) / 0.6745) ** 2, 1e-300)
        counted &= residual**2 <= BELIEVED**2 * variance
        columns = np.concatenate([terms, of_move], axis=2)[counted]
        matrix = np.einsum("ni,nij->nj", self.gradient[counted], columns)
        normal, right = matrix.T @ matrix, matrix.T @ residual[counted]
        normal[-1, -1] += variance / uncertainty**2
        right[-1] -= variance / uncertainty**2 * ahead
        try:
            inverse = np.linalg.inv(normal)
        except np.linalg.LinAlgError as error:
            raise ConvergenceError("pixels about the tip do not determine Williams' series") from error
        step = inverse @ right
        return step[:-1], float(step[-1]), variance * float(inverse[-1, -1])
