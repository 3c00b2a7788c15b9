"""PGD-DIC prepared for any number of frames: the rectangle that it measures, pixels, the regularisation's weight."""

from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array, BoolArray
from ddic.case.schema import Case, RegularizationSection, ShapeSection
from ddic.errors import InputError, as_collective
from ddic.functionals.regularization import find_cut_off_weight, find_edge_weight
from ddic.images.sub_image import DeformedSubImage, read_reference
from ddic.images.window import Window
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.inputs.mesh_source import NO_INNER_NODE, check_wavelength_fits
from ddic.mesh.mesh import Mesh
from ddic.mesh.repair import check_inside
from ddic.mesh.structured import build_structured_mesh, count_cells
from ddic.mesh.topology import BOUNDARY
from ddic.parallel.distribution import TeamSums
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.problem.region_mesh import build_material, describe_cut_off
from ddic.problem.weighted_problem import ProblemSize
from ddic.separated.corrections import OF_GAP, OF_TIKHONOV, Regularization, Scheme, StoppingRules
from ddic.separated.field import LineElements, divide_rows
from ddic.separated.pixel_bands import FramePixels, ReferenceBands, count_usable, cut_bands
from ddic.separated.separated_regularization import (
    ControlledLines,
    SeparatedOperator,
    build_equilibrium_gap,
    build_plane_waves,
    build_tikhonov,
    measure_wave_gaps,
    measure_wave_gradients,
    measure_wave_textures,
)

SMALLEST_ELEMENT = 1.0
"""Side of an element, pixels: smaller ones hold no pixel."""

COARSE_CELLS = 16
"""Cells along a side of the mesh that stands for the rectangle where its elements are too many to be listed."""

OUTPUT_PX, MOST_CELLS = 4.0, 250_000
"""Least side, pixels, and largest number of the cells on which a displacement is written out, if nothing is said."""

SIDES = ("left", "right", "top", "bottom")

POWER = {"equilibrium_gap": 4, "tikhonov": 2}
"""Of the cut-off wavelength, with which its weight grows."""


@dataclass(frozen=True, eq=False)
class Rectangle:
    """Lines between the elements of a rectangle.

    Attributes
    ----------
    along_x, along_y : LineElements
        Across the vertical lines, and across the horizontal ones.
    """

    along_x: LineElements
    along_y: LineElements

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """First and last lines: x0, y0, x1, y1, pixels."""
        x, y = self.along_x.nodes, self.along_y.nodes
        return float(x[0]), float(y[0]), float(x[-1]), float(y[-1])

    @property
    def element_size(self) -> float:
        """Mean side of the elements, pixels."""
        n_elements = self.along_x.n_nodes + self.along_y.n_nodes - 2
        return (self.along_x.length + self.along_y.length) / n_elements

    def build_coarse_mesh(self) -> Mesh:
        """Mesh the rectangle by few cells, which cover the same pixels."""
        return build_structured_mesh(self.bounds, min(self.along_x.length, self.along_y.length) / COARSE_CELLS)


def build_rectangle(case: Case) -> Rectangle:
    """Build the lines that a case with [pgd] asks for: those that the Q4 elements of its structured mesh would have.

    Raises InputError where it asks for something other than a whole rectangle of Q4 elements of a pixel or more.
    """
    section = case.mesh.structured
    if section is None:
        key = "mesh.file" if case.mesh.unstructured is None else "mesh.unstructured"
        raise InputError(f"{key}: [pgd] measures on a rectangle of Q4 elements; describe it by [mesh.structured]")
    if isinstance(section.region, ShapeSection):
        raise InputError("mesh.structured.region: [pgd] measures whole rectangles; give [x0, y0, x1, y1]")
    if section.cell != "Q4":
        raise InputError(f'mesh.structured.cell = "{section.cell}": [pgd] measures on "Q4" elements; leave the key out')
    given = [key for key in ("circles", "polygons", "mask") if getattr(section, key)]
    if given:
        raise InputError(f"mesh.structured.{given[0]}: [pgd] measures whole rectangles; leave pixels out by "
                         "images.reference_mask or images.masked")
    if section.element_size < SMALLEST_ELEMENT:
        raise InputError(f"mesh.structured.element_size = {section.element_size:g}: smaller than a pixel; give "
                         f"{SMALLEST_ELEMENT:g} or more")
    x0, y0, x1, y1 = section.box
    n_x, n_y = count_cells(section.box, section.element_size)
    return Rectangle(LineElements(np.linspace(x0, x1, n_x + 1)), LineElements(np.linspace(y0, y1, n_y + 1)))


def find_rectangle(mesh: Mesh) -> Rectangle:
    """Find the lines, pixels, that cross at a mesh's nodes; raises InputError where it is no rectangle all of Q4."""
    x, y = (np.unique(mesh.nodes[:, axis].round(9)) for axis in range(2))
    n_cells = (len(x) - 1) * (len(y) - 1)
    if mesh.n_nodes != len(x) * len(y) or mesh.n_cells != n_cells or len(mesh.connectivity) != 4 * n_cells:
        raise InputError("mesh: [pgd] measures on a whole rectangle of Q4 elements between straight lines, such as "
                         "ddic.structured_mesh makes; leave [pgd] out for other meshes")
    return Rectangle(LineElements(x), LineElements(y))


