"""Speckles found again by their looks, whatever the rotation, and the displacement that they give a mesh.

OpenCV's SIFT finds them; affine maps through a few neighbours tell which of them err, in each piece of a region.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ddic.arrays import Array, IntArray
from ddic.images.sub_image import MaskedSource
from ddic.mesh.cut_mesh import find_points_on_own_side
from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree
from ddic.mesh.raster import rasterize
from ddic.start.binned_pair import BinnedPair, find_active_blocks, scale_mesh

N_FEATURES = 3000
"""Features of the region; as many a block in the whole deformed image. More take longer as their square."""

MOST_FEATURES = 12_000
"""Features of the deformed image at most."""

LEAST_CONTRAST = 0.02
"""SIFT's contrast threshold. A larger one leaves out faint speckle."""

LARGEST_RATIO = 0.8
"""Distance of a feature to its nearest one over that to the second nearest: above, a match is ambiguous."""

GREY_TAILS = (1.0, 99.0)
"""Percentiles of grey levels that become black and white."""

LARGEST_MISFIT = 2.0
"""Blocks by which a match may differ from what its neighbours say. A larger one lets wrong matches pass."""

FEWEST_MATCHES = 20
"""Matches that have to agree with each other; unrelated images leave none of some hundred."""

LEAST_SHARE = 0.3
"""Share of all matches that have to agree. On repeated patterns fewer do."""

EXACT = 1e-9
"""What an affine map may leave of the displacements, pixels, to be taken for all of them: rounding."""

NODES_AT_ONCE = 50_000
"""Nodes whose neighbours are held at the same time: 100 MB."""

THIN = 0.02
"""Width of a set of points, times its length, below which they are on a line and tell no affine map. A larger value
takes a similarity for more of them."""

N_NEIGHBOURS = 12
"""Neighbours that an affine map is fitted to: twice its unknowns a component, and as many again for wrong ones."""

N_ROUNDS = 15
"""Rounds of reweighting, which leave the least sum of distances instead of squares: wrong neighbours hardly count."""

RIDGE = 1e-3
"""Share of the neighbours' spread that holds a gradient which they do not tell."""

SMALLEST = 1e-3
"""Misfit, pixels, below which a neighbour's weight grows no more."""


@dataclass(frozen=True, eq=False)
class FeatureMatches:
    """Places of the reference image found in the deformed one.

    Attributes
    ----------
    points, displacement : (n, 2) array
        Places in the reference image, and how they are displaced, pixels.
    pieces : (n,) array of int64
        Piece of the region that each lies in.
    n_found : int
        Matches before those were left out that do not agree with their neighbours.
    """

    points: Array
    displacement: Array
    pieces: IntArray
    n_found: int

    @property
    def agree(self) -> bool:
        """Whether enough of them agree to be believed."""
        n = len(self.points)
        return n >= FEWEST_MATCHES and n >= LEAST_SHARE * self.n_found


def match_features(pair: BinnedPair, mesh: Mesh, piece_of_cell: IntArray) -> FeatureMatches:
    """Match features of a region with those of the deformed image, and keep those that agree with their neighbours.

    ``piece_of_cell``, (n_cells,), says which piece of the region, perhaps cut by lines, each cell is of: displacements
    of one piece say nothing of those of another.
    """
    active = find_active_blocks(pair.reference, rasterize(scale_mesh(mesh, pair.factor)))
    extent = pair.deformed.extent
    usable = pair.deformed.find_usable(extent)
    n_deformed = int(min(N_FEATURES * extent.height * extent.width / max(active.sum(), 1), MOST_FEATURES))
    of_reference = _find_features(pair.reference, active, N_FEATURES)
    of_deformed = _find_features(pair.deformed, usable, n_deformed)
    points, displacement = _match(of_reference, of_deformed)
    points, displacement = points * pair.factor + pair.centre, displacement * pair.factor
    cells = locate(mesh, points).cells
    inside = cells >= 0
    points, displacement, pieces = points[inside], displacement[inside], piece_of_cell[cells[inside]]
    kept = _find_consistent(points, displacement, pieces, LARGEST_MISFIT * pair.factor)
    return FeatureMatches(points[kept], displacement[kept], pieces[kept], len(points))


_Features = tuple[Array, NDArray[np.float32]]
"""Places (n, 2), blocks, and descriptors (n, 128)."""


def _find_features(source: MaskedSource, mask: NDArray[np.uint8] | None, n_features: int) -> _Features:
    """The strongest features of an image where a mask is not zero."""
    values = source.read_whole().astype(np.float32)
    counted = values if mask is None else values[mask > 0]
    nothing = np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    if not counted.size:
        return nothing
    low, high = np.percentile(counted, GREY_TAILS)
    grey = np.clip((values - low) * (255.0 / max(float(high - low), 1e-6)), 0, 255).astype(np.uint8)
    # Without precise upscaling all places are a quarter of a block off, which a rotation shows.
    sift = cv2.SIFT.create(nfeatures=n_features, contrastThreshold=LEAST_CONTRAST, enable_precise_upscale=True)
    key_points, descriptors = sift.detectAndCompute(grey, mask)
    if descriptors is None:
        return nothing
    return np.array([point.pt for point in key_points], dtype=np.float64), descriptors


