"""The truth of virtual experiments: a measured field, roughened."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ddic.io.result_reader import Result
from ddic.kinematics.nodal_gradients import recover_gradients
from ddic.mesh.interpolation import interpolate
from ddic.mesh.mesh import Mesh
from ddic.synth.virtual_image import fill_displacement, render_virtual_image

Array = NDArray[np.float64]


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
        """Interpolate it.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Pixels; nan where there is none.
        """
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

        The measurement S leaves a wave a share t of its amplitude; the measured wave, t times the specimen's, becomes
        t (2 - t) times. What noise has put in is raised by at most as much.

        Parameters
        ----------
        again : Result
            What the same settings measure of an image without noise that has this displacement.

        Returns
        -------
        VirtualTruth
            On the same mesh.
        """
        rougher = 2.0 * self.displacement - again.displacement
        # Where it was not measured again it stays as it is.
        return VirtualTruth(self.mesh, np.where(np.isfinite(rougher), rougher, self.displacement))

    def render(self, grey: Array, noise: float) -> NDArray[np.float32]:
        """Render the deformed image, with noise.

        Parameters
        ----------
        grey : (height, width) array
            The reference image, grey levels.
        noise : float
            Standard deviation, grey levels.

        Returns
        -------
        (height, width) array
            Grey levels.
        """
        height, width = grey.shape
        y, x = np.mgrid[0:height, 0:width]
        pixels = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
        displacement = fill_displacement(self.at(pixels).reshape(height, width, 2))
        image = render_virtual_image(grey, displacement)
        random = np.random.default_rng(0)
        image += np.float32(noise) * random.standard_normal(image.shape, dtype=np.float32)
        return image
