"""The residual f - g(x + u) of all subdomains in one frame: what Gauss-Newton asks of the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddic.arrays import Array
from ddic.case.schema import Case
from ddic.errors import ConvergenceError, as_collective
from ddic.functionals.correlation import LARGE_SHARE, Residual, find_large_gradients
from ddic.functionals.grey_statistics import GreyCorrection, GreyState, GreySums, measure_deviation
from ddic.functionals.view import FrameView, View
from ddic.images.binned import Blur
from ddic.images.sub_image import DeformedSubImage
from ddic.images.threads import Threads
from ddic.images.window import Window
from ddic.inputs.cameras import Frame
from ddic.parallel.field import ByView, Field, add_views
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.added_forces import FilledCells, HeldRotation
from ddic.problem.held_cells import PulledView, sum_pulls
from ddic.solvers.correction_size import CorrectionSize, Tolerances, measure_correction, weigh_nodes


@dataclass(frozen=True)
class Evaluation:
    """The residual at some unknowns.

    Attributes
    ----------
    residuals : ByView of Residual
        Of owned subdomains.
    grey : tuple of GreyState
        Of each camera, over the whole region.
    """

    residuals: ByView[Residual]
    grey: tuple[GreyState, ...]


@dataclass(frozen=True)
class ResidualModel:
    """Grey-level conservation of all subdomains in one frame.

    Attributes
    ----------
    team, subdomains, views : Team, sequence of Subdomain, ByView of FrameView
        All ranks, and owned subdomains with their pixels.
    correction : GreyCorrection
        Of grey levels: "none", "global" or "element".
    n_cameras : int
        Number of cameras.
    follows : bool
        Whether b takes the gradient of the deformed image where the displacement puts it, F^-T grad f.
    rotation : HeldRotation, optional
        Lets the region's rotation cost nothing; None where it has not turned.
    filled : FilledCells, optional
        Cells that neither pixels nor mechanics hold; None where there are none.
    pulled : ByView of PulledView or None, optional
        Cells that are pulled to where the frame shows them; None where there are none.
    blurs : tuple of (int, Blur)
        Cameras whose reference image was blurred as much as the frame is, and how.
    deviations : list of (n_nodes,) array, optional
        Standard deviation of each node's displacement, of each owned subdomain, pixels; None where every node is
        followed to the last digit.
    held_grey : tuple of GreyState, optional
        Statistics of the cameras that are not computed anew: this model passes over a few cells only.
    known : tuple of Field and Evaluation, optional
        Unknowns at which the residual is known already, and the residual.
    keeps_windows : bool
        Whether the frame's windows that are held stay, since others use them as well.
    """

    team: Team
    subdomains: Sequence[Subdomain]
    views: ByView[FrameView]
    correction: GreyCorrection
    n_cameras: int = 1
    follows: bool = False
    rotation: HeldRotation | None = None
    filled: FilledCells | None = None
    pulled: ByView[PulledView | None] | None = None
    blurs: tuple[tuple[int, Blur], ...] = ()
    deviations: list[Array] | None = None
    held_grey: tuple[GreyState, ...] | None = None
    known: tuple[Field, Evaluation] | None = None
    keeps_windows: bool = False

    def with_large_gradients(self, q: Field) -> ResidualModel:
        """Take the gradient where the displacement puts it, if cells turn or stretch by much; collective."""
        return replace(self, follows=is_deformation_large(self.team, self.views, q))

    def evaluate(self, q: Field) -> Evaluation:
        """Pass over all pixels; collective. Raises ConvergenceError on all ranks, where a camera has no pixel left."""
        if self.known is not None and q.is_equal_to(self.known[0]):
            return self.known[1]
        residuals = self.team.together(lambda: self._compute_residuals(q))
        if self.held_grey is not None:
            return Evaluation(residuals, self.held_grey)
        sums = self.sum_by_camera(residuals.map(lambda residual: residual.sums.values))
        corrected: Sequence[Array | None] = [None] * self.n_cameras
        if self.correction == "element":
            corrected = list(self.sum_by_camera(residuals.map(_sums_corrected_by_cell)))
        grey = [self._grey_state(GreySums(total), by_cell) for total, by_cell in zip(sums, corrected, strict=True)]
        return Evaluation(residuals, tuple(grey))

    def _compute_residuals(self, q: Field) -> ByView[Residual]:
        if not self.keeps_windows:
            # Before any is used: those who share a window would read it once each, larger and larger.
            read_frame_windows(self.views, q)
        all_kinds = self.correction != "none"
        residuals = self.views.map(lambda view, q_s: view.compute_residual(q_s, all_kinds=all_kinds),
                                   self.views.fill(q))
        if self.pulled is None:
            return residuals
        return self.pulled.map(lambda pulled, residual: residual if pulled is None else pulled.keep_others(residual),
                               residuals)

    def assemble_right_hand_side(self, evaluation: Evaluation, q: Field) -> Field:
        """Assemble b, Eq. 7 of [BP17], grey levels squared per pixel, from the evaluation at q, on each rank."""

        def assemble(view: FrameView, residual: Residual, q_s: Array) -> Array:
            followed = view.with_moved_gradient(q_s) if self.follows else view
            return followed.assemble_right_hand_side(residual, *self.find_correction(evaluation, view.camera, residual))

        return q.with_parts(add_views(self.views.map(assemble, evaluation.residuals, self.views.fill(q))))

    def show(self, view: FrameView, q_s: Array) -> FrameView:
        """Give a view of the pixels that unknowns of its subdomain do not hide, with the gradient that b takes."""
        shown = view.without_hidden(q_s)
        return shown.with_moved_gradient(q_s) if self.follows else shown

    def find_correction(self, evaluation: Evaluation, camera: int, residual: Residual) -> tuple[Array, Array]:
        """Find gain, no unit, and offset, grey levels, of a view's cells: one number, or one per cell, (n_cells,)."""
        if self.correction == "element":
            return residual.cell_sums.fit_gain_and_offset()
        state = evaluation.grey[camera]
        return np.array(state.gain), np.array(state.offset)

    def linearize(self, q: Field) -> tuple[Field, tuple[GreyState, ...]]:
        """Pass over all pixels: b, grey levels squared per pixel, and each camera's grey statistics; collective."""
        evaluation = self.evaluate(q)
        b = self.assemble_right_hand_side(evaluation, q)
        for part in (self.rotation, self.filled):
            if part is not None:
                b = b + part.compute_forces(q)
        if self.pulled is not None:
            b = b + sum_pulls(self.pulled, q)
        return b, evaluation.grey

    def measure_correction(self, dq: Field, q: Field, tolerances: Tolerances) -> CorrectionSize:
        """Measure a correction of q on displacements of nodes, slow ones by the tolerances; collective."""
        return measure_correction(dq, q, self.weigh_nodes(), tolerances.largest)

    def weigh_nodes(self) -> list[Array] | None:
        """Weigh corrections of nodes by what can be known of them, (n_nodes,) of each owned subdomain."""
        return None if self.deviations is None else weigh_nodes(self.deviations)

    def sum_by_camera(self, values: ByView[Array]) -> Array:
        """Sum what views have by their cameras, (n_cameras, ...); collective."""

        def put_in_row(view: FrameView, of_view: Array) -> Array:
            rows = np.zeros((self.n_cameras, *of_view.shape))
            rows[view.camera] = of_view
            return rows

        return self.team.ordered_sum(add_views(self.views.map(put_in_row, values)))

    def _grey_state(self, total: GreySums, corrected: Array | None) -> GreyState:
        """Statistics of a camera from the sums over its pixels; corrected: of the residual corrected by cell, (2,)."""
        n = float(total.n_pixels)
        if n == 0:
            raise as_collective(ConvergenceError(
                "no pixel is left: every pixel of the mesh is masked or mapped outside the deformed image; "
                "check the start of the displacement and the masks"))
        gain, offset = np.ones(()), np.zeros(())
        if self.correction == "global":
            gain, offset = total.fit_gain_and_offset()
        first, second = total.sum_residual(gain, offset) if corrected is None else corrected
        return GreyState(*measure_deviation(n, first, second), int(n), float(gain), float(offset))


