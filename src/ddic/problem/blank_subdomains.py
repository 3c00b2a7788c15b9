"""Subdomains without texture join a neighbour: by themselves their operators would be singular."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.case.schema import Case
from ddic.errors import InputError, first_of
from ddic.functionals.correlation import restrict_to_cells
from ddic.functionals.texture_strength import Texture, find_blank_subdomains, measure_texture
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import cell_adjacency
from ddic.parallel.team import Team
from ddic.partition.merge import connected_pieces, merge_blank
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import correlate, own_parts, seen_parts
from ddic.problem.inputs import ImagePair, Region, deal_out
from ddic.solvers.gauss_newton import OwnedPart
from ddic.start.coarse_field import StartField


@dataclass(frozen=True)
class Correlated:
    """Owned subdomains and their M_s, what all ranks know of the region, and the displacement that they start from.

    parts: without the pixels that the start hides, for these hold nothing either.
    """

    parts: list[OwnedPart]
    hessians: list[sparse.csr_matrix]
    region: Region
    start: StartField


def with_texture(team: Team, case: Case, pair: ImagePair, mesh: Mesh | None, given: Correlated) -> Correlated:
    """Merge subdomains, or loose pieces of them, without texture with neighbours and share out again; collective.

    mesh: on rank 0. The start moves along and gains a note. All is returned unchanged where no subdomain is blank, and
    without regularization: there the blank part is singular whatever the partition, and the factorization says where.
    Raises InputError where fewer subdomains than ranks are left.
    """
    parts, region, start = given.parts, given.region, given.start
    if case.regularization is None or region.n_subdomains == 1:
        return given
    pieces = team.together(lambda: [_pieces(part, m) for part, m in zip(parts, given.hessians, strict=True)])
    # Everybody holds the same list of the same numbers, hence comes to the same decision.
    owner = np.array(team.gather_lists([p.subdomain for piece in pieces for p in piece]))
    blank = find_blank_subdomains(team.gather_lists([p.texture for piece in pieces for p in piece]))
    if not blank.any() or blank.all():
        return given
    held: list[NDArray[np.int64]] = []
    with team.waiting.counted():
        cells = team.comm.gather([p.cells for piece in pieces for p in piece], root=0)

    def merge() -> int:
        assert mesh is not None
        assert cells is not None
        held.append(_merged(mesh, [c for rank in cells for c in rank], owner, blank))
        return _count(held[0], region.n_subdomains, team.size)

    n_left = team.on_root(merge)
    subdomains = deal_out(team, case, mesh, lambda whole: held[0])
    q = _moved(team, region, parts, start.q, subdomains)
    degree, n_threads = case.correlation.spline_degree, case.solver.threads
    parts = team.together(lambda: seen_parts(own_parts(subdomains, pair, degree, n_threads), q))
    note = _note(owner, blank, region.n_subdomains, n_left)
    return Correlated(parts, correlate(team, parts), replace(region, n_subdomains=n_left),
                      StartField(q, (note, *start.notes)))


@dataclass(frozen=True)
class _Piece:
    """A connected piece of a subdomain; cells: their numbers in the whole mesh."""

    subdomain: int
    cells: NDArray[np.int64]
    texture: Texture


def _pieces(part: OwnedPart, hessian: sparse.csr_matrix) -> list[_Piece]:
    label = connected_pieces(cell_adjacency(part.subdomain.mesh))
    index, degree = part.subdomain.index, part.view.deformed.degree
    if label.max() == 0:
        return [_Piece(index, part.subdomain.cell_ids, measure_texture(part.view.correlation, hessian, degree))]
    loose = [np.flatnonzero(label == k) for k in range(int(label.max()) + 1)]
    correlations = [restrict_to_cells(part.view.correlation, cells) for cells in loose]
    return [_Piece(index, part.subdomain.cell_ids[cells], measure_texture(alone, alone.assemble_hessian(), degree))
            for cells, alone in zip(loose, correlations, strict=True)]


def _merged(mesh: Mesh, cells: Sequence[NDArray[np.int64]], owner: NDArray[np.int64],
            blank: NDArray[np.bool_]) -> NDArray[np.int64]:
    """New subdomain of each cell, (n_cells,)."""
    pieces = np.empty(mesh.n_cells, dtype=np.int64)
    for number, members in enumerate(cells):
        pieces[members] = number
    return merge_blank(pieces, owner, cell_adjacency(mesh), blank)


def _count(merged: NDArray[np.int64], n_before: int, n_ranks: int) -> int:
    n_left = int(merged.max()) + 1
    if n_left < n_ranks:
        raise InputError(
            f"{n_before - n_left} of {n_before} subdomains hold no texture and join a neighbour, which leaves {n_left} "
            f"for {n_ranks} MPI ranks, but every rank needs at least one; start at most {n_left} ranks or ask for more "
            "subdomains (solver.subdomains)")
    return n_left


def _moved(team: Team, region: Region, parts: Sequence[OwnedPart], q: Sequence[NDArray[np.float64]],
           subdomains: Sequence[Subdomain]) -> list[NDArray[np.float64]]:
    """The displacement q of the old parts on the new subdomains; copies of a node hold the same value."""
    with team.waiting.counted():
        old = team.comm.gather([(p.subdomain.node_ids, q_s) for p, q_s in zip(parts, q, strict=True)], root=0)
        new = team.comm.gather([s.node_ids for s in subdomains], root=0)

    def pick() -> list[list[NDArray[np.float64]]]:
        assert old is not None
        assert new is not None
        whole = np.empty((region.n_nodes, region.n_dofs // region.n_nodes))
        for nodes, values in (item for rank in old for item in rank):
            whole[nodes] = values.reshape(len(nodes), -1)
        return [[whole[nodes].ravel() for nodes in rank] for rank in new]

    return team.scatter_from_root(pick)


def _note(owner: NDArray[np.int64], blank: NDArray[np.bool_], n_before: int, n_left: int) -> str:
    textured = np.isin(owner, owner[~blank])
    whole, loose = np.unique(owner[~textured]), int((blank & textured).sum())
    lines = []
    if len(whole):
        lines.append(f"{len(whole)} of {n_before} subdomains without texture ({first_of(whole)}); "
                     f"{n_before - n_left} joined a neighbour, {n_left} are left")
    if loose:
        lines.append(f"{loose} loose pieces of subdomains without texture, joined with a neighbour")
    return "partition: " + "; ".join(lines)
