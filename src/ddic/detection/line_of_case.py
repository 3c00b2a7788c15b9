"""The line that a case asks for, looked for in its images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.detection.find_line import Detection, find_line
from ddic.problem.cameras import Frame
from ddic.problem.inputs import Inputs
from ddic.start.given_start import extrapolate
from ddic.start.independent import Images


def find_line_of_case(inputs: Inputs, frame: Frame, displacement: NDArray[np.float64]) -> Detection:
    """Find the line that a case asks for; on one rank.

    Parameters
    ----------
    inputs : Inputs
        Its first camera sees the whole region.
    frame : Frame
        The deformed images.
    displacement : (n_nodes, 2) array
        Of a continuous field, pixels; nan where it was not measured, there it follows by equilibrium.

    Returns
    -------
    Detection
        The line, or why there is none.
    """
    case = inputs.case
    camera, deformed = inputs.cameras[0], frame[0]
    extent = camera.reference.extent
    usable = camera.reference.find_usable(extent)
    active = np.ones((extent.height, extent.width), dtype=np.uint8) if usable is None else usable
    images = Images(camera.reference, deformed, active, case.correlation.spline_degree,
                    case.correlation.correction_of_start)
    mesh, _ = inputs.build_mesh()
    is_measured = np.isfinite(displacement).all(axis=1)
    if not is_measured.all():
        displacement = extrapolate(mesh, displacement, is_measured).displacement
    return find_line(images, mesh, displacement, case.discontinuity[0].opening)
