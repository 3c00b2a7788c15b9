"""Partitions in which every subdomain's slaves determine its masters, and its pixels both sides of a discontinuity."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.kinematics.enriched import EnrichedRegion
from ddic.mesh.cut_mesh import CutMesh
from ddic.mesh.mesh import Mesh
from ddic.partition.split import join_pairs, renumber
from ddic.partition.ties import Tying

LEAST = 0.1
"""Singular value of a subdomain's weights below which its slaves do not determine its masters: squared, the share of
the texture by which a master's displacement is held there. A larger value moves more cells."""


def keep_masters_determined(mesh: Mesh, tying: Tying, parts: IntArray) -> IntArray:
    """Move cells with slaves from subdomains that have too few of them to a neighbour of the same near mesh.

    A subdomain's masters are unknowns there, which nothing but its slaves holds: with fewer slaves than masters, where
    it touches the boundary at a corner for instance, its operator would be singular. Subdomains of the cells,
    (n_cells,), are numbered anew without gaps. Raises InputError where a whole near mesh has too few slaves.
    """
    cells, slaves = _cells_with_slaves(mesh, tying)
    parts = parts.copy()
    determined: set[int] = set()
    while True:
        waiting = [int(s) for s in np.unique(parts[cells]) if int(s) not in determined]
        if not waiting:
            return renumber(parts)
        mine = parts[cells] == waiting[0]
        if _are_determined(tying, slaves[mine]):
            determined.add(waiting[0])
            continue
        camera = int(tying.cameras[cells[mine][0]])
        others = ~mine & (tying.cameras[cells] == camera)
        if not others.any():
            raise InputError(f"near, entry {camera}: its mesh has too few nodes on the boundary with the far elements; "
                             "use smaller near elements than far ones there")
        n_shared_nodes = np.asarray(slaves[mine].sum(axis=0) @ slaves.T).ravel()
        # Cells without a common node are neighbours along the boundary only where nothing else is left.
        votes = np.bincount(parts[cells[others]], 1e-9 + n_shared_nodes[others])
        target = int(votes.argmax())
        parts[cells[mine]] = target
        determined.discard(target)


def _cells_with_slaves(mesh: Mesh, tying: Tying) -> tuple[IntArray, sparse.csr_matrix]:
    """Cells that have slaves, (n,), and 1 at the slaves of each of them, (n, n_nodes)."""
    owner = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    is_slave = mesh.connectivity >= tying.n_unknown_nodes
    cells = np.unique(owner[is_slave])
    rows = np.searchsorted(cells, owner[is_slave])
    ones = np.ones(len(rows))
    return cells, sparse.csr_matrix((ones, (rows, mesh.connectivity[is_slave])), shape=(len(cells), mesh.n_nodes))


def _are_determined(tying: Tying, slaves: sparse.csr_matrix) -> bool:
    """Whether the slaves of some cells, (n_cells, n_nodes), determine their masters."""
    weights = tying.weights[np.unique(slaves.indices)]
    masters = np.unique(weights.indices)
    block = weights[:, masters].toarray()
    n_slaves, n_masters = block.shape
    if n_slaves < n_masters:
        return False
    return bool(np.linalg.svd(block, compute_uv=False)[-1] >= LEAST)


LEAST_SHARE = 0.02
"""Share of a node's pixels that a cell must have for it to determine the node's unknowns. A larger value moves more
cells."""


@dataclass(frozen=True, eq=False)
class CutSides:
    """A mesh cut by discontinuities, and what determines the displacement on their sides.

    Attributes
    ----------
    cut, kinematics : CutMesh and EnrichedRegion
        The mesh and its unknowns.
    corner_weights : (len(cut.mesh.connectivity),) array
        How firmly the pixels of each cell hold each of its nodes.
    around_tips : tuple of (n,) array of int64
        Cells of the mesh that was cut which only together determine what happens at a tip, for each tip.
    """

    cut: CutMesh
    kinematics: EnrichedRegion
    corner_weights: Array
    around_tips: tuple[IntArray, ...] = ()


def keep_cameras_determined(sides: CutSides, cameras: IntArray) -> IntArray:
    """Give the first camera the cells that only together with another camera's determine the sides of a discontinuity.

    Cameras are those of each cell of the mesh that was cut, (n_cells,); the first one, 0, sees them all.
    """
    if not cameras.any():
        return cameras
    needs, sees_enough = _find_needs(sides)
    kept = cameras.copy()
    for cells in sides.around_tips:
        if len(np.unique(kept[cells])) > 1:
            kept[cells] = 0
    for cell in _list_cells_with_needs(needs):
        of_same_camera = _choose_hosts(needs[[cell]], sees_enough, cell, kept == kept[cell])
        if not _are_met(needs[[cell]], sees_enough, [cell, *of_same_camera]):
            hosts = _choose_hosts(needs[[cell]], sees_enough, cell, np.ones(len(kept), dtype=bool))
            kept[[cell, *hosts]] = 0
    return kept


