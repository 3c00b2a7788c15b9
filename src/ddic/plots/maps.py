"""A value at the nodes or on the cells in colour, over the reference image where there is one.

Maps of displacement, also around near fields, of strain, of the difference between two measured fields (Fig. 10) and of
the correlation residual, of standard deviations and of the regularization's bias, the deformed mesh (Fig. 9), and an
image thinned out to what a figure can show. Limits of colours are in the unit that is drawn.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray
from ddic.errors import InputError
from ddic.images.source import ImageSource
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result, displacement_at, read_independent_fields
from ddic.kinematics import strain
from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_boundary_facets
from ddic.plots import canvas
from ddic.plots.canvas import OF_VALUES, PIXELS, Bounds, ColourScale, Component, LengthUnit, Limits, Preview
from ddic.plots.slices import Below, Slices, choose_slices, make_views


@dataclass(frozen=True, eq=False)
class ComparedFields:
    """A result's displacement beside another's.

    Attributes
    ----------
    result, other : Result
        Both.
    difference : (n_nodes, 2) array
        Its own minus the other's at its nodes, pixels; nan where either is unmeasured.
    rms : float
        Root mean square of the difference's length, pixels.
    err : float
        Err = |difference| / |other| over all nodes where both were measured, Eq. 41 of [BP17].
    """

    result: Result
    other: Result
    difference: Array
    rms: float
    err: float


def draw_difference(compared: ComparedFields, component: Component = "magnitude", unit: LengthUnit = PIXELS,
                    scale: ColourScale = OF_VALUES, slices: Slices | None = None) -> Figure:
    """Draw a result's displacement minus another's, at its nodes; nothing where either is unmeasured."""
    mesh, nodes = compared.result.mesh, unit.size * compared.result.mesh.nodes
    difference = unit.size * compared.difference
    title = (f"{compared.result.path.name} minus {compared.other.path.name}, RMS {unit.size * compared.rms:.2e} "
             f"{unit.name}, Err {compared.err:.2e}")
    values = canvas.pick_component(difference, component)
    label = canvas.format_component_label(r"\Delta u", component, unit)
    if slices is not None:
        return draw_values(mesh, [Values(title, label, values)], slices, unit, [scale])
    figure, axes = canvas.make_image_figure(canvas.find_mesh_bounds(nodes), title, unit)
    colours = canvas.draw_nodal_colours(axes, mesh, nodes, values, scale)
    canvas.add_colour_bar(figure, axes, colours, scale.format_label(label))
    return figure


def compute_difference(result: Result, other: Result) -> ComparedFields:
    """Compare a result's displacement with another one's, interpolated to its nodes: Err is Eq. 41 of [BP17]."""
    theirs = _interpolate(other, result.mesh.nodes)
    difference = result.displacement - theirs
    is_known = np.isfinite(difference).all(axis=1)
    if not is_known.any():
        return ComparedFields(result, other, difference, np.nan, np.nan)
    norm, of_other = float(np.linalg.norm(difference[is_known])), float(np.linalg.norm(theirs[is_known]))
    return ComparedFields(result, other, difference, norm / np.sqrt(is_known.sum()),
                          norm / of_other if of_other else np.inf)


def _interpolate(result: Result, points: Array) -> Array:
    """Displacement at points, pixels: a guess outside the mesh, nan in it where nothing was measured."""
    values = displacement_at(result, points)
    if not result.measured_nodes.all():
        is_unmeasured = np.isnan(result.at(points)).any(axis=1) & (locate(result.mesh, points).cells >= 0)
        values[is_unmeasured] = np.nan
    return values


def make_figure_over(image: Preview | None, bounds: Bounds, title: str, unit: LengthUnit = PIXELS,
                     beside: float = canvas.RIGHT_INCHES) -> tuple[Figure, Axes]:
    """Make a figure as ``make_image_figure`` does, over the image where it is given, whose edges cut the bounds."""
    if image is None:
        return canvas.make_image_figure(bounds, title, unit, beside=beside)
    bounds = image.clip(bounds, unit.size)
    figure, axes = canvas.make_image_figure(bounds, title, unit, beside=beside)
    image.draw(axes, unit.size)
    canvas.set_bounds(axes, bounds)
    return figure, axes


def read_below(mesh: Mesh, source: ImageSource | None, asked: Sequence[tuple[str, float]] = ()) -> Below:
    """Read what a mesh's fields are drawn over: the image, if there is one, or slices of a volume, those asked for.

    Raises InputError where a slice misses the mesh.
    """
    if mesh.dim == 3:
        return choose_slices(mesh, source, asked)
    return None if source is None else read_preview(source)


def read_preview(source: ImageSource) -> Preview:
    """Read an image row by row and keep at most 2000 pixels a side, thinned out evenly."""
    step = -(-max(source.width, source.height) // canvas.LARGEST_SIDE)
    if step == 1:
        pixels = source.read(source.extent)
    else:
        pixels = np.concatenate([source.read(rows)[::step, ::step] for rows in source.extent.split_rows(64 * step)])
    return Preview(pixels, step, source.width, source.height)


MARGIN = 0.06
"""Of the image that is shown around the mesh, relative to its longer side."""

OPACITY = 0.7
"""Share of colours where there is an image below; a larger value hides more of it."""


@dataclass(frozen=True, eq=False)
class Values:
    """What a panel shows.

    Attributes
    ----------
    title : str
        Above the panel.
    label : str
        Of the colour bar, with the unit.
    values : (n_nodes,) or (n_cells,) array
        At the nodes, or on the cells.
    by_cell : bool
        Whether they are on the cells.
    """

    title: str
    label: str
    values: Array
    by_cell: bool = False


def draw_displacement(result: Result, image: Below = None, component: Component = "magnitude",
                      unit: LengthUnit = PIXELS, scale: ColourScale = OF_VALUES) -> Figure:
    """Draw the displacement on the mesh at rest, over the reference image where it is given."""
    return draw_values(result.mesh, list_displacement_panels(result, component, unit), image, unit, [scale])


def list_displacement_panels(result: Result, component: Component, unit: LengthUnit) -> list[Values]:
    """List the one panel of a displacement map."""
    return [Values(f"Displacement {canvas.format_component('u', component)}",
                   canvas.format_component_label("u", component, unit),
                   unit.size * canvas.pick_component(result.displacement, component))]


def draw_values(mesh: Mesh, shown: Sequence[Values], image: Below, unit: LengthUnit,
                scales: Sequence[ColourScale]) -> Figure:
    """Draw panels of values on one mesh, over the image where it is given; ``scales`` has one for each panel."""
    if isinstance(image, tuple):
        return _draw_on_slices(shown, image, unit, scales)
    nodes = unit.size * mesh.nodes
    bounds = canvas.find_mesh_bounds(nodes, MARGIN)
    if image is not None:
        bounds = image.clip(bounds, unit.size)
    figure, panels = canvas.make_panels([bounds] * len(shown), [panel.title for panel in shown], unit)
    for axes, panel, scale in zip(panels, shown, scales, strict=True):
        draw = canvas.draw_cell_colours if panel.by_cell else canvas.draw_nodal_colours
        colours = draw(axes, mesh, nodes, panel.values, scale)
        shown_as = None
        if image is not None:
            # The image once more, thinly, and not colours thinly over it: those of triangles would show their edges.
            image.draw(axes, unit.size)
            image.draw(axes, unit.size, opacity=1.0 - OPACITY)
            canvas.set_bounds(axes, bounds)
            shown_as = _mix_with_grey(colours.get_cmap(), image.measure_grey())
        canvas.add_colour_bar(figure, axes, colours, scale.format_label(panel.label), shown_as)
    return figure


def _draw_on_slices(shown: Sequence[Values], slices: Slices, unit: LengthUnit, scales: Sequence[ColourScale]) -> Figure:
    """The same on slices of a volume."""
    figure, views = make_views(slices, [panel.title for panel in shown], unit)
    grey = slices[0].grey
    for of_panel, panel, scale in zip(views, shown, scales, strict=True):
        norm, palette = Normalize(*scale.find_limits(panel.values)), colormaps[scale.palette or canvas.COLOURS]
        for axes, one in zip(of_panel.axes, slices, strict=True):
            one.show(axes, one.sample(panel.values, by_cell=panel.by_cell), unit, norm=norm, cmap=palette,
                     alpha=1.0 if grey is None else OPACITY)
        # Of all values, not of those in one slice.
        colours = ScalarMappable(norm, palette)
        colours.set_array(panel.values)
        shown_as = None if grey is None else _mix_with_grey(palette, grey.measure_grey())
        for host in of_panel.hosts:
            canvas.add_colour_bar(figure, host, colours, scale.format_label(panel.label), shown_as)
    return figure


def _mix_with_grey(palette: Colormap, grey: float) -> Colormap:
    """The colours of a palette as they are seen with an image of a mean grey thinly over them."""
    colours = palette(np.linspace(0.0, 1.0, palette.N))
    colours[:, :3] = OPACITY * colours[:, :3] + (1.0 - OPACITY) * grey
    return ListedColormap(colours, name=f"{palette.name} over an image")


AROUND = 0.12
"""Around a near field, relative to its longer side."""


def draw_near_far(result: Result, component: Component = "magnitude", unit: LengthUnit = PIXELS,
                  scale: ColourScale = OF_VALUES) -> Figure:
    """Draw the displacement of the whole mesh, then around each near field in colours of its own.

    Near fields are outlined; titles tell alpha, in pixels, by which each near set-up moved.
    """
    whole = replace(result.mesh, nodes=unit.size * result.mesh.nodes)
    camera_of_cell = result.cell_data[schema.CAMERA]
    titles, boxes, near = ["far field"], [canvas.find_mesh_bounds(whole.nodes)], []
    for camera in range(1, int(camera_of_cell.max()) + 1):
        mesh, _ = whole.create_submesh(np.flatnonzero(camera_of_cell == camera))
        alpha = result.attributes[schema.near_group(camera)]["alpha_px"]
        titles.append(f"near field {camera}, $\\alpha$ = ({alpha[0]:.3f}, {alpha[1]:.3f}) px")
        boxes.append(canvas.find_mesh_bounds(mesh.nodes, AROUND))
        near.append(mesh)
    figure, panels = canvas.make_panels(boxes, titles, unit)
    values = unit.size * canvas.pick_component(result.displacement, component)
    for axes, box in zip(panels, boxes, strict=True):
        limits = scale.find_limits(values[find_points_inside(whole.nodes, box)])
        colours = canvas.draw_nodal_colours(axes, whole, whole.nodes, values, replace(scale, limits=limits))
        draw_outlines(axes, near)
        canvas.set_bounds(axes, box)
        label = canvas.format_component_label("u", component, unit)
        canvas.add_colour_bar(figure, axes, colours, scale.format_label(label))
    return figure


def draw_outlines(axes: Axes, outlined: Sequence[Mesh]) -> None:
    """Draw the outlines of meshes, on grey."""
    for mesh in outlined:
        edges = find_boundary_facets(mesh)[:, :2]
        axes.add_collection(LineCollection(list(mesh.nodes[edges]), colors="white", linewidths=1.2))
    axes.set_facecolor("0.6")


def find_points_inside(points: Array, box: Bounds) -> BoolArray:
    """Tell which points (n, 2) lie in a box, (n,)."""
    low, high = box[:2], box[2:]
    is_inside = (points >= low) & (points <= high)
    return np.asarray(is_inside.all(axis=1))


Measure = Literal["infinitesimal", "green-lagrange", "hencky"]
NAMES = {"infinitesimal": "Strain", "green-lagrange": "Green-Lagrange strain", "hencky": "Logarithmic strain"}
SYMBOLS = {"principal-1": "1", "principal-2": "2", "principal-3": "3", "von-mises": "vM"}
"""As labels have them; of a component its name."""


@dataclass(frozen=True)
class StrainChoice:
    """Which strain is drawn.

    Attributes
    ----------
    measure : {"infinitesimal", "green-lagrange", "hencky"}
        The tensor.
    number : str or None
        One of ``kinds.NUMBERS``; None for a panel of each component.
    by_cell : bool
        As it was computed in the middle of cells, not as it was recovered at nodes.
    """

    measure: Measure = "infinitesimal"
    number: str | None = None
    by_cell: bool = False


def draw_strain(result: Result, choice: StrainChoice, image: Below = None, unit: LengthUnit = PIXELS,
                scales: Sequence[ColourScale] = (OF_VALUES,)) -> Figure:
    """Draw strain on the mesh at rest, over an image if given, in one panel or several; scales are theirs, or one."""
    panels = list_strain_panels(result, choice)
    return draw_values(result.mesh, panels, image, unit, scales if len(scales) > 1 else [*scales] * len(panels))


def list_strain_panels(result: Result, choice: StrainChoice) -> list[Values]:
    """List what the panels of a strain map show, one or as many as there are components."""
    tensors = _pick_tensors(result, choice)
    numbers = schema.list_components(result.mesh.dim) if choice.number is None else (choice.number,)
    symbol = "E" if choice.measure == "green-lagrange" else r"\varepsilon"
    where = ", by cell" if choice.by_cell else ""
    panels = []
    for number in numbers:
        written = f"${symbol}_{{{SYMBOLS.get(number, number)}}}$"
        panels.append(Values(f"{NAMES[choice.measure]} {written}{where}", f"{written} [-]",
                             _pick_number(tensors, number), choice.by_cell))
    return panels


def _pick_tensors(result: Result, choice: StrainChoice) -> Array:
    """Pick the strains' components, of nodes or cells (n, n_components); raises InputError where nodes have none."""
    if choice.by_cell:
        name = schema.STRAIN_INFINITESIMAL if choice.measure == "infinitesimal" else schema.STRAIN_GREEN_LAGRANGE
        tensors = schema.pick_components(result.cell_data[name], result.mesh.dim)
        return strain.compute_hencky(tensors) if choice.measure == "hencky" else tensors
    name = schema.NODAL_STRAINS[choice.measure]
    if name not in result.point_data:
        raise InputError(f"{result.path}: holds no strain at nodes (written before schema 1.6); add --by-cell, or run "
                         "ddic again")
    return schema.pick_components(result.point_data[name], result.mesh.dim)


