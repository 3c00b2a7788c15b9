"""Spatial resolution and noise floor of probes, and what one costs in the other (docs/probes.md).

They follow from how probes answer to a wave of the displacement exp(i k.x), and from what elements and regularization
do to it: a wave of wave vector k (rad/px) is measured with the share of its amplitude that linear elements of spacing h
follow and that equilibrium leaves. Noise of the images makes noise of the displacement with the spectrum of
A^-1 M A^-1: where the mesh is regular, the texture even and A = M + eta Kbar^T Kbar, that is r(k)^2 / m(k), r the share
that equilibrium leaves of a wave of that direction and m the spectrum of the elements' shape functions. Its level is
that of the noise floor; only its shape is modelled.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.optimize import brentq

from ddic.arrays import Array, IntArray
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result
from ddic.mesh.interpolation import interpolate_located, locate
from ddic.mesh.quality import measure_covered_areas
from ddic.probes.probes import Extensometer, LineProbe, PointProbe, Probe, StrainGauge, list_samples

ORDERS = {"equilibrium_gap": 4, "tikhonov": 2}
"""Power of wavelength with which a regularization fades: fourth of the equilibrium gap, second of Tikhonov's term."""

N_WAVES = 512
"""Wave numbers along each axis of the plane of the integrals over spectra; twice as many change noise by less than a
per cent."""

N_SCATTERED = 1 << 16
"""Waves of these integrals in a volume, where a grid would have too many: twice as many change the noise of probes of
up to some hundred elements by less than a per cent."""

SCATTER = np.array([0.8191725133961644, 0.671043606703789, 0.5497004779019701])
"""Steps along the axes of places, modulo 1, that fill a cube evenly, and each axis too: 1/r, 1/r^2, 1/r^3, r^4 = r + 1.
"""

DOMAINS = 4.0
"""Length of the domain whose waves are summed, in units of the longest thing in it: twice as long changes noise by
less than a per cent."""


@dataclass(frozen=True, eq=False)
class Waves:
    """Waves over which noise is summed.

    Attributes
    ----------
    vectors : (n, dim) array
        Wave vectors, rad/px.
    weights : (n,) array
        How many cells of the space of wave vectors each stands for.
    cell : float
        Volume of such a cell, or area in the plane, (rad/px)^dim.
    """

    vectors: Array
    weights: Array
    cell: float


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
    dim : int
        Number of space dimensions.
    """

    spacing: float
    shear: float = 0.0
    longitudinal: float = 0.0
    order: int = 4
    dim: int = 2

    @property
    def longest(self) -> float:
        """The longest length of the chain, over which its noise is correlated, pixels."""
        return float(np.max([self.spacing, self.shear, self.longitudinal]))

    def keep_by_elements(self, wave_number: Array) -> Array:
        """Find the share of a wave, its number in rad/px, that linear elements follow; 1 for long waves."""
        return np.asarray(_evaluate_sinc(0.5 * wave_number * self.spacing)**4 / self.weigh_shapes(wave_number))

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

    def weigh_shapes_along_all(self, vectors: Array) -> Array:
        """The same of waves of any direction, (n, dim), rad/px: the product over the axes."""
        return np.asarray(math.prod(self.weigh_shapes(of_axis) for of_axis in vectors.T))

    def make_waves(self, length: float) -> Waves:
        """List waves over which noise of what has some length, px, is summed: in the plane a regular grid of them."""
        if self.dim == 3:
            return self._scatter_waves(2.0 * np.pi / max(length, self.longest))
        step = 2.0 * np.pi / (DOMAINS * max(length, 2.0 * self.longest))
        highest = min(np.pi / self.spacing, 0.5 * N_WAVES * step)
        n = int(np.ceil(2.0 * highest / step))
        axis = highest * (2.0 * (np.arange(n) + 0.5) / n - 1.0)
        vectors = np.column_stack([grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij")])
        return Waves(vectors, np.ones(len(vectors)), float(axis[1] - axis[0])**2)

    def _scatter_waves(self, scale: float) -> Waves:
        """Waves scattered evenly, but along each axis the more thinly the farther they are beyond a scale, rad/px."""
        places = 2.0 * (np.arange(1, N_SCATTERED + 1)[:, None] * SCATTER % 1.0) - 1.0
        stretch = np.arcsinh(np.pi / self.spacing / scale)
        vectors = scale * np.sinh(stretch * places)
        weights = (stretch * np.hypot(scale, vectors)).prod(axis=1)
        return Waves(vectors, weights, 2.0**self.dim / N_SCATTERED)

    def predict_noise(self, waves: Waves) -> Array:
        """Predict the covariance, (n, dim, dim), of unit noise of the nodes in each of these waves; they add up."""
        return np.asarray(self._shape_noise(waves) * (waves.cell / self._total))

    @cached_property
    def _total(self) -> float:
        """Mean variance of the components under the shape of the spectrum."""
        waves = self.make_waves(0.0)
        return float(1 / self.dim * np.einsum("nii->", self._shape_noise(waves)) * waves.cell)

    def _shape_noise(self, waves: Waves) -> Array:
        """The spectrum but for its level, times the waves' weights, (n, dim, dim)."""
        size = np.linalg.norm(waves.vectors, axis=1)
        along = waves.vectors / np.maximum(size, 1e-300)[:, None]
        mass = self.weigh_shapes_along_all(waves.vectors)
        longitudinal = self.keep_by_regularization(size, self.longitudinal)**2 / mass * waves.weights
        shear = self.keep_by_regularization(size, self.shear)**2 / mass * waves.weights
        lengthwise = along[:, :, None] * along[:, None, :]
        across = np.eye(self.dim) - lengthwise
        return np.asarray(longitudinal[:, None, None] * lengthwise + shear[:, None, None] * across)


