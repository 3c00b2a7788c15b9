"""Lines across which the displacement may be discontinuous, and in which directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Opening = Literal["both", "tangential", "normal"]
"""Directions, seen from the line, in which the displacement may be discontinuous."""


@dataclass(frozen=True, eq=False)
class Discontinuities:
    """Lines across which the displacement may be discontinuous.

    Attributes
    ----------
    lines : tuple of (n_vertices, 2) array
        Polylines, pixels.
    openings : tuple of Opening
        Of each line.
    """

    lines: tuple[Array, ...] = ()
    openings: tuple[Opening, ...] = ()

    @property
    def n_lines(self) -> int:
        """Number of lines."""
        return len(self.lines)

    def with_line(self, number: int, line: Array) -> Discontinuities:
        """Give the same lines but for one, which lies elsewhere: (n_vertices, 2), pixels."""
        return Discontinuities((*self.lines[:number], line, *self.lines[number + 1:]), self.openings)

    def scale(self, origin: float | Array, factor: float) -> Discontinuities:
        """Give the lines in coarser pixels.

        Parameters
        ----------
        origin : float or (2,) array
            Position of the first coarse pixel's centre along either axis, or along each, pixels.
        factor : float
            Side of a coarse pixel, pixels.

        Returns
        -------
        Discontinuities
            The same lines, coarse pixels.
        """
        return Discontinuities(tuple((line - origin) / factor for line in self.lines), self.openings)