def _pick_number(tensors: Array, number: str) -> Array:
    """Pick a component, a principal value or the equivalent strain, of tensors (n, n_components)."""
    if number == "von-mises":
        return strain.compute_von_mises_strain(tensors)
    if number.startswith("principal-"):
        return strain.find_principal_strains(tensors)[:, int(number[-1]) - 1]
    dim = 2 if tensors.shape[1] == 3 else 3
    return tensors[:, list(schema.list_components(dim)).index(number)]


def list_sigma_panels(result: Result, component: Component, number: str | None, unit: LengthUnit) -> list[Values]:
    """List panels of what noise leaves: of a strain at nodes where ``number`` names one, else of the displacement.

    Of the displacement there is a panel for each axis, or that of one of them.
    """
    if number is not None:
        name = f"sigma_e{number}"
        if name not in result.point_data:
            raise InputError(f"{result.path}: the noise of strain {number} is not estimated; give one of "
                             f"{', '.join(schema.list_components(result.mesh.dim))}")
        symbol = rf"$\sigma(\varepsilon_{{{number}}})$"
        return [Values(f"Standard deviation {symbol}", f"{symbol} [-]", result.point_data[name])]
    axes = schema.AXES[:result.mesh.dim] if component == "magnitude" else component
    panels = []
    for axis in axes:
        symbol = rf"$\sigma(u_{axis})$"
        values = unit.size * result.point_data[schema.SIGMA_DISPLACEMENT[schema.AXES.index(axis)]]
        panels.append(Values(f"Standard deviation {symbol}", f"{symbol} [{unit.name}]", values))
    return panels


