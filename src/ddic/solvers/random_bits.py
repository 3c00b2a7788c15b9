"""Random bits by number: no rank needs those of the others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def generate_bits(numbers: NDArray[np.int64], stream: int) -> NDArray[np.float64]:
    """Generate a random bit for each number, by the mixing of splitmix64.

    Parameters
    ----------
    numbers : (...) array of int64
        Of whatever has a bit, the same on all ranks.
    stream : int
        Of independent bits.

    Returns
    -------
    (...) array
        0 or 1.
    """
    x = numbers.astype(np.uint64) + np.uint64((stream + 1) * 0x9E3779B97F4A7C15 % 2**64)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        x = (x ^ (x >> np.uint64(shift))) * np.uint64(factor)
    return ((x ^ (x >> np.uint64(31))) & np.uint64(1)).astype(np.float64)