def _match(reference: _Features, deformed: _Features) -> tuple[Array, Array]:
    """Places and displacements, blocks, of features whose nearest one is nearer by far than the second."""
    (places, of_reference), (found, of_deformed) = reference, deformed
    if len(places) == 0 or len(found) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    pairs = cv2.BFMatcher().knnMatch(of_reference, of_deformed, k=2)
    clear = [best for best, second in pairs if best.distance < LARGEST_RATIO * second.distance]
    points = places[[match.queryIdx for match in clear]]
    return points, found[[match.trainIdx for match in clear]] - points


def _find_consistent(points: Array, displacement: Array, pieces: IntArray, misfit: float) -> IntArray:
    """Matches that an affine map of their neighbours in the same piece predicts."""
    kept = []
    for piece in np.unique(pieces):
        own = np.flatnonzero(pieces == piece)
        # Twice: wrong ones mislead their neighbours.
        for _ in range(2):
            if len(own) <= N_NEIGHBOURS:
                own = own[:0]
                break
            neighbours = build_tree(points[own]).query(points[own], N_NEIGHBOURS + 1)[1]
            predicted = fit_without_itself(points[own], displacement[own], neighbours)
            own = own[np.linalg.norm(predicted - displacement[own], axis=1) <= misfit]
        kept.append(own)
    return np.concatenate(kept) if kept else np.zeros(0, np.int64)


@dataclass(frozen=True, eq=False)
class MatchedField:
    """Displacement by affine maps of the nearest matches, each piece of the region for itself.

    Beyond the region it is that of the piece of the nearest match.

    Attributes
    ----------
    matches : FeatureMatches
        At least one.
    mesh : Mesh
        The region, perhaps cut by lines, pixels.
    piece_of_cell : (n_cells,) array of int64
        Piece of the region that each cell is of.
    """

    matches: FeatureMatches
    mesh: Mesh
    piece_of_cell: IntArray

    def interpolate_at_nodes(self, mesh: Mesh) -> Array:
        """Interpolate the displacement at nodes, each in the piece that it belongs to, (n_nodes, 2), pixels."""
        return self._interpolate(mesh.nodes, find_points_on_own_side(mesh))

    def at(self, points: Array) -> Array:
        """Interpolate the displacement at points, (n, 2), pixels."""
        return self._interpolate(points, points)

    def _interpolate(self, points: Array, on_own_side: Array) -> Array:
        """Displacement of points, each in the piece that a point on its own side lies in."""
        cells = locate(self.mesh, on_own_side).cells
        nearest = build_tree(self.matches.points).query(on_own_side)[1]
        pieces = np.where(cells >= 0, self.piece_of_cell[cells], self.matches.pieces[nearest])
        # A piece in which nothing was found moves with what is next to it.
        pieces = np.where(np.isin(pieces, self.matches.pieces), pieces, self.matches.pieces[nearest])
        values = np.empty(points.shape)
        for piece in np.unique(pieces):
            wanted, own = np.flatnonzero(pieces == piece), np.flatnonzero(self.matches.pieces == piece)
            n_neighbours = min(N_NEIGHBOURS, len(own))
            tree = build_tree(self.matches.points[own])
            near = own[tree.query(points[wanted], list(range(1, n_neighbours + 1)))[1]]
            offsets = self.matches.points[near] - points[wanted, None]
            values[wanted] = fit_robustly(offsets, self.matches.displacement[near])
        return values


@dataclass(frozen=True, eq=False)
class ExtendedField:
    """A displacement at the nodes of a mesh, of which it was known somewhere.

    Attributes
    ----------
    displacement : (n_nodes, 2) array
        Pixels.
    n_pieces_without : int
        Pieces of the mesh in which it was known nowhere: they move with the affine map of what is nearest.
    """

    displacement: Array
    n_pieces_without: int


def interpolate_pairs(points: Array, displacement: Array, mesh: Mesh) -> ExtendedField:
    """Interpolate displacements, (n, 2), at points, (n, 2), pixels, to a mesh, each piece of it for itself.

    One point says a translation, two a rotation with a scale, three an affine map; what this leaves of more points is
    interpolated by affine maps of the nearest ones, of which some may be wrong. At least one point is needed.
    """
    piece_of_node = find_piece_of_nodes(mesh)
    cells = locate(mesh, points).cells
    nearest_node = build_tree(mesh.nodes).query(points)[1]
    piece_of_point = np.where(cells >= 0, find_pieces(mesh)[cells], piece_of_node[nearest_node])
    held = np.unique(piece_of_point)
    nearest_point = build_tree(points).query(mesh.nodes)[1]
    from_piece = np.where(np.isin(piece_of_node, held), piece_of_node, piece_of_point[nearest_point])
    values = np.empty((mesh.n_nodes, 2))
    for piece in held:
        own, nodes = piece_of_point == piece, np.flatnonzero(from_piece == piece)
        of_piece = fit_affine_map(points[own], displacement[own])
        values[nodes] = of_piece.at(mesh.nodes[nodes])
        values[nodes] += _interpolate_rest(points[own], displacement[own], of_piece, mesh.nodes[nodes])
    return ExtendedField(values, int(piece_of_node.max()) + 1 - len(held))


