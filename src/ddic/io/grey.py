"""From the channels of a colour image to grey levels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LUMA = (0.299, 0.587, 0.114)


def to_grey(channels: NDArray[Any], n_colours: int) -> NDArray[Any]:
    """Turn the channels of pixels into grey levels.

    Parameters
    ----------
    channels : (height, width, n) array
        Red, green and blue first, or grey first; what follows is dropped.
    n_colours : int
        1 keeps the first channel and its type, 3 weighs red, green and blue (ITU-R BT.601) to float32.

    Returns
    -------
    (height, width) array
        Grey levels.
    """
    if n_colours == 1:
        return np.ascontiguousarray(channels[..., 0])
    grey = np.zeros(channels.shape[:2])
    for weight, channel in zip(LUMA, range(3), strict=True):
        grey += weight * channels[..., channel]
    return grey.astype(np.float32)
