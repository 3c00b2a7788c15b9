"""What a method measured, whatever it is made of: the seam by which it is written, summed up and started from."""

from typing import Any, Protocol, runtime_checkable

from ddic.arrays import Array
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.io.result_writer import ResultWriter
from ddic.parallel.team import Team
from ddic.problem.weighted_problem import ProblemSize
from ddic.results.summary import Summary


@runtime_checkable
class Publishable(Protocol):
    """What a method measured, and what it does to be read by others; every call is collective.

    A method without subdomains or a mesh writes what it has: images, tables, attributes.
    """

    @property
    def team(self) -> Team:
        """All ranks."""

    @property
    def inputs(self) -> Inputs:
        """Reference images and settings."""

    @property
    def frame(self) -> Frame:
        """The deformed images."""

    @property
    def size(self) -> ProblemSize:
        """Sizes and weights."""

    @property
    def unknowns(self) -> Any:
        """What the session that measured it may start another frame from."""

    @property
    def grey_correction(self) -> GreyCorrection:
        """What was corrected of grey levels."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know."""

    @property
    def failure(self) -> str:
        """Why it is no result; empty where it converged."""

    def write(self, writer: ResultWriter | None) -> None:
        """Write everything that was measured.

        Parameters
        ----------
        writer : ResultWriter or None
            Open on rank 0, None elsewhere.
        """

    def describe_origin(self) -> dict[str, str | int]:
        """Say what it was measured from.

        Returns
        -------
        dict
            Images and sizes, by name; on rank 0.
        """

    def summarize(self, of_run: dict[str, Any]) -> Summary:
        """Sum it up for scripts and people.

        Parameters
        ----------
        of_run : dict
            What is told of any method, by field of the summary.

        Returns
        -------
        Summary
            The same on all ranks.
        """

    def at(self, points: Array) -> Array:
        """Interpolate the displacement.

        Parameters
        ----------
        points : (n, 2) array
            Where, pixels.

        Returns
        -------
        (n, 2) array
            Pixels; nan where nothing was measured.
        """
