"""How steep the reference image is in each cell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

FLAT = 1e-6
"""Slope across speckle that varies in one direction only, squared, relative to that along: rounding."""


@dataclass(frozen=True, eq=False)
class CellSlopes:
    """Mean of grad f grad f^T over the pixels of cells.

    Attributes
    ----------
    mean : (n_cells, 2, 2) array
        (Grey levels / px)^2; 0 without pixels.
    """

    mean: NDArray[np.float64]

    @cached_property
    def inverse(self) -> NDArray[np.float64]:
        """Pseudo-inverse of each mean, (n_cells, 2, 2): a translation along lines of equal grey is not seen."""
        return np.asarray(np.linalg.pinv(self.mean, rcond=FLAT, hermitian=True))

    @property
    def texture(self) -> NDArray[np.float64]:
        """Mean of |grad f|^2, (n_cells,)."""
        return np.asarray(np.trace(self.mean, axis1=1, axis2=2))