def _sums_corrected_by_cell(residual: Residual) -> Array:
    """Sum of the residual corrected cell by cell, and of its square, (2,)."""
    first, second = residual.cell_sums.sum_residual(*residual.cell_sums.fit_gain_and_offset())
    return np.array([first.sum(), second.sum()])


def is_deformation_large(team: Team, views: ByView[FrameView], q: Sequence[Array]) -> bool:
    """Tell whether more than a few cells of the region turn or stretch by much, the same on all ranks; collective."""
    counts = np.zeros(2)
    for (own, *_), q_s in zip(views, q, strict=True):
        # By pixels: cells about a crack's tip are small and many.
        of_cells = own.count_pixels()
        is_large = find_large_gradients(own.correlation.mesh, own.kinematics.displacement(q_s))
        counts += of_cells[is_large].sum(), of_cells.sum()
    n_large, n_pixels = team.sum(counts)
    return bool(n_large > LARGE_SHARE * n_pixels)


def open_frame_views(case: Case, frame: Frame, views: ByView[View]) -> ByView[FrameView]:
    """Look at a frame; views that share a window of the reference share one of it, read when unknowns say where."""
    threads = Threads(case.solver.threads)
    windows: dict[tuple[int, int], DeformedSubImage] = {}
    for view in views.flat:
        windows.setdefault((view.camera, view.group),
                           DeformedSubImage(frame[view.camera], case.correlation.spline_degree, threads))
    return views.map(lambda view: view.open_frame(windows[view.camera, view.group]))


def read_frame_windows(views: ByView[FrameView], q: Sequence[Array]) -> None:
    """Read the windows of a frame that unknowns ask for, and no larger ones; free of communication."""
    wanted: dict[int, tuple[DeformedSubImage, Window]] = {}
    for view, q_s in zip(views.flat, views.fill(q).flat, strict=True):
        window = view.find_displaced_window(q_s)
        known = wanted.get(id(view.deformed))
        # At once for all who share it: one by one, every subdomain would outgrow what the last one read.
        union = window if known is None else window.union(known[1])
        wanted[id(view.deformed)] = (view.deformed, union)
    for deformed, window in wanted.values():
        deformed.hold(window)
