"""What elements and regularization do to waves of the displacement, and how noise is spread over them.

A wave of wave vector k (rad/px) is measured with the share of its amplitude that linear elements of spacing h follow
and that equilibrium leaves. Noise of the images makes noise of the displacement with the spectrum of A^-1 M A^-1: where
the mesh is regular, the texture even and A = M + eta Kbar^T Kbar, that is r(k)^2 / m(k), r the share that equilibrium
leaves of a wave of that direction and m the spectrum of the elements' shape functions. Its level is that of the noise
floor; only its shape is modelled.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ddic.io import result_schema as schema
from ddic.io.result_reader import Result
from ddic.mesh.cell_type import T3
from ddic.mesh.quality import measure_covered_areas

Array = NDArray[np.float64]

ORDERS = {"equilibrium_gap": 4, "tikhonov": 2}
"""Power of wavelength with which a regularization fades: fourth of the equilibrium gap, second of Tikhonov's term."""

N_WAVES = 512
"""Wave numbers along each axis of the integrals over spectra; twice as many change noise by less than a per cent."""

DOMAINS = 4.0
"""Length of the domain whose waves are summed, in units of the longest thing in it: twice as long changes noise by
less than a per cent."""


@dataclass(frozen=True)
class DisplacementChain:
    """Elements and regularization, as waves of the displacement see them.

    Attributes
    ----------
    spacing : float
        Between nodes, pixels.
    shear, longitudinal : float
        Wavelengths of which the regularization leaves a half, across and along their direction, pixels; 0 without
        regularization, nan where they are not known.
    order : int
        Power of the wavelength with which the regularization fades.
    """

    spacing: float
    shear: float = 0.0
    longitudinal: float = 0.0
    order: int = 4

    @property
    def longest(self) -> float:
        """The longest length of the chain, over which its noise is correlated, pixels."""
        return float(np.max([self.spacing, self.shear, self.longitudinal]))

    def keep_by_elements(self, wave_number: Array) -> Array:
        """Find the share of a wave's amplitude that linear elements follow, fitted by least squares.

        ``wave_number`` is along the wave, rad/px; the share is 1 for long waves.
        """
        return np.asarray(evaluate_sinc(0.5 * wave_number * self.spacing)**4 / self.weigh_shapes(wave_number))

    def keep_by_regularization(self, wave_number: Array, half: float) -> Array:
        """Find the share of a wave's amplitude that the regularization leaves; 1 for long waves.

        ``half`` is the wavelength of which a half is left, pixels, 0 without regularization; wave numbers are in
        rad/px.
        """
        return np.asarray(1.0 / (1.0 + (np.abs(wave_number) * half / (2.0 * np.pi))**self.order))

    def weigh_shapes(self, wave_number: Array) -> Array:
        """Weigh the squares of linear elements by waves: the spectrum of the products of their shape functions.

        Mean square over an element of a wave whose nodes have that of 1, 1 for long waves; ``wave_number`` is along one
        axis, rad/px.
        """
        return np.asarray((2.0 + np.cos(wave_number * self.spacing)) / 3.0)

    def make_waves(self, length: float) -> Array:
        """List wave vectors (n, 2), a regular grid, rad/px, over which the noise of something of some length is summed.

        ``length`` is of what asks for the displacement, pixels.
        """
        step = 2.0 * np.pi / (DOMAINS * max(length, 2.0 * self.longest))
        highest = min(np.pi / self.spacing, 0.5 * N_WAVES * step)
        n = int(np.ceil(2.0 * highest / step))
        axis = highest * (2.0 * (np.arange(n) + 0.5) / n - 1.0)
        return np.column_stack([grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij")])

    def predict_noise(self, waves: Array) -> Array:
        """Predict how unit noise of a component of the nodes' displacements is spread over waves.

        Covariance (n, 2, 2) of the two components in each wave of ``make_waves``; the variance of a component is the
        sum.
        """
        return np.asarray(self._shape_noise(waves) * (_find_cell(waves) / self._total))

    @cached_property
    def _total(self) -> float:
        """Mean variance of the two components under the shape of the spectrum."""
        waves = self.make_waves(0.0)
        return float(0.5 * np.einsum("nii->", self._shape_noise(waves)) * _find_cell(waves))

    def _shape_noise(self, waves: Array) -> Array:
        """The spectrum but for its level, (n, 2, 2)."""
        size = np.linalg.norm(waves, axis=1)
        along = waves / np.maximum(size, 1e-300)[:, None]
        mass = self.weigh_shapes(waves[:, 0]) * self.weigh_shapes(waves[:, 1])
        longitudinal = self.keep_by_regularization(size, self.longitudinal)**2 / mass
        shear = self.keep_by_regularization(size, self.shear)**2 / mass
        lengthwise = along[:, :, None] * along[:, None, :]
        across = np.eye(2) - lengthwise
        return np.asarray(longitudinal[:, None, None] * lengthwise + shear[:, None, None] * across)


def evaluate_sinc(x: Array) -> Array:
    """Evaluate sin x / x, 1 at 0, of radians."""
    return np.asarray(np.sinc(x / np.pi))


def find_chain(result: Result, cells: NDArray[np.int64]) -> DisplacementChain:
    """Find the elements and the regularization of a result, with the mean spacing of the nodes of some cells.

    Those are the cells about which is asked, all where ``cells`` is empty.
    """
    case = result.attributes.get(schema.CASE, {})
    text = str(case.get("json", ""))
    section = (json.loads(text) if text else {}).get("regularization") or {}
    # A weight given as eta says nothing of wavelengths.
    unknown = math.nan if section else 0.0
    return DisplacementChain(_find_spacing(result, cells), float(case.get("half_amplitude_shear_px", unknown)),
                             float(case.get("half_amplitude_longitudinal_px", unknown)),
                             ORDERS[str(section.get("operator", "equilibrium_gap"))])


def _find_spacing(result: Result, cells: NDArray[np.int64]) -> float:
    """Mean spacing of nodes: the root of a square's area, or of two triangles'."""
    if result.separated is not None:
        axes = (result.separated.along_x.nodes, result.separated.along_y.nodes)
        return float(np.sqrt(np.prod([np.ptp(nodes) / (len(nodes) - 1) for nodes in axes])))
    areas, _ = measure_covered_areas(result.mesh)
    of_nodes = np.where(result.mesh.types == T3.vtk, 2.0 * areas, areas)
    return float(np.sqrt(of_nodes[cells] if len(cells) else of_nodes).mean())


def _find_cell(waves: Array) -> float:
    """Area of the plane of wave vectors that each of a regular grid stands for."""
    step = abs(float(waves[1, 1] - waves[0, 1])) if len(waves) > 1 else 1.0
    return step * step
