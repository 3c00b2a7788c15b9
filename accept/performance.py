"""The acceptance table of performance: ``make accept-performance``, a check alone with CHECK=NAME.

What a check ran goes to bench/results/paper.jsonl, kernels.jsonl, peers.jsonl and accuracy_runs.jsonl. A smoke run of
the peers measures with ddic alone, unless their environment is there already.
"""

from __future__ import annotations

import sys

from accept.accuracy import BOUNDS, Field, measure_errors
from accept.table import Check, Scale, run_table
from bench import kernels as pixel_kernels
from bench import paper as megapixels
from bench import peers
from bench.support.paper_case import MEASURED
from bench.support.peer_environment import peers_are_there
from bench.support.rows import Row

BEFORE = {(0, 0): {3: 0.0022063, 5: 0.0019515}, (0, 64): {3: 0.0011295, 5: 0.0005963},
          (2, 0): {3: 0.0123402, 5: 0.0122960}, (2, 64): {3: 0.0031624, 5: 0.0029959}}
"""RMS errors before the work on performance, px, by (noise, l_c) and spline degree (commit 7dab11f)."""

LAST_DIGIT = 1e-5
"""Errors are compared as the tables give them, to 1e-5 px: sums in another order change what is behind."""

SPEEDUP_CASES = ("beam_16", "full_16")
"""Cases of ``bench.paper`` whose pixel work is measured on one and two ranks."""

SMOKE_CASE = "tiny"
"""A case of ``bench.paper`` that takes a second."""


def measure_paper(scale: Scale) -> list[Row]:
    """Measure the whole command on every 29-megapixel case, records kept as by ``make bench-paper``.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a tiny case, and leaves the kernels to their own check.

    Returns
    -------
    list of Row
        One for each case.
    """
    if scale.smoke:
        return megapixels.measure_case(SMOKE_CASE, repeats=1, with_kernels=False)[:1]
    return [row for name in MEASURED for row in megapixels.measure_case(name)[:1]]


def measure_speedup(scale: Scale) -> list[Row]:
    """Measure the pixel work on one and two ranks.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a tiny case.

    Returns
    -------
    list of Row
        One for each case.
    """
    if scale.smoke:
        return [megapixels.speedup(SMOKE_CASE, repeats=1)[0]]
    return [megapixels.speedup(name)[0] for name in SPEEDUP_CASES]


def measure_kernels(scale: Scale) -> list[Row]:
    """Measure both pixel kernels against their bounds and against C.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small image.

    Returns
    -------
    list of Row
        Two for each problem.
    """
    return pixel_kernels.measure(pixel_kernels.SMALL if scale.smoke else pixel_kernels.SIZE)


def measure_pyxel(scale: Scale) -> list[Row]:
    """Measure CPU and error against pyxel-dic.

    Parameters
    ----------
    scale : Scale
        A smoke run takes small images.

    Returns
    -------
    list of Row
        Of ``bench.peers``.
    """
    return _measure_peer("pyxel", scale)


def measure_pyvale(scale: Scale) -> list[Row]:
    """Measure CPU and error against pyvale.

    Parameters
    ----------
    scale : Scale
        A smoke run takes small images.

    Returns
    -------
    list of Row
        Of ``bench.peers``.
    """
    return _measure_peer("pyvale", scale)


def _measure_peer(name: str, scale: Scale) -> list[Row]:
    """Rows of a peer; without its environment a smoke run measures with ddic alone."""
    if not scale.smoke:
        return peers.measure(name)
    if peers_are_there():
        return list(peers.rows(name, ("tiny",), 1))
    run = peers.measure_ddic(peers.warm_up_pair(), peers.WAVELENGTH, 1, peers.METHODS[name])
    return [Row(f"{name}: ddic alone", "runs", f"{run.seconds:.2f} CPU s, RMS error {run.error:.5f} px", True,
                judged_small=False)]


def measure_accuracy(scale: Scale) -> list[Row]:
    """Compare the reference field's errors, quintic and cubic, with what they were before and with their bounds.

    Parameters
    ----------
    scale : Scale
        A smoke run takes small images and one row.

    Returns
    -------
    list of Row
        One for each noise and cut-off wavelength.
    """
    fields = [Field(*key) for key in BEFORE]
    return [_compare_errors(field, scale) for field in (fields[-1:] if scale.smoke else fields)]


def _compare_errors(field: Field, scale: Scale) -> Row:
    errors = measure_errors(field, scale)
    before, bound = BEFORE[field.noise, field.wavelength], BOUNDS[field.noise, field.wavelength]
    return Row(f"{field.what}: RMS error",
               f"no worse than before, to {LAST_DIGIT:.0e} px: quintic {before[5]:.5f}, cubic {before[3]:.5f} px; "
               f"quintic at most {bound} px",
               f"quintic {errors[5]:.6f} px, cubic {errors[3]:.6f} px",
               errors[5] <= bound and all(errors[d] <= before[d] + LAST_DIGIT / 2 for d in errors))


CHECKS: dict[str, Check] = {
    "paper": measure_paper,
    "kernels": measure_kernels,
    "speedup": measure_speedup,
    "pyxel": measure_pyxel,
    "pyvale": measure_pyvale,
    "accuracy": measure_accuracy,
}

if __name__ == "__main__":
    sys.exit(run_table("performance", CHECKS))
