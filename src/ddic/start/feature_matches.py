"""Speckles found again by their looks, whatever the rotation, and the displacement that they give.

OpenCV's SIFT finds them in images, balls of blocks stand in for them in volumes. Affine maps through a few neighbours
tell which of them err, in each piece of a region.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.images.sub_image import MaskedSource
from ddic.kinematics.motions import N_NEIGHBOURS, interpolate_robustly
from ddic.mesh.cut_mesh import find_points_on_own_side
from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree
from ddic.partition.split import join_pairs
from ddic.start.binned_pair import BinnedPair
from ddic.start.matched_blocks import match_blocks

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


@dataclass(frozen=True, eq=False)
class FeatureMatches:
    """Places of the reference image found in the deformed one.

    Attributes
    ----------
    points, displacement : (n, dim) array
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
    find = _match_speckles if pair.dim == 2 else _match_balls
    places, found, pieces = find(pair, mesh, piece_of_cell)
    points, displacement = places * pair.factor + pair.centre, found * pair.factor
    kept = _find_consistent(points, displacement, pieces, LARGEST_MISFIT * pair.factor)
    return FeatureMatches(points[kept], displacement[kept], pieces[kept], len(points))


def _match_balls(pair: BinnedPair, mesh: Mesh, piece_of_cell: IntArray) -> tuple[Array, Array, IntArray]:
    """Places and displacements, blocks, of parts of a volume, and the piece that each lies in."""
    numbers = np.unique(piece_of_cell)
    of_pieces = [match_blocks(pair, mesh.create_submesh(np.flatnonzero(piece_of_cell == piece))[0])
                 for piece in numbers]
    places, displacement = (np.concatenate(of_all) for of_all in zip(*of_pieces, strict=True))
    return places, displacement, np.repeat(numbers, [len(own) for own, _ in of_pieces])


def _match_speckles(pair: BinnedPair, mesh: Mesh, piece_of_cell: IntArray) -> tuple[Array, Array, IntArray]:
    """Places and displacements, blocks, of features of an image, and the piece that each lies in."""
    active = pair.find_active(pair.scale(mesh))
    extent = pair.deformed.extent
    usable = pair.deformed.find_usable(extent)
    n_deformed = int(min(N_FEATURES * extent.height * extent.width / max(active.sum(), 1), MOST_FEATURES))
    of_reference = _find_features(pair.reference, active, N_FEATURES)
    of_deformed = _find_features(pair.deformed, usable, n_deformed)
    points, displacement = _match(of_reference, of_deformed)
    cells = locate(mesh, points * pair.factor + pair.centre).cells
    inside = cells >= 0
    return points[inside], displacement[inside], piece_of_cell[cells[inside]]


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
            predicted = interpolate_robustly(points[own], displacement[own], points[own], skip=1)
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

    def measure_share_against(self, displacement: Array, size: int) -> float:
        """Measure the share of matches that their displacement by blocks of ``size`` pixels, (n, dim), contradicts."""
        apart = np.linalg.norm(displacement - self.matches.displacement, axis=1)
        return float((apart > LARGEST_MISFIT * size).mean())

    def _interpolate(self, points: Array, on_own_side: Array) -> Array:
        """Displacement of points, each in the piece that a point on its own side lies in."""
        cells = locate(self.mesh, on_own_side).cells
        nearest = build_tree(self.matches.points).query(on_own_side)[1]
        pieces = np.where(cells >= 0, self.piece_of_cell[cells], self.matches.pieces[nearest])
        # A piece in which nothing was found moves with what is next to it.
        pieces = np.where(np.isin(pieces, self.matches.pieces), pieces, self.matches.pieces[nearest])
        values = np.empty(points.shape)
        for piece in np.unique(pieces):
            wanted, own = pieces == piece, self.matches.pieces == piece
            values[wanted] = interpolate_robustly(self.matches.points[own], self.matches.displacement[own],
                                                  points[wanted])
        return values


def find_pieces(mesh: Mesh) -> IntArray:
    """Find each cell's piece of a mesh, perhaps cut by lines, from 0: cells that hang together by nodes are of one."""
    cell_of_corner = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    of_all = join_pairs(cell_of_corner, mesh.n_cells + mesh.connectivity, mesh.n_cells + mesh.n_nodes)
    return of_all[:mesh.n_cells]


def find_piece_of_nodes(mesh: Mesh) -> IntArray:
    """Find the piece, as ``find_pieces`` numbers them, of each node of a mesh, all of which are corners of cells."""
    pieces = np.zeros(mesh.n_nodes, dtype=np.int64)
    pieces[mesh.connectivity] = np.repeat(find_pieces(mesh), np.diff(mesh.offsets))
    return pieces