def _evaluate_sinc(x: Array) -> Array:
    """Evaluate sin x / x, 1 at 0, of radians."""
    return np.asarray(np.sinc(x / np.pi))


def find_chain(result: Result, cells: IntArray) -> DisplacementChain:
    """Find the elements and the regularization of a result, with the mean spacing of the nodes of some cells.

    Those are the cells about which is asked, all where ``cells`` is empty.
    """
    case = result.attributes.get(schema.CASE, {})
    section = schema.get_case(result.attributes).get("regularization") or {}
    # A weight given as eta says nothing of wavelengths.
    unknown = math.nan if section else 0.0
    # Cells that are alike but for rounding have one chain, whose noise is estimated once.
    spacing = float(f"{_find_spacing(result, cells):.12g}")
    return DisplacementChain(spacing, float(case.get("half_amplitude_shear_px", unknown)),
                             float(case.get("half_amplitude_longitudinal_px", unknown)),
                             ORDERS[str(section.get("operator", "equilibrium_gap"))], result.mesh.dim)


def _find_spacing(result: Result, cells: IntArray) -> float:
    """Mean spacing of nodes: the side of a square or a cube that has as much of the mesh as a node has."""
    if result.separated is not None:
        axes = (result.separated.along_x.nodes, result.separated.along_y.nodes)
        return float(np.sqrt(np.prod([np.ptp(nodes) / (len(nodes) - 1) for nodes in axes])))
    of_nodes, _ = measure_covered_areas(result.mesh)
    for block in result.mesh.cell_blocks:
        of_nodes[block.cells] *= block.type.cells_around_node / block.type.n_nodes
    return float(((of_nodes[cells] if len(cells) else of_nodes)**(1 / result.mesh.dim)).mean())


SMALL = 1e-3
"""Radians below which the slope's answer is written as a series: its quotient would lose its digits."""


def _evaluate_displacement_response(probe: Probe, chain: DisplacementChain, waves: Array) -> Array:
    """What is left, (n,), of waves (n, dim), rad/px, in the displacement of a point, a line or a strain gauge."""
    if not isinstance(probe, StrainGauge):
        return np.ones(len(waves))
    mean = _evaluate_sinc(0.5 * (waves @ probe.axis) * probe.length) * _average_across(probe, waves)
    return np.asarray(_interpolate(chain, waves) * mean)


def _evaluate_strain_response(probe: Probe, chain: DisplacementChain, waves: Array) -> Array:
    """The slope, (n,), 1/px without the factor i, that a probe measures along itself, or x, of waves (n, dim)."""
    if isinstance(probe, PointProbe | LineProbe):
        # Recovered from the cells around a node: a central difference.
        return np.asarray(np.sin(waves[:, 0] * chain.spacing) / chain.spacing)
    along = waves @ probe.axis
    half = 0.5 * along * probe.length
    if isinstance(probe, Extensometer):
        return along * _evaluate_sinc(half)
    return along * _interpolate(chain, waves) * _fit_slope(half) * _average_across(probe, waves)


