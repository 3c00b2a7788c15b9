"""Virtual images of a sweep: made on rank 0 from the reference image, measured on all ranks.

Their truth is a measured field, roughened.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.functionals.noise_transfer import build_white_transfer
from ddic.functionals.regularization import Material
from ddic.images.binned import ArraySource
from ddic.images.spline import read_gradient
from ddic.images.sub_image import MaskedSource
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.io.result_reader import Result
from ddic.kinematics.nodal_gradients import recover_gradients
from ddic.mesh.interpolation import interpolate
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team
from ddic.results.sweep import Trial
from ddic.synth.virtual_image import fill_displacement, render_virtual_image


@dataclass(frozen=True, eq=False)
class VirtualTruth:
    """A displacement that virtual images have.

    Between nodes it is no finite element's: sum_i N_i (u_i + G_i (x - x_i) / 2), G_i the gradients at nodes, which is
    exact where the displacement is quadratic. Else the elements of its own mesh would hold it better than any specimen.

    Attributes
    ----------
    mesh : Mesh
        On which it was measured, pixels.
    displacement : (n_nodes, 2) array
        Of its nodes, pixels; nan where nothing was measured.
    """

    mesh: Mesh
    displacement: Array

    def at(self, points: Array) -> Array:
        """Interpolate it at points, (n, 2), pixels; nan where there is none."""
        found = interpolate(self.mesh, self._columns, points)
        gradient = found[:, 2:].reshape(-1, 2, 2)
        return np.asarray(found[:, :2] + 0.5 * np.einsum("ncj,nj->nc", gradient, points))

    @cached_property
    def _columns(self) -> Array:
        """u_i - G_i x_i / 2 and G_i of the nodes, (n_nodes, 6)."""
        (gradient,) = recover_gradients([self.mesh], [self.displacement.ravel()], list)
        gradient = np.where(np.isfinite(gradient), gradient, 0.0)
        linear = 0.5 * np.einsum("ncj,nj->nc", gradient, self.mesh.nodes)
        return np.column_stack([self.displacement - linear, gradient.reshape(-1, 4)])

    def with_lost_detail(self, again: Result) -> VirtualTruth:
        """Add what measuring it once more takes off: 2 u - S u.

        The measurement S leaves a wave a share t of its amplitude; the measured wave, t times the specimen's, becomes t
        (2 - t) times. What noise has put in is raised by at most as much. ``again`` is what the same settings measure
        of an image without noise that has this displacement.
        """
        rougher = 2.0 * self.displacement - again.displacement
        # Where it was not measured again it stays as it is.
        return VirtualTruth(self.mesh, np.where(np.isfinite(rougher), rougher, self.displacement))

    def render(self, grey: Array, noise: float) -> NDArray[np.float32]:
        """Render the deformed image of ``grey``, (height, width), with noise of a standard deviation; grey levels."""
        height, width = grey.shape
        y, x = np.mgrid[0:height, 0:width]
        pixels = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
        displacement = fill_displacement(self.at(pixels).reshape(height, width, 2))
        image = render_virtual_image(grey, displacement)
        random = np.random.default_rng(0)
        image += np.float32(noise) * random.standard_normal(image.shape, dtype=np.float32)
        return image


@dataclass(frozen=True)
class VirtualFrames:
    """The reference image, of which virtual images are made.

    Attributes
    ----------
    team : Team
    inputs : Inputs
        Of one camera.
    """

    team: Team
    inputs: Inputs

    @property
    def reference(self) -> MaskedSource:
        """The reference image."""
        return self.inputs.cameras[0].reference

    @property
    def material(self) -> Material:
        """The case's, or the default one's."""
        section = self.inputs.case.regularization
        return Material() if section is None else Material(section.poisson_ratio, section.plane)

    def find_noise_transfer(self, trials: Sequence[Trial]) -> float:
        """Find what interpolation leaves of the deformed image's noise where the specimen has moved, from 0 to 1.

        Of the trials of the pair the first that measured it counts.
        """
        measured = next(trial for trial in trials if not trial.failure)
        is_known = np.isfinite(measured.displacement).all(axis=1)
        table = build_white_transfer(self.inputs.case.correlation.spline_degree)
        # As much along x as along y.
        return float(table.find(measured.displacement[is_known])[:, 0].mean())

    def measure_gradient(self, points: Array) -> float:
        """Measure the mean square of the reference image's gradient at the pixels next to points, (n, 2); collective.

        Both components together, grey levels squared per square pixel.
        """
        image, degree = self.reference.image, self.inputs.case.correlation.spline_degree

        def measure() -> float:
            gradient = read_gradient(image, self.reference.extent, degree)
            columns, rows = np.rint(points).astype(np.int64).T
            squares = gradient.by_x[rows, columns] ** 2 + gradient.by_y[rows, columns] ** 2
            return float(squares.mean(dtype=np.float64))

        return self.team.on_root(measure)

    def render(self, truth: VirtualTruth, noise: float) -> Frame:
        """Render the deformed image of a displacement, with noise of a standard deviation, grey levels; collective.

        Every rank holds it whole, 4 bytes a pixel.
        """
        image = self.reference.image
        values = self.team.on_root(lambda: truth.render(
            np.asarray(image.read(self.reference.extent), dtype=np.float64), noise))
        return (MaskedSource(ArraySource(Path("virtual image"), values)),)
