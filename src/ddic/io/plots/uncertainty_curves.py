"""Measurement uncertainty against the size of the elements [RRH07], [RHR08]."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray


def draw_uncertainty(sizes: NDArray[np.float64], deviations: Mapping[Any, NDArray[np.float64]],
                     bases: Sequence[str]) -> Figure:
    """Draw the standard deviation, the largest over displacements, against the size of the elements.

    Parameters
    ----------
    sizes : (n_sizes,) array
        Pixels.
    deviations : dict of (n_sizes, n_amplitudes, n_bases) array
        By kind of displacement, pixels.
    bases : sequence of str
        Names of the kinds of elements.

    Returns
    -------
    Figure
        The page.
    """
    figure = Figure(figsize=(4.0 * len(deviations), 4.0), layout="tight")
    for number, (kind, deviation) in enumerate(deviations.items(), start=1):
        axes = figure.add_subplot(1, len(deviations), number)
        for basis, marker, values in zip(bases, "os^v", np.moveaxis(deviation.max(axis=1), -1, 0), strict=False):
            axes.loglog(sizes, values, f"{marker}-", linewidth=1.4, label=f"{basis} elements")
        axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
        axes.set_xticks([], minor=True)
        axes.set_xlabel("element size [px]")
        axes.set_ylabel("largest standard deviation [px]")
        axes.set_title(f"{kind} displacements")
        axes.grid(which="both", alpha=0.25)
        axes.legend(fontsize="small")
    return figure
