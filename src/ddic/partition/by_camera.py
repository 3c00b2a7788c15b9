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
from ddic.partition.subdomain import Shifts, Subdomain

SplitInto = Callable[[NDArray[np.int64], int], NDArray[np.int64]]
"""From the cells of a camera and a number of subdomains to the subdomain of each of these cells."""


def camera_of_cells(mesh: Mesh, seen: Sequence[NDArray[np.bool_]]) -> NDArray[np.int64]:
    """Number of the camera that measures each cell, (n_cells,): the first near one that sees all its nodes, else 0.

    seen: for each near camera, (n_nodes,), whether it sees each node.
    """
    labels = np.zeros(mesh.n_cells, dtype=np.int64)
    for number in reversed(range(len(seen))):
        whole = np.logical_and.reduceat(seen[number][mesh.connectivity], mesh.offsets[:-1])
        labels[whole] = number + 1
    return labels


def cameras_at_nodes(mesh: Mesh, labels: NDArray[np.int64], n_cameras: int,
                     weights: sparse.csr_matrix | None = None) -> NDArray[np.bool_]:
    """Whether a camera measures a cell at each node, (n_nodes, n_cameras); labels: of ``camera_of_cells``.

    weights: (n_nodes, n_unknown_nodes), where some nodes are tied to others: then of the unknown nodes, at which the
    cells of nodes tied to them are as well.
    """
    present = np.zeros((mesh.n_nodes, n_cameras), dtype=bool)
    present[mesh.connectivity, np.repeat(labels, np.diff(mesh.offsets))] = True
    return present if weights is None else np.asarray((weights != 0).T @ present.astype(np.int64) > 0)


def split_by_camera(labels: NDArray[np.int64], costs: NDArray[np.float64], n_subdomains: int,
                    split: SplitInto) -> NDArray[np.int64]:
    """Split each camera's cells by themselves, into subdomains of about equal cost; the far camera's come first.

    labels, costs: camera and work of each cell, (n_cells,). Raises InputError where cameras outnumber subdomains.
    """
    cameras = np.unique(labels)
    if n_subdomains < len(cameras):
        raise InputError(f"solver.subdomains = {n_subdomains}: {len(cameras)} cameras measure elements, and each needs "
                         f"a subdomain of its own; ask for at least {len(cameras)}")
    work = np.array([costs[labels == camera].sum() for camera in cameras])
    counts = _apportioned(work, n_subdomains, [int((labels == camera).sum()) for camera in cameras])
    parts = np.zeros(len(labels), dtype=np.int64)
    first = 0
    for camera, count in zip(cameras, counts, strict=True):
        cells = np.flatnonzero(labels == camera)
        parts[cells] = first + split(cells, count)
        first += count
    return parts


def kept_apart(parts: NDArray[np.int64], labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """A given partition whose subdomains are cut where the camera changes, numbered by camera, (n_cells,)."""
    return renumber(labels * (int(parts.max()) + 1) + parts, 0)


def with_cameras(subdomains: Sequence[Subdomain], labels: NDArray[np.int64], n_shifts: Sequence[int],
                 far_inside: NDArray[np.bool_], n_dofs: int) -> list[Subdomain]:
    """Subdomains that know their camera and number the unknowns of its motion.

    labels: (n_cells,); n_shifts: unknowns of each camera's motion; far_inside: (n_nodes,) whether only far cells lie
    around a node inside the mesh, by which texture is weighed against mechanics; n_dofs: of the mesh.
    """
    cameras = [int(labels[s.cell_ids[0]]) for s in subdomains]
    n_rows, last = sum(s.n_owned_rows for s in subdomains), len(subdomains) - 1
    first = np.concatenate([[0], np.cumsum(n_shifts)]).astype(np.int64)
    out = []
    for k, (subdomain, camera) in enumerate(zip(subdomains, cameras, strict=True)):
        numbers = np.arange(first[camera], first[camera + 1])
        shifts = Shifts(n_dofs + numbers, n_rows + numbers, cameras.count(camera), cameras.index(camera) == k)
        out.append(replace(subdomain, camera=camera, shifts=shifts if len(numbers) else None,
                           interior=far_inside[subdomain.node_ids],
                           n_owned_rows=subdomain.n_owned_rows + (int(first[-1]) if k == last else 0)))
    return out


def _apportioned(work: NDArray[np.float64], total: int, most: Sequence[int]) -> list[int]:
    """Whole numbers from 1 to ``most`` that add up to ``total``, so that the largest work a piece is least."""
    counts = [1] * len(work)
    for _ in range(total - len(work)):
        loads = [w / n if n < limit else -1.0 for w, n, limit in zip(work, counts, most, strict=True)]
        counts[int(np.argmax(loads))] += 1
    return counts
