"""How much of the deformed image's noise reaches b: interpolation smooths it, as far as the texture lets it."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.functionals.correlation import Correlation
from ddic.functionals.view import View
from ddic.images.noise import REACH, correlate_interpolation
from ddic.images.volume import find_slopes
from ddic.images.window import Window
from ddic.mesh.mesh import pad_cells

LARGEST_SAMPLES = {2: 512, 3: 64}
"""Side, pixels, of the part of a subdomain from which the texture's correlation is taken, in images and in volumes; a
larger value takes time and memory."""

N_SHIFTS = 32
"""Shifts of a table along each axis: between two of them the transfer changes by 0.03 at most."""

PLACES = (0.3, 0.8)
"""Where shifts are taken in a cell, on the way from its middle to each corner: two places for each."""


@dataclass(frozen=True, eq=False)
class TransferTable:
    """Noise transfer by shift.

    Attributes
    ----------
    values : (dim, N_SHIFTS, ...) array
        To the noise of b along x, along y, ..., by the shift along each axis, x last, in steps of 1 / N_SHIFTS px: 1 at
        whole pixels, less between.
    """

    values: Array

    def find(self, displacement: Array) -> Array:
        """Look up the transfer, to b along each axis, at displacements, both (n, dim); these in pixels."""
        places = np.rint(displacement % 1.0 * N_SHIFTS).astype(np.int64) % N_SHIFTS
        return self.values[(slice(None), *places.T[::-1])].T


def correlate_slopes(correlation: Correlation) -> Array:
    """Sum f_x(p) f_x(p + k), and the same of f_y, ..., over the pixels p of a subdomain, for all small distances k.

    (dim, 2 REACH + 1, ...) sums, by k along each axis, x last, grey levels squared per pixel squared; what subdomains
    have adds up.
    """
    reference, dim = correlation.reference, correlation.mesh.dim
    sums = np.zeros((dim, *[2 * REACH + 1] * dim))
    sample = _choose_sample(correlation).intersection(reference.window)
    if not sample.n_pixels:
        return sums
    sampled = reference.restrict(sample)
    usable = 1.0 if sampled.usable is None else sampled.usable
    for axis, slopes in enumerate(find_slopes(sampled)):
        sums[axis] = _correlate(slopes * usable)
    return sums


def _choose_sample(correlation: Correlation) -> Window:
    """The middle of a subdomain's box: the same however many ranks there are."""
    nodes = correlation.mesh.nodes
    low, high = np.floor(nodes.min(axis=0)).astype(int), np.ceil(nodes.max(axis=0)).astype(int) + 1
    excess = np.maximum(high - low - LARGEST_SAMPLES[len(low)], 0)
    low, high = low + excess // 2, high - (excess + 1) // 2
    return Window.between(low, high)


def _correlate(values: Array) -> Array:
    """Sums of products of values at distances up to REACH, without wrapping around."""
    # It imports scipy.special, a tenth of a second, and few runs need it.
    from scipy import fft

    shape = [fft.next_fast_len(n + REACH, real=True) for n in values.shape]
    spectrum = fft.rfftn(values, s=shape)
    whole = fft.irfftn(np.abs(spectrum) ** 2, s=shape)
    return np.asarray(whole[np.ix_(*[np.arange(-REACH, REACH + 1)] * values.ndim)])


def build_transfer(sums: Array, degree: int) -> TransferTable:
    """Tabulate the noise transfer of an image with a texture.

    The noise of b is sum_p grad f(p) n(p) with interpolated noise n, whose values go together: its variance over that
    of noise of the pixels' own is sum_k R(k) rho(k), rho the correlation of grad f. Were grad f white, it would be
    R(0), the transfer of single values; a coarse texture hardly gains by interpolation. ``sums`` are those of
    ``correlate_slopes`` over all subdomains; the transfer is 1 where there is no texture.
    """
    along = np.stack([correlate_interpolation(k / N_SHIFTS, degree) for k in range(N_SHIFTS)])
    dim = len(sums)
    totals = np.array([of_axis[(REACH,) * dim] for of_axis in sums])
    values = np.ones((dim, *[N_SHIFTS] * dim))
    for axis in np.flatnonzero(totals > 0):
        found = sums[axis] / totals[axis]
        for _ in range(dim):
            # Axis by axis, each of which comes last in its turn.
            found = np.tensordot(found, along, axes=(0, 1))
        values[axis] = found
    return TransferTable(values)


@cache
def build_white_transfer(degree: int, dim: int) -> TransferTable:
    """Tabulate the variance of interpolated values over that of pixels, which is what the residual shows."""
    white = np.zeros((dim, *[2 * REACH + 1] * dim))
    for of_axis in white:
        of_axis[(REACH,) * dim] = 1.0
    return build_transfer(white, degree)


def find_cell_transfer(table: TransferTable, view: View, q: Array, cells: IntArray | slice = slice(None)) -> Array:
    """Average the noise transfer over the shifts that a displacement gives the pixels of each cell.

    To b along each axis, (n, dim), no unit, for cells given by number, by default all. ``q`` are the subdomain's
    unknowns.
    """
    mesh = view.correlation.mesh
    at_corners = view.kinematics.displacement(q).reshape(mesh.nodes.shape)[pad_cells(mesh)[cells]]
    middle = at_corners.mean(axis=1, keepdims=True)
    found = [table.find((middle + place * (at_corners - middle)).reshape(-1, mesh.dim)) for place in PLACES]
    return np.asarray(np.mean(found, axis=0).reshape(*at_corners.shape).mean(axis=1))
