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
from ddic.mesh.cell_type import T3
from ddic.mesh.interpolation import interpolate_located, locate
from ddic.mesh.quality import measure_covered_areas
from ddic.probes.probes import Extensometer, LineProbe, PointProbe, Probe, StrainGauge, list_samples

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

    def make_waves(self, length: float) -> Array:
        """List wave vectors (n, 2), a regular grid, rad/px, over which noise of what has some length, px, is summed."""
        step = 2.0 * np.pi / (DOMAINS * max(length, 2.0 * self.longest))
        highest = min(np.pi / self.spacing, 0.5 * N_WAVES * step)
        n = int(np.ceil(2.0 * highest / step))
        axis = highest * (2.0 * (np.arange(n) + 0.5) / n - 1.0)
        return np.column_stack([grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij")])

    def predict_noise(self, waves: Array) -> Array:
        """Predict the covariance, (n, 2, 2), of unit noise of the nodes in each wave of ``make_waves``; they add up."""
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
                             ORDERS[str(section.get("operator", "equilibrium_gap"))])


def _find_spacing(result: Result, cells: IntArray) -> float:
    """Mean spacing of nodes: the root of a square's area, or of two triangles'."""
    if result.separated is not None:
        axes = (result.separated.along_x.nodes, result.separated.along_y.nodes)
        return float(np.sqrt(np.prod([np.ptp(nodes) / (len(nodes) - 1) for nodes in axes])))
    areas, _ = measure_covered_areas(result.mesh)
    of_nodes = np.where(result.mesh.types == T3.vtk, 2.0 * areas, areas)
    return float(np.sqrt(of_nodes[cells] if len(cells) else of_nodes).mean())


def _find_cell(waves: Array) -> float:
    """Area of the plane of wave vectors that each of a regular grid stands for."""
    step = float(waves[1, 1] - waves[0, 1])
    return step * step


SMALL = 1e-3
"""Radians below which the slope's answer is written as a series: its quotient would lose its digits."""


def _evaluate_displacement_response(probe: Probe, chain: DisplacementChain, waves: Array) -> Array:
    """What is left, (n,), of waves (n, 2), rad/px, in the displacement of a point, a line or a strain gauge."""
    if not isinstance(probe, StrainGauge):
        return np.ones(len(waves))
    along, across = _turn(probe, waves)
    mean = _evaluate_sinc(0.5 * along * probe.length) * _evaluate_sinc(0.5 * across * probe.across)
    return np.asarray(_interpolate(chain, waves) * mean)


def _evaluate_strain_response(probe: Probe, chain: DisplacementChain, waves: Array) -> Array:
    """The slope, (n,), 1/px without the factor i, that a probe measures along itself, or x, of waves (n, 2), rad/px."""
    if isinstance(probe, PointProbe | LineProbe):
        # Recovered from the cells around a node: a central difference.
        return np.asarray(np.sin(waves[:, 0] * chain.spacing) / chain.spacing)
    along, across = _turn(probe, waves)
    half = 0.5 * along * probe.length
    if isinstance(probe, Extensometer):
        return along * _evaluate_sinc(half)
    return along * _interpolate(chain, waves) * _fit_slope(half) * _evaluate_sinc(0.5 * across * probe.across)


def _evaluate_strain_power(probe: Probe, chain: DisplacementChain, waves: Array) -> Array:
    """The mean square of the slope, (n,), 1/px^2, that a probe measures of noise of mean square 1, wave by wave."""
    if not isinstance(probe, Extensometer):
        return np.asarray(_evaluate_strain_response(probe, chain, waves)**2)
    # Ends lie anywhere in their cells: their squares are means over a cell.
    along, _ = _turn(probe, waves)
    square = chain.weigh_shapes(waves[:, 0]) * chain.weigh_shapes(waves[:, 1])
    common = _interpolate(chain, waves)**2 * np.cos(along * probe.length)
    return np.asarray(2.0 * (square - common) / probe.length**2)


def _turn(probe: Extensometer | StrainGauge, waves: Array) -> tuple[Array, Array]:
    """Wave numbers along a probe and across it."""
    x, y = probe.direction
    return waves @ np.array([x, y]), waves @ np.array([-y, x])


def _interpolate(chain: DisplacementChain, waves: Array) -> Array:
    """Mean amplitude between nodes of a wave that nodes have with amplitude 1, by bilinear shape functions."""
    x, y = 0.5 * chain.spacing * waves.T
    return np.asarray(_evaluate_sinc(x)**2 * _evaluate_sinc(y)**2)


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
        Standard deviation of the strain along the probe, or of xx and yy, no unit.
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
    samples = list_samples(probe)
    cells = locate(result.mesh, samples).cells
    chain = find_chain(result, cells[cells >= 0])
    if isinstance(probe, PointProbe):
        # It is alike everywhere.
        probe = PointProbe("", (0.0, 0.0))
    level = _find_level(result, samples, schema.SIGMA_DISPLACEMENT) if noise is None else noise
    if math.isnan(level) and noise is None:
        level = float(result.attributes.get(schema.CASE, {}).get(schema.NOISE_FLOOR, math.nan))
    notes = ["the result records no noise floor"] if math.isnan(level) else []
    if math.isnan(chain.longest):
        notes.append("regularized by eta: no cut-off wavelength is recorded")
        return Metrology(level, math.nan, math.nan, math.nan, "; ".join(notes))
    of_strain = math.nan if noise is not None else _find_level(result, samples, schema.SIGMA_NODAL_STRAIN[:2])
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
    response = _evaluate_displacement_response(probe, chain, waves)
    return float(np.sqrt(0.5 * np.einsum("n,nii->", response**2, chain.predict_noise(waves))))


@lru_cache(maxsize=KEPT_PROBES)
def find_strain_noise(probe: Probe, chain: DisplacementChain) -> float:
    """Find the noise of a probe's strain, along it or xx, relative to that of the nodes' displacements, 1/px."""
    waves = chain.make_waves(_find_size(probe))
    direction = _find_axis(probe)
    along = np.einsum("nij,i,j->n", chain.predict_noise(waves), direction, direction)
    return float(np.sqrt((_evaluate_strain_power(probe, chain, waves) * along).sum()))


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
    return np.array([1.0, 0.0]) if isinstance(probe, PointProbe | LineProbe) else probe.direction


def _find_size(probe: Probe) -> float:
    """Length over which a probe looks, pixels."""
    if isinstance(probe, PointProbe | LineProbe):
        return 0.0
    return probe.length if isinstance(probe, Extensometer) else max(probe.length, probe.across)


def _find_level(result: Result, samples: Array, names: Sequence[str]) -> float:
    """RMS over some places of two fields of standard deviations; nan where the result has none."""
    if any(name not in result.point_data for name in names):
        return math.nan
    fields = np.column_stack([result.point_data[name] for name in names])
    values = interpolate_located(result.mesh, fields, locate(result.mesh, samples))
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else math.nan