def list_bias_panels(result: Result, component: Component, unit: LengthUnit) -> list[Values]:
    """List the one panel of what the regularization takes from the displacement."""
    symbol = canvas.format_component("b", component)
    values = unit.size * canvas.pick_component(result.fields[schema.REGULARIZATION_BIAS], component)
    return [Values(f"Bias of the regularization {symbol}", f"{symbol} [{unit.name}]", values)]


def list_simulation_panels(result: Result, component: Component) -> list[Values]:
    """List the one panel of how far a simulation is from the measured displacement, in standard deviations."""
    symbol = canvas.format_component(r"\Delta u / \sigma", component)
    values = canvas.pick_component(result.fields[schema.NORMALISED_DIFFERENCE], component)
    return [Values(f"Measured minus simulated, in standard deviations {symbol}", f"{symbol} [-]", values)]


VISIBLE_SHARE = 0.05
"""Largest displacement that is drawn, relative to the mesh, where cells bear it; a larger value exaggerates more."""

LARGEST_STRETCH = 0.5
"""Largest gradient of what is drawn: no cell is squeezed to less than the half. Below 1 no cell folds."""

MOST_CELLS_WITH_EDGES = 20_000
"""Cells up to which their edges are drawn; a larger value makes fine meshes black."""


@dataclass(frozen=True)
class SharedView:
    """How several results are drawn alike.

    Attributes
    ----------
    factor : float
        By which the displacement without its rigid motion is amplified, where the user asks for nothing else.
    bounds : (float, float, float, float)
        x0, y0, x1, y1 of the axes, in their unit.
    """

    factor: float
    bounds: Bounds


