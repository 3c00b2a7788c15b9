"""Subdomains of several cameras: who gets which cells, and what each camera says about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.case.schema import Case
from ddic.functionals.correlation import read_correlations
from ddic.functionals.view import View
from ddic.images.sub_image import DeformedSubImage
from ddic.images.threads import Threads
from ddic.kinematics.pose import Rig, pose, seen_mesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.partition.by_camera import cameras_at_nodes, kept_apart, split_by_camera, with_cameras
from ddic.partition.connectivity import build_subdomains
from ddic.partition.cost import cell_costs, subdomain_costs
from ddic.partition.split import split_by_metis
from ddic.partition.subdomain import Subdomain
from ddic.partition.tied_parts import with_told_masters
from ddic.partition.ties import Tying
from ddic.problem.cameras import Camera, measured_by
from ddic.problem.inputs import CutMesh, Region, controlled_dofs, given_parts, inner_nodes, region_gap_energies
from ddic.solvers.gauss_newton import OwnedPart


@dataclass(frozen=True)
class NearFarMesh:
    """The whole mesh cut, and where cameras meet.

    meshes: the cells that each camera measures, in its own pixels; shared: nodes of several cameras, by number.
    """

    whole: CutMesh
    meshes: list[Mesh]
    shared: NDArray[np.int64]


def still(rig: Rig) -> Rig:
    """The camera as if its set-up did not move between its pictures."""
    return replace(rig, motion="none")


@dataclass(frozen=True)
class CameraField:
    """What one camera measures: numbers of its cells, their mesh, and that in the camera's pixels."""

    cells: NDArray[np.int64]
    mesh: Mesh
    seen: Mesh


def camera_fields(cameras: Sequence[Camera], mesh: Mesh, labels: NDArray[np.int64]) -> list[CameraField]:
    """The cells of each camera; labels: of ``measured_by``, (n_cells,)."""
    fields = []
    for number, camera in enumerate(cameras):
        cells = np.flatnonzero(labels == number)
        part, _ = mesh.submesh(cells)
        fields.append(CameraField(cells, part, seen_mesh(part, pose(still(camera.rig), part.nodes, 1.0))))
    return fields


def cut_by_camera(case: Case, mesh: Mesh, cameras: Sequence[Camera], n_ranks: int,
                  tying: Tying | None = None) -> NearFarMesh:
    """Split the whole mesh so that every subdomain has one camera; free of communication. Raises InputError.

    tying: of near fields' own meshes in the whole one, None without.
    """
    labels = measured_by(case, tuple(cameras), mesh, tying)
    at_nodes = cameras_at_nodes(mesh, labels, len(cameras), None if tying is None else tying.weights)
    fields = camera_fields(cameras, mesh, labels)
    costs = np.zeros(mesh.n_cells)
    for number, field in enumerate(fields):
        costs[field.cells] = cell_costs(field.seen)
        if number and case.near[number - 1].use_far:
            costs[field.cells] += rasterize(field.mesh).pixel_counts
    given = given_parts(case.solver, mesh)
    parts = kept_apart(given, labels) if given is not None else split_by_camera(
        labels, costs, case.solver.subdomains or max(n_ranks, len(cameras)),
        lambda cells, n: split_by_metis(mesh.submesh(cells)[0], n, costs[cells]))
    boundary = None if tying is None else tying.boundary
    weights = None if tying is None else tying.weights
    if tying is not None:
        parts = with_told_masters(mesh, tying, parts)
    far_inside = inner_nodes(mesh, boundary)
    far_inside[:len(at_nodes)] &= ~at_nodes[:, 1:].any(axis=1)
    far_inside[len(at_nodes):] = False
    n_dofs = at_nodes.shape[0] * mesh.dim
    controlled = controlled_dofs(case.regularization, mesh, boundary)[:n_dofs]
    subdomains = with_cameras(build_subdomains(mesh, parts, controlled, weights), labels,
                              [camera.rig.n_shifts for camera in cameras], far_inside, n_dofs)
    region = Region(mesh.n_nodes, mesh.n_cells, n_dofs, len(subdomains),
                    region_gap_energies(case.regularization, mesh, far_inside), mesh.mapping)
    return NearFarMesh(CutMesh(subdomains, subdomain_costs(costs, parts), region), [field.seen for field in fields],
                       np.flatnonzero(at_nodes.sum(axis=1) > 1))


def own_views(case: Case, cameras: Sequence[Camera], subdomains: Sequence[Subdomain]) -> list[OwnedPart]:
    """Read the reference images of owned subdomains; set-ups still, all weights 1."""
    degree = case.correlation.spline_degree
    threads = Threads(case.solver.threads)
    views: list[list[View]] = [[] for _ in subdomains]
    for number, camera in enumerate(cameras):
        own = [k for k, s in enumerate(subdomains) if s.camera == number]
        also = [k for k, s in enumerate(subdomains)
                if number == 0 and s.camera and case.near[s.camera - 1].use_far]
        poses = [pose(still(camera.rig), subdomains[k].mesh.nodes, 1.0, tie=subdomains[k].tie) for k in own + also]
        meshes = [seen_mesh(subdomains[k].mesh, placed) for k, placed in zip(own + also, poses, strict=True)]
        found = 0
        for group in read_correlations(meshes, camera.pair.reference, degree, threads):
            deformed = DeformedSubImage(camera.pair.deformed, degree, threads)
            for correlation in group:
                views[(own + also)[found]].append(View(correlation, deformed, number, poses[found]))
                found += 1
    # Its own camera first.
    return [OwnedPart(s, tuple(sorted(v, key=lambda view: view.camera != s.camera)))
            for s, v in zip(subdomains, views, strict=True)]


def own_camera_only(part: OwnedPart) -> OwnedPart:
    """A part that only its own camera sees, whose set-up is still."""
    return OwnedPart(replace(part.subdomain, shifts=None), part.views[:1])


def as_only_camera(part: OwnedPart) -> OwnedPart:
    """The same in a measurement of its own, where there is no other camera."""
    alone = own_camera_only(part)
    return replace(alone, views=(replace(alone.view, camera=0),))


def moving(part: OwnedPart, cameras: Sequence[Camera], weights: Sequence[float]) -> OwnedPart:
    """The part with the motion of its camera's set-up among its unknowns, and weighted cameras, (n_cameras,)."""
    n_shifts = 0 if part.subdomain.shifts is None else len(part.subdomain.shifts.numbers)
    nodes, tie = part.subdomain.mesh.nodes, part.subdomain.tie
    views = []
    for view in part.views:
        own = view.camera == part.subdomain.camera
        rig = cameras[view.camera].rig
        placed = pose(rig if own else still(rig), nodes, weights[view.camera], 0 if own else n_shifts, tie)
        views.append(replace(view, pose=placed))
    return replace(part, views=tuple(views))


def in_unknowns(part: OwnedPart, matrices: Sequence[sparse.csr_matrix]) -> sparse.csr_matrix:
    """M_s in the unknowns of a part, from its views' M in displacements in their images."""
    total = part.views[0].in_unknowns(matrices[0])
    for view, matrix in zip(part.views[1:], matrices[1:], strict=True):
        total = total + view.in_unknowns(matrix)
    return total.tocsr()
