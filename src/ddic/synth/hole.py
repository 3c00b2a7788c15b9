"""A hole cut out of the speckled plate, as it looks in a picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ddic.errors import InputError


@dataclass(frozen=True)
class Hole:
    """A flat dark disc with a smooth edge, in reference coordinates.

    Attributes
    ----------
    center : (float, float)
        Pixels.
    radius : float
        Pixels.
    level : float
        Grey level inside, as a fraction of full scale.
    edge : float
        Half-width of the edge (1 + tanh(distance / edge)) / 2, pixels.

    Raises
    ------
    InputError
        For a radius or edge that is not positive, or a level outside 0..1.
    """

    center: tuple[float, float]
    radius: float
    level: float = 0.05
    edge: float = 1.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.center).all():
            raise InputError(f"hole: center = {self.center}: must be finite")
        for key, value in (("radius", self.radius), ("edge", self.edge)):
            if not (value > 0 and math.isfinite(value)):
                raise InputError(f"hole: {key} = {value}: must be positive")
        if not 0 <= self.level <= 1:
            raise InputError(f"hole: level = {self.level}: must lie between 0 and 1")

    def cut(self, grey: NDArray[np.float64], x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Cut the hole out of grey levels.

        Parameters
        ----------
        grey : array
            Of any shape, fractions of full scale.
        x, y : array_like
            Reference points where they were taken, pixels.

        Returns
        -------
        array
            Of the shape of ``grey``, fractions of full scale.
        """
        distance = np.hypot(np.asarray(x) - self.center[0], np.asarray(y) - self.center[1]) - self.radius
        matter = 0.5 * (1 + np.tanh(distance / self.edge))
        return np.asarray(self.level + matter * (grey - self.level))
