"""Curves: convergence of the Krylov iterations (Fig. 11 of [BP17]), of Gauss-Newton and of PGD-DIC, and more.

Gauss-Newton and PGD-DIC (Fig. 8a of [PP12]) by corrections and residual against their number; the functions of x and of
y that a separated displacement is made of (Fig. 9 of [PP12]); opening of discontinuities along them, and what was seen
where they were looked for [RHR08]; measurement uncertainty against the size of the elements [RRH07], [RHR08];
displacement and strain along a line, with a band of what noise leaves in them; a sweep over cut-off wavelengths and
element sizes; how residuals and grey levels are distributed.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.fracture.opening import Opening, get_lines
from ddic.io import result_schema as schema
from ddic.io.image_chunks import CHUNK_SIDES
from ddic.io.result_reader import Result
from ddic.mesh.interpolation import interpolate
from ddic.mesh.plane import build_tree
from ddic.plots import canvas
from ddic.plots.canvas import COLOURS, OF_VALUES, PIXELS, ColourScale, LengthUnit
from ddic.separated.field import SeparatedField

STYLES = (("-", "o"), ("--", "s"), ("-.", "^"), (":", "v"))
"""Lines and markers: a history of one value is a point."""

LONGEST_LABEL = 24
"""Characters of a label; a larger value makes the legend as wide as the page."""

MOST_NAMED = 12
"""Curves that are all named beside the axes; of more, every second or third is."""

LIGHTEST = 0.85
"""Place in the colours of the last iteration or mode, 0 to 1; a larger value is lighter."""


def draw_krylov(curves: Mapping[str, Sequence[Array]]) -> Figure:
    """Draw the relative residual against the iteration, by label a history for each Gauss-Newton iteration.

    Each label has a line style; its Gauss-Newton iterations run through the colours. The label is empty for one result
    alone.
    """
    figure, axes = _make_figure(7.0, 4.5)
    for (style, marker), (label, histories) in zip(cycle(STYLES), curves.items(), strict=False):
        shades = colormaps[COLOURS](np.linspace(0.0, LIGHTEST, len(histories)))
        for number, (history, shade) in enumerate(zip(histories, shades, strict=True), start=1):
            if len(history) == 0:
                continue
            name = f"Gauss-Newton {number}"
            # A history that ends at an exact zero has no logarithm: its last point is not drawn.
            axes.semilogy(np.arange(len(history)), _positive(np.asarray(history)), style, color=shade,
                          linewidth=1.4, marker=marker, markersize=4,
                          label=f"{_shorten(label)}, {name}" if label else name)
    axes.set(xlabel="Krylov iteration [-]", ylabel="relative residual [-]",
             title="Convergence of the interface problem")
    axes.grid(which="both", alpha=0.25)
    # Where no iteration was needed the axis would be one of fractions.
    longest = max((len(history) for histories in curves.values() for history in histories), default=1)
    margin = 0.02 * max(longest - 1, 1) + 0.05
    axes.set_xlim(-margin, max(longest - 1, 1) + margin)
    axes.xaxis.set_major_locator(_whole_numbers())
    drawn, names = axes.get_legend_handles_labels()
    if drawn:
        every = -(-len(drawn) // MOST_NAMED)
        axes.legend(drawn[::every], names[::every], fontsize="x-small", ncols=1 if len(drawn) <= 4 else 2)
    return figure


def _make_figure(width: float, height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, height), layout="tight")
    return figure, figure.add_subplot()


def _whole_numbers() -> MaxNLocator:
    return MaxNLocator(integer=True, min_n_ticks=1)


def _positive(values: NDArray[Any]) -> Array:
    """Values that have a logarithm, nan for others."""
    return np.where(values > 0, values, np.nan).astype(np.float64)


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
            sizes.semilogy(number, _positive(table[column]), marker="o", markersize=4, color=colour, label=label)
    if np.isfinite(noise_floor) and noise_floor > 0:
        sizes.axhline(noise_floor, linestyle="--", color="tab:grey", label="noise floor")
    sizes.set_ylabel("correction [px]")
    sizes.legend(fontsize="small")
    residual.plot(number, table["residual_std_grey"], marker="o", markersize=4)
    residual.set_ylabel("residual before it\n[grey levels]")
    known = np.isfinite(table["residual_std_grey"])
    residual.set_ylim(0.0, 1.15 * float(np.max(table["residual_std_grey"], initial=0.0, where=known)) or 1.0)
    residual.set_xlabel("iteration [-]")
    for axes in (sizes, residual):
        _count_along_x(axes, number)
    return figure


def _count_along_x(axes: Axes, number: NDArray[Any]) -> None:
    """Whole numbers below, with room at both ends: one alone would have an axis of fractions."""
    axes.set_xlim(number.min() - 0.5, number.max() + 0.5)
    axes.xaxis.set_major_locator(_whole_numbers())
    axes.grid(which="both", alpha=0.25)


def draw_corrections(table: Mapping[str, NDArray[Any]]) -> Figure:
    """Draw size and gain of a result file's table of corrections, and the residual's standard deviation before each."""
    figure = Figure(figsize=(10.0, 3.6), layout="tight")
    sizes, gains, residual = figure.subplots(1, 3)
    number = table["correction"]
    for component, colour in (("x", "tab:blue"), ("y", "tab:orange")):
        sizes.semilogy(number, _positive(table[f"fluctuation_{component}"]), color=colour, marker="o", markersize=3,
                       label=f"of u_{component} without its mean")
        sizes.semilogy(number, _positive(table[f"relative_{component}"]), "--", color=colour, label=f"of u_{component}")
    if "relative" in table:
        # Files of earlier versions have it by component alone.
        sizes.semilogy(number, _positive(table["relative"]), ":", color="black", label="of both (eta of [PP12])")
    sizes.set_ylabel("RMS of the correction [-]")
    gains.semilogy(number, _positive(table["gain"]), color="tab:blue", marker="o", markersize=3, label="correction")
    gains.semilogy(number, _positive(table["noise_gain"]), "--", color="tab:grey", label="of noise")
    gains.set_ylabel("gain [grey levels²]")
    residual.plot(number, table["residual_std_grey"], color="tab:blue", marker="o", markersize=3)
    residual.set_ylabel("residual before it [grey levels]")
    residual.set_ylim(bottom=0.0)
    for axes in (sizes, gains, residual):
        axes.set_xlabel("correction [-]")
        _count_along_x(axes, number)
    for axes in (sizes, gains):
        axes.legend(fontsize="x-small")
    return figure


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
            axes.set(xlabel=f"{name} [px]", ylabel=f"function of {name}, u_{component} [-]")
            axes.grid(alpha=0.25)
            if not row and n:
                axes.legend(fontsize="x-small", title="RMS displacement", title_fontsize="x-small")
    figure.suptitle(f"{n} largest of {field.n_modes} modes")
    return figure


def draw_opening(openings: Mapping[str, Opening], unit: LengthUnit = PIXELS) -> Figure:
    """Draw slip and opening against the place along lines, by their labels, with bands where deviations are known.

    Bands are of two standard deviations; where the bias of the regularization is known, 2 sqrt(sigma^2 + bias^2).
    """
    figure, axes = _make_figure(7.0, 4.5)
    title = "Opening of discontinuities"
    for (style, _), (label, of) in zip(cycle(STYLES), openings.items(), strict=False):
        prefix = "" if len(openings) == 1 else f"{label}, "
        for name, colour, values, sigma, bias in (
                ("normal", "tab:blue", of.normal, of.sigma_normal, of.bias_normal),
                ("tangential", "tab:orange", of.tangential, of.sigma_tangential, of.bias_tangential)):
            axes.plot(unit.size * of.distance, unit.size * values, style, color=colour, linewidth=1.4,
                      label=f"{prefix}{name}")
            if sigma is not None:
                margin = BAND * (sigma if bias is None else np.hypot(sigma, bias))
                axes.fill_between(unit.size * of.distance, unit.size * (values - margin),
                                  unit.size * (values + margin), color=colour, alpha=0.25, linewidth=0.0)
                of_what = "" if bias is None else ", of noise and bias"
                title = f"Opening of discontinuities, with {BAND:g} standard deviations{of_what}"
    axes.set(xlabel=f"distance along the line [{unit.name}]", ylabel=f"opening [{unit.name}]", title=title)
    axes.grid(alpha=0.25)
    axes.legend(fontsize="small")
    return figure


def draw_uncertainty(sizes: Array, deviations: Mapping[Any, Array], bases: Sequence[str]) -> Figure:
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
        axes.set(xlabel="element size [px]", ylabel="largest standard deviation [px]", title=f"{kind} displacements")
        axes.grid(which="both", alpha=0.25)
        axes.legend(fontsize="small")
    return figure


N_POINTS = 400
"""Along the line; more than anybody sees on a page."""

BAND = 2.0
"""Standard deviations on either side: 95 % of normal errors."""

LINE_COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:brown")


def draw_line(result: Result, ends: Sequence[float], unit: LengthUnit = PIXELS) -> Figure:
    """Draw the displacement and the strain at nodes along a straight line, with bands of two standard deviations.

    Those of the displacement count the bias of the regularization, 2 sqrt(sigma^2 + bias^2). There are no bands where
    the result has no standard deviations, and gaps where nothing was measured. ``ends`` are the coordinates
    of the point where the line begins and of that where it ends, pixels of the reference image. Raises InputError where
    the line misses the mesh.
    """
    dim = result.mesh.dim
    begin, end = np.array(ends, dtype=float).reshape(2, dim)
    share = np.linspace(0.0, 1.0, N_POINTS)[:, None]
    points = begin + share * (end - begin)
    distance = unit.size * share[:, 0] * float(np.linalg.norm(end - begin))
    displacement = unit.size * result.at(points)
    if not np.isfinite(displacement).any():
        given = " ".join(f"{value:g}" for value in ends)
        axes, unit_of_ends = ("x and y", "pixels") if dim == 2 else ("x, y and z", "voxels")
        raise InputError(f"--line {given}: no point of it lies in the measured mesh; give {axes} of its ends in "
                         f"{unit_of_ends} of the reference image")
    has_strain = schema.NODAL_INFINITESIMAL in result.point_data
    figure = Figure(figsize=(7.0, 6.5 if has_strain else 3.8), layout="tight")
    above = figure.add_subplot(2 if has_strain else 1, 1, 1)
    deviations = _read_along(result, schema.SIGMA_DISPLACEMENT[:dim], points)
    title = "Along the line" if deviations is None else f"Along the line, with {BAND:g} standard deviations"
    if deviations is not None and schema.REGULARIZATION_BIAS in result.point_data:
        bias = interpolate(result.mesh, result.fields[schema.REGULARIZATION_BIAS], points)
        deviations = np.hypot(deviations, bias)
        title += ", of $u$ of noise and bias"
    _draw_bands(above, distance, displacement,
                None if deviations is None else unit.size * deviations, [f"$u_{axis}$" for axis in schema.AXES[:dim]])
    above.set(ylabel=f"displacement [{unit.name}]", title=title)
    if has_strain:
        strain = schema.pick_components(result.point_data[schema.NODAL_INFINITESIMAL], dim)
        below = figure.add_subplot(2, 1, 2, sharex=above)
        _draw_bands(below, distance, interpolate(result.mesh, strain, points),
                    _read_along(result, schema.list_sigma_strains(dim), points),
                    [rf"$\epsilon_{{{name}}}$" for name in schema.list_components(dim)])
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


MOST_LABELS = 12
"""Wavelengths that are written at an axis."""

CROWDED = 0.07
"""Distance of points of the L-curve, relative to the axes, below which only one of them has its wavelength written."""


WIDE_RANGE = 10.0
"""Largest over least residual from which on its axis is logarithmic."""


@dataclass(frozen=True, eq=False)
class SweptElements:
    """What was found with elements of one size, by increasing wavelength.

    Attributes
    ----------
    name : str
        Of the elements.
    wavelengths : (n,) array
        Pixels; 0 without regularization.
    residuals, gaps : (n,) array
        RMS residual, grey levels, and forces out of equilibrium, 1/px.
    predicted, virtual : (n,) array
        Errors, pixels; nan where there is none.
    recommended : int or None
        Which is recommended, of these.
    """

    name: str
    wavelengths: Array
    residuals: Array
    gaps: Array
    predicted: Array
    virtual: Array
    recommended: int | None


def draw_sweep(swept: Sequence[SweptElements], title: str) -> Figure:
    """Draw the L-curve, the residual and the errors against the wavelength; the recommendation is marked by a ring."""
    figure = Figure(figsize=(14.0, 4.9), layout="constrained")
    corner, residual, error = figure.subplots(1, 3)
    colours = colormaps[COLOURS](np.linspace(0.0, 0.88, max(len(swept), 2)))
    lengths = np.unique(np.concatenate([of_size.wavelengths for of_size in swept]))
    places = _place(lengths)
    for of_size, colour in zip(swept, colours, strict=False):
        x = places[np.searchsorted(lengths, of_size.wavelengths)]
        style = {"color": colour, "linewidth": 1.4, "markersize": 4.5}
        corner.semilogx(of_size.gaps, of_size.residuals, "o-", label=of_size.name, **style)
        residual.semilogx(x, of_size.residuals, "o-", **style)
        error.loglog(x, of_size.virtual, "o-", **style)
        error.loglog(x, np.where(of_size.predicted > 0, of_size.predicted, np.nan), ":", color=colour, linewidth=1.2)
        if of_size.recommended is not None:
            k = of_size.recommended
            for axes, here, values in ((corner, of_size.gaps, of_size.residuals), (residual, x, of_size.residuals),
                                       (error, x, of_size.virtual)):
                axes.plot(here[k], values[k], "o", markersize=13, markerfacecolor="none", markeredgecolor="crimson",
                            markeredgewidth=1.8)
    _annotate(corner, swept)
    _finish(corner, residual, error, (lengths, places))
    figure.suptitle(title, fontsize=11)
    return figure


def _place(lengths: Array) -> Array:
    """Places of wavelengths on a logarithmic axis: none stands left of the shortest."""
    regularized = lengths[lengths > 0]
    left = float(regularized[0]) / 2 if len(regularized) else 1.0
    return np.where(lengths > 0, lengths, left)


def _annotate(axes: Axes, swept: Sequence[SweptElements]) -> None:
    """Write wavelengths at the points of the first curve."""
    first = next((of_size for of_size in swept if np.isfinite(of_size.residuals * of_size.gaps).any()), None)
    if first is None:
        return
    points = np.column_stack([np.log(first.gaps), first.residuals])
    places = (points - np.nanmin(points, axis=0)) / np.maximum(np.ptp(points[np.isfinite(points).all(axis=1)], axis=0),
                                                              1e-300)
    written: list[Array] = []
    # From the longest on: the corner is crowded, the ends are not.
    for k in reversed(range(len(places))):
        if not np.isfinite(places[k]).all() or any(np.abs(places[k] - other).max() < CROWDED for other in written):
            continue
        written.append(places[k])
        text = f"{first.wavelengths[k]:g}" if first.wavelengths[k] else "none"
        axes.annotate(text, (first.gaps[k], first.residuals[k]), xytext=(5, 5), textcoords="offset points", fontsize=7)


def _finish(corner: Axes, residual: Axes, error: Axes, lengths: tuple[Array, Array]) -> None:
    """Labels, grids and legends."""
    corner.set(title="L-curve (numbers: l_c [px])", xlabel="forces out of equilibrium, RMS of div s / E [1/px]")
    corner.legend(fontsize="small", title="elements", title_fontsize="small")
    residual.set_title("residual")
    error.set(title="error of the displacement", ylabel="RMS error [px]")
    error.plot([], [], "ko-", markersize=4.5, label="on the virtual images")
    error.plot([], [], "k:", label="as the residual predicts")
    error.legend(fontsize="small")
    for axes in (corner, residual):
        axes.set_ylabel("RMS residual [grey levels]")
        low, high = axes.dataLim.intervaly
        if high > WIDE_RANGE * low:
            axes.set_yscale("log")
    # Room for the numbers at the ends.
    corner.margins(x=0.14)
    wavelengths, places = lengths
    # At most MOST_LABELS, the first and the last among them.
    n = len(places)
    chosen = sorted({int(k) for k in np.rint(np.linspace(0, n - 1, min(n, MOST_LABELS)))})
    for axes in (residual, error):
        axes.set_xlabel("cut-off wavelength l_c [px]")
        axes.set_xticks(places[chosen], [f"{wavelengths[k]:g}" if wavelengths[k] else "none" for k in chosen],
                        fontsize=8)
        axes.set_xticks([], minor=True)
    for axes in (corner, residual, error):
        axes.grid(which="both", alpha=0.25)


N_BINS = 120
"""Of a histogram; more show the noise of their counts."""

WIDEST = 6.0
"""Standard deviations to either side of 0 that are shown of residuals."""

HISTOGRAM_COLOURS = ("tab:blue", "tab:orange")


def draw_residual_histogram(result: Result) -> Figure:
    """Draw the distribution of the residual image and the normal one of its standard deviation: tails are not noise.

    Of a volume, which is looked at twice, a few planes are in memory.
    """
    # Number, mean and variance of each piece: what all are comes of that of their means.
    pieces = [(len(values), values.mean(), values.var()) for values in _read_pieces(result)]
    counted, means, variances = np.array(pieces or [(1, 0.0, 1.0)]).T
    mean = np.average(means, weights=counted)
    std = float(np.sqrt(np.average(variances + (means - mean)**2, weights=counted)))
    # Of a residual of one value, such as 0, the curve is that of any deviation.
    std = std or 1.0
    edge = WIDEST * std
    figure, axes = _make_figure(5.0, 3.4)
    counts, edges = np.histogram([], N_BINS, (-edge, edge))
    for values in _read_pieces(result):
        counts += np.histogram(values, N_BINS, (-edge, edge))[0]
    axes.stairs(counts / counted.sum() / np.diff(edges), edges, fill=True, color="tab:blue", alpha=0.6,
                label="residual")
    x = np.linspace(-edge, edge, 400)
    normal = np.exp(-0.5 * (x / std)**2) / (std * np.sqrt(2.0 * np.pi))
    axes.plot(x, normal, color="black", linewidth=1.2, label="normal, same deviation")
    axes.set_yscale("log")
    axes.set_ylim(bottom=1e-6 / std)
    axes.set(xlabel="$f(x) - g(x + u)$ [grey levels]", ylabel="density [1 / grey level]")
    axes.legend(fontsize="small", loc="lower center")
    return figure


def _read_pieces(result: Result) -> Iterator[Array]:
    """The values of a residual image that was written, a plane of a volume at a time."""
    extent = result.residual_extent
    assert extent is not None
    thickness = CHUNK_SIDES[3] if result.mesh.dim == 3 else extent.height
    for band in extent.split_rows(thickness):
        read = result.read_residual(band)
        for piece in read if result.mesh.dim == 3 else [read]:
            values = piece[np.isfinite(piece)].astype(np.float64)
            if values.size:
                yield values


def draw_grey_histogram(images: Mapping[str, NDArray[Any]]) -> Figure:
    """Draw the distribution of the grey levels of images, by their names."""
    figure, axes = _make_figure(5.0, 3.4)
    finite = {name: pixels[np.isfinite(pixels)] for name, pixels in images.items()}
    low, high = (float(edge([edge(pixels) for pixels in finite.values()])) for edge in (np.min, np.max))
    # Bins of whole grey levels: others would hold now one level, now two.
    width = max(1.0, np.ceil((high - low + 1.0) / N_BINS)) if high - low > 1.0 else (high - low or 1.0) / N_BINS
    edges = np.arange(low - 0.5 * min(width, 1.0), high + width, width)
    for (name, pixels), colour in zip(finite.items(), HISTOGRAM_COLOURS, strict=False):
        density = np.histogram(pixels, edges)[0] / pixels.size / width
        axes.stairs(density, edges, color=colour, linewidth=1.4, label=name)
    axes.set(xlabel="grey level", ylabel="density [1 / grey level]")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize="small")
    return figure


SCORES, SCORE = "viridis", "score [standard deviations of noise]"


def draw_detection(result: Result, unit: LengthUnit = PIXELS, scale: ColourScale = OF_VALUES) -> Figure:
    """Draw the Tresca strain with the lines that were found, its Radon transform, and that of the best direction.

    Each cell has the strain of the cell of the continuous field that was nearest.
    """
    seen, mesh = result.detection, result.mesh
    nodes = unit.size * mesh.nodes
    bounds = canvas.find_mesh_bounds(nodes)
    lines = [unit.size * line for line in get_lines(result)]
    title = f"Equivalent strain of Tresca, {len(lines) or 'no'} line{'' if len(lines) == 1 else 's'} found"
    figure, (of_strain, of_scores, of_best) = canvas.make_panels(
        [bounds] * 3, [title, "Radon transform", "Projection along the best direction"], unit)
    strain = seen["tresca_strain"][build_tree(seen["centres"]).query(mesh.centroids)[1]]
    colours = canvas.draw_cell_colours(of_strain, mesh, nodes, strain, scale)
    for line in lines:
        of_strain.plot(*line.T, color="red", linestyle="--", linewidth=1.0)
    canvas.set_bounds(of_strain, bounds)
    canvas.add_colour_bar(figure, of_strain, colours, scale.format_label(r"$|\varepsilon_1 - \varepsilon_2| / 2$"))
    _draw_scores(figure, of_scores, seen["radon_scores"], np.rad2deg(seen["radon_angles"]),
                 unit.size * seen["radon_distances"], unit)
    best = int(seen["radon_scores"].max(axis=1).argmax())
    of_best.clear()
    of_best.plot(unit.size * seen["radon_distances"], seen["radon_scores"][best], linewidth=1.4)
    of_best.set(xlabel=f"distance from the middle [{unit.name}]", ylabel=SCORE, aspect="auto",
                title=f"Projection along {np.rad2deg(seen['radon_angles'][best]):.1f} degrees")
    of_best.grid(alpha=0.25)
    return figure


def _draw_scores(figure: Figure, axes: Axes, scores: Array, angles: Array, distances: Array, unit: LengthUnit) -> None:
    """Scores by distance and angle, (n_angles, n_distances)."""
    title = axes.get_title()
    axes.clear()
    # Most scores are a few: a band of many would leave them dark. Those below 0 say as little as 0.
    shown = axes.pcolormesh(distances, angles, np.maximum(scores, 0.0), cmap=SCORES, norm=PowerNorm(0.5, vmin=0.0),
                            shading="nearest", rasterized=True)
    axes.set(xlabel=f"distance from the middle [{unit.name}]", ylabel="angle from +x to +y [degrees]", title=title,
             aspect="auto")
    canvas.add_colour_bar(figure, axes, shown, SCORE)
