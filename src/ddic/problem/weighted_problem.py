"""The systems of a measurement, cameras weighted by their noise, factorised and renewed where a frame asks for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ddic.errors import SingularSubdomainError, as_collective, is_collective
from ddic.functionals.regularization import HalfAmplitudes
from ddic.functionals.view import CellSlopes, FrameView, View
from ddic.inputs.cameras import Frame
from ddic.mesh.rotation import Rotation
from ddic.parallel.field import ByView, Field
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.added_forces import LEAST_ANGLE, HeldRotation, choose_stiffness_rotation, fit_rigid_motion
from ddic.problem.assembly import AssembledFrom, assemble, describe_lost_pixels, find_renewal, find_unseen_unknowns
from ddic.problem.linear_solver import LinearSolver
from ddic.problem.material_law import LawStep, build_law
from ddic.problem.reference_problem import ReferenceProblem, weigh_cameras
from ddic.problem.region_mesh import compute_cut_off_wavelength, describe_cut_off
from ddic.problem.residual_model import ResidualModel, open_frame_views
from ddic.solvers.correction_size import Tolerances
from ddic.solvers.linear_step import LinearStep
from ddic.solvers.local_system import describe_lost


class WeightedProblem:
    """Local systems and the linear solver of a reference problem.

    One camera weighs 1. Several are weighted by their noise; where the case does not give it, the first frame does, and
    nothing is factorised before. Raises InputError, SingularSubdomainError or FactorizationError on all ranks.

    Parameters
    ----------
    team, reference, clock : Team, ReferenceProblem, PhaseClock
        All ranks, what the reference images give, and the clock of the phases.
    factorize_now : bool
        Whether to factorise what is known without a frame; where the first frame is at hand, it may ask for other
        operators. What the reference images alone leave singular waits for a frame all the same.

    Attributes
    ----------
    noise : tuple of float
        Of each camera, grey levels; empty with one camera, and before it is known.
    n_assembled : int
        Times that M_s of an owned subdomain was assembled.
    law : FollowedLaw or None
        What the material has been through, where it is plastic.
    """

    def __init__(self, team: Team, reference: ReferenceProblem, clock: PhaseClock, *,
                 factorize_now: bool = True) -> None:
        self.team, self.reference = team, reference
        self.noise: tuple[float, ...] = ()
        self.n_assembled = len(reference.subdomains)
        self._clock = clock
        self._weights: list[float] = []
        self._solver: LinearSolver | None = None
        self._assembled_from = AssembledFrom.all_of(reference.subdomains, reference.views)
        # By which the stiffness is turned.
        self._stiffness_rotation = Rotation.none(reference.subdomains[0].mesh.dim)
        self.law = build_law(team, reference.inputs, reference.subdomains)
        # Whether a frame has changed M or K.
        self._is_changed = False
        cameras = reference.inputs.cameras
        given = [camera.noise for camera in cameras]
        if len(cameras) == 1:
            self._weigh([1.0])
        elif None not in given:
            self.set_noise([noise for noise in given if noise is not None])
        if factorize_now and self._solver is not None and not self._has_free_unknowns():
            try:
                self._solver.set_up()
            except BaseException:
                self.destroy()
                raise

    def _has_free_unknowns(self) -> bool:
        """Whether neither a pixel nor mechanics hold some unknowns: a frame fills the cells of these; collective."""
        reference = self.reference
        if reference.inputs.case.regularization is not None:
            return False
        return len(find_unseen_unknowns(self.team, reference.subdomains, self._assembled_from.n_pixels)) > 0

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

    @property
    def step(self) -> LinearStep:
        """The linear step of Gauss-Newton."""
        return self.solver.step if self.law is None else LawStep(self.law, self.solver)

    @cached_property
    def size(self) -> ProblemSize:
        """How large the problem is, counted once a frame has been looked at; collective when it is first asked for."""
        region, solver, case = self.reference.region, self.solver, self.reference.inputs.case
        ranges = self.team.gather_lists([own.measure_grey_range() for own, *_ in self.reference.views])
        lowest, highest = zip(*ranges, strict=True)
        return ProblemSize(region.n_field, region.n_cells, self.reference.n_pixels, region.n_subdomains, self.team.size,
                           solver.n_interface, max(highest) - min(lowest), solver.assembly.eta,
                           describe_cut_off(case.regularization, case.dim))

    @property
    def tolerances(self) -> Tolerances:
        """When Gauss-Newton stops."""
        case = self.reference.inputs.case
        section = case.gauss_newton
        return Tolerances(section.tolerance, section.rms_tolerance, section.max_iterations, case.solver.inexact,
                          section.largest_tolerance)

    def open_frame(self, frame: Frame) -> ByView[FrameView]:
        """Look at a frame, cameras not yet weighted; its windows are read when unknowns say where."""
        return open_frame_views(self.reference.inputs.case, frame, self.reference.views)

    def build_residual_model(self, views: ByView[FrameView]) -> ResidualModel:
        """Model the residual of a frame, cameras weighted: what Gauss-Newton asks of the images."""
        inputs = self.reference.inputs
        asked = inputs.case.correlation.grey_correction
        correction = "none" if asked == "auto" else asked
        return ResidualModel(self.team, self.reference.subdomains, weigh_cameras(views, self._weights), correction,
                             len(inputs.cameras))

    @cached_property
    def slopes(self) -> ByView[CellSlopes]:
        """Mean of grad f grad f^T on the cells of each view."""
        return self.reference.views.map(View.measure_slopes)

    def set_noise(self, noise: Sequence[float]) -> None:
        """Weight the cameras by the standard deviations of their noise, grey levels; collective.

        Raises InputError, SingularSubdomainError or FactorizationError on all ranks.
        """
        self.noise = tuple(noise)
        self._weigh([(noise[0] / sigma) ** 2 for sigma in noise])

    def hold_rotation(self, model: ResidualModel, q: Field) -> tuple[ResidualModel, tuple[str, ...]]:
        """Let a rotation of the region, told by unknowns ``q``, cost nothing; collective.

        The equilibrium gap of the new model is that of q less its rigid motion. The notes are for the log; there are
        none where the rotation is as it was.
        """
        if self.reference.inputs.case.regularization is None:
            return model, ()
        rotation = fit_rigid_motion(q).rotation
        angle = rotation.angle
        notes: tuple[str, ...] = ()
        of_stiffness = choose_stiffness_rotation(rotation, self._stiffness_rotation)
        if of_stiffness is not self._stiffness_rotation:
            self._turn_stiffness(of_stiffness)
            notes = (f"the stiffness is turned by {np.rad2deg(of_stiffness.angle):.1f} degrees",)
        elif self.law is not None or (abs(angle) > LEAST_ANGLE) == (model.rotation is not None):
            return model, ()
        if abs(angle) <= LEAST_ANGLE or self.law is not None:
            # A law knows any rotation.
            return replace(model, rotation=None), notes
        note = f"the region has turned by {np.rad2deg(angle):.2f} degrees: the equilibrium gap is that of what is left"
        return replace(model, rotation=HeldRotation(self.team, self.solver.assembly.systems)), (*notes, note)

    def _turn_stiffness(self, rotation: Rotation) -> None:
        """Set the systems up anew, with R K R^T; where that fails, the old ones stay."""
        before, old = self._stiffness_rotation, self.solver
        self._stiffness_rotation, self._is_changed = rotation, True
        try:
            self._weigh(self._weights)
        except BaseException:
            self._stiffness_rotation, self._solver = before, old
            raise
        self.solver.n_factorized = old.n_factorized
        # Conjugate gradients that did not converge would not now.
        self.solver.method = old.method
        # Before the new ones are factorised.
        old.destroy()

    def fit(self, model: ResidualModel, q: Field) -> tuple[ResidualModel, tuple[str, ...]]:
        """Let a rotation of the region cost nothing, and M count what a model shows; collective.

        The frame is thought to show the specimen at ``q``. The new model has what lets the rotation cost nothing, and
        the cells that nothing else holds; the notes are for the log, none where nothing changes. Raises
        SingularSubdomainError or FactorizationError on all ranks.
        """
        turned, of_rotation = self.hold_rotation(model, q)
        fitted, of_pixels = self.renew(turned, q)
        return fitted, (*of_rotation, *of_pixels)

    def renew(self, model: ResidualModel, q: Field) -> tuple[ResidualModel, tuple[str, ...]]:
        """Assemble and factorise again where a frame shows something else than M was made of; collective.

        Cameras are weighted, and the frame is thought to show the specimen at ``q``. The new model has the cells that
        neither pixels nor mechanics hold; the notes are for the log, none where nothing changes. Raises
        SingularSubdomainError or FactorizationError on all ranks.
        """
        wavelength = compute_cut_off_wavelength(self.reference.inputs.case)
        with self._clock.phase(Phase.ASSEMBLE):
            renewal = find_renewal(model, q, (self._assembled_from, self.reference.hessians), wavelength,
                                   self.solver.assembly)
        if renewal.notes or not self.solver.is_set_up:
            self.n_assembled += sum(system is not None for system in renewal.systems)
            try:
                self.solver.renew(renewal.systems)
            except SingularSubdomainError as error:
                n_pixels = renewal.assembled_from.n_pixels
                # What the frame has to do with it.
                reason = describe_lost_pixels(model, n_pixels) if is_collective(error) else ""
                if not reason:
                    raise
                raise as_collective(SingularSubdomainError(describe_lost(str(error), reason))) from error
            # Not before: where the factorisation fails, the next frame asks for it again.
            self._assembled_from = renewal.assembled_from
            self._is_changed |= bool(renewal.notes)
            if model.rotation is not None:
                # Of the rows that count now.
                model = replace(model, rotation=HeldRotation(self.team, self.solver.assembly.systems))
        return replace(model, filled=renewal.filled), renewal.notes

    def begin_anew(self) -> None:
        """Forget earlier frames: what the next one comes to depends on its images and its start alone; collective.

        M and K are again what the reference images give, where frames have changed them.
        """
        if self._is_changed:
            self._turn_stiffness(Rotation.none(self.reference.subdomains[0].mesh.dim))
            self._is_changed = False
        elif self._solver is not None and self._solver.is_set_up:
            self._solver.step.forget()

    def destroy(self) -> None:
        """Free PETSc's objects."""
        if self._solver is not None:
            self._solver.destroy()
            self._solver = None

    def _weigh(self, weights: list[float]) -> None:
        self._weights = weights
        reference = self.reference
        with self._clock.phase(Phase.ASSEMBLE):
            is_turned = self._stiffness_rotation.angle != 0
            assembly = assemble(self.team, reference, weights, self._stiffness_rotation.matrix if is_turned else None)
        self._assembled_from = AssembledFrom.all_of(reference.subdomains, reference.views)
        choice = reference.inputs.choice
        self._solver = LinearSolver(self.team, reference.inputs.case, assembly, self._clock,
                                    None if choice is None else choice.most_iterations)


@dataclass(frozen=True)
class ProblemSize:
    """What is about to be solved.

    Attributes
    ----------
    n_unknowns, n_cells : int
        Of the whole field, and of the mesh.
    n_pixels : int
        Pixels of the mesh that the reference images do not exclude.
    n_subdomains, n_ranks, n_interface : int
        Subdomains, MPI ranks, interface unknowns.
    dynamic_range : float
        max f - min f over the region, grey levels.
    eta : float
        Weight of the equilibrium gap, grey levels squared per pixel squared; 0 without.
    half_amplitudes : HalfAmplitudes or None
        Waves that a cut-off wavelength halves; None where there is none.
    """

    n_unknowns: int
    n_cells: int
    n_pixels: int
    n_subdomains: int
    n_ranks: int
    n_interface: int
    dynamic_range: float
    eta: float
    half_amplitudes: HalfAmplitudes | None = None
