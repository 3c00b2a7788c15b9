"""What one camera says about a subdomain: Eq. 5 of [BP17] in the subdomain's unknowns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.functionals.correlation import Correlation, Residual
from ddic.images.sub_image import DeformedSubImage
from ddic.images.window import Window
from ddic.kinematics.pose import Pose


@dataclass(frozen=True)
class View:
    """A camera's pixels of a subdomain.

    correlation: reference image on the mesh in the camera's pixels; deformed: window of the deformed image.
    camera: its number, 0 the first. pose: from unknowns to displacements in the image; None where the unknowns are
    displacements in this camera's pixels and its squared grey levels weigh 1.
    """

    correlation: Correlation
    deformed: DeformedSubImage
    camera: int = 0
    pose: Pose | None = None

    def displacement(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement of the nodes in the image (n_dofs,), pixels, from unknowns q (n_unknowns,)."""
        return q if self.pose is None else self.pose.displacement(q)

    def displaced_window(self, q: NDArray[np.float64]) -> Window:
        """Window of the deformed image that unknowns q need."""
        return self.correlation.displaced_window(self.displacement(q))

    def seen_from(self, q: NDArray[np.float64]) -> View:
        """The same without the pixels that q hides in the deformed image."""
        return replace(self, correlation=self.correlation.without_hidden(self.deformed, self.displacement(q)))

    def hessian(self) -> sparse.csr_matrix:
        """M of this camera, (n_unknowns, n_unknowns)."""
        return self.in_unknowns(self.correlation.assemble_hessian())

    def in_unknowns(self, matrix: sparse.csr_matrix) -> sparse.csr_matrix:
        """M in the unknowns, weighted, from that in displacements in the image (n_dofs, n_dofs)."""
        if self.pose is None:
            return matrix
        t = self.pose.tangent
        return (self.pose.weight * (t.T @ matrix @ t)).tocsr()

    def residual(self, q: NDArray[np.float64], *, all_kinds: bool = False) -> Residual:
        """One pass over all pixels with unknowns q; all_kinds: also what a grey correction needs."""
        return self.correlation.compute_residual(self.deformed, self.displacement(q), all_kinds=all_kinds)

    def right_hand_side(self, residual: Residual, gain: NDArray[np.float64] | float = 1.0,
                        offset: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
        """Right-hand side b of this camera, (n_unknowns,)."""
        b = self.correlation.assemble_right_hand_side(residual, gain, offset)
        return b if self.pose is None else np.asarray(self.pose.weight * (self.pose.tangent.T @ b))

    def residual_image(self, q: NDArray[np.float64], gain: NDArray[np.float64] | float = 1.0,
                       offset: NDArray[np.float64] | float = 0.0) -> NDArray[np.float32]:
        """Residual f - gain g(x + u) - offset on the reference window, NaN on pixels that do not count."""
        return self.correlation.compute_residual_image(self.deformed, self.displacement(q), gain, offset)
