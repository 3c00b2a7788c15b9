"""Speckles found again by their looks, whatever the rotation: OpenCV's SIFT, and what neighbours say of each other."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ddic.images.sub_image import MaskedSource
from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.start.binned_pair import BinnedPair, find_active_blocks, scale_mesh
from ddic.start.local_affine import N_NEIGHBOURS, fit_without_itself

Array = NDArray[np.float64]

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
    points : (n, 2) array
        Pixels of the reference image.
    displacement : (n, 2) array
        Pixels.
    pieces : (n,) array of int64
        Piece of the region that each lies in.
    n_found : int
        Matches before those were left out that do not agree with their neighbours.
    """

    points: Array
    displacement: Array
    pieces: NDArray[np.int64]
    n_found: int

    @property
    def agree(self) -> bool:
        """Whether enough of them agree to be believed."""
        n = len(self.points)
        return n >= FEWEST_MATCHES and n >= LEAST_SHARE * self.n_found


def match_features(pair: BinnedPair, mesh: Mesh, piece_of_cell: NDArray[np.int64]) -> FeatureMatches:
    """Match features of a region with those of the deformed image.

    Parameters
    ----------
    pair : BinnedPair
        The images.
    mesh : Mesh
        The region, perhaps cut by lines, pixels.
    piece_of_cell : (n_cells,) array of int64
        Piece of the region that each cell is of: what displacements of one piece say nothing of those of another.

    Returns
    -------
    FeatureMatches
        Those that agree with their neighbours.
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


@dataclass(frozen=True, eq=False)
class _Features:
    """Places (n, 2), blocks, and descriptors (n, 128)."""

    points: Array
    descriptors: NDArray[np.float32]


def _find_features(source: MaskedSource, mask: NDArray[np.uint8] | None, n_features: int) -> _Features:
    """The strongest features of an image where a mask is not zero."""
    values = source.read_whole().astype(np.float32)
    counted = values if mask is None else values[mask > 0]
    if not counted.size:
        return _Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    low, high = np.percentile(counted, GREY_TAILS)
    grey = np.clip((values - low) * (255.0 / max(float(high - low), 1e-6)), 0, 255).astype(np.uint8)
    # Without precise upscaling all places are a quarter of a block off, which a rotation shows.
    sift = cv2.SIFT.create(nfeatures=n_features, contrastThreshold=LEAST_CONTRAST, enable_precise_upscale=True)
    key_points, descriptors = sift.detectAndCompute(grey, mask)
    if descriptors is None:
        return _Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    return _Features(np.array([point.pt for point in key_points], dtype=np.float64), descriptors)


def _match(reference: _Features, deformed: _Features) -> tuple[Array, Array]:
    """Places and displacements, blocks, of features whose nearest one is nearer by far than the second."""
    if len(reference.points) == 0 or len(deformed.points) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    pairs = cv2.BFMatcher().knnMatch(reference.descriptors, deformed.descriptors, k=2)
    clear = [best for best, second in pairs if best.distance < LARGEST_RATIO * second.distance]
    points = reference.points[[match.queryIdx for match in clear]]
    return points, deformed.points[[match.trainIdx for match in clear]] - points


def _find_consistent(points: Array, displacement: Array, pieces: NDArray[np.int64], misfit: float) -> NDArray[np.int64]:
    """Matches that an affine map of their neighbours in the same piece predicts."""
    kept = []
    for piece in np.unique(pieces):
        own = np.flatnonzero(pieces == piece)
        # Twice: wrong ones mislead their neighbours.
        for _ in range(2):
            if len(own) <= N_NEIGHBOURS:
                own = own[:0]
                break
            neighbours = cKDTree(points[own]).query(points[own], N_NEIGHBOURS + 1)[1]
            predicted = fit_without_itself(points[own], displacement[own], neighbours)
            own = own[np.linalg.norm(predicted - displacement[own], axis=1) <= misfit]
        kept.append(own)
    return np.concatenate(kept) if kept else np.zeros(0, np.int64)
