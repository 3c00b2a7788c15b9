"""What a file's header says of its pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class PixelFormat:
    """Size and type of an image's pixels.

    Attributes
    ----------
    width, height : int
        Pixels.
    dtype : dtype
        Type of one channel.
    bits : int
        Used bits of a channel.
    n_colours : int
        1 (grey) or 3.
    n_channels : int
        Colours and what comes with them (alpha).
    n_pages : int
        Images in the file.
    inverted : bool
        Zero is stored for white.
    is_compressed : bool
        Pixels are decoded as they are read, so that only reading shows whether they can be.
    """

    width: int
    height: int
    dtype: np.dtype[Any]
    bits: int
    n_colours: int
    n_channels: int
    n_pages: int = 1
    inverted: bool = False
    is_compressed: bool = False

    @property
    def saturation(self) -> float | None:
        """Largest value that the integer type holds, None for floats."""
        if self.dtype.kind == "f":
            return None
        return float(2 ** (self.bits - (self.dtype.kind == "i")) - 1)
