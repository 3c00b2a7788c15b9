"""What the inputs of a case are, found fit."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ddic.arrays import IntArray
from ddic.case.schema import Case
from ddic.check.mesh import CheckedMesh, count_most_ranks
from ddic.functionals.regularization import HalfAmplitudes
from ddic.images.source import ImageSource
from ddic.inputs.rectangle import Rectangle, choose_controlled_lines
from ddic.mesh.cell_type import CELL_TYPES
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.mesh import Mesh
from ddic.problem.cut_region import describe_cut, list_discontinuities
from ddic.problem.weighted_problem import describe_cut_off
from ddic.separated.band_sums import N_BANDS


@dataclass(frozen=True)
class CheckReport:
    """What the inputs of a case are.

    Attributes
    ----------
    image_size : (width, height)
        Of the first camera's images, pixels.
    bits : int or None
        Bits per pixel of the images' integers; None for floats.
    n_nodes, n_cells, n_dofs : int
        Nodes and cells of the mesh, unknowns of the field.
    cell_counts, node_sets : dict of int
        Number of cells by name (T3, Q4), and of nodes by name of the set.
    pixels_min, pixels_mean : int, float
        Pixels of the cell that has fewest, and pixels per cell.
    n_controlled_dofs : int
        Unknowns that the equilibrium gap controls; 0 without regularization.
    output : Path
        The result file.
    discontinuities : str or None
        How much of the mesh they cut, where there are any.
    half_amplitudes : HalfAmplitudes or None
        Waves that the cut-off wavelength halves, pixels; None without one.
    most_ranks : int
        MPI ranks that can share the work, unless subdomains without texture join others.
    """

    image_size: tuple[int, int]
    bits: int | None
    n_nodes: int
    n_cells: int
    n_dofs: int
    cell_counts: dict[str, int]
    node_sets: dict[str, int]
    pixels_min: int
    pixels_mean: float
    n_controlled_dofs: int
    output: Path
    discontinuities: str | None
    half_amplitudes: HalfAmplitudes | None
    most_ranks: int


def describe_inputs(case: Case, reference: ImageSource, checked: CheckedMesh, not_controlled: IntArray) -> CheckReport:
    """Describe inputs that were found fit; ``not_controlled``, (n,), are nodes that are not controlled."""
    mesh = checked.mesh
    n_unknown_nodes = mesh.n_nodes if checked.tying is None else checked.tying.n_unknown_nodes
    n_not_controlled = int((not_controlled < n_unknown_nodes).sum())
    n_controlled_nodes = 0 if case.regularization is None else n_unknown_nodes - n_not_controlled
    types, n_of_type = np.unique(mesh.types, return_counts=True)
    return CheckReport(
        image_size=(reference.width, reference.height),
        bits=count_bits(reference),
        n_nodes=mesh.n_nodes,
        n_cells=mesh.n_cells,
        n_dofs=mesh.dim * n_unknown_nodes,
        cell_counts={CELL_TYPES[int(t)].name: int(n) for t, n in zip(types, n_of_type, strict=True)},
        node_sets={name: len(nodes) for name, nodes in mesh.node_sets.items()},
        pixels_min=int(checked.pixel_counts.min()),
        pixels_mean=float(checked.pixel_counts.mean()),
        n_controlled_dofs=mesh.dim * n_controlled_nodes,
        output=case.output.file,
        discontinuities=_describe_discontinuities(case, mesh),
        half_amplitudes=describe_cut_off(case.regularization),
        most_ranks=count_most_ranks(case, mesh),
    )


def count_bits(image: ImageSource) -> int | None:
    """Count the bits per pixel of an image; None for floats."""
    saturation = image.saturation
    return None if saturation is None else int(saturation).bit_length()


def _describe_discontinuities(case: Case, mesh: Mesh) -> str | None:
    lines = list_discontinuities(case).lines
    if lines:
        return describe_cut(cut_mesh(mesh, lines))
    return "1 line, to be found" if case.discontinuity else None


def describe_rectangle(case: Case, reference: ImageSource, rectangle: Rectangle) -> CheckReport:
    """Describe inputs with [pgd] that were found fit."""
    n_nodes = rectangle.along_x.n_nodes * rectangle.along_y.n_nodes
    n_cells = (rectangle.along_x.n_nodes - 1) * (rectangle.along_y.n_nodes - 1)
    of_x, of_y = (line.count_pixels() for line in (rectangle.along_x, rectangle.along_y))
    n_controlled = n_nodes
    section = case.regularization
    if section is None:
        n_controlled = 0
    elif section.operator == "equilibrium_gap":
        lines = choose_controlled_lines(section, rectangle)
        n_controlled = int(lines.x.sum()) * int(lines.y.sum())
    return CheckReport(
        image_size=(reference.width, reference.height),
        bits=count_bits(reference),
        n_nodes=n_nodes,
        n_cells=n_cells,
        n_dofs=2 * n_nodes,
        cell_counts={"Q4": n_cells},
        node_sets={},
        pixels_min=int(of_x.min() * of_y.min()),
        pixels_mean=float(of_x.mean() * of_y.mean()),
        n_controlled_dofs=2 * n_controlled,
        output=case.output.file,
        discontinuities=None,
        half_amplitudes=describe_cut_off(section),
        most_ranks=N_BANDS,
    )
