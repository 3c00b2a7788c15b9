"""What the reference image alone gives PGD-DIC: pixels in bands of rows, and the weight of the regularisation."""

from __future__ import annotations

import numpy as np

from ddic.case.schema import RegularizationSection
from ddic.errors import InputError
from ddic.functionals.equilibrium_gap import find_edge_weight
from ddic.images.sub_image import read_reference
from ddic.images.window import Window
from ddic.parallel.team import Team
from ddic.parallel.team_sums import TeamSums
from ddic.problem.inputs import Inputs
from ddic.problem.rectangle import Rectangle, choose_controlled_lines
from ddic.problem.region_mesh import build_material
from ddic.separated.band_sums import divide_rows
from ddic.separated.corrections import Regularization
from ddic.separated.noise_gain import OF_GAP, OF_TIKHONOV
from ddic.separated.pixel_bands import ReferencePixels, count_usable, cut_bands
from ddic.separated.separated_regularization import (
    SeparatedOperator,
    build_equilibrium_gap,
    build_plane_waves,
    build_tikhonov,
    find_weight,
    measure_wave_gaps,
    measure_wave_gradients,
    measure_wave_textures,
)

POWER = {"equilibrium_gap": 4, "tikhonov": 2}
"""Of the cut-off wavelength, with which its weight grows."""


def choose_own_bands(rectangle: Rectangle, rank: int, n_ranks: int) -> tuple[int, list[range]]:
    """Choose the bands of rows that a rank reads.

    Parameters
    ----------
    rectangle : Rectangle
        What is measured.
    rank, n_ranks : int
        Of the team.

    Returns
    -------
    first : int
        Number of the first band.
    bands : list of range
        Rows of bands that follow each other, about as many on each rank.
    """
    bands = divide_rows(rectangle.along_y)
    edges = np.linspace(0, len(bands), n_ranks + 1).round().astype(int)
    return int(edges[rank]), bands[edges[rank]:edges[rank + 1]]


def read_reference_pixels(team: Team, inputs: Inputs, rectangle: Rectangle) -> ReferencePixels:
    """Read the rows of the reference image that this rank owns; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        With the reference image.
    rectangle : Rectangle
        What is measured.

    Returns
    -------
    ReferencePixels
        Spread over ranks.

    Raises
    ------
    InputError
        On all ranks, where an image cannot be read or no pixel counts.
    """
    source, degree = inputs.cameras[0].reference, inputs.case.correlation.spline_degree
    first, own = choose_own_bands(rectangle, team.rank, team.size)

    def read() -> ReferencePixels:
        columns = rectangle.along_x.pixels
        bands = []
        if own:
            window = Window(columns.start, own[0].start, columns.stop, own[-1].stop)
            bands = cut_bands(read_reference(source, window, degree), rectangle.along_x, own)
        return ReferencePixels(rectangle.along_x, rectangle.along_y, bands, source.extent, TeamSums(team, first))

    reference = team.together(read)
    if not team.sum(count_usable(reference.bands)):
        team.together(_refuse_nothing_to_see)
    return reference


def _refuse_nothing_to_see() -> None:
    raise InputError("images.reference_mask: it leaves out every pixel of mesh.structured.region; check both")


def build_regularization(section: RegularizationSection | None, reference: ReferencePixels,
                         rectangle: Rectangle) -> Regularization | None:
    """Build the regularisation and find its weight; collective.

    Parameters
    ----------
    section : RegularizationSection or None
        Of the case.
    reference : ReferencePixels
        The reference image.
    rectangle : Rectangle
        What is measured.

    Returns
    -------
    Regularization or None
        None where the case asks for none.
    """
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
    weight = find_weight(measure_wave_textures(along_x, along_y, waves, reference.sum_texture), energies)
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
