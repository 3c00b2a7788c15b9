"""The acceptance table of performance: every check measured here and now; exit 1 where one falls short.

Usage: accept_performance.py [NAME ...], with the names of CHECKS; all by default. What a check ran goes to
bench/results/paper.jsonl, kernels.jsonl, peers.jsonl and accuracy_runs.jsonl.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

import accuracy as reference
import paper as megapixels
from bench.support.rows import Row, append_result
from bench.support.runs import DATA, ddic_run, images

BEFORE = {(0, 0): {3: 0.0022063, 5: 0.0019515}, (0, 64): {3: 0.0011295, 5: 0.0005963},
          (2, 0): {3: 0.0123402, 5: 0.0122960}, (2, 64): {3: 0.0031624, 5: 0.0029959}}
"""RMS errors before the work on performance, px, by (noise, l_c) and spline degree (commit 7dab11f)."""

LAST_DIGIT = 1e-5
"""Errors are compared as the tables give them, to 1e-5 px: sums in another order change what is behind."""


def paper() -> Sequence[Row]:
    """The whole command on every 29-megapixel case, records kept as by ``make bench-paper``."""
    return [row for name in megapixels.CASES for row in megapixels.measure_case(name)[:1]]


def speedup() -> Sequence[Row]:
    """Pixel work on one and two ranks."""
    return [megapixels.speedup(name)[0] for name in ("beam_16", "full_16")]


def kernels() -> Sequence[Row]:
    """Both pixel kernels against their bounds and against C."""
    rows: Sequence[Row] = importlib.import_module("kernels").measure()
    return rows


def pyxel() -> Sequence[Row]:
    """CPU and error against pyxel-dic."""
    return _peer("pyxel")


def pyvale() -> Sequence[Row]:
    """CPU and error against pyvale."""
    return _peer("pyvale")


def accuracy() -> Sequence[Row]:
    """The reference field's errors, quintic and cubic, against what they were before and against their bounds."""
    return [_no_worse(noise, wavelength) for noise, wavelength in BEFORE]


CHECKS = {check.__name__: check for check in (paper, kernels, speedup, pyxel, pyvale, accuracy)}


def _peer(name: str) -> Sequence[Row]:
    rows: Sequence[Row] = importlib.import_module("peers").measure(name)
    return rows


def _no_worse(noise: int, wavelength: int) -> Row:
    folder = images("sinusoidal", "--size", f"{reference.SIZE}x{reference.SIZE}", "--noise", str(noise),
                    folder=DATA / f"reference_field_noise{noise}")
    errors = {}
    for degree in (3, 5):
        name = f"lc{wavelength}_degree{degree}"
        summary = ddic_run(reference.case(folder, wavelength, degree), folder, 2, name)
        errors[degree] = reference.error_rms(folder, name, folder / "truth.json")
        append_result("accuracy_runs", {"noise": noise, "cut_off_wavelength": wavelength, "spline_degree": degree,
                                        "rms_error_px": errors[degree], **summary})
    before, bound = BEFORE[noise, wavelength], reference.BOUNDS[noise, wavelength]
    what = f"l_c = {wavelength} px" if wavelength else "no regularization"
    return Row(f"reference field, 2112 x 2112, 8 bit, 16-px Q4, noise {noise} grey levels, {what}: RMS error",
               f"no worse than before, to {LAST_DIGIT:.0e} px: quintic {before[5]:.5f}, cubic {before[3]:.5f} px; "
               f"quintic at most {bound} px",
               f"quintic {errors[5]:.6f} px, cubic {errors[3]:.6f} px",
               errors[5] <= bound and all(errors[d] <= before[d] + LAST_DIGIT / 2 for d in errors))


if __name__ == "__main__":
    sys.exit(accept("performance", sys.argv[1:], CHECKS, lambda name: CHECKS[name]()))