def keep_sides_determined(sides: CutSides, cameras: IntArray, parts: IntArray) -> IntArray:
    """Keep cells along a discontinuity together that determine only together what is on its sides.

    A subdomain with a node takes part in the unknowns of those that lead it, phantom or not: without pixels there, its
    operator would be singular. Cameras and subdomains, none with cells of two cameras, are those of each cell of the
    mesh that was cut, (n_cells,); the new subdomains are numbered without gaps.
    """
    if not parts.any():
        return parts
    needs, sees_enough = _find_needs(sides)
    pairs = [(int(cells[0]), int(cell)) for cells in sides.around_tips for cell in cells[1:]]
    pairs += [(cell, host) for cell in _list_cells_with_needs(needs)
             for host in _choose_hosts(needs[[cell]], sees_enough, cell, cameras == cameras[cell])]
    one, other = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    clusters = join_pairs(one, other, len(parts))
    n_subdomains = int(parts.max()) + 1
    votes = np.bincount(clusters * n_subdomains + parts, minlength=(clusters.max() + 1) * n_subdomains)
    return renumber(votes.reshape(-1, n_subdomains).argmax(axis=1)[clusters])


def _find_needs(sides: CutSides) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """1 where a node's unknowns matter to a cell before the cut, and where the cell has pixels enough of the node.

    Both (n_cells, cut.mesh.n_nodes), nothing at nodes without phantoms.
    """
    cut, kinematics = sides.cut, sides.kinematics
    mesh = cut.mesh
    n_twins = np.bincount(cut.node_of)[cut.node_of]
    has_phantom = sparse.diags((n_twins > 1).astype(float))
    cell_of_corner = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    ones = np.ones(len(cell_of_corner))
    corners = sparse.csr_matrix((ones, (cell_of_corner, mesh.connectivity)), (mesh.n_cells, mesh.n_nodes))
    n_cells = int(cut.cell_of.max()) + 1
    fold = sparse.csr_matrix((np.ones(mesh.n_cells), (cut.cell_of, np.arange(mesh.n_cells))), (n_cells, mesh.n_cells))

    rows = abs(kinematics.matrix).tocoo()
    owners = kinematics.seen_at[rows.col]
    depends = sparse.csr_matrix((np.ones(len(owners)), (rows.row // mesh.dim, owners)), (mesh.n_nodes, mesh.n_nodes))
    weights = sparse.csr_matrix((sides.corner_weights, (cell_of_corner, mesh.connectivity)), corners.shape)
    pixels = (fold @ weights @ has_phantom).tocsr()
    takes_part = (fold @ corners @ depends @ has_phantom).tocsr()
    takes_part.eliminate_zeros()
    takes_part.data[:] = 1.0

    seen = pixels.tocoo()
    enough = seen.data >= LEAST_SHARE * np.asarray(pixels.sum(axis=0)).ravel()[seen.col]
    sees_enough = sparse.csr_matrix((np.ones(enough.sum()), (seen.row[enough], seen.col[enough])), pixels.shape)
    return takes_part, sees_enough


def _list_cells_with_needs(needs: sparse.csr_matrix) -> list[int]:
    return [int(cell) for cell in np.flatnonzero(np.diff(needs.indptr))]


def _choose_hosts(needs: sparse.csr_matrix, sees_enough: sparse.csr_matrix, cell: int,
                  may_be_host: BoolArray) -> list[int]:
    """As few cells as together see enough of the nodes that a cell needs and does not see enough of itself."""
    missing = needs - needs.multiply(sees_enough[[cell]])
    hosts = []
    while missing.count_nonzero():
        covered = np.asarray((sees_enough @ missing.T).todense()).ravel() * may_be_host
        if not covered.any():
            break
        hosts.append(int(covered.argmax()))
        missing = missing - missing.multiply(sees_enough[[hosts[-1]]])
    return hosts


def _are_met(needs: sparse.csr_matrix, sees_enough: sparse.csr_matrix, cells: list[int]) -> bool:
    """Whether some cells see enough of all nodes that are needed."""
    is_seen = np.asarray(sees_enough[cells].sum(axis=0)).ravel() > 0
    return bool(is_seen[needs.indices].all())
