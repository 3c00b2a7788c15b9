"""PGD-DIC prepared for any number of frames."""

from __future__ import annotations

from dataclasses import dataclass

from ddic.images.sub_image import DeformedSubImage
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.problem.cameras import Frame
from ddic.problem.inputs import Inputs
from ddic.problem.problem_size import ProblemSize
from ddic.problem.rectangle import Rectangle
from ddic.problem.separated_reference import build_regularization, read_reference_pixels
from ddic.problem.separated_size import choose_rules, choose_scheme, measure_separated_size
from ddic.separated.corrections import Regularization, Scheme, StoppingRules
from ddic.separated.pixel_bands import FramePixels, ReferencePixels


@dataclass(frozen=True, eq=False)
class SeparatedProblem:
    """What the reference image and the case determine.

    Attributes
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        Reference image, rectangle and settings.
    rectangle : Rectangle
        What is measured.
    reference : ReferencePixels
        Bands of rows of this rank.
    regularization : Regularization or None
        With its weight.
    size : ProblemSize
        Sizes and weights.
    scheme : Scheme
        How corrections are found.
    rules : StoppingRules
        When they end.
    """

    team: Team
    inputs: Inputs
    rectangle: Rectangle
    reference: ReferencePixels
    regularization: Regularization | None
    size: ProblemSize
    scheme: Scheme
    rules: StoppingRules

    def open_frame(self, frame: Frame) -> FramePixels:
        """Put a deformed image beside the reference image.

        Parameters
        ----------
        frame : Frame
            Of one camera.

        Returns
        -------
        FramePixels
            Nothing of it read yet.
        """
        return FramePixels(self.reference, DeformedSubImage(frame[0], self.inputs.case.correlation.spline_degree))


def prepare_separated_problem(team: Team, inputs: Inputs, clock: PhaseClock) -> SeparatedProblem:
    """Read the reference image and find the weight of the regularisation; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        With a rectangle.
    clock : PhaseClock
        Of the phases.

    Returns
    -------
    SeparatedProblem
        Pixels spread over ranks.

    Raises
    ------
    InputError
        On all ranks.
    """
    rectangle, case = require_held(inputs.rectangle), inputs.case
    with clock.phase(Phase.READ):
        reference = read_reference_pixels(team, inputs, rectangle)
    with clock.phase(Phase.ASSEMBLE):
        regularization = build_regularization(case.regularization, reference, rectangle)
        size = measure_separated_size(team, inputs, reference, regularization)
    return SeparatedProblem(team, inputs, rectangle, reference, regularization, size, choose_scheme(case),
                            choose_rules(case))
