"""Constants of the cost model of ``solver.method = "auto"``; ``make bench-interface`` measures them anew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LARGEST_ARRAYS = 12_800
"""Unknowns of a subdomain, 80 x 80 cells, up to which S_s and its inverse are arrays (``DENSE_LIMIT`` in
``solvers/dual/local_inverse.py``)."""


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
    system_memory : float
        Bytes of M and Kbar.
    whole : pair of Factor
        Of A by MUMPS on one rank, forming it included.
    whole_solve : float
        Seconds of a solve with it, by the logarithm to base 2 of the unknowns.
    parallel_factor : pair of float
        Power of the number of ranks by which the seconds of a rank fall.
    parallel_memory : float
        The same of bytes.
    local : pair of Factor
        Of A_s by the package for subdomains.
    local_solve : float
        Seconds of a solve with it, by the logarithm to base 2 of its unknowns.
    interface : pair of Factor
        Of S_s and its inverse as arrays, where other subdomains lie all round.
    sparse_interface : pair of Factor
        The same by a sparse factor, as large subdomains have it.
    coarse_set_up : Growth
        Seconds of modes and coarse matrix of two levels, with the root of a subdomain's unknowns.
    dual_product : float
        Solves with A_s that an iteration of the interface problem is worth.
    one_level_iterations : pair of float
        Of an inexact step: where the cut-off wavelength is far below the side of a subdomain, and more for each side
        in it.
    two_level_iterations : float
        Of an inexact step.
    cg_set_up : float
        Seconds.
    cg_product : pair of float
        Seconds of an iteration of conjugate gradients.
    cg_product_calls : pair of float
        Seconds of an iteration whatever the number of unknowns: of a rank, and of each of its subdomains.
    cg_iterations : float
        Of an inexact step without regularization, and with the least.
    cg_iterations_by_square : float
        The same over the square of the cut-off wavelength in cells.
    """

    system_memory: float
    whole: tuple[Factor, Factor]
    whole_solve: float
    parallel_factor: tuple[float, float]
    parallel_memory: float
    local: tuple[Factor, Factor]
    local_solve: float
    interface: tuple[Factor, Factor]
    sparse_interface: tuple[Factor, Factor]
    coarse_set_up: Growth
    dual_product: float
    one_level_iterations: tuple[float, float]
    two_level_iterations: float
    cg_set_up: float
    cg_product: tuple[float, float]
    cg_product_calls: tuple[float, float]
    cg_iterations: float
    cg_iterations_by_square: float


MEASURED = CostConstants(
    system_memory=1900.0,
    whole=(
        Factor(seconds=Growth(constant=6.1e-06, growing=5.5e-09), memory=Growth(constant=540.0, growing=0.0)),
        Factor(seconds=Growth(constant=1.1e-05, growing=5.2e-08), memory=Growth(constant=3500.0, growing=32.0)),
    ),
    whole_solve=4e-08,
    parallel_factor=(0.0, 0.69),
    parallel_memory=0.98,
    local=(
        Factor(seconds=Growth(constant=2.1e-06, growing=1.4e-08), memory=Growth(constant=1900.0, growing=0.0)),
        Factor(seconds=Growth(constant=6e-06, growing=6.3e-08), memory=Growth(constant=3900.0, growing=52.0)),
    ),
    local_solve=1.5e-08,
    interface=(
        Factor(seconds=Growth(constant=0.0, growing=2.6e-07), memory=Growth(constant=0.0, growing=120.0)),
        Factor(seconds=Growth(constant=0.0, growing=7.4e-07), memory=Growth(constant=0.0, growing=220.0)),
    ),
    sparse_interface=(
        Factor(seconds=Growth(constant=0.0, growing=1e-07), memory=Growth(constant=0.0, growing=0.0)),
        Factor(seconds=Growth(constant=2.3e-05, growing=0.0), memory=Growth(constant=0.0, growing=36.0)),
    ),
    coarse_set_up=Growth(constant=3.8e-05, growing=0.0),
    dual_product=5.6,
    one_level_iterations=(1.8, 2.9),
    two_level_iterations=3.0,
    cg_set_up=6.2e-07,
    cg_product=(2.9e-08, 5.7e-08),
    cg_product_calls=(0.00016, 4.2e-05),
    cg_iterations=12.0,
    cg_iterations_by_square=1.0,
)
"""Fitted on 22 November 2026 to runs of ``bench.interface_solvers`` with 10,000 to 250,000 unknowns on one and two
ranks of a shared two-core machine, CHOLMOD and MUMPS of Debian 12: predictions are within a third of most of them."""
