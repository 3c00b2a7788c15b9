"""Grey-level statistics of a camera's pixels, and the correction of grey levels that follows from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.correlation import GreyCorrection, Residual


@dataclass(frozen=True)
class GreyState:
    """Grey-level statistics of one camera's pixels of the whole region at one displacement.

    Attributes
    ----------
    residual_std, residual_rms : float
        Of f - gain g(x + u) - offset, grey levels.
    n_pixels : int
        Pixels that count.
    gain, offset : float
        Of f = gain g + offset: the global correction; 1 and 0 without it, and with the correction per element.
    """

    residual_std: float
    residual_rms: float
    n_pixels: int
    gain: float
    offset: float


def find_correction(residual: Residual, state: GreyState,
                    correction: GreyCorrection) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find gain and offset of f = gain g + offset for a view's cells.

    Parameters
    ----------
    residual : Residual
        Of the view.
    state : GreyState
        Of the view's camera.
    correction : GreyCorrection
        "none", "global" or "element".

    Returns
    -------
    gain, offset : array
        One number, or one per cell (n_cells,); no unit, and grey levels.
    """
    if correction == "element":
        return residual.cell_sums.gain_and_offset()
    return np.array(state.gain), np.array(state.offset)
