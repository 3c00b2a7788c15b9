"""Whether what refers to the mesh fits it: pixels, node sets, wavelength, partition, ranks."""

from dataclasses import dataclass

import numpy as np

from ddic.arrays import IntArray
from ddic.case.loader import LoadedCase
from ddic.case.schema import Case, SolverSection
from ddic.errors import InputError, Problems
from ddic.inputs.mesh_source import NO_INNER_NODE, check_wavelength_fits
from ddic.io.text_files import read_partition
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_cell_size
from ddic.mesh.raster import rasterize
from ddic.mesh.repair import check_pixels
from ddic.mesh.topology import find_boundary_nodes, find_not_controlled_nodes
from ddic.partition.split import split_by_blocks
from ddic.partition.ties import Tying
from ddic.problem.cut_region import check_lines


@dataclass(frozen=True)
class CheckedMesh:
    """The mesh of a case.

    Attributes
    ----------
    mesh : Mesh
        The whole mesh, pixels.
    tying : Tying or None
        How near fields' own meshes are tied in it; None where there are none.
    pixel_counts : (n_cells,) array of int64
        Pixels of each cell in the images that measure it.
    """

    mesh: Mesh
    tying: Tying | None
    pixel_counts: IntArray


def check_mesh_uses(loaded: LoadedCase, checked: CheckedMesh, problems: Problems) -> IntArray:
    """Check what refers to the mesh; ``problems`` takes what is found.

    The nodes that are not controlled, (n,), are returned.
    """
    case = loaded.case
    mesh = checked.mesh
    with problems.gathered():
        check_pixels(mesh, checked.pixel_counts, case.mesh.name)
    not_controlled = np.zeros(0, np.int64)
    section = case.regularization
    if section is not None:
        edge = find_boundary_nodes(mesh)
        with problems.gathered(loaded.path):
            boundary = edge if checked.tying is None else checked.tying.boundary
            not_controlled = find_not_controlled_nodes(mesh, section.not_controlled, section.boxes, boundary)
        with problems.gathered(loaded.path):
            _check_wavelength(section.cut_off_wavelength, mesh, edge)
    with problems.gathered(loaded.path):
        check_lines(case, mesh)
    with problems.gathered():
        if case.solver.partition_file is not None:
            read_partition(case.solver.partition_file, mesh.n_cells)
    with problems.gathered(loaded.path):
        _check_number_of_subdomains(case.solver, mesh)
    return not_controlled


def count_most_ranks(case: Case, mesh: Mesh) -> int:
    """Count the subdomains that a case, found fit, can have at most, of which every rank needs one.

    There is one for a cell where the case leaves their number open.
    """
    solver = case.solver
    if solver.method == "monolithic":
        return 1
    if solver.partition_file is not None:
        return int(read_partition(solver.partition_file, mesh.n_cells).max()) + 1
    if solver.blocks is not None:
        # Blocks without cells are dropped; those with cells of several cameras become several.
        return solver.blocks[0] * solver.blocks[1] if case.near else int(split_by_blocks(mesh, solver.blocks).max()) + 1
    return solver.subdomains or mesh.n_cells


def check_most_ranks(loaded: LoadedCase, most: int, n_ranks: int) -> None:
    """Refuse more ranks than the mesh can have subdomains: ``most``, as ``count_most_ranks`` says.

    The InputError says what can be changed: only keys that the case gives.
    """
    if n_ranks <= most:
        return
    solver = loaded.case.solver
    if solver.partition_file is not None:
        what, remedy = f"{solver.partition_file}: {most} subdomains", "divide the mesh further there"
    elif solver.blocks is not None:
        what, remedy = f"{loaded.path}: solver.blocks: {most} blocks with cells", "ask for more of them"
    else:
        what, remedy = f"{loaded.path}: {most} cells of the mesh", "use smaller elements"
    raise InputError(f"{what} for {n_ranks} MPI ranks, but every rank needs at least one; start at most {most} ranks "
                     f"or {remedy}")


def check_mesh(loaded: LoadedCase, mesh: Mesh, n_ranks: int) -> None:
    """Check what a case with one camera asks of a mesh.

    Raises InputError with a line for each problem: cells without pixels, node sets, cut-off wavelength, partition,
    ranks.
    """
    problems = Problems()
    check_mesh_uses(loaded, CheckedMesh(mesh, None, rasterize(mesh).pixel_counts), problems)
    if problems.lines:
        raise InputError(problems.lines)
    check_most_ranks(loaded, count_most_ranks(loaded.case, mesh), n_ranks)


def _check_number_of_subdomains(solver: SolverSection, mesh: Mesh) -> None:
    """Refuse more of them than cells; the schema lets only one of both keys be given."""
    if solver.subdomains is not None and solver.subdomains > mesh.n_cells:
        raise InputError(f"solver.subdomains = {solver.subdomains}: the mesh has only {mesh.n_cells} cells; ask for "
                         "fewer subdomains")
    if solver.blocks is not None and solver.blocks[0] * solver.blocks[1] > mesh.n_cells:
        raise InputError(f"solver.blocks = {list(solver.blocks)}: {solver.blocks[0] * solver.blocks[1]} blocks of a "
                         f"mesh of only {mesh.n_cells} cells; ask for fewer")


def _check_wavelength(wavelength: float | None, mesh: Mesh, edge: IntArray) -> None:
    """Refuse one that the mesh does not carry, and a mesh without inner nodes, which says nothing of any."""
    if wavelength is None:
        return
    if len(edge) == mesh.n_nodes:
        raise InputError(f"regularization.cut_off_wavelength = {wavelength:g}: {NO_INNER_NODE}")
    check_wavelength_fits(wavelength, measure_cell_size(mesh))
