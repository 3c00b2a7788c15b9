"""Cameras' pixels of owned subdomains: of the reference images, and of one frame."""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from operator import add
from typing import TypeVar

from scipy import sparse

from ddic.arrays import Array
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
from ddic.parallel.field import ByView
from ddic.partition.subdomain import Subdomain

V = TypeVar("V", bound=View)

Hessians = ByView[sparse.csr_matrix]
"""M of each view, on displacements of nodes in its image, (n_dofs, n_dofs)."""


def read_reference_views(case: Case, cameras: Sequence[Camera], subdomains: Sequence[Subdomain]) -> ByView[View]:
    """Read the windows of the reference images that this rank's subdomains need; free of communication.

    The views of a subdomain are that of its own camera first, then of others that see it as well. All cameras weigh 1.
    Raises InputError where pixels of the mesh lie outside an image.
    """
    threads = Threads(case.solver.threads)
    views: list[list[View]] = [[] for _ in subdomains]
    for camera in cameras:
        seen = [k for k, s in enumerate(subdomains) if _is_seen_by(camera, cameras, s)]
        kinematics = [_kinematics_before(camera, cameras, subdomains[k]) for k in seen]
        groups = _read_groups(camera, [k.mesh for k in kinematics], case.correlation.spline_degree, threads)
        for place, of_subdomain, (group, correlation) in zip(seen, kinematics, groups, strict=True):
            views[place].append(View(correlation, of_subdomain, camera.number, group))
    return ByView(sorted(of_subdomain, key=lambda view: view.camera != s.camera)
                  for s, of_subdomain in zip(subdomains, views, strict=True))


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


def open_frame_views(case: Case, frame: Frame, views: ByView[View]) -> ByView[FrameView]:
    """Look at a frame; its windows are read when unknowns say where.

    Views that share a window of the reference share one of the frame.
    """
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


def project_hessians(views: ByView[V], hessians: Hessians) -> list[sparse.csr_matrix]:
    """Add up the cameras' M in the unknowns of each subdomain: M_s, (n_unknowns, n_unknowns)."""
    return add_matrices(views.map(View.project, hessians))


def add_matrices(matrices: ByView[sparse.csr_matrix]) -> list[sparse.csr_matrix]:
    """Add up the views of each owned subdomain, in their order."""
    return [reduce(add, of_views).tocsr() for of_views in matrices]


def hold_set_ups_still(subdomains: Sequence[Subdomain], views: ByView[V]) -> tuple[list[Subdomain], ByView[V]]:
    """Give what each subdomain's own camera alone sees, in a set-up that does not move: the field's unknowns only."""
    return [replace(s, motion=None) for s in subdomains], ByView([own.hold_still()] for own, *_ in views)


def weigh_cameras(views: ByView[V], weights: Sequence[float]) -> ByView[V]:
    """Give each camera its weight in the functional, of squared grey levels, no unit."""
    return views.map(lambda view: replace(view, weight=weights[view.camera]))
