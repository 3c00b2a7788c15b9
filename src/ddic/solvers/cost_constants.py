"""Constants of the cost model of ``solver.method = "auto"``; ``make bench-interface`` measures them anew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Growth:
    """Cost of an unknown of a problem: constant, and growing with the size of the problem.

    Attributes
    ----------
    constant : float
        Seconds or bytes.
    growing : float
        The same, by the root of the number of unknowns, or by its logarithm to base 2.
    """

    constant: float
    growing: float

    def evaluate_by_root(self, n: float) -> float:
        """Evaluate it for operations of a factor by nested dissection, n^1.5.

        Parameters
        ----------
        n : float
            Unknowns of the problem.

        Returns
        -------
        float
            Of an unknown.
        """
        return self.constant + self.growing * float(np.sqrt(n))

    def evaluate_by_log(self, n: float) -> float:
        """Evaluate it for entries of a factor by nested dissection, n log n.

        Parameters
        ----------
        n : float
            Unknowns of the problem.

        Returns
        -------
        float
            Of an unknown.
        """
        return self.constant + self.growing * float(np.log2(max(n, 2.0)))


@dataclass(frozen=True)
class Factor:
    """Cost of a factorisation.

    Attributes
    ----------
    seconds : Growth
        CPU seconds, with the root.
    memory : Growth
        Bytes, with the logarithm.
    """

    seconds: Growth
    memory: Growth


@dataclass(frozen=True)
class CostConstants:
    """What a machine takes for the parts of a linear step, an unknown; pairs are without and with regularization.

    Attributes
    ----------
    whole : pair of Factor
        Of A by MUMPS, forming it included.
    whole_solve : float
        Seconds of a solve with it, by the logarithm of the unknowns.
    parallel_factor, parallel_memory : float
        Powers of the number of ranks by which seconds and bytes of a rank fall.
    local : pair of Factor
        Of A_s by the package for subdomains.
    local_solve : float
        Seconds of a solve with it, by the logarithm of its unknowns.
    interface : pair of Factor
        Of S_s and its inverse.
    coarse_set_up : Growth
        Seconds of modes and coarse matrix of two levels, with the root of a subdomain's unknowns.
    dual_product : float
        Solves with A_s that an iteration of the interface problem is worth.
    one_level_iterations, two_level_iterations : float
        Of an inexact step, the first where the cut-off wavelength is far below the side of a subdomain.
    cg_set_up : float
        Seconds.
    cg_product : pair of float
        Seconds of an iteration of conjugate gradients.
    cg_product_call : float
        Seconds of an iteration for each subdomain of a rank, whatever its size.
    cg_iterations, cg_iterations_by_square : float
        Of an inexact step: without regularization, and more by the square of the cut-off wavelength in cells.
    cg_memory : float
        Bytes.
    """

    whole: tuple[Factor, Factor]
    whole_solve: float
    parallel_factor: float
    parallel_memory: float
    local: tuple[Factor, Factor]
    local_solve: float
    interface: tuple[Factor, Factor]
    coarse_set_up: Growth
    dual_product: float
    one_level_iterations: float
    two_level_iterations: float
    cg_set_up: float
    cg_product: tuple[float, float]
    cg_product_call: float
    cg_iterations: float
    cg_iterations_by_square: float
    cg_memory: float


MEASURED = CostConstants(
    whole=(Factor(Growth(6e-06, 5e-09), Growth(300, 20)), Factor(Growth(1e-05, 4.9e-08), Growth(300, 230))),
    whole_solve=4e-8,
    parallel_factor=0.65,
    parallel_memory=0.9,
    local=(Factor(Growth(6e-06, 1.5e-08), Growth(300, 90)), Factor(Growth(1e-05, 5e-08), Growth(300, 250))),
    local_solve=2.5e-8,
    interface=(Factor(Growth(1e-05, 2e-08), Growth(300, 20)), Factor(Growth(1e-05, 1e-07), Growth(300, 100))),
    coarse_set_up=Growth(4e-05, 0),
    dual_product=5.0,
    one_level_iterations=2.0,
    two_level_iterations=2.0,
    cg_set_up=5e-7,
    cg_product=(3e-08, 6e-08),
    cg_product_call=1e-4,
    cg_iterations=12.0,
    cg_iterations_by_square=1.0,
    cg_memory=300.0,
)
