"""A camera's picture: its size, and how grey levels become stored values."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.synth.digitise import Digitiser
from ddic.synth.fields import Pair


@dataclass(frozen=True)
class Picture:
    """Size of a camera's pictures and how they are digitised.

    Attributes
    ----------
    width, height : int
        Pixels, at least 1.
    digitiser : Digitiser
        From grey levels to stored values; 8 bit without noise where it is left out.

    Raises
    ------
    InputError
        Where there is no pixel.
    """

    width: int
    height: int
    digitiser: Digitiser = field(default_factory=Digitiser)

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise InputError(f"image: size = {self.width}x{self.height}: must be at least 1x1 pixels")

    @property
    def middle(self) -> Pair:
        """Position of the picture's centre, pixels."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    @property
    def corners(self) -> NDArray[np.float64]:
        """Centres of the four corner pixels (4, 2), pixels."""
        right = self.width - 1.0
        bottom = self.height - 1.0
        return np.array([[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]])
