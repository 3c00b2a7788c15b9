"""The images and the region that a case asks for, spread over ranks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case, ImagesSection, NearSection, RegularizationSection, SolverSection
from ddic.functionals.elasticity import Material
from ddic.functionals.equilibrium_gap import measure_gap_energies
from ddic.images.source import ImageSource
from ddic.images.sub_image import MaskedSource
from ddic.io.image_file import open_decoded, open_image
from ddic.io.partition_file import read_partition
from ddic.mesh.control import find_not_controlled_nodes
from ddic.mesh.mesh import Mesh, Similarity
from ddic.mesh.topology import find_boundary_nodes
from ddic.parallel.distribution import distribute
from ddic.parallel.shared_image import open_once_a_node
from ddic.parallel.team import Team
from ddic.partition.connectivity import build_subdomains
from ddic.partition.cost import estimate_cell_costs, sum_costs
from ddic.partition.split import split_by_blocks, split_by_metis
from ddic.partition.subdomain import Subdomain


@dataclass(frozen=True)
class ImagePair:
    """Reference and deformed image with what is excluded from each."""

    reference: MaskedSource
    deformed: MaskedSource


@dataclass(frozen=True)
class Region:
    """What every rank knows of the whole mesh.

    n_nodes, n_cells, n_dofs, n_subdomains: sizes; gap_energies: |K v|^2 of the plane waves of the
    cut-off wavelength (None where eta is given or nothing is regularized); mapping: mesh units to pixels.
    """

    n_nodes: int
    n_cells: int
    n_dofs: int
    n_subdomains: int
    gap_energies: NDArray[np.float64] | None
    mapping: Similarity


def open_pair(case: Case) -> ImagePair:
    """Open the images of a case (headers only)."""
    return pair_of(case.images, open_image)


def open_shared_pair(team: Team, case: Case) -> ImagePair:
    """``open_pair`` on all ranks: an image that can only be decoded whole is decoded once a node; collective."""
    return pair_of(case.images, lambda path: open_once_a_node(team, lambda: open_decoded(path)))


def pair_of(section: ImagesSection | NearSection, opened: Callable[[Path], ImageSource]) -> ImagePair:
    """A section's images and masks, opened as told."""
    masks = [None if path is None else opened(path) for path in (section.reference_mask, section.deformed_mask)]
    return ImagePair(MaskedSource(opened(section.reference), masks[0], section.exclude_saturated),
                     MaskedSource(opened(section.deformed), masks[1], section.exclude_saturated))


def material(section: RegularizationSection) -> Material:
    """Elastic constants of the regularization."""
    return Material(section.poisson_ratio, section.plane)


@dataclass(frozen=True)
class CutMesh:
    """All subdomains of the mesh, the work that each brings, (n_subdomains,), and what every rank is to know of it."""

    subdomains: list[Subdomain]
    costs: NDArray[np.float64]
    region: Region


def cut(case: Case, mesh: Mesh, n_ranks: int) -> CutMesh:
    """Split the whole mesh as the case says; free of communication."""
    costs = estimate_cell_costs(mesh)
    if case.solver.method == "monolithic":
        parts: NDArray[np.int64] | None = np.zeros(mesh.n_cells, dtype=np.int64)
    else:
        parts = given_parts(case.solver, mesh)
    if parts is None:
        parts = split_by_metis(mesh, case.solver.subdomains or n_ranks, costs)
    subdomains, work = _subdomains(case, mesh, parts, costs)
    region = Region(mesh.n_nodes, mesh.n_cells, mesh.n_dofs, len(subdomains),
                    region_gap_energies(case.regularization, mesh), mesh.mapping)
    return CutMesh(subdomains, work, region)


def hand_out(team: Team, whole: CutMesh | None) -> tuple[list[Subdomain], Region]:
    """Give each rank its subdomains of the mesh that rank 0 has cut."""
    def known() -> CutMesh:
        assert whole is not None
        return whole

    return distribute(team, lambda: (known().subdomains, known().costs)), team.on_root(lambda: known().region)


def share_out(team: Team, case: Case, mesh: Mesh | None) -> tuple[list[Subdomain], Region]:
    """Split the mesh that rank 0 holds and give each rank its subdomains."""
    held: list[CutMesh] = []

    def make() -> None:
        assert mesh is not None
        held.append(cut(case, mesh, team.size))

    team.on_root(make)
    return hand_out(team, held[0] if held else None)


def deal_out(team: Team, case: Case, mesh: Mesh | None, split: Callable[[Mesh], NDArray[np.int64]]) -> list[Subdomain]:
    """Cut the mesh that rank 0 holds as ``split`` says there, (n_cells,), and give each rank its subdomains."""
    def build() -> tuple[list[Subdomain], NDArray[np.float64]]:
        assert mesh is not None
        return _subdomains(case, mesh, split(mesh), estimate_cell_costs(mesh))

    return distribute(team, build)


def _subdomains(case: Case, mesh: Mesh, parts: NDArray[np.int64], costs: NDArray[np.float64],
                ) -> tuple[list[Subdomain], NDArray[np.float64]]:
    """The subdomains of given parts and the work that each brings, (n_subdomains,); parts, costs: of cells."""
    return build_subdomains(mesh, parts, controlled_dofs(case.regularization, mesh)), sum_costs(costs, parts)


def given_parts(solver: SolverSection, mesh: Mesh) -> NDArray[np.int64] | None:
    """Subdomain of each cell where the case gives blocks or a file, (n_cells,); None where METIS is to find it."""
    if solver.partition == "blocks":
        assert solver.blocks is not None
        return split_by_blocks(mesh, solver.blocks)
    if solver.partition == "file":
        assert solver.partition_file is not None
        return read_partition(solver.partition_file, mesh.n_cells)
    return None


def controlled_dofs(section: RegularizationSection | None, mesh: Mesh,
                    boundary: NDArray[np.int64] | None = None) -> NDArray[np.bool_]:
    """Dofs whose equilibrium row is controlled: P of Eq. 11 of [BP17]; boundary: its nodes, by default the mesh's."""
    if section is None:
        return np.zeros(mesh.n_dofs, dtype=bool)
    controlled = np.ones(mesh.n_nodes, dtype=bool)
    controlled[find_not_controlled_nodes(mesh, section.not_controlled, section.boxes, boundary)] = False
    return np.repeat(controlled, mesh.dim)


def region_gap_energies(section: RegularizationSection | None, mesh: Mesh,
                        inside: NDArray[np.bool_] | None = None) -> NDArray[np.float64] | None:
    """|K v|^2 of the plane waves on nodes inside the whole mesh (``measure_gap_energies``); None where eta needs none.

    inside: (n_nodes,) which nodes count, by default all that are not on the boundary.
    """
    if section is None or section.cut_off_wavelength is None:
        return None
    inside = inner_nodes(mesh) if inside is None else inside
    return measure_gap_energies(mesh, material(section), inside, section.cut_off_wavelength)


def inner_nodes(mesh: Mesh, boundary: NDArray[np.int64] | None = None) -> NDArray[np.bool_]:
    """Whether each node lies inside the mesh and not on its boundary, (n_nodes,); boundary: its nodes, if known."""
    interior = np.ones(mesh.n_nodes, dtype=bool)
    interior[find_boundary_nodes(mesh) if boundary is None else boundary] = False
    return interior