def check_rectangle(case: Case, rectangle: Rectangle, extent: Window) -> None:
    """Check that a rectangle lies in the images, and what a case with [pgd] says of it.

    Raises InputError where it leaves the images or holds no pixel, or a key does not fit it.
    """
    check_inside(rectangle.build_coarse_mesh(), extent)
    if not (len(rectangle.along_x.pixels) and len(rectangle.along_y.pixels)):
        raise InputError("mesh.structured.region: it holds no pixel centre; give a larger one")
    choose_output_lines(case, rectangle)
    section = case.regularization
    if section is None:
        return
    choose_controlled_lines(section, rectangle)
    if section.operator == "equilibrium_gap" and min(rectangle.along_x.n_nodes, rectangle.along_y.n_nodes) < 3:
        raise InputError(f"[regularization]: {NO_INNER_NODE.replace('give regularization.eta', 'leave it out')}")
    if section.cut_off_wavelength is not None:
        check_wavelength_fits(section.cut_off_wavelength, rectangle.element_size)


def choose_controlled_lines(section: RegularizationSection, rectangle: Rectangle) -> ControlledLines:
    """Choose the lines on which equilibrium is imposed: all but sides that the case names; InputError for others."""
    lines = ControlledLines(np.ones(rectangle.along_x.n_nodes, dtype=bool),
                            np.ones(rectangle.along_y.n_nodes, dtype=bool))
    ends: dict[str, tuple[BoolArray, int]] = {"left": (lines.x, 0), "right": (lines.x, -1),
                                                      "top": (lines.y, 0), "bottom": (lines.y, -1)}
    for name in section.not_controlled:
        if name not in (*SIDES, BOUNDARY):
            raise InputError(f'regularization.not_controlled: "{name}" is no side of a rectangle; there are '
                             f"{', '.join((*SIDES, BOUNDARY))}")
        for side in SIDES if name == BOUNDARY else (name,):
            on_lines, end = ends[side]
            on_lines[end] = False
    return lines


def choose_output_lines(case: Case, rectangle: Rectangle) -> tuple[Array, Array]:
    """Choose the lines x and y, (n,), pixels, between the cells on which a displacement is written out.

    They are lines of the rectangle, each so many elements from the one before. Raises InputError where the case asks
    for cells smaller than an element.
    """
    wanted = None if case.pgd is None else case.pgd.output_spacing
    size = rectangle.element_size
    if wanted is not None and wanted < (1 - 1e-9) * size:
        raise InputError(f"pgd.output_spacing = {wanted:g}: smaller than the elements, of {size:.3g} px; give at least "
                         "their size")
    if wanted is None:
        wanted = max(OUTPUT_PX, (rectangle.along_x.length * rectangle.along_y.length / MOST_CELLS) ** 0.5)
        stride = int(np.ceil(wanted / size - 1e-9))
    else:
        stride = round(wanted / size)
    x, y = (_take_every(line.nodes, max(stride, 1)) for line in (rectangle.along_x, rectangle.along_y))
    return x, y


def _take_every(nodes: Array, stride: int) -> Array:
    """Every so many nodes, and the last one; the last cell is the larger one where they do not divide the side."""
    chosen = nodes[:-1:stride]
    if len(chosen) > 1 and len(nodes) - 1 - (len(chosen) - 1) * stride < (stride + 1) // 2:
        chosen = chosen[:-1]
    return np.append(chosen, nodes[-1])


@dataclass(frozen=True, eq=False)
class SeparatedProblem:
    """What the reference image and the case determine.

    Attributes
    ----------
    team : Team
        All ranks.
    inputs, rectangle : Inputs, Rectangle
        Reference image and settings, and what is measured.
    reference : ReferenceBands
        Bands of rows of this rank.
    regularization : Regularization or None
        With its weight.
    size : ProblemSize
        Sizes and weights.
    scheme, rules : Scheme, StoppingRules
        How corrections are found, and when they end.
    """

    team: Team
    inputs: Inputs
    rectangle: Rectangle
    reference: ReferenceBands
    regularization: Regularization | None
    size: ProblemSize
    scheme: Scheme
    rules: StoppingRules

    def open_frame(self, frame: Frame) -> FramePixels:
        """Put a deformed image beside the reference image; nothing of it is read yet."""
        return FramePixels(self.reference, DeformedSubImage(frame[0], self.inputs.case.correlation.spline_degree))


