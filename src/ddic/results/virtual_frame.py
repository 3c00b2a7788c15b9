"""Virtual images of a sweep: made on rank 0 from the reference image, measured on all ranks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.noise_transfer import build_white_transfer
from ddic.functionals.regularization import Material
from ddic.images.binned import ArraySource
from ddic.images.spline import read_gradient
from ddic.images.sub_image import MaskedSource
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.parallel.team import Team
from ddic.results.sweep_trials import Trial
from ddic.results.virtual_truth import VirtualTruth


@dataclass(frozen=True)
class VirtualFrames:
    """The reference image, of which virtual images are made.

    Attributes
    ----------
    team : Team
        All ranks.
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
        """Find what interpolation leaves of the deformed image's noise where the specimen has moved.

        Parameters
        ----------
        trials : sequence of Trial
            Of the pair; the first that measured it counts.

        Returns
        -------
        float
            From 0 to 1.
        """
        measured = next(trial for trial in trials if not trial.failure)
        is_known = np.isfinite(measured.displacement).all(axis=1)
        table = build_white_transfer(self.inputs.case.correlation.spline_degree)
        # As much along x as along y.
        return float(table.find(measured.displacement[is_known])[:, 0].mean())

    def measure_gradient(self, points: NDArray[np.float64]) -> float:
        """Measure the mean square of the reference image's gradient; collective.

        Parameters
        ----------
        points : (n, 2) array
            At the pixels next to these.

        Returns
        -------
        float
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
        """Render the deformed image of a displacement; collective.

        Every rank holds it whole, 4 bytes a pixel.

        Parameters
        ----------
        truth : VirtualTruth
            The displacement.
        noise : float
            Standard deviation, grey levels.

        Returns
        -------
        Frame
            The virtual image.
        """
        image = self.reference.image
        values = self.team.on_root(lambda: truth.render(
            np.asarray(image.read(self.reference.extent), dtype=np.float64), noise))
        return (MaskedSource(ArraySource(Path("virtual image"), values)),)
