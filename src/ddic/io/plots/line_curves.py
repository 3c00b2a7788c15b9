"""Displacement and strain along a line, with a band of what noise leaves in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.plots.length_unit import PIXELS, LengthUnit
from ddic.io.result_reader import Result
from ddic.mesh.interpolation import interpolate

Array = NDArray[np.float64]

N_POINTS = 400
"""Along the line; more than anybody sees on a page."""

BAND = 2.0
"""Standard deviations on either side: 95 % of normal errors."""

LINE_COLOURS = ("tab:blue", "tab:orange", "tab:green")
STRAIN_COLUMNS = {"xx": 0, "yy": 1, "xy": 3}


def draw_line(result: Result, ends: Sequence[float], unit: LengthUnit = PIXELS) -> Figure:
    """Draw the displacement and the strain at nodes along a straight line, with bands of two standard deviations.

    Those of the displacement count the bias of the regularization, 2 sqrt(sigma^2 + bias^2).

    Parameters
    ----------
    result : Result
        The field.
    ends : sequence of four float
        x and y where the line begins and where it ends, pixels of the reference image.
    unit : LengthUnit, optional
        Of lengths and displacements.

    Returns
    -------
    Figure
        The page; without bands where the result has no standard deviations, gaps where nothing was measured.

    Raises
    ------
    InputError
        Where the line misses the mesh.
    """
    begin, end = np.array(ends[:2], dtype=float), np.array(ends[2:], dtype=float)
    share = np.linspace(0.0, 1.0, N_POINTS)[:, None]
    points = begin + share * (end - begin)
    distance = unit.size * share[:, 0] * float(np.linalg.norm(end - begin))
    displacement = unit.size * result.at(points)
    if not np.isfinite(displacement).any():
        given = " ".join(f"{value:g}" for value in ends)
        raise InputError(f"--line {given}: no point of it lies in the measured mesh; give x and y of its ends in "
                         "pixels of the reference image")
    has_strain = schema.NODAL_INFINITESIMAL in result.point_data
    figure = Figure(figsize=(7.0, 6.5 if has_strain else 3.8), layout="tight")
    above = figure.add_subplot(2 if has_strain else 1, 1, 1)
    deviations = _read_along(result, schema.SIGMA_DISPLACEMENT, points)
    title = "Along the line" if deviations is None else f"Along the line, with {BAND:g} standard deviations"
    if deviations is not None and schema.REGULARIZATION_BIAS in result.point_data:
        bias = interpolate(result.mesh, result.point_data[schema.REGULARIZATION_BIAS][:, :2], points)
        deviations = np.hypot(deviations, bias)
        title += ", of $u$ of noise and bias"
    _draw_bands(above, distance, displacement,
                None if deviations is None else unit.size * deviations, ("$u_x$", "$u_y$"))
    above.set_ylabel(f"displacement [{unit.name}]")
    above.set_title(title)
    if has_strain:
        strain = result.point_data[schema.NODAL_INFINITESIMAL][:, list(STRAIN_COLUMNS.values())]
        below = figure.add_subplot(2, 1, 2, sharex=above)
        _draw_bands(below, distance, interpolate(result.mesh, strain, points),
                    _read_along(result, schema.SIGMA_NODAL_STRAIN, points),
                    tuple(rf"$\epsilon_{{{name}}}$" for name in STRAIN_COLUMNS))
        below.set_ylabel("infinitesimal strain")
    figure.axes[-1].set_xlabel(f"distance along the line [{unit.name}]")
    return figure


def _read_along(result: Result, names: Sequence[str], points: Array) -> Array | None:
    """Standard deviations at points, (n, k); None where the result has none."""
    if names[0] not in result.point_data:
        return None
    return interpolate(result.mesh, np.stack([result.point_data[name] for name in names], axis=1), points)


def _draw_bands(axes: Axes, distance: Array, values: Array, deviations: Array | None, labels: Sequence[str]) -> None:
    """Curves of the columns of values (n, k), each with its band."""
    for k, label in enumerate(labels):
        axes.plot(distance, values[:, k], color=LINE_COLOURS[k], linewidth=1.4, label=label)
        if deviations is not None:
            margin = BAND * deviations[:, k]
            axes.fill_between(distance, values[:, k] - margin, values[:, k] + margin, color=LINE_COLOURS[k], alpha=0.25,
                              linewidth=0.0)
    axes.grid(alpha=0.25)
    axes.legend(fontsize="small")