def _interpolate_rest(points: Array, displacement: Array, of_all: AffineMap, places: Array) -> Array:
    """What an affine map leaves of displacements, at places."""
    rest = displacement - of_all.at(points)
    values = np.zeros_like(places)
    if np.abs(rest).max() <= EXACT * max(1.0, float(np.abs(displacement).max())):
        return values
    tree, n_neighbours = build_tree(points), min(N_NEIGHBOURS, len(points))
    for first in range(0, len(places), NODES_AT_ONCE):
        some = slice(first, first + NODES_AT_ONCE)
        near = tree.query(places[some], list(range(1, n_neighbours + 1)))[1]
        values[some] = fit_robustly(points[near] - places[some, None], rest[near])
    return values


def find_pieces(mesh: Mesh) -> IntArray:
    """Find each cell's piece of a mesh, perhaps cut by lines, from 0: cells that hang together by nodes are of one."""
    cell_of_corner = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    ones = np.ones(len(cell_of_corner))
    has_node = sparse.csr_matrix((ones, (cell_of_corner, mesh.connectivity)), (mesh.n_cells, mesh.n_nodes))
    _, pieces = connected_components(has_node @ has_node.T, directed=False)
    return np.asarray(pieces, dtype=np.int64)


def find_piece_of_nodes(mesh: Mesh) -> IntArray:
    """Find the piece of a mesh that each node is of, as ``find_pieces`` numbers them.

    Every node must be a corner of a cell.
    """
    pieces = np.zeros(mesh.n_nodes, dtype=np.int64)
    pieces[mesh.connectivity] = np.repeat(find_pieces(mesh), np.diff(mesh.offsets))
    return pieces


@dataclass(frozen=True, eq=False)
class AffineMap:
    """A displacement that is linear in the position.

    Attributes
    ----------
    centre, translation : (2,) array
        A position, and its displacement, pixels.
    gradient : (2, 2) array
        du_i/dx_j.
    """

    centre: Array
    translation: Array
    gradient: Array

    def at(self, points: Array) -> Array:
        """Evaluate the displacement at points, (n, 2), pixels."""
        return np.asarray(self.translation + (points - self.centre) @ self.gradient.T)


def fit_affine_map(points: Array, displacement: Array) -> AffineMap:
    """Fit the map of least squares that the points tell, at least one, (n, 2), pixels.

    It is a translation of one point, a rotation with a scale of two or of several on a line, affine of others.
    """
    centre, translation = points.mean(axis=0), displacement.mean(axis=0)
    offsets, rest = points - centre, displacement - translation
    axes = np.linalg.svd(offsets, compute_uv=False)
    if axes[0] == 0.0:
        return AffineMap(centre, translation, np.zeros((2, 2)))
    if len(axes) > 1 and axes[1] > THIN * axes[0]:
        return AffineMap(centre, translation, np.linalg.lstsq(offsets, rest, rcond=None)[0].T)
    # (1 + a + ib) (x + iy): a rotation with a scale.
    x, y = offsets.T
    square = float((offsets**2).sum())
    a = float((x * rest[:, 0] + y * rest[:, 1]).sum()) / square
    b = float((x * rest[:, 1] - y * rest[:, 0]).sum()) / square
    return AffineMap(centre, translation, np.array([[a, -b], [b, a]]))


def fit_without_itself(points: Array, displacement: Array, neighbours: IntArray) -> Array:
    """Predict the displacement of each point from its neighbours', (n, 2), pixels.

    ``neighbours``, (n, k + 1), are the points nearest to each, itself first.
    """
    others = neighbours[:, 1:]
    return fit_robustly(points[others] - points[:, None], displacement[others])


def fit_robustly(offsets: Array, displacement: Array) -> Array:
    """Fit an affine map to the displacements of some neighbours, of which some may be wrong.

    Returns the map's value at each place, (n, 2), pixels, from which the neighbours are at ``offsets``, (n, k, 2).
    """
    spread = np.sqrt((offsets**2).mean(axis=(1, 2), keepdims=True))
    terms = np.concatenate([np.ones((*offsets.shape[:2], 1)), offsets / np.maximum(spread, 1e-12)], axis=2)
    ridge = offsets.shape[1] * RIDGE**2 * np.diag([0.0, 1.0, 1.0])
    weights = np.ones(offsets.shape[:2])
    for _ in range(N_ROUNDS):
        weighted = terms * weights[..., None]
        normal = np.einsum("nki,nkj->nij", weighted, terms) + weights.mean(axis=1)[:, None, None] * ridge
        coefficients = np.linalg.solve(normal, np.einsum("nki,nkc->nic", weighted, displacement))
        misfit = np.linalg.norm(terms @ coefficients - displacement, axis=2)
        weights = 1.0 / np.maximum(misfit, SMALLEST)
    return np.asarray(coefficients[:, 0])