def prepare_separated_problem(team: Team, inputs: Inputs, clock: PhaseClock) -> SeparatedProblem:
    """Read the reference image, spread over ranks, and find eta; collective, raises InputError on all ranks."""
    rectangle, case = team.together(lambda: _choose_rectangle(inputs)), inputs.case
    with clock.phase(Phase.READ):
        reference = _read_reference_pixels(team, inputs, rectangle)
    with clock.phase(Phase.ASSEMBLE):
        regularization = _build_regularization(case.regularization, reference, rectangle)
        size = _measure_separated_size(team, inputs, reference, regularization)
    section = require_held(case.pgd)
    scheme = Scheme(section.max_sweeps, section.stagnation, section.update, case.correlation.correction_of_start)
    rules = StoppingRules(section.tolerance, section.rms_tolerance, section.max_corrections, section.stop_at_noise)
    return SeparatedProblem(team, inputs, rectangle, reference, regularization, size, scheme, rules)


def _choose_rectangle(inputs: Inputs) -> Rectangle:
    """What is measured; raises InputError where that is no rectangle inside the image."""
    case, mesh, image = inputs.case, inputs.given_mesh, inputs.cameras[0].reference.image
    if inputs.choose_kinematics is not None:
        raise InputError("kinematics: [pgd] has products of functions for unknowns; leave one of them out")
    rectangle = build_rectangle(case) if mesh is None else find_rectangle(mesh)
    check_rectangle(case, rectangle, image.extent)
    return rectangle


def _read_reference_pixels(team: Team, inputs: Inputs, rectangle: Rectangle) -> ReferenceBands:
    """Read this rank's rows of the reference image; collective, InputError on all ranks where no pixel counts."""
    source, degree = inputs.cameras[0].reference, inputs.case.correlation.spline_degree
    all_bands = divide_rows(rectangle.along_y)
    # All ranks have about as many.
    edges = np.linspace(0, len(all_bands), team.size + 1).round().astype(int)
    first, end = edges[team.rank:team.rank + 2].tolist()
    own = all_bands[first:end]

    def read() -> ReferenceBands:
        columns = rectangle.along_x.pixels
        bands = []
        if own:
            window = Window((columns.start, own[0].start), (columns.stop, own[-1].stop))
            bands = cut_bands(read_reference(source, window, degree), rectangle.along_x, own)
        return ReferenceBands(rectangle.along_x, rectangle.along_y, bands, source.extent, TeamSums(team, first))

    reference = team.together(read)
    if not team.sum(count_usable(reference.bands)):
        raise as_collective(InputError(
            "images.reference_mask, images.masked: leave out every pixel of mesh.structured.region; check them"))
    return reference


def _build_regularization(section: RegularizationSection | None, reference: ReferenceBands,
                          rectangle: Rectangle) -> Regularization | None:
    """Build the regularisation, None where the case asks for none, and find its weight; collective."""
    if section is None:
        return None
    along_x, along_y = rectangle.along_x, rectangle.along_y
    # Where the weight is given, any wavelength tells which one it stands for.
    wavelength = section.cut_off_wavelength or min(along_x.length, along_y.length) / 4
    waves = build_plane_waves(along_x, along_y, wavelength)
    is_gap = section.operator == "equilibrium_gap"
    tikhonov, material = build_tikhonov(along_x, along_y), build_material(section, 2)
    energies = (measure_wave_gaps(along_x, along_y, material, waves) if is_gap
                else measure_wave_gradients(tikhonov, waves))
    weight = find_cut_off_weight(measure_wave_textures(along_x, along_y, waves, reference.sum_texture), energies)
    probe = (wavelength, weight)
    if section.eta is not None:
        wavelength *= (section.eta / weight) ** (1 / POWER[section.operator])
        weight = section.eta
    of_edges = find_edge_weight(weight, probe, section.edge_wavelength)
    lines = choose_controlled_lines(section, rectangle)
    operator = build_equilibrium_gap(along_x, along_y, material, lines, of_edges) if is_gap else tikhonov
    weighted = SeparatedOperator(operator.rows, operator.columns, weight * operator.x, operator.y)
    per_wave = OF_TIKHONOV if section.operator == "tikhonov" else OF_GAP
    return Regularization(weighted, weight, per_wave / wavelength)


def _measure_separated_size(team: Team, inputs: Inputs, reference: ReferenceBands,
                            regularization: Regularization | None) -> ProblemSize:
    """Count what is about to be measured; collective. Unknowns are those of the Q4 elements between the same lines."""
    n_x, n_y = reference.along_x.n_nodes, reference.along_y.n_nodes
    own = [(float(np.nanmin(band.values)), float(np.nanmax(band.values))) for band in reference.bands
           if np.isfinite(band.values).any()]
    ranges = team.gather_lists(own)
    dynamic_range = max(high for _, high in ranges) - min(low for low, _ in ranges)
    eta = 0.0 if regularization is None else regularization.weight
    return ProblemSize(2 * n_x * n_y, (n_x - 1) * (n_y - 1), int(team.sum(count_usable(reference.bands))), 1,
                       team.size, 0, dynamic_range, eta, describe_cut_off(inputs.case.regularization, 2))