def _choose_factor(result: Result, mesh: Mesh, departure: Array) -> float:
    """An amplification, one digit and at least 1, of the displacement of the measured cells without its rigid motion.

    It makes that, which is not 0, 5 % of the mesh, or less where its largest gradient would fold cells.
    """
    wanted = VISIBLE_SHARE * float(np.ptp(result.mesh.nodes, axis=0).max()) / float(np.abs(departure).max())
    limit = LARGEST_STRETCH / max(strain.find_largest_gradient(mesh, departure), 1e-300)
    factor = float(f"{wanted:.0e}")
    return max(1.0, factor if factor <= limit else _round_down(limit))


def find_shared_view(results: Iterable[Result], amplification: float | None, unit: LengthUnit) -> SharedView:
    """Find a factor, the least among theirs, and axes that suit all of several results, each looked at once.

    ``amplification`` is that of the whole displacement, where the user asks for it. Raises InputError where no cell of
    one was measured.
    """
    factors, boxes, moves = [], [], []
    for result in results:
        mesh, displacement = _keep_measured(result)
        departure = strain.project_rigid_motion_out(mesh.nodes, displacement)
        # What stands still looks alike by any factor.
        factors += [_choose_factor(result, mesh, departure)] if departure.any() else []
        shown = departure if amplification is None else displacement
        boxes.append((result.mesh.nodes.min(axis=0), result.mesh.nodes.max(axis=0)))
        moves.append((np.minimum(shown.min(axis=0), 0.0), np.maximum(shown.max(axis=0), 0.0)))
    factor = min(factors, default=1.0)
    scale = factor if amplification is None else amplification
    # Two opposite corners that no node passes, whichever moves farthest.
    corners = np.array(boxes) + scale * (np.array(moves) if scale >= 0 else np.array(moves)[:, ::-1])
    return SharedView(factor, canvas.find_mesh_bounds(unit.size * corners.reshape(-1, 2)))


