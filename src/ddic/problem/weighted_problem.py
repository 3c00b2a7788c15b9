"""The systems of a measurement, cameras weighted by their noise, factorised and renewed where a frame asks for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.view import FrameView
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.assembly import assemble
from ddic.problem.linear_solver import LinearSolver
from ddic.problem.reference_problem import ReferenceProblem
from ddic.problem.renewal import VisiblePixels, find_renewal
from ddic.problem.views import FrameViews, ReferenceViews


class WeightedProblem:
    """Local systems and the linear solver of a reference problem.

    One camera weighs 1. Several are weighted by their noise; where the case does not give it, the first frame does, and
    nothing is factorised before.

    Attributes
    ----------
    team : Team
        All ranks.
    reference : ReferenceProblem
        What the reference images give.
    noise : tuple of float
        Of each camera, grey levels; empty with one camera, and before it is known.
    n_assembled : int
        Times that M_s of an owned subdomain was assembled.
    """

    def __init__(self, team: Team, reference: ReferenceProblem, clock: PhaseClock) -> None:
        """Set up what is known without a frame; collective.

        Parameters
        ----------
        team : Team
            All ranks.
        reference : ReferenceProblem
            What the reference images give.
        clock : PhaseClock
            Of the phases.

        Raises
        ------
        InputError, SingularSubdomainError, FactorizationError
            On all ranks.
        """
        self.team, self.reference = team, reference
        self.noise: tuple[float, ...] = ()
        self.n_assembled = len(reference.references)
        self._clock = clock
        self._weights: list[float] = []
        self._is_spoiled = False
        self._solver: LinearSolver | None = None
        self._visible = VisiblePixels.all_of([r.views for r in reference.references])
        cameras = reference.inputs.cameras
        given = [camera.noise for camera in cameras]
        if len(cameras) == 1:
            self._set_up([1.0])
        elif None not in given:
            self.set_noise([noise for noise in given if noise is not None])

    @property
    def is_set_up(self) -> bool:
        """Whether the cameras' weights are known."""
        return self._solver is not None

    @property
    def solver(self) -> LinearSolver:
        """The factorised linear step."""
        if self._solver is None:
            raise RuntimeError("the noise of the cameras is not known yet")
        return self._solver

    def set_noise(self, noise: Sequence[float]) -> None:
        """Weight the cameras by their noise and factorise; collective.

        Parameters
        ----------
        noise : sequence of float
            Standard deviation of each camera's noise, grey levels.

        Raises
        ------
        InputError, SingularSubdomainError, FactorizationError
            On all ranks.
        """
        self.noise = tuple(noise)
        self._set_up([(noise[0] / sigma) ** 2 for sigma in noise])

    def weigh(self, views: Sequence[FrameViews]) -> list[FrameViews]:
        """Give the cameras of a frame their weights.

        Parameters
        ----------
        views : sequence of FrameViews
            Owned subdomains in the frame.

        Returns
        -------
        list of FrameViews
            The same pixels.
        """
        weighted = []
        for of_subdomain in views:
            reference = of_subdomain.reference.weigh(self._weights)
            frame_views = tuple(FrameView(view, old.deformed)
                                for view, old in zip(reference.views, of_subdomain.views, strict=True))
            weighted.append(FrameViews(reference, frame_views))
        return weighted

    def renew(self, views: Sequence[FrameViews], q: Sequence[NDArray[np.float64]]) -> str:
        """Assemble and factorise again where a frame shows other pixels than M counts; collective.

        Parameters
        ----------
        views : sequence of FrameViews
            Owned subdomains in the frame, weighted.
        q : sequence of (n_unknowns,) array
            Where the frame is thought to show them.

        Returns
        -------
        str
            What the log says; empty where nothing changes.

        Raises
        ------
        SingularSubdomainError, FactorizationError
            On all ranks.
        """
        if self._is_spoiled:
            self._restore()
        is_regularized = self.reference.inputs.case.regularization is not None
        renewal = find_renewal(self.team, views, q, (self._visible, self.reference.hessians), keep_held=is_regularized)
        if renewal.note:
            self.n_assembled += sum(hessian is not None for hessian in renewal.hessians)
            # True until it has worked: a factorisation that fails leaves some factors without the others.
            self._is_spoiled = True
            self.solver.renew(renewal.hessians)
            self._is_spoiled = False
            self._visible = renewal.visible
        return renewal.note

    def destroy(self) -> None:
        """Free PETSc's objects."""
        if self._solver is not None:
            self._solver.destroy()
            self._solver = None

    def _restore(self) -> None:
        """Go back to the factors of the reference images, after a frame for which they could not be renewed."""
        n_factorized = self.solver.n_factorized
        self.solver.destroy()
        self._visible = VisiblePixels.all_of([r.views for r in self.reference.references])
        self._set_up(self._weights)
        self.solver.n_factorized += n_factorized
        self._is_spoiled = False

    def _set_up(self, weights: list[float]) -> None:
        self._weights = weights
        reference = self.reference
        with self._clock.phase(Phase.ASSEMBLE):
            weighted: list[ReferenceViews] = [r.weigh(weights) for r in reference.references]
            assembly = assemble(self.team, reference.inputs.case, reference.region, weighted, reference.hessians)
        self._solver = LinearSolver(self.team, reference.inputs.case, assembly, self._clock)
