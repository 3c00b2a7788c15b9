"""Whether a subdomain holds texture, or no more than image noise would give."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ddic.functionals.correlation import Correlation
from ddic.kinematics.finite_element import finite_element_kinematics
from ddic.mesh.raster import rasterize

NOISE_GAIN = {3: 1.392305, 5: 1.893960}
"""Variance of the spline's slope at a pixel for white noise of variance 1: mean over w of |slope(w)/value(w)|^2 of the
degree's taps; 9 (2/sqrt(3) - 1) for the cubic."""

EMPTY = 1e-4
"""Energy relative to the largest subdomain's below which nothing is seen: gradients a hundred times weaker than those
of full-contrast speckle (tens of grey levels per pixel) are those of the rounding to 8 bit."""

NOISY = 2.0
"""Energy relative to that of noise below which it is no more than noise. White noise gives 0.6 to 1 (rotations weigh
the outer nodes, which see fewer pixels), speckle of a few pixels six and more."""

WEAK = 0.05
"""Energy relative to the textured subdomains' median above which it counts as texture, whatever its spectrum: grains
of one pixel look like noise too."""

_SECOND_DIFFERENCE = np.array([1.0, -2.0, 1.0]) / np.sqrt(6.0)
"""Along both axes it is blind to constants, slopes and curvatures along one axis, and keeps the variance of noise."""


@dataclass(frozen=True)
class Texture:
    """How well a subdomain's pixels hold it against rigid motion, the null space of its mechanics.

    energy: least v^T M_s v / v^T v over rigid modes v, grey^2/px^2, hence none where the grey level varies in one
    direction only; noise: what white noise as strong as the image's finest detail would give.
    """

    energy: float
    noise: float


def texture(correlation: Correlation, degree: int) -> Texture:
    """Measure a subdomain's texture on the pixels that count; degree: of the spline (3 or 5).

    The noise is estimated by J. Immerkaer's operator, Computer Vision and Image Understanding 64 (1996) 300-302,
    which texture can only raise, and goes through the sums of M_s in place of the gradient. Pixels beside masked ones
    count for the energy alone.
    """
    f = correlation.reference
    slope = f.values
    for axis in (0, 1):
        slope = ndimage.correlate1d(slope, _SECOND_DIFFERENCE * NOISE_GAIN[degree] ** 0.25, axis=axis, mode="mirror")
    usable = None if f.usable is None else ndimage.binary_erosion(f.usable, np.ones((3, 3))).astype(np.uint8)
    noise = replace(correlation, reference=replace(f, by_x=slope, by_y=slope, usable=usable))
    modes = np.linalg.qr(rigid_modes(correlation.mesh.nodes))[0]
    dim = correlation.mesh.dim
    # White noise holds all rigid modes alike: their mean over the translations, the first modes, will do. The
    # stand-in's slopes are equal, which moves energy between directions but keeps the trace.
    return Texture(float(np.linalg.eigvalsh(modes.T @ (correlation.hessian() @ modes))[0]),
                   float(np.trace(modes[:, :dim].T @ (noise.hessian() @ modes[:, :dim])) / dim))


def restricted(correlation: Correlation, cells: NDArray[np.int64]) -> Correlation:
    """The same on some of a subdomain's cells, with the same window of the image."""
    mesh, _ = correlation.mesh.submesh(cells)
    return replace(correlation, mesh=mesh, kinematics=finite_element_kinematics(mesh), raster=rasterize(mesh))


def rigid_modes(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Translations, then infinitesimal rotations about the centre, of nodes (n, dim); (n dim, dim (dim + 1) / 2)."""
    n, dim = nodes.shape
    centred = nodes - nodes.mean(axis=0)
    modes = [np.tile(row, (n, 1)) for row in np.eye(dim)]
    for a in range(dim):
        for b in range(a + 1, dim):
            rotation = np.zeros((n, dim))
            rotation[:, a], rotation[:, b] = -centred[:, b], centred[:, a]
            modes.append(rotation)
    return np.stack([mode.ravel() for mode in modes], axis=1)


def blank_subdomains(textures: list[Texture]) -> NDArray[np.bool_]:
    """Which of all subdomains (or pieces of them) hold no usable texture, (n,)."""
    energy = np.array([t.energy for t in textures])
    noise = np.array([t.noise for t in textures])
    empty = energy <= EMPTY * energy.max()
    noisy = energy <= NOISY * noise
    textured = ~empty & ~noisy
    if not textured.any():
        return np.asarray(empty)
    return np.asarray(empty | noisy & (energy <= WEAK * np.median(energy[textured])))