def _keep_measured(result: Result) -> tuple[Mesh, Array]:
    """The cells whose nodes all were measured, and the displacement of their nodes, pixels."""
    cells = result.mesh.find_cells_among(result.measured_nodes)
    if not len(cells):
        raise InputError(f"{result.path}: no cell was measured, of which a deformed mesh could be drawn")
    if len(cells) == result.mesh.n_cells:
        return result.mesh, result.displacement
    mesh, node_ids = result.mesh.create_submesh(cells)
    return mesh, result.displacement[node_ids]


def remove_rigid_motion(result: Result) -> Array:
    """Remove the rigid motion that fits best from the displacement of measured cells' nodes, (n, 2), pixels."""
    mesh, displacement = _keep_measured(result)
    return strain.project_rigid_motion_out(mesh.nodes, displacement)


def _round_down(value: float) -> float:
    """The largest number of one digit that is not above a positive one."""
    power = 10.0 ** math.floor(math.log10(value))
    return math.floor(value / power) * power


def draw_deformed(result: Result, component: Component = "magnitude", amplification: float | None = None,
                  unit: LengthUnit = PIXELS, scale: ColourScale = OF_VALUES,
                  shared: SharedView | None = None) -> Figure:
    """Draw the mesh moved by its amplified displacement, over the whole mesh at rest in grey.

    In colour is the displacement that moves it.

    Cells with a node that was not measured are drawn at rest alone. ``amplification`` is of the whole displacement,
    rigid motion and all; where it is left out, one that shows the displacement without its rigid motion and folds no
    cell. ``shared`` is of several results that are drawn alike; where it is left out, what fits this one. Raises
    InputError where no cell was measured.
    """
    mesh, displacement = _keep_measured(result)
    rest = unit.size * result.mesh.nodes
    symbol = "u"
    if amplification is None:
        displacement = strain.project_rigid_motion_out(mesh.nodes, displacement)
        factor = (shared or find_shared_view([result], None, unit)).factor
        moved = unit.size * (mesh.nodes + factor * displacement)
        title, symbol = f"Deformed mesh without rigid motion, amplified {factor:g} times", r"\tilde{u}"
    else:
        moved = unit.size * (mesh.nodes + amplification * displacement)
        n_folded = strain.count_folded_cells(mesh, moved)
        folded = f"; {n_folded} cells are folded" if n_folded else ""
        title = f"Deformed mesh, displacement amplified {amplification:g} times{folded}"
    bounds = canvas.find_mesh_bounds(np.concatenate([rest, moved])) if shared is None else shared.bounds
    figure, axes = canvas.make_image_figure(bounds, title, unit)
    at_rest = canvas.make_cell_polygons(result.mesh, rest, facecolors="0.9", edgecolors="0.9", linewidths=0.3)
    axes.add_collection(at_rest)
    values = unit.size * canvas.pick_component(displacement, component)
    colours = canvas.draw_nodal_colours(axes, mesh, moved, values, scale)
    if mesh.n_cells <= MOST_CELLS_WITH_EDGES:
        edges = canvas.make_cell_polygons(mesh, moved, facecolors="none", edgecolors="black", linewidths=0.15,
                                          rasterized=mesh.n_cells > canvas.MOST_SHARP_CELLS)
        axes.add_collection(edges)
    label = canvas.format_component_label(symbol, component, unit)
    canvas.add_colour_bar(figure, axes, colours, scale.format_label(label))
    return figure


