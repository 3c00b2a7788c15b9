"""How probes answer to a wave of the displacement exp(i k.x), the elements' part included."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.probes.displacement_chain import DisplacementChain, evaluate_sinc
from ddic.probes.probe_kinds import Extensometer, LineProbe, PointProbe, Probe, StrainGauge

Array = NDArray[np.float64]

SMALL = 1e-3
"""Radians below which the slope's answer is written as a series: its quotient would lose its digits."""


def evaluate_displacement_response(probe: Probe, chain: DisplacementChain, waves: Array) -> Array:
    """Evaluate what is left of a wave in a probe's displacement.

    Parameters
    ----------
    probe : Probe
        A point, a line or a strain gauge.
    chain : DisplacementChain
        Of which elements the displacement is.
    waves : (n, 2) array
        Wave vectors, rad/px.

    Returns
    -------
    (n,) array
        Share of the nodes' amplitude.
    """
    if not isinstance(probe, StrainGauge):
        return np.ones(len(waves))
    along, across = _turn(probe, waves)
    mean = evaluate_sinc(0.5 * along * probe.length) * evaluate_sinc(0.5 * across * probe.across)
    return np.asarray(_interpolate(chain, waves) * mean)


def evaluate_strain_response(probe: Probe, chain: DisplacementChain, waves: Array) -> Array:
    """Evaluate the slope that a probe measures of a wave, along itself; along x of points and lines.

    Parameters
    ----------
    probe : Probe
        Of any kind.
    chain : DisplacementChain
        Of which elements the displacement is.
    waves : (n, 2) array
        Wave vectors, rad/px.

    Returns
    -------
    (n,) array
        Amplitude of the measured slope, without the factor i, of a wave whose nodes have the amplitude 1; 1/px.
    """
    if isinstance(probe, PointProbe | LineProbe):
        # Recovered from the cells around a node: a central difference.
        return np.asarray(np.sin(waves[:, 0] * chain.spacing) / chain.spacing)
    along, across = _turn(probe, waves)
    half = 0.5 * along * probe.length
    if isinstance(probe, Extensometer):
        return along * evaluate_sinc(half)
    return along * _interpolate(chain, waves) * _fit_slope(half) * evaluate_sinc(0.5 * across * probe.across)


def evaluate_strain_power(probe: Probe, chain: DisplacementChain, waves: Array) -> Array:
    """Evaluate the mean square of the slope that a probe measures of noise, wave by wave.

    Parameters
    ----------
    probe : Probe
        Of any kind.
    chain : DisplacementChain
        Of which elements the displacement is.
    waves : (n, 2) array
        Wave vectors, rad/px.

    Returns
    -------
    (n,) array
        Of waves whose nodes have the mean square 1, 1/px^2.
    """
    if not isinstance(probe, Extensometer):
        return np.asarray(evaluate_strain_response(probe, chain, waves)**2)
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
    return np.asarray(evaluate_sinc(x)**2 * evaluate_sinc(y)**2)


def _fit_slope(half: Array) -> Array:
    """Slope that fits sin(k s) best over a gauge's length L, relative to k; half: k L / 2."""
    safe = np.where(np.abs(half) < SMALL, 1.0, half)
    quotient = 3.0 * (np.sin(safe) - safe * np.cos(safe)) / safe**3
    return np.where(np.abs(half) < SMALL, 1.0 - half**2 / 10.0, quotient)
