"""PGD-DIC prepared for any number of frames: pixels in bands of rows, the regularisation's weight, and their size."""

from dataclasses import dataclass

import numpy as np

from ddic.case.schema import RegularizationSection
from ddic.errors import InputError, as_collective
from ddic.functionals.regularization import find_cut_off_weight, find_edge_weight
from ddic.images.sub_image import DeformedSubImage, read_reference
from ddic.images.window import Window
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.inputs.rectangle import Rectangle, build_rectangle, check_rectangle, choose_controlled_lines, find_rectangle
from ddic.parallel.distribution import TeamSums
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.problem.region_mesh import build_material
from ddic.problem.weighted_problem import ProblemSize, describe_cut_off
from ddic.separated.band_sums import divide_rows
from ddic.separated.corrections import OF_GAP, OF_TIKHONOV, Regularization, Scheme, StoppingRules
from ddic.separated.pixel_bands import FramePixels, ReferenceBands, count_usable, cut_bands
from ddic.separated.separated_regularization import (
    SeparatedOperator,
    build_equilibrium_gap,
    build_plane_waves,
    build_tikhonov,
    measure_wave_gaps,
    measure_wave_gradients,
    measure_wave_textures,
)

POWER = {"equilibrium_gap": 4, "tikhonov": 2}
"""Of the cut-off wavelength, with which its weight grows."""


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
    """Read the reference image and find the weight of the regularisation; collective.

    Pixels are spread over ranks. Raises InputError on all ranks.
    """
    rectangle, case = team.together(lambda: _choose_rectangle(inputs)), inputs.case
    with clock.phase(Phase.READ):
        reference = read_reference_pixels(team, inputs, rectangle)
    with clock.phase(Phase.ASSEMBLE):
        regularization = build_regularization(case.regularization, reference, rectangle)
        size = measure_separated_size(team, inputs, reference, regularization)
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
    check_rectangle(case, rectangle, image.width, image.height)
    return rectangle


def read_reference_pixels(team: Team, inputs: Inputs, rectangle: Rectangle) -> ReferenceBands:
    """Read the rows of the reference image that this rank owns; collective.

    Raises InputError on all ranks, where an image cannot be read or no pixel counts.
    """
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
            "images.reference_mask: it leaves out every pixel of mesh.structured.region; check both"))
    return reference


def build_regularization(section: RegularizationSection | None, reference: ReferenceBands,
                         rectangle: Rectangle) -> Regularization | None:
    """Build the regularisation, None where the case asks for none, and find its weight; collective."""
    if section is None:
        return None
    along_x, along_y = rectangle.along_x, rectangle.along_y
    # Where the weight is given, any wavelength tells which one it stands for.
    wavelength = section.cut_off_wavelength or min(along_x.length, along_y.length) / 4
    waves = build_plane_waves(along_x, along_y, wavelength)
    is_gap = section.operator == "equilibrium_gap"
    tikhonov, material = build_tikhonov(along_x, along_y), build_material(section)
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


def measure_separated_size(team: Team, inputs: Inputs, reference: ReferenceBands,
                           regularization: Regularization | None) -> ProblemSize:
    """Count what is about to be measured; collective. Unknowns are those of the Q4 elements between the same lines."""
    n_x, n_y = reference.along_x.n_nodes, reference.along_y.n_nodes
    own = [(float(np.nanmin(band.values)), float(np.nanmax(band.values))) for band in reference.bands
           if np.isfinite(band.values).any()]
    ranges = team.gather_lists(own)
    dynamic_range = max(high for _, high in ranges) - min(low for low, _ in ranges)
    eta = 0.0 if regularization is None else regularization.weight
    return ProblemSize(2 * n_x * n_y, (n_x - 1) * (n_y - 1), int(team.sum(count_usable(reference.bands))), 1,
                       team.size, 0, dynamic_range, eta, describe_cut_off(inputs.case.regularization))
