"""What a measurement method offers: the seam that a new one implements.

``METHODS`` in ``ddic.case.methods`` names the module of each; its guide adds one.
"""

from typing import Any, Protocol, Self

from ddic.case.loader import LoadedCase
from ddic.case.methods import find_method
from ddic.case.schema import Case
from ddic.check.case import CheckReport
from ddic.errors import Problems
from ddic.images.source import ImageSource
from ddic.images.window import Window
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs, StartPoints
from ddic.mesh.mesh import Mesh
from ddic.parallel.phases import PhaseClock
from ddic.parallel.stop_request import stop_if_asked
from ddic.parallel.team import Team
from ddic.results.listener import Listener
from ddic.results.publishing import Publishable


class MethodSession(Protocol):
    """The reference images of a case prepared by its method, for any number of frames; used in a ``with`` statement.

    One that inherits from it says how it measures and closes; the rest is that of a session without operators of a
    mesh, from whose linear steps the noise would follow.
    """

    @property
    def n_assembled(self) -> int:
        """Times that this rank assembled M of a subdomain; 0 where there is none."""
        return 0

    @property
    def n_factorized(self) -> int:
        """Operators that this rank factorised."""
        return 0

    def __enter__(self) -> Self:
        """Give the session itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def measure(self, frame: Frame, start: Any = None) -> Publishable:
        """Measure the displacement between the reference images and a frame; collective.

        Parameters
        ----------
        frame : Frame
            A deformed image of each camera.
        start : optional
            ``unknowns`` of what the session measured before, from which it starts as they are; or a ``GivenStart``,
            from which the search for a start goes on. By default the case says where it starts.

        Returns
        -------
        Publishable
            What was measured.

        Raises
        ------
        InputError, SingularSubdomainError, ConvergenceError
            On all ranks; the last with what was measured so far as ``last``. Other frames can be measured afterwards.
        """

    def estimate_noise_floor(self, measured: Any) -> float:
        """Estimate what noise of the residual's size leaves in a measured displacement; collective.

        Parameters
        ----------
        measured : Publishable
            What the session measured last.

        Returns
        -------
        float
            RMS of a component at a node, pixels; nan where it is not known.
        """
        return float("nan")

    def close(self) -> None:
        """Free what does not go by itself, PETSc's objects say; may be called again."""


class Method(Protocol):
    """A measurement method. Its module holds one as ``METHOD``."""

    def check_ranks(self, loaded: LoadedCase, n_ranks: int) -> None:
        """Refuse a number of ranks; free of communication.

        Parameters
        ----------
        loaded : LoadedCase
            The case.
        n_ranks : int
            MPI ranks that were started.

        Raises
        ------
        InputError
            Where the case cannot be measured on so many.
        """

    def check(self, loaded: LoadedCase, reference: ImageSource | None, points: StartPoints | None,
              problems: Problems) -> CheckReport | None:
        """Check what a case says beyond its images, start and output, which were checked before; on one rank.

        Parameters
        ----------
        loaded : LoadedCase
            The case.
        reference : ImageSource or None
            The first camera's reference image; None where it cannot be opened.
        points : StartPoints or None
            Points that it starts from, where it gives some.
        problems : Problems
            Of the case so far; those that are found are added.

        Returns
        -------
        CheckReport or None
            What is going to be measured; None where problems do not let it be said.
        """

    def build_result_mesh(self, case: Case, extent: Window) -> Mesh:
        """Build the mesh on which a case's result is written, as ``ddic check`` draws it.

        Parameters
        ----------
        case : Case
            One that was found fit.
        extent : Window
            Of the first camera's images.

        Returns
        -------
        Mesh
            Pixels.
        """

    def prepare(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                first_frame: Frame | None = None) -> MethodSession:
        """Do what the reference images determine; collective.

        Parameters
        ----------
        team : Team
            All ranks.
        inputs : Inputs
            Reference images, mesh and settings.
        listener : Listener
            Told what happens.
        clock : PhaseClock
            Of the phases.
        first_frame : Frame, optional
            Where it is known already, and most likely the only one.

        Returns
        -------
        MethodSession
            The caller's to close.

        Raises
        ------
        InputError, SingularSubdomainError, FactorizationError
            On all ranks.
        """


def prepare_session(team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                    first_frame: Frame | None = None) -> MethodSession:
    """Prepare the reference images as the case's method does; collective.

    Parameters
    ----------
    team, inputs, listener, clock : Team, Inputs, Listener, PhaseClock
        As ``Method.prepare`` takes them.
    first_frame : Frame, optional
        The same.

    Returns
    -------
    MethodSession
        The caller's to close.

    Raises
    ------
    InputError, SingularSubdomainError, FactorizationError, StoppedError
        On all ranks; the last where a signal asked one of them to stop.
    """
    stop_if_asked(team, "before the first iteration")
    method: Method = find_method(inputs.case)
    return method.prepare(team, inputs, listener, clock, first_frame)