def _evaluate_strain_power(probe: Probe, chain: DisplacementChain, waves: Array) -> Array:
    """The mean square of the slope, (n,), 1/px^2, that a probe measures of noise of mean square 1, wave by wave."""
    if not isinstance(probe, Extensometer):
        return np.asarray(_evaluate_strain_response(probe, chain, waves)**2)
    # Ends lie anywhere in their cells: their squares are means over a cell.
    common = _interpolate(chain, waves)**2 * np.cos(waves @ probe.axis * probe.length)
    return np.asarray(2.0 * (chain.weigh_shapes_along_all(waves) - common) / probe.length**2)


def _average_across(gauge: StrainGauge, waves: Array) -> Array:
    """What the means over the sides across a gauge leave, (n,), of waves."""
    return np.asarray(math.prod(_evaluate_sinc(0.5 * (waves @ axis) * gauge.across) for axis in gauge.axes[1:]))


def _interpolate(chain: DisplacementChain, waves: Array) -> Array:
    """Mean amplitude between nodes of a wave that nodes have with amplitude 1, by shape functions linear along axes."""
    return np.asarray(math.prod(_evaluate_sinc(of_axis)**2 for of_axis in 0.5 * chain.spacing * waves.T))


def _fit_slope(half: Array) -> Array:
    """Slope that fits sin(k s) best over a gauge's length L, relative to k; half: k L / 2."""
    safe = np.where(np.abs(half) < SMALL, 1.0, half)
    quotient = 3.0 * (np.sin(safe) - safe * np.cos(safe)) / safe**3
    return np.where(np.abs(half) < SMALL, 1.0 - half**2 / 10.0, quotient)


KEPT = 0.9
"""Share of a wave's amplitude that is left at the spatial resolution."""

KEPT_PROBES = 1024
"""Probes whose resolution and noise are kept for the next frame, which has the same; more take a few bytes each."""

LONGEST_WAVE = 1e3
"""Longest wave that is looked at, relative to the longest length of probe and chain."""


@dataclass(frozen=True)
class Metrology:
    """How fine and how exact a probe is; nan where that is not known.

    Attributes
    ----------
    displacement_noise : float
        Standard deviation of a component of the displacement, pixels; nan of an extensometer.
    displacement_resolution : float
        Wavelength of which 90 % are left in the displacement, pixels; nan of an extensometer.
    strain_noise : float
        Standard deviation of the strain along the probe, or of xx, yy and, in a volume, zz, no unit.
    strain_resolution : float
        Wavelength of which 90 % are left in the strain, pixels.
    note : str
        Why something is not known; empty where all is.
    """

    displacement_noise: float
    displacement_resolution: float
    strain_noise: float
    strain_resolution: float
    note: str = ""

    @property
    def displacement_indicator(self) -> float:
        """Metrological efficiency indicator of the displacement: noise times resolution, px^2; less is better."""
        return self.displacement_noise * self.displacement_resolution

    @property
    def strain_indicator(self) -> float:
        """The same of the strain, noise times resolution squared, px^2: a longer gauge leaves it about as it is."""
        return self.strain_noise * self.strain_resolution**2


def estimate_metrology(result: Result, probe: Probe, noise: float | None = None) -> Metrology:
    """Estimate the spatial resolution and the noise floor of a probe on a result.

    Parameters
    ----------
    result : Result
        The field.
    probe : Probe
        Where and how it is read.
    noise : float, optional
        Standard deviation of a component of the nodes' displacements, pixels, of a static pair for instance; by default
        that of the result's fields of standard deviations, else its noise floor.

    Returns
    -------
    Metrology
        With nan, and a note, where the result does not say its noise or its cut-off wavelength.
    """
    samples = list_samples(result, probe)
    cells = locate(result.mesh, samples).cells
    chain = find_chain(result, cells[cells >= 0])
    if isinstance(probe, PointProbe):
        # It is alike everywhere.
        probe = PointProbe("", (0.0,) * probe.dim)
    level = _find_level(result, samples, schema.SIGMA_DISPLACEMENT[:probe.dim]) if noise is None else noise
    if math.isnan(level) and noise is None:
        level = float(result.attributes.get(schema.CASE, {}).get(schema.NOISE_FLOOR, math.nan))
    notes = ["the result records no noise floor"] if math.isnan(level) else []
    if math.isnan(chain.longest):
        notes.append("regularized by eta: no cut-off wavelength is recorded")
        return Metrology(level, math.nan, math.nan, math.nan, "; ".join(notes))
    # xx, yy and, in a volume, zz are the first.
    normal = schema.list_sigma_strains(probe.dim)[:probe.dim]
    of_strain = math.nan if noise is not None else _find_level(result, samples, normal)
    is_local = isinstance(probe, PointProbe | LineProbe) and not math.isnan(of_strain)
    strain_noise = of_strain if is_local else level * find_strain_noise(probe, chain)
    of_displacement = math.nan, math.nan
    if not isinstance(probe, Extensometer):
        of_displacement = level * _find_displacement_noise(probe, chain), find_displacement_resolution(probe, chain)
    return Metrology(*of_displacement, strain_noise, find_strain_resolution(probe, chain), "; ".join(notes))


