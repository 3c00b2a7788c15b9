"""Which camera measures which cell, and the partition that keeps cameras apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import InputError
from ddic.mesh.mesh import Mesh
from ddic.partition.split import renumber
from ddic.partition.subdomain import MotionUnknowns, Subdomain

SplitInto = Callable[[NDArray[np.int64], int], NDArray[np.int64]]
"""From the cells of a camera and a number of subdomains to the subdomain of each of these cells."""


def assign_cameras(mesh: Mesh, seen: Sequence[NDArray[np.bool_]]) -> NDArray[np.int64]:
    """Assign each cell to the first near camera that sees all its nodes, else to the first of all cameras.

    Parameters
    ----------
    mesh : Mesh
        The whole mesh.
    seen : sequence of (n_nodes,) array of bool
        For each near camera whether it sees each node.

    Returns
    -------
    (n_cells,) array of int64
        Number of the camera that measures each cell, 0 the first.
    """
    labels = np.zeros(mesh.n_cells, dtype=np.int64)
    # The first near camera comes last, so that what it sees is its own.
    for place in reversed(range(len(seen))):
        is_corner_seen = seen[place][mesh.connectivity]
        is_cell_seen = np.logical_and.reduceat(is_corner_seen, mesh.offsets[:-1])
        labels[is_cell_seen] = place + 1
    return labels


def find_cameras_at_nodes(mesh: Mesh, labels: NDArray[np.int64], n_cameras: int,
                          weights: sparse.csr_matrix | None = None) -> NDArray[np.bool_]:
    """Find the cameras that measure a cell at each node.

    Parameters
    ----------
    mesh : Mesh
        The whole mesh.
    labels : (n_cells,) array of int64
        Camera of each cell.
    n_cameras : int
        Number of cameras.
    weights : (n_nodes, n_unknown_nodes) csr_matrix, optional
        Where some nodes are tied to others: then the cells of a node are also those of the nodes that are tied to it.

    Returns
    -------
    (n_nodes, n_cameras) array of bool
        Whether a camera measures a cell at a node; with weights of the unknown nodes, (n_unknown_nodes, n_cameras).
    """
    camera_of_corner = np.repeat(labels, np.diff(mesh.offsets))
    present = np.zeros((mesh.n_nodes, n_cameras), dtype=bool)
    present[mesh.connectivity, camera_of_corner] = True
    if weights is None:
        return present
    is_tied_to = weights != 0
    n_tied = is_tied_to.T @ present.astype(np.int64)
    return np.asarray(n_tied > 0)


def split_by_camera(labels: NDArray[np.int64], costs: NDArray[np.float64], n_subdomains: int,
                    split: SplitInto) -> NDArray[np.int64]:
    """Split each camera's cells by themselves, into subdomains of about equal cost; the first camera's come first.

    Parameters
    ----------
    labels : (n_cells,) array of int64
        Camera of each cell.
    costs : (n_cells,) array
        Work of each cell, pixels.
    n_subdomains : int
        Number of subdomains in all.
    split : callable
        From cells and a number of subdomains to the subdomain of each of these cells.

    Returns
    -------
    (n_cells,) array of int64
        Subdomain of each cell.

    Raises
    ------
    InputError
        Where cameras outnumber subdomains.
    """
    cameras = np.unique(labels)
    if n_subdomains < len(cameras):
        raise InputError(f"solver.subdomains = {n_subdomains}: {len(cameras)} cameras measure elements, and each needs "
                         f"a subdomain of its own; ask for at least {len(cameras)}")
    cells_of = [np.flatnonzero(labels == camera) for camera in cameras]
    work = np.array([costs[cells].sum() for cells in cells_of])
    counts = _apportion(work, n_subdomains, [len(cells) for cells in cells_of])
    parts = np.zeros(len(labels), dtype=np.int64)
    first = 0
    for cells, count in zip(cells_of, counts, strict=True):
        parts[cells] = first + split(cells, count)
        first += count
    return parts


def keep_cameras_apart(parts: NDArray[np.int64], labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cut the subdomains of a given partition where the camera changes.

    Parameters
    ----------
    parts : (n_cells,) array of int64
        Subdomain of each cell.
    labels : (n_cells,) array of int64
        Camera of each cell.

    Returns
    -------
    (n_cells,) array of int64
        New subdomain of each cell, numbered by camera without gaps.
    """
    n_parts = int(parts.max()) + 1
    by_camera_and_part = labels * n_parts + parts
    return renumber(by_camera_and_part)


def add_motions(subdomains: Sequence[Subdomain], cameras: Sequence[int], n_motion_unknowns: Sequence[int],
                n_field: int) -> list[Subdomain]:
    """Give subdomains their camera and the unknowns of its motion, numbered after those of the field.

    Parameters
    ----------
    subdomains : sequence of Subdomain
        All of them, by number.
    cameras : sequence of int
        Camera of each.
    n_motion_unknowns : sequence of int
        Unknowns of each camera's motion.
    n_field : int
        Number of unknowns of the whole field.

    Returns
    -------
    list of Subdomain
        The same; the last owns the interface rows of all motions.
    """
    n_chain_rows = sum(subdomain.n_owned_rows for subdomain in subdomains)
    # Unknowns of all motions, camera after camera; each has a row of its own after those of the chains.
    first = np.concatenate([[0], np.cumsum(n_motion_unknowns)]).astype(np.int64)
    cameras = list(cameras)
    with_motion = []
    for place, (subdomain, camera) in enumerate(zip(subdomains, cameras, strict=True)):
        of_camera = np.arange(first[camera], first[camera + 1])
        motion = None
        if len(of_camera):
            is_lowest = cameras.index(camera) == place
            motion = MotionUnknowns(n_field + of_camera, n_chain_rows + of_camera, cameras.count(camera), is_lowest)
        with_motion.append(replace(subdomain, camera=camera, motion=motion))
    last = with_motion[-1]
    n_motion_rows = int(first[-1])
    with_motion[-1] = replace(last, n_owned_rows=last.n_owned_rows + n_motion_rows)
    return with_motion


def _apportion(work: NDArray[np.float64], total: int, most: Sequence[int]) -> list[int]:
    """Whole numbers from 1 to ``most`` that add up to ``total``, so that the largest work a piece is least."""
    limits = np.asarray(most)
    counts = np.ones(len(work), dtype=np.int64)
    for _ in range(total - len(work)):
        # One piece more where pieces are largest; -1 where there can be no more.
        loads = np.where(counts < limits, work / counts, -1.0)
        counts[loads.argmax()] += 1
    return [int(count) for count in counts]
