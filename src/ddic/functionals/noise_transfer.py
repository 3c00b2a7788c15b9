"""How much of the deformed image's noise reaches b: interpolation smooths it, as far as the texture lets it."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.functionals.correlation import Correlation
from ddic.functionals.view import View
from ddic.images.noise import REACH, correlate_interpolation
from ddic.images.window import Window
from ddic.mesh.mesh import pad_cells

LARGEST_SAMPLE = 512
"""Side, pixels, of the part of a subdomain from which the texture's correlation is taken; a larger value takes time and
memory."""

N_SHIFTS = 32
"""Shifts of a table along each axis: between two of them the transfer changes by 0.03 at most."""

PLACES = (0.3, 0.8)
"""Where shifts are taken in a cell, on the way from its middle to each corner: four corners' make 8 places."""


@dataclass(frozen=True, eq=False)
class TransferTable:
    """Noise transfer by shift.

    Attributes
    ----------
    values : (2, N_SHIFTS, N_SHIFTS) array
        To the noise of b along x and along y, by the shift along y and along x in steps of 1 / N_SHIFTS px: 1 at whole
        pixels, less between.
    """

    values: Array

    def find(self, displacement: Array) -> Array:
        """Look up the transfer, to b along x and along y, at displacements, both (n, 2); these in pixels."""
        places = np.rint(displacement % 1.0 * N_SHIFTS).astype(np.int64) % N_SHIFTS
        return self.values[:, places[:, 1], places[:, 0]].T


def correlate_slopes(correlation: Correlation) -> Array:
    """Sum f_x(p) f_x(p + k), and the same of f_y, over the pixels p of a subdomain, for all small distances k.

    (2, 2 REACH + 1, 2 REACH + 1) sums of f_x and f_y, by k along y and along x, grey levels squared per pixel squared;
    what subdomains have adds up.
    """
    sums = np.zeros((2, 2 * REACH + 1, 2 * REACH + 1))
    reference = correlation.reference
    sample = _choose_sample(correlation).intersection(reference.window)
    if min(sample.width, sample.height) < 1:
        return sums
    place = reference.window.locate(sample)
    usable = 1.0 if reference.usable is None else reference.usable[place]
    for axis, slopes in enumerate((reference.by_x, reference.by_y)):
        sums[axis] = _correlate(slopes[place].astype(np.float64) * usable)
    return sums


def _choose_sample(correlation: Correlation) -> Window:
    """The middle of a subdomain's box: the same however many ranks there are."""
    nodes = correlation.mesh.nodes
    low, high = np.floor(nodes.min(axis=0)).astype(int), np.ceil(nodes.max(axis=0)).astype(int) + 1
    excess = np.maximum(high - low - LARGEST_SAMPLE, 0)
    low, high = low + excess // 2, high - (excess + 1) // 2
    return Window(int(low[0]), int(low[1]), int(high[0]), int(high[1]))


def _correlate(values: Array) -> Array:
    """Sums of products of values at distances up to REACH, without wrapping around."""
    # It imports scipy.special, a tenth of a second, and few runs need it.
    from scipy import fft

    shape = [fft.next_fast_len(n + REACH, real=True) for n in values.shape]
    spectrum = fft.rfft2(values, s=shape)
    whole = fft.irfft2(np.abs(spectrum) ** 2, s=shape)
    near = np.arange(-REACH, REACH + 1)
    return np.asarray(whole[np.ix_(near, near)])


def build_transfer(sums: Array, degree: int) -> TransferTable:
    """Tabulate the noise transfer of an image with a texture.

    The noise of b is sum_p grad f(p) n(p) with interpolated noise n, whose values go together: its variance over that
    of noise of the pixels' own is sum_k R(k) rho(k), rho the correlation of grad f. Were grad f white, it would be
    R(0), the transfer of single values; a coarse texture hardly gains by interpolation. ``sums`` are those of
    ``correlate_slopes`` over all subdomains; the transfer is 1 where there is no texture.
    """
    along = np.stack([correlate_interpolation(k / N_SHIFTS, degree) for k in range(N_SHIFTS)])
    totals = sums[:, REACH, REACH]
    values = np.ones((2, N_SHIFTS, N_SHIFTS))
    for axis in np.flatnonzero(totals > 0):
        values[axis] = along @ (sums[axis] / totals[axis]) @ along.T
    return TransferTable(values)


@cache
def build_white_transfer(degree: int) -> TransferTable:
    """Tabulate the variance of interpolated values over that of pixels, which is what the residual shows."""
    white = np.zeros((2, 2 * REACH + 1, 2 * REACH + 1))
    white[:, REACH, REACH] = 1.0
    return build_transfer(white, degree)


def find_cell_transfer(table: TransferTable, view: View, q: Array, cells: IntArray | slice = slice(None)) -> Array:
    """Average the noise transfer over the shifts that a displacement gives the pixels of each cell.

    To b along x and along y, (n, 2), no unit, for cells given by number, by default all. ``q`` are the subdomain's
    unknowns.
    """
    mesh = view.correlation.mesh
    at_corners = view.kinematics.displacement(q).reshape(mesh.nodes.shape)[pad_cells(mesh)[cells]]
    middle = at_corners.mean(axis=1, keepdims=True)
    found = [table.find((middle + place * (at_corners - middle)).reshape(-1, 2)) for place in PLACES]
    return np.asarray(np.mean(found, axis=0).reshape(*at_corners.shape).mean(axis=1))