@lru_cache(maxsize=KEPT_PROBES)
def _find_displacement_noise(probe: Probe, chain: DisplacementChain) -> float:
    """Noise of a component of the displacement of a point, a line or a gauge, relative to that of the nodes."""
    waves = chain.make_waves(_find_size(probe))
    response = _evaluate_displacement_response(probe, chain, waves.vectors)
    return float(np.sqrt(1 / chain.dim * np.einsum("n,nii->", response**2, chain.predict_noise(waves))))


@lru_cache(maxsize=KEPT_PROBES)
def find_strain_noise(probe: Probe, chain: DisplacementChain) -> float:
    """Find the noise of a probe's strain, along it or xx, relative to that of the nodes' displacements, 1/px."""
    waves = chain.make_waves(_find_size(probe))
    direction = _find_axis(probe)
    along = np.einsum("nij,i,j->n", chain.predict_noise(waves), direction, direction)
    return float(np.sqrt((_evaluate_strain_power(probe, chain, waves.vectors) * along).sum()))


@lru_cache(maxsize=KEPT_PROBES)
def find_displacement_resolution(probe: Probe, chain: DisplacementChain) -> float:
    """Find the wavelength, along a probe or x, of which 90 % are left in its displacement, pixels."""
    return _find_wavelength(probe, chain, lambda waves, _: _evaluate_displacement_response(probe, chain, waves))


@lru_cache(maxsize=KEPT_PROBES)
def find_strain_resolution(probe: Probe, chain: DisplacementChain) -> float:
    """Find the wavelength, along the probe or along x, of which 90 % are left in a probe's strain, pixels."""
    return _find_wavelength(probe, chain, lambda waves, k: _evaluate_strain_response(probe, chain, waves) / k)


def _find_wavelength(probe: Probe, chain: DisplacementChain, respond: Callable[[Array, float], Array]) -> float:
    """The longest wave along the probe of which no more than KEPT is left, pixels.

    ``respond`` tells what the probe leaves of waves, of their number too. Elements and regularization leave least of a
    wave along its direction.
    """
    half = max(chain.longitudinal, chain.shear)

    def keep(k: float) -> float:
        wave_number = np.array(k)
        by_chain = float(chain.keep_by_elements(wave_number) * chain.keep_by_regularization(wave_number, half))
        return float(respond(k * _find_axis(probe)[None], k)[0]) * by_chain

    lowest = 2.0 * np.pi / (LONGEST_WAVE * max(_find_size(probe), chain.longest))
    # Waves shorter than two elements are not seen at all; 0.49 of those are left.
    tried = np.geomspace(lowest, np.pi / chain.spacing, 400)
    first = int(np.argmax(np.array([keep(k) for k in tried]) < KEPT))
    return float(2.0 * np.pi / brentq(lambda k: keep(k) - KEPT, tried[first - 1], tried[first]))


def _find_axis(probe: Probe) -> Array:
    return np.eye(probe.dim)[0] if isinstance(probe, PointProbe | LineProbe) else probe.axis


def _find_size(probe: Probe) -> float:
    """Length over which a probe looks, pixels."""
    if isinstance(probe, PointProbe | LineProbe):
        return 0.0
    return probe.length if isinstance(probe, Extensometer) else max(probe.length, probe.across)


def _find_level(result: Result, samples: Array, names: Sequence[str]) -> float:
    """RMS over some places of fields of standard deviations; nan where the result has none."""
    if any(name not in result.point_data for name in names):
        return math.nan
    fields = np.column_stack([result.point_data[name] for name in names])
    values = interpolate_located(result.mesh, fields, locate(result.mesh, samples))
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else math.nan