def draw_independent(result: Result, component: Component, amplification: float | None, unit: LengthUnit,
                     scale: ColourScale) -> Figure:
    """Draw the deformed mesh as the subdomains measured it by themselves, in pieces, Fig. 9a of [BP17].

    As ``draw_deformed`` does.
    """
    figure = draw_deformed(read_independent_fields(result.path), component, amplification, unit, scale)
    canvas.set_titles(figure, f"Subdomains by themselves: {figure.axes[0].get_title()}")
    return figure


RESIDUAL_PALETTE, SIGNED_PALETTE = "magma", "RdBu_r"

SHOWN_PERCENT = 99.5
"""Absolute residuals up to which colours go; a larger value lets single bad pixels darken the rest."""


def draw_residual(result: Result, *, signed: bool = False, unit: LengthUnit = PIXELS,
                  scale: ColourScale = OF_VALUES, slices: Slices | None = None) -> Figure:
    """Draw the residual f(x) - g(x + u) by pixel, of a volume in slices, or its RMS by cell without a residual image.

    The title tells the standard deviation of what is looked at: the image, or these slices.

    Colours of pixels end at the 99.5 % quantile of absolute values. If ``signed``, 0 is white; else they are absolute
    values. Raises InputError where a sign is asked for and there is no residual image.
    """
    planes, std = _read_planes(result, slices)
    if not planes:
        if signed:
            raise InputError(f"{result.path}: holds no residual image, hence no signs; measure with "
                             "output.residual_image = true, or choose --kind residual")
        return _by_cell(result, unit, scale, slices)
    low, high = scale.limits or _span_shown(planes, signed)
    pixels = "pixels" if slices is None else "voxels"
    note = scale.note if scale.limits is not None else f"{SHOWN_PERCENT:g} % of the {pixels}"
    if signed:
        name, symbol, palette = "Signed correlation residual", "$f(x) - g(x + u)$", SIGNED_PALETTE
    else:
        name, symbol, palette = "Correlation residual", "$|f(x) - g(x + u)|$", RESIDUAL_PALETTE
        planes = [replace(plane, pixels=np.abs(plane.pixels)) for plane in planes]
    title = f"{name}, standard deviation {std:.3g} grey levels"
    style = {"cmap": scale.palette or palette, "vmin": low, "vmax": high}
    if slices is None:
        bounds = canvas.find_mesh_bounds(unit.size * result.mesh.nodes)
        figure, axes = canvas.make_image_figure(bounds, title, unit)
        hosts, colours = [axes], planes[0].show(axes, unit.size, **style)
        canvas.set_bounds(axes, bounds)
    else:
        figure, (views,) = make_views(slices, [title], unit)
        hosts = views.hosts
        for axes, one, plane in zip(views.axes, slices, planes, strict=True):
            colours = plane.show(axes, unit.size, **style)
            one.set_bounds(axes, unit)
    label = replace(scale, limits=(low, high), note=note).format_label(f"{symbol} [grey levels]")
    for host in hosts:
        canvas.add_colour_bar(figure, host, colours, label)
    return figure


