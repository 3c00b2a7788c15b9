"""Subdomains without texture join a neighbour: by themselves their operators would be singular."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import InputError, list_first
from ddic.functionals.read_correlation import restrict_to_cells
from ddic.functionals.texture_strength import Texture, find_blank_subdomains, measure_texture
from ddic.mesh.topology import find_adjacent_cells
from ddic.parallel.team import Team, require_held
from ddic.partition.merge import find_connected_pieces, merge_blank
from ddic.problem.region_mesh import RegionMesh
from ddic.problem.views import ReferenceViews


@dataclass(frozen=True)
class Joining:
    """A partition in which no subdomain is blank.

    Attributes
    ----------
    parts : (n_cells,) array of int64 or None
        New subdomain of each cell, on rank 0.
    note : str
        What the user should know.
    """

    parts: NDArray[np.int64] | None
    note: str


@dataclass(frozen=True)
class _Piece:
    """A connected piece of a subdomain; cells: their numbers in the whole mesh."""

    subdomain: int
    camera: int
    cells: NDArray[np.int64]
    texture: Texture


def join_blank_subdomains(team: Team, region_mesh: RegionMesh | None, references: Sequence[ReferenceViews],
                          hessians: Sequence[sparse.csr_matrix], degree: int) -> Joining | None:
    """Merge subdomains, or loose pieces of them, without texture with neighbours of the same camera; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    region_mesh : RegionMesh or None
        The whole mesh, on rank 0.
    references : sequence of ReferenceViews
        Owned subdomains.
    hessians : sequence of (n_dofs, n_dofs) csr_matrix
        M of each by its own camera, on displacements of nodes in the image.
    degree : int
        Of the spline.

    Returns
    -------
    Joining or None
        None where no subdomain is blank, and where all are.

    Raises
    ------
    InputError
        On all ranks, where fewer subdomains than ranks are left.
    """
    pieces = team.together(lambda: [
        piece for reference, hessian in zip(references, hessians, strict=True)
        for piece in _find_pieces(reference, hessian, degree)])
    # Everybody holds the same list of the same numbers, hence comes to the same decision.
    owner = np.array(team.gather_lists([piece.subdomain for piece in pieces]))
    cameras = np.array(team.gather_lists([piece.camera for piece in pieces]))
    textures = team.gather_lists([piece.texture for piece in pieces])
    blank = _find_blank(textures, cameras)
    if not blank.any():
        return None
    cells = team.gather_to([piece.cells for piece in pieces])

    def merge() -> NDArray[np.int64]:
        by_piece = [c for of_rank in require_held(cells) for c in of_rank]
        parts = _merge(require_held(region_mesh), by_piece, owner, blank)
        _refuse_too_few(parts, len(np.unique(owner)), team.size)
        return parts

    parts = team.build_on_root(merge)
    n_left = team.on_root(lambda: int(require_held(parts).max()) + 1)
    return Joining(parts, _describe(owner, blank, n_left))


def _find_pieces(reference: ReferenceViews, hessian: sparse.csr_matrix, degree: int) -> list[_Piece]:
    subdomain, correlation = reference.subdomain, reference.own.correlation
    labels = find_connected_pieces(find_adjacent_cells(subdomain.mesh))
    n_pieces = int(labels.max()) + 1
    if n_pieces == 1:
        whole = measure_texture(correlation, hessian, degree)
        return [_Piece(subdomain.index, subdomain.camera, subdomain.cell_ids, whole)]
    pieces = []
    for k in range(n_pieces):
        cells = np.flatnonzero(labels == k)
        alone = restrict_to_cells(correlation, cells)
        of_piece = measure_texture(alone, alone.assemble_hessian(), degree)
        pieces.append(_Piece(subdomain.index, subdomain.camera, subdomain.cell_ids[cells], of_piece))
    return pieces


def _find_blank(textures: Sequence[Texture], cameras: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which pieces are blank, (n_pieces,), by comparison with those of the same camera; none where all of one are."""
    blank = np.zeros(len(textures), dtype=bool)
    for camera in np.unique(cameras):
        places = np.flatnonzero(cameras == camera)
        found = find_blank_subdomains([textures[k] for k in places])
        # Where all are blank, there is no neighbour to join: the factorisation says where.
        blank[places] = found & ~found.all()
    return blank


def _merge(region_mesh: RegionMesh, cells: Sequence[NDArray[np.int64]], owner: NDArray[np.int64],
           blank: NDArray[np.bool_]) -> NDArray[np.int64]:
    """New subdomain of each cell, (n_cells,); cells: of each piece."""
    mesh = region_mesh.mesh
    pieces = np.empty(mesh.n_cells, dtype=np.int64)
    for number, members in enumerate(cells):
        pieces[members] = number
    return merge_blank(pieces, owner, _adjacency_within_cameras(region_mesh), blank)


def _adjacency_within_cameras(region_mesh: RegionMesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells that share a facet, of one camera, as ``find_adjacent_cells`` gives them."""
    indptr, indices = find_adjacent_cells(region_mesh.mesh)
    cameras = region_mesh.cameras
    row = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    same = cameras[row] == cameras[indices]
    counts = np.bincount(row[same], minlength=len(indptr) - 1)
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), indices[same]


def _refuse_too_few(parts: NDArray[np.int64], n_before: int, n_ranks: int) -> None:
    n_left = int(parts.max()) + 1
    if n_left < n_ranks:
        raise InputError(
            f"{n_before - n_left} of {n_before} subdomains hold no texture and join a neighbour, which leaves {n_left} "
            f"for {n_ranks} MPI ranks, but every rank needs at least one; start at most {n_left} ranks or ask for more "
            "subdomains (solver.subdomains)")


def _describe(owner: NDArray[np.int64], blank: NDArray[np.bool_], n_left: int) -> str:
    n_before = len(np.unique(owner))
    has_texture = np.isin(owner, owner[~blank])
    whole = np.unique(owner[~has_texture])
    n_loose = int((blank & has_texture).sum())
    lines = []
    if len(whole):
        lines.append(f"{len(whole)} of {n_before} subdomains without texture ({list_first(whole)}); "
                     f"{n_before - n_left} joined a neighbour, {n_left} are left")
    if n_loose:
        lines.append(f"{n_loose} loose pieces of subdomains without texture, joined with a neighbour")
    return "partition: " + "; ".join(lines)
