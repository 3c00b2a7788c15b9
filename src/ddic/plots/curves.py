"""Curves: convergence of the Krylov iterations (Fig. 11 of [BP17]), of Gauss-Newton and of PGD-DIC, and more.

Gauss-Newton and PGD-DIC (Fig. 8a of [PP12]) by corrections and residual against their number; the functions of x and of
y that a separated displacement is made of (Fig. 9 of [PP12]); opening of discontinuities along them; measurement
uncertainty against the size of the elements [RRH07], [RHR08]; displacement and strain along a line, with a band of what
noise leaves in them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result
from ddic.mesh.interpolation import interpolate
from ddic.plots.canvas import COLOURS, PIXELS, LengthUnit
from ddic.separated.field import SeparatedField

STYLES = (("-", "o"), ("--", "s"), ("-.", "^"), (":", "v"))
"""Lines and markers: a history of one value is a point."""

LONGEST_LABEL = 24
"""Characters of a label; a larger value makes the legend as wide as the page."""

MOST_NAMED = 12
"""Curves that are all named beside the axes; of more, every second or third is."""

LIGHTEST = 0.85
"""Place in the colours of the last iteration or mode, 0 to 1; a larger value is lighter."""


def draw_krylov(curves: Mapping[str, Sequence[NDArray[np.float64]]]) -> Figure:
    """Draw the relative residual against the iteration, by label a history for each Gauss-Newton iteration.

    Each label has a line style; its Gauss-Newton iterations run through the colours. The label is empty for one result
    alone.
    """
    figure = Figure(figsize=(7.0, 4.5), layout="tight")
    axes = figure.add_subplot()
    for (style, marker), (label, histories) in zip(cycle(STYLES), curves.items(), strict=False):
        shades = colormaps[COLOURS](np.linspace(0.0, LIGHTEST, len(histories)))
        for number, (history, shade) in enumerate(zip(histories, shades, strict=True), start=1):
            if len(history) == 0:
                continue
            # A history that ends at an exact zero has no logarithm: its last point is not drawn.
            shown = np.where(np.asarray(history) > 0, history, np.nan)
            name = f"Gauss-Newton {number}"
            axes.semilogy(np.arange(len(shown)), shown, style, color=shade, linewidth=1.4, marker=marker, markersize=4,
                          label=f"{_shorten(label)}, {name}" if label else name)
    axes.set_xlabel("Krylov iteration [-]")
    axes.set_ylabel("relative residual [-]")
    axes.set_title("Convergence of the interface problem")
    axes.grid(which="both", alpha=0.25)
    # Where no iteration was needed the axis would be one of fractions.
    longest = max((len(history) for histories in curves.values() for history in histories), default=1)
    margin = 0.02 * max(longest - 1, 1) + 0.05
    axes.set_xlim(-margin, max(longest - 1, 1) + margin)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    drawn, names = axes.get_legend_handles_labels()
    if drawn:
        every = -(-len(drawn) // MOST_NAMED)
        axes.legend(drawn[::every], names[::every], fontsize="x-small", ncols=1 if len(drawn) <= 4 else 2)
    return figure


def _shorten(label: str) -> str:
    """A label, or its end where it is long: results of one series differ there."""
    return label if len(label) <= LONGEST_LABEL else f"…{label[1 - LONGEST_LABEL:]}"


def draw_iterations(table: Mapping[str, NDArray[Any]], noise_floor: float = float("nan")) -> Figure:
    """Draw the size of corrections, beside the noise floor, and the residual before each of them.

    ``table`` has the columns of the result file's table of iterations; the noise floor is that of the displacement,
    pixels, nan where it is not known.
    """
    figure = Figure(figsize=(5.6, 4.4), layout="tight")
    sizes, residual = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    number = table["iteration"]
    for column, colour, label in (("rms_correction_px", "tab:blue", "RMS"),
                                  ("largest_correction_px", "tab:orange", "largest")):
        if column in table:
            values = np.where(table[column] > 0, table[column], np.nan)
            sizes.semilogy(number, values, marker="o", markersize=4, color=colour, label=label)
    if np.isfinite(noise_floor) and noise_floor > 0:
        sizes.axhline(noise_floor, linestyle="--", color="tab:grey", label="noise floor")
    sizes.set_ylabel("correction [px]")
    sizes.legend(fontsize="small")
    residual.plot(number, table["residual_std_grey"], marker="o", markersize=4)
    residual.set_ylabel("residual before it\n[grey levels]")
    residual.set_ylim(0.0, 1.15 * float(np.nanmax(table["residual_std_grey"])) or 1.0)
    residual.set_xlabel("iteration [-]")
    for axes in (sizes, residual):
        axes.set_xlim(number.min() - 0.5, number.max() + 0.5)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        axes.grid(which="both", alpha=0.25)
    return figure


def draw_corrections(table: Mapping[str, NDArray[Any]]) -> Figure:
    """Draw size and gain of a result file's table of corrections, and the residual's standard deviation before each."""
    figure = Figure(figsize=(10.0, 3.6), layout="tight")
    sizes, gains, residual = figure.subplots(1, 3)
    number = table["correction"]
    for component, colour in (("x", "tab:blue"), ("y", "tab:orange")):
        sizes.semilogy(number, _positive(table[f"fluctuation_{component}"]), color=colour, marker="o", markersize=3,
                       label=f"of u_{component} without its mean")
        sizes.semilogy(number, _positive(table[f"relative_{component}"]), "--", color=colour,
                       label=f"of u_{component} (the paper's eta)")
    sizes.set_ylabel("RMS of the correction [-]")
    gains.semilogy(number, _positive(table["gain"]), color="tab:blue", marker="o", markersize=3, label="correction")
    gains.semilogy(number, _positive(table["noise_gain"]), "--", color="tab:grey", label="of noise")
    gains.set_ylabel("gain [grey levels²]")
    residual.plot(number, table["residual_std_grey"], color="tab:blue", marker="o", markersize=3)
    residual.set_ylabel("residual before it [grey levels]")
    residual.set_ylim(bottom=0.0)
    for axes in (sizes, gains, residual):
        axes.set_xlabel("correction [-]")
        # One correction alone would have an axis of fractions.
        axes.set_xlim(number.min() - 0.5, number.max() + 0.5)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        axes.grid(which="both", alpha=0.25)
    for axes in (sizes, gains):
        axes.legend(fontsize="x-small")
    return figure


def _positive(values: NDArray[Any]) -> NDArray[np.float64]:
    """Values that have a logarithm, nan for others."""
    return np.where(values > 0, values, np.nan).astype(np.float64)


MOST = 5
"""Modes that are drawn, the largest ones; a larger value crowds the axes."""


def draw_modes(field: SeparatedField) -> Figure:
    """Draw the functions of the largest modes: of x above, of y below, one column a component."""
    figure = Figure(figsize=(9.0, 6.0), layout="tight")
    panels = figure.subplots(2, 2)
    n = min(MOST, field.n_modes)
    shades = colormaps[COLOURS](np.linspace(0.0, LIGHTEST, n))
    for c, component in enumerate("xy"):
        for row, (name, line, functions) in enumerate((("x", field.along_x, field.x), ("y", field.along_y, field.y))):
            axes = panels[row, c]
            for k, shade in enumerate(shades):
                axes.plot(line.nodes, functions[k, c], color=shade, linewidth=1.2,
                          label=f"mode {k + 1}, {field.amplitudes[k, c]:.2g} px")
            axes.set_xlabel(f"{name} [px]")
            axes.set_ylabel(f"function of {name}, u_{component} [-]")
            axes.grid(alpha=0.25)
            if not row and n:
                axes.legend(fontsize="x-small", title="RMS displacement", title_fontsize="x-small")
    figure.suptitle(f"{n} largest of {field.n_modes} modes")
    return figure


Array = NDArray[np.float64]

OPENING_STYLES = ("-", "--", "-.", ":")


def draw_opening(curves: Mapping[str, tuple[Array, Array, Array]], unit: LengthUnit = PIXELS) -> Figure:
    """Draw slip and opening against the place along the line.

    ``curves`` hold, by the label of a line, distance along it, tangential and normal opening, (n,) each, in the unit.
    """
    figure = Figure(figsize=(7.0, 4.5), layout="tight")
    axes = figure.add_subplot()
    for style, (label, (distance, tangential, normal)) in zip(cycle(OPENING_STYLES), curves.items(), strict=False):
        prefix = "" if len(curves) == 1 else f"{label}, "
        axes.plot(distance, normal, style, color="tab:blue", linewidth=1.4, label=f"{prefix}normal")
        axes.plot(distance, tangential, style, color="tab:orange", linewidth=1.4, label=f"{prefix}tangential")
    axes.set_xlabel(f"distance along the line [{unit.name}]")
    axes.set_ylabel(f"opening [{unit.name}]")
    axes.set_title("Opening of discontinuities")
    axes.grid(alpha=0.25)
    axes.legend(fontsize="small")
    return figure


def draw_uncertainty(sizes: NDArray[np.float64], deviations: Mapping[Any, NDArray[np.float64]],
                     bases: Sequence[str]) -> Figure:
    """Draw the standard deviation, the largest over displacements, against the size of the elements.

    ``sizes`` (n_sizes,) and, by kind of displacement, ``deviations`` (n_sizes, n_amplitudes, n_bases) are in pixels;
    ``bases`` are names of the kinds of elements.
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


N_POINTS = 400
"""Along the line; more than anybody sees on a page."""

BAND = 2.0
"""Standard deviations on either side: 95 % of normal errors."""

LINE_COLOURS = ("tab:blue", "tab:orange", "tab:green")
STRAIN_COLUMNS = {"xx": 0, "yy": 1, "xy": 3}


def draw_line(result: Result, ends: Sequence[float], unit: LengthUnit = PIXELS) -> Figure:
    """Draw the displacement and the strain at nodes along a straight line, with bands of two standard deviations.

    Those of the displacement count the bias of the regularization, 2 sqrt(sigma^2 + bias^2). There are no bands where
    the result has no standard deviations, and gaps where nothing was measured. ``ends`` are x and y where the line
    begins and where it ends, pixels of the reference image. Raises InputError where the line misses the mesh.
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