def find_residual_limits(result: Result, *, signed: bool = False, slices: Slices | None = None) -> Limits:
    """Find where the colours of a residual begin and end, grey levels."""
    planes, _ = _read_planes(result, slices)
    return _span_shown(planes, signed) if planes else OF_VALUES.find_limits(result.cell_data[schema.RESIDUAL_RMS])


def _read_planes(result: Result, slices: Slices | None) -> tuple[list[Preview], float]:
    """What a figure can show of a residual image, or slices of a volume's, and the standard deviation of these.

    There are none where no residual image was written.
    """
    if slices is None:
        image = result.residual_image
        return ([], math.nan) if image is None else ([_thin(image)], _measure_std(image))
    extent = result.residual_extent
    planes = [] if extent is None else [one.read(result.read_residual, extent) for one in slices]
    return planes, _measure_std(np.concatenate([np.empty(0), *(plane.pixels.ravel() for plane in planes)]))


def _measure_std(image: NDArray[Any]) -> float:
    return float(np.nanstd(image)) if np.isfinite(image).any() else math.nan


def _thin(image: NDArray[np.float32]) -> Preview:
    """What a figure can show of an image."""
    height, width = image.shape
    step = -(-max(height, width) // canvas.LARGEST_SIDE)
    return Preview(image[::step, ::step], step, width, height)


def _span_shown(planes: Sequence[Preview], signed: bool) -> Limits:
    """Where colours begin and end: 0 in the middle of signed values, at the beginning of others."""
    shown = np.concatenate([plane.pixels.ravel() for plane in planes])
    finite = shown[np.isfinite(shown)]
    top = float(np.percentile(np.abs(finite), SHOWN_PERCENT)) if finite.size else 1.0
    top = top or 1.0
    return (-top if signed else 0.0), top


def _by_cell(result: Result, unit: LengthUnit, scale: ColourScale, slices: Slices | None) -> Figure:
    """RMS by cell in colour."""
    nodes, panel = unit.size * result.mesh.nodes, list_residual_panels(result)[0]
    if slices is not None:
        scale = replace(scale, palette=scale.palette or RESIDUAL_PALETTE)
        return draw_values(result.mesh, [panel], slices, unit, [scale])
    figure, axes = canvas.make_image_figure(canvas.find_mesh_bounds(nodes), panel.title, unit)
    cells = canvas.draw_cell_colours(axes, result.mesh, nodes, panel.values, scale, RESIDUAL_PALETTE)
    canvas.add_colour_bar(figure, axes, cells, scale.format_label(panel.label))
    return figure


def list_residual_panels(result: Result) -> list[Values]:
    """List the one panel of the residual by cell."""
    return [Values("Correlation residual by cell", "RMS of $f(x) - g(x + u)$ [grey levels]",
                   result.cell_data[schema.RESIDUAL_RMS], by_cell=True)]
