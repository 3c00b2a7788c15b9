"""One-dimensional linear elements along a side of a rectangle, and the pixels that lie in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.raster import SNAP

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LineElements:
    """Linear elements between nodes on a line.

    A pixel centre belongs to the element that holds it, its lower end included, its upper end not: those of Q4 on the
    same lines have the same pixels.

    Attributes
    ----------
    nodes : (n_nodes,) array
        Ascending, pixels.
    """

    nodes: Array

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def length(self) -> float:
        """From the first node to the last, pixels."""
        return float(self.nodes[-1] - self.nodes[0])

    @cached_property
    def pixels(self) -> range:
        """Pixel centres between the first node and the last."""
        ends = np.round(self.nodes[[0, -1]] * SNAP) / SNAP
        first, stop = np.ceil(ends).astype(int)
        return range(int(first), int(stop))

    @cached_property
    def _elements(self) -> NDArray[np.int64]:
        """Element of each pixel, (n_pixels,)."""
        snapped = np.round(self.nodes * SNAP) / SNAP
        found = np.searchsorted(snapped, np.arange(self.pixels.start, self.pixels.stop), side="right") - 1
        return np.clip(found, 0, self.n_nodes - 2).astype(np.int64)

    @cached_property
    def _shares(self) -> Array:
        """Value of the upper node's function at each pixel, (n_pixels,); the lower one's is what is left to 1."""
        places = np.arange(self.pixels.start, self.pixels.stop, dtype=float)
        return np.asarray((places - self.nodes[self._elements]) / np.diff(self.nodes)[self._elements])

    def count_pixels(self) -> NDArray[np.int64]:
        """Count the pixels of each element.

        Returns
        -------
        (n_nodes - 1,) int64 array
            Along the line.
        """
        return np.bincount(self._elements, minlength=self.n_nodes - 1).astype(np.int64)

    def evaluate_at_pixels(self, values: Array) -> Array:
        """Evaluate functions at pixel centres.

        Parameters
        ----------
        values : (..., n_nodes) array
            At the nodes.

        Returns
        -------
        (..., n_pixels) array
            At the pixels.
        """
        lower = values[..., self._elements]
        return np.asarray(lower + self._shares * (values[..., self._elements + 1] - lower))

    def evaluate(self, values: Array, points: Array) -> Array:
        """Evaluate functions anywhere.

        Parameters
        ----------
        values : (..., n_nodes) array
            At the nodes.
        points : (n,) array
            Pixels; beyond the ends a function keeps the value of the end.

        Returns
        -------
        (..., n) array
            At the points.
        """
        places = np.clip(points, self.nodes[0], self.nodes[-1])
        elements = np.clip(np.searchsorted(self.nodes, places, side="right") - 1, 0, self.n_nodes - 2)
        shares = (places - self.nodes[elements]) / np.diff(self.nodes)[elements]
        lower = values[..., elements]
        return np.asarray(lower + shares * (values[..., elements + 1] - lower))

    def sum_at_nodes(self, of_pixels: Array) -> Array:
        """Sum per-pixel numbers against the shape functions.

        Parameters
        ----------
        of_pixels : (n_pixels,) array
            Any unit.

        Returns
        -------
        (n_nodes,) array
            N^T of_pixels.
        """
        upper = of_pixels * self._shares
        return self._sum_by_node(of_pixels - upper, 0) + self._sum_by_node(upper, 1)

    def assemble(self, weights: Array) -> Array:
        """Assemble N^T diag(weights) N.

        Parameters
        ----------
        weights : (n_pixels,) array
            Any unit.

        Returns
        -------
        (3, n_nodes) array
            Its diagonals: entry [1 + k, i] couples node i to node i + k.
        """
        upper, lower = self._shares, 1.0 - self._shares
        bands = np.zeros((3, self.n_nodes))
        bands[1] = self._sum_by_node(weights * lower**2, 0) + self._sum_by_node(weights * upper**2, 1)
        coupled = self._sum_by_node(weights * lower * upper, 0)
        bands[2] = coupled
        bands[0, 1:] = coupled[:-1]
        return bands

    def _sum_by_node(self, of_pixels: Array, end: int) -> Array:
        """Sums over pixels at the lower (0) or upper (1) node of their element, (n_nodes,)."""
        summed = np.bincount(self._elements + end, weights=of_pixels, minlength=self.n_nodes)
        return np.asarray(summed, dtype=np.float64)

    @cached_property
    def mass(self) -> Array:
        """Integrals of N_i N_j over the line, as diagonals (3, n_nodes), pixels."""
        h = np.diff(self.nodes)
        return self._assemble_elements(h / 3.0, h / 6.0, h / 6.0, h / 3.0)

    @cached_property
    def stiffness(self) -> Array:
        """Integrals of N_i' N_j', as diagonals (3, n_nodes), 1 / pixels."""
        inverse = 1.0 / np.diff(self.nodes)
        return self._assemble_elements(inverse, -inverse, -inverse, inverse)

    @cached_property
    def mixed(self) -> Array:
        """Integrals of N_i' N_j, as diagonals (3, n_nodes), no unit."""
        half = np.full(self.n_nodes - 1, 0.5)
        return self._assemble_elements(-half, -half, half, half)

    def _assemble_elements(self, lower: Array, above: Array, below: Array, upper: Array) -> Array:
        """Diagonals from the entries (lower, lower), (lower, upper), (upper, lower), (upper, upper) of elements."""
        bands = np.zeros((3, self.n_nodes))
        bands[1, :-1] += lower
        bands[1, 1:] += upper
        bands[2, :-1] = above
        bands[0, 1:] = below
        return bands
