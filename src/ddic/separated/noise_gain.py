"""What the best rank-one correction gains from noise alone."""

from __future__ import annotations

import numpy as np

from ddic.functionals.grey_statistics import GreyState
from ddic.separated.line_elements import LineElements
from ddic.separated.pixel_bands import ReferencePixels

WAVES = 2.0
"""Unknowns per cut-off wavelength."""


def predict_noise_gain(reference: ReferencePixels, regularization, grey: GreyState) -> float:
    wavelength = None if regularization is None else regularization.wavelength
    sizes = [count_unknowns(line, wavelength) for line in (reference.along_x, reference.along_y)]
    return grey.residual_rms**2 * (np.sqrt(sizes[0]) + np.sqrt(sizes[1])) ** 2


def count_unknowns(line: LineElements, wavelength: float | None) -> float:
    n = min(line.n_nodes, len(line.pixels))
    return float(n) if wavelength is None else min(float(n), 1 + WAVES * line.length / wavelength)
