"""Whether a case can run on so many MPI ranks, each of which needs a subdomain of the mesh."""

import math

from ddic.case.loader import LoadedCase
from ddic.case.methods import find_method
from ddic.case.schema import Case, SolverSection
from ddic.errors import InputError
from ddic.mesh.mesh import Mesh
from ddic.partition.split import split_by_blocks
from ddic.problem.choose_solver import count_given_subdomains
from ddic.solvers.petsc import require_packages


def count_ranks_of_group(loaded: LoadedCase, n_ranks: int) -> int:
    """Count the ranks that measure a frame, of all ranks; refuse, with an InputError, what has no equal groups."""
    n_groups = loaded.case.series.groups
    if n_ranks % n_groups:
        raise InputError(f"{loaded.path}: series.groups: {n_groups} equal groups cannot be made of {n_ranks} MPI "
                         f"ranks; start a multiple of {n_groups} ranks, or ask for another number of groups")
    return n_ranks // n_groups


def check_ranks(loaded: LoadedCase, n_ranks: int) -> None:
    """Refuse, with an InputError, a number of ranks on which the case's method cannot measure it."""
    find_method(loaded.case).check_ranks(loaded, n_ranks)


def check_ranks_of_subdomains(loaded: LoadedCase, n_ranks: int) -> None:
    """Refuse, by an InputError, more ranks than a case has subdomains, and solvers that PETSc lacks on so many."""
    solver = loaded.case.solver
    require_packages(str(loaded.path), solver.method, solver.local_inverse, n_ranks)
    if solver.method == "monolithic":
        if n_ranks > 1:
            raise InputError(f'{loaded.path}: solver.method = "monolithic" runs on one rank, {n_ranks} were started; '
                             'start one rank or use "dual"')
        return
    largest = solver.subdomains if solver.blocks is None else math.prod(solver.blocks)
    if largest is not None and n_ranks > largest:
        key = "solver.subdomains" if solver.blocks is None else "solver.blocks"
        raise InputError(f"{loaded.path}: {key}: {largest} subdomains for {n_ranks} MPI ranks, but every rank needs at "
                         f"least one; start at most {largest} ranks or ask for more subdomains")


def check_number_of_subdomains(solver: SolverSection, n_cells: int) -> None:
    """Refuse more of them than cells; the schema lets only one of both keys be given."""
    if solver.subdomains is not None and solver.subdomains > n_cells:
        raise InputError(f"solver.subdomains = {solver.subdomains}: the mesh has only {n_cells} cells; ask for fewer "
                         "subdomains")
    if solver.blocks is not None and math.prod(solver.blocks) > n_cells:
        raise InputError(f"solver.blocks = {list(solver.blocks)}: {math.prod(solver.blocks)} blocks of a mesh of only "
                         f"{n_cells} cells; ask for fewer")


def count_most_ranks(case: Case, mesh: Mesh) -> int:
    """Count the subdomains, one a rank, that a case found fit can have at most: one a cell where it leaves it open."""
    solver = case.solver
    if solver.method == "monolithic":
        return 1
    if solver.blocks is not None and not case.near:
        # Those without cells are dropped; those with cells of several cameras become several.
        return int(split_by_blocks(mesh, solver.blocks).max()) + 1
    return count_given_subdomains(solver, mesh.n_cells) or mesh.n_cells


def check_most_ranks(loaded: LoadedCase, most: int, n_ranks: int) -> None:
    """Raise InputError for more ranks than ``most`` subdomains, with the keys of the case that can be changed."""
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
