"""Subdomains with their cameras' pixels: of the reference images, and of one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.case.schema import Case
from ddic.functionals.correlation import Correlation, read_correlations
from ddic.functionals.view import FrameView, View
from ddic.images.sub_image import DeformedSubImage
from ddic.images.threads import Threads
from ddic.images.window import Window
from ddic.inputs.cameras import Camera, Frame
from ddic.kinematics.camera import place_before_camera
from ddic.kinematics.kinematics import Kinematics
from ddic.mesh.mesh import Mesh
from ddic.partition.subdomain import Subdomain


@dataclass(frozen=True)
class ReferenceViews:
    """An owned subdomain with its pixels of the reference images.

    Attributes
    ----------
    subdomain : Subdomain
        Its cells and unknowns.
    views : tuple of View
        Of its own camera first, then of others that see it as well.
    """

    subdomain: Subdomain
    views: tuple[View, ...]

    @property
    def own(self) -> View:
        """What its own camera says."""
        return self.views[0]

    def weigh(self, weights: Sequence[float]) -> ReferenceViews:
        """Give each camera its weight in the functional, of squared grey levels, no unit."""
        return replace(self, views=tuple(replace(view, weight=weights[view.camera]) for view in self.views))

    def project(self, hessians: Sequence[sparse.csr_matrix]) -> sparse.csr_matrix:
        """Add up the cameras' M in the subdomain's unknowns: M_s, (n_unknowns, n_unknowns).

        ``hessians`` are M of each view, (n_dofs, n_dofs), on displacements of nodes in its image.
        """
        total = self.views[0].project(hessians[0])
        for view, hessian in zip(self.views[1:], hessians[1:], strict=True):
            total = total + view.project(hessian)
        return total.tocsr()

    def alone(self) -> ReferenceViews:
        """Give the same as its own camera alone sees it, in a set-up that does not move: the field's unknowns only."""
        still = replace(self.own.hold_still(), camera=0)
        return ReferenceViews(replace(self.subdomain, motion=None), (still,))


@dataclass(frozen=True)
class FrameViews:
    """An owned subdomain with its pixels in one frame.

    Attributes
    ----------
    reference, views : ReferenceViews, tuple of FrameView
        The same in the reference images, and in the frame by the same cameras.
    """

    reference: ReferenceViews
    views: tuple[FrameView, ...]

    @property
    def subdomain(self) -> Subdomain:
        """Its cells and unknowns."""
        return self.reference.subdomain

    def alone(self) -> FrameViews:
        """Give the same as its own camera alone sees it, in a set-up that does not move: the field's unknowns only."""
        reference = self.reference.alone()
        return FrameViews(reference, (FrameView(reference.own, self.views[0].deformed),))


def read_reference_views(case: Case, cameras: Sequence[Camera],
                         subdomains: Sequence[Subdomain]) -> list[ReferenceViews]:
    """Read the windows of the reference images that this rank's subdomains need; free of communication.

    All cameras weigh 1. Raises InputError where pixels of the mesh lie outside an image.
    """
    threads = Threads(case.solver.threads)
    views: list[list[View]] = [[] for _ in subdomains]
    for camera in cameras:
        seen = [k for k, s in enumerate(subdomains) if _is_seen_by(camera, cameras, s)]
        kinematics = [_kinematics_before(camera, cameras, subdomains[k]) for k in seen]
        groups = _read_groups(camera, [k.mesh for k in kinematics], case.correlation.spline_degree, threads)
        for place, of_subdomain, (group, correlation) in zip(seen, kinematics, groups, strict=True):
            views[place].append(View(correlation, of_subdomain, camera.number, group))
    # Its own camera first.
    return [ReferenceViews(s, tuple(sorted(of_subdomain, key=lambda view: view.camera != s.camera)))
            for s, of_subdomain in zip(subdomains, views, strict=True)]


def _is_seen_by(camera: Camera, cameras: Sequence[Camera], subdomain: Subdomain) -> bool:
    if subdomain.camera == camera.number:
        return True
    return camera.number == 0 and cameras[subdomain.camera].use_far


def _kinematics_before(camera: Camera, cameras: Sequence[Camera], subdomain: Subdomain) -> Kinematics:
    """From a subdomain's unknowns to displacements in a camera's pixels."""
    is_specimens_frame = camera.number == 0
    if is_specimens_frame and subdomain.motion is None:
        return subdomain.kinematics
    setup = camera.setup if camera.number == subdomain.camera else camera.setup.hold_still()
    numbers = None if subdomain.motion is None else subdomain.motion.numbers
    return place_before_camera(subdomain.kinematics, setup, numbers)


def _read_groups(camera: Camera, meshes: Sequence[Mesh], degree: int,
                 threads: Threads) -> list[tuple[int, Correlation]]:
    """The correlation of each mesh, with the number of the window that it shares with others."""
    if not meshes:
        return []
    groups = read_correlations(meshes, camera.reference, degree, threads)
    return [(number, correlation) for number, group in enumerate(groups) for correlation in group]


def open_frame_views(case: Case, frame: Frame, references: Sequence[ReferenceViews]) -> list[FrameViews]:
    """Look at a frame; its windows are read when unknowns say where.

    Views that share a window of the reference share one of the frame.
    """
    threads = Threads(case.solver.threads)
    windows: dict[tuple[int, int], DeformedSubImage] = {}
    for reference in references:
        for view in reference.views:
            windows.setdefault((view.camera, view.group),
                               DeformedSubImage(frame[view.camera], case.correlation.spline_degree, threads))
    return [FrameViews(reference, tuple(FrameView(view, windows[view.camera, view.group])
                                        for view in reference.views))
            for reference in references]


def read_frame_windows(views: Sequence[FrameViews], q: Sequence[NDArray[np.float64]]) -> None:
    """Read the windows of a frame that unknowns ask for, and no larger ones; free of communication."""
    wanted: dict[int, tuple[DeformedSubImage, Window]] = {}
    for of_subdomain, q_s in zip(views, q, strict=True):
        for view in of_subdomain.views:
            window = view.find_displaced_window(q_s)
            known = wanted.get(id(view.deformed))
            # At once for all who share it: one by one, every subdomain would outgrow what the last one read.
            union = window if known is None else window.union(known[1])
            wanted[id(view.deformed)] = (view.deformed, union)
    for deformed, window in wanted.values():
        deformed.hold(window)
