"""Right-hand sides as noise makes them, whose mean products are their covariance, without chance between neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import hadamard

from ddic.solvers.random_bits import generate_bits

Array = NDArray[np.float64]

MOST_SAMPLES, FEWEST_SAMPLES = 256, 128
"""Right-hand sides, powers of 2, with regularization and without, where a node depends on few cells. On elements of
16 px the first leave errors of 0.3, 2 and 5 % of a standard deviation with cut-off wavelengths of 4, 7 and 16 elements,
the second 0.4 % without (1.3 % of a strain's). Twice as many take twice the time."""

LARGEST_FORCES = 8
"""Most displacement components of a cell, each with a sequence of signs of its own."""

_SEQUENCES = hadamard(MOST_SAMPLES).astype(np.float64)
"""Signs by sample and sequence, of which any two are orthogonal; the first half of both by themselves, too."""

_ROW_SHIFTS = {MOST_SAMPLES: 7, FEWEST_SAMPLES: 6}
"""Places by which tiles are shifted from row to row of cells: those alike of 32 are then at least 5.7 cells apart, of
16 at least 3.6."""


@dataclass(frozen=True, eq=False)
class SampledCells:
    """What makes forces with a given covariance on the cells of a view.

    Attributes
    ----------
    factors : (n_cells, n, n) array
        L of each cell with L L^T = cov(b of the cell), grey levels squared per pixel.
    rows : (n_cells, n) array of int64
        Which sequence of signs each column takes.
    signs : (n_cells, n) array
        1 or -1 by chance, by which it is multiplied.
    """

    factors: Array
    rows: NDArray[np.int64]
    signs: Array

    def generate_forces(self, sample: int) -> Array:
        """Generate the forces on the nodes of each cell.

        Parameters
        ----------
        sample : int
            From 0; over all of them the mean of products is the covariance.

        Returns
        -------
        (n_cells, n) array
            Node-major, grey levels squared per pixel.
        """
        signs = self.signs * _SEQUENCES[sample][self.rows]
        return np.asarray(np.einsum("eij,ej->ei", self.factors, signs))


def prepare_samples(covariances: Array, cell_ids: NDArray[np.int64], places: NDArray[np.int64],
                    camera: int, n_samples: int) -> SampledCells:
    """Prepare forces with a covariance that is independent from cell to cell.

    Each column of a cell's factor takes a sequence of +1 and -1 over the samples. Sequences of Walsh are orthogonal, so
    that the mean of products over all samples is exact for cells that have different ones: near cells have. Those that
    have the same, far apart, are multiplied by signs by chance, which leaves an error of the kind that independent
    samples have.

    Parameters
    ----------
    covariances : (n_cells, n, n) array
        Of the forces of each cell, n at most LARGEST_FORCES.
    cell_ids : (n_cells,) array of int64
        Numbers of the cells in the whole mesh.
    places : (n_cells, 2) array of int64
        Column and row of each cell, counted in cells.
    camera : int
        Number of the camera: the noise of each is its own.
    n_samples : int
        MOST_SAMPLES or FEWEST_SAMPLES.

    Returns
    -------
    SampledCells
        The same whatever the partition.
    """
    values, vectors = np.linalg.eigh(covariances)
    # Rounding may leave eigenvalues of nothing below zero.
    factors = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    n = covariances.shape[1]
    # Cells of other tiles have signs that have nothing to do with each other.
    n_tiles = n_samples // LARGEST_FORCES
    tiles = places[:, 0] + _ROW_SHIFTS[n_samples] * places[:, 1] + camera
    # Those next to each other in an irregular mesh go where no near one is.
    tiles = (tiles + n_tiles // 2 * _number_within_places(places)) % n_tiles
    columns = np.arange(n)
    rows = tiles[:, None] * LARGEST_FORCES + columns
    numbers = cell_ids[:, None] * LARGEST_FORCES + columns
    return SampledCells(factors, rows, 1.0 - 2.0 * generate_bits(numbers, camera))


def _number_within_places(places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of each cell among those with the same place, 0 for the first, (n_cells,)."""
    order = np.lexsort((np.arange(len(places)), places[:, 0], places[:, 1]))
    begins = np.append(True, (np.diff(places[order], axis=0) != 0).any(axis=1))
    first = np.maximum.accumulate(np.where(begins, np.arange(len(places)), 0))
    numbers = np.empty(len(places), dtype=np.int64)
    numbers[order] = np.arange(len(places)) - first
    return numbers
