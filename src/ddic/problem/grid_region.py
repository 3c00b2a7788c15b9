"""A rectangle of equal cells, of which no rank has the whole mesh: each makes its own subdomains."""

from dataclasses import dataclass
from functools import cached_property
from math import prod

import numpy as np

from ddic.arrays import IntArray
from ddic.errors import InputError
from ddic.inputs.cameras import MeasuredCells
from ddic.inputs.inputs import Inputs
from ddic.inputs.mesh_source import accept_mesh, build_plain_grid, is_plain_grid
from ddic.kinematics.nodal import NodalKinematics, component_numbers
from ddic.mesh.grid import GridBlock, GridLines
from ddic.mesh.mesh import Similarity
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import BOUNDARY, is_in_box
from ddic.parallel.distribution import split_evenly
from ddic.parallel.team import Team
from ddic.partition.split import NODE_PIXELS, split_grid, split_grid_by_blocks
from ddic.partition.subdomain import Subdomain, begin_subdomain
from ddic.problem.region_mesh import Region, RegionSizes


@dataclass(frozen=True, eq=False)
class GridRegion:
    """A rectangle, or box, of equal cells that one camera measures, the same on every rank.

    Attributes
    ----------
    inputs : Inputs
        What it was made from.
    grid : GridLines
        The cells' sides.
    """

    inputs: Inputs
    grid: GridLines

    @property
    def measured(self) -> list[MeasuredCells]:
        """What the start looks at: the region as a whole, and its nodes only where a field is given there."""
        start, section = self.inputs.case.start, self.inputs.case.mesh.structured
        is_given = start.from_result is not None or start.from_points is not None or start.points is not None
        if is_given and section is not None:
            mesh = build_structured_mesh(section.box, section.element_size)
        else:
            mesh = self.grid.build_outline()
        return [MeasuredCells(np.arange(mesh.n_cells), mesh, mesh)]

    @cached_property
    def _pixels(self) -> list[IntArray]:
        return self.grid.count_pixels()

    def measure_sizes(self) -> RegionSizes:
        """Measure what the choice of a solver asks for."""
        grid = self.grid
        whole = GridBlock(tuple(map(range, grid.n_along)))
        return RegionSizes(grid.dim * grid.n_nodes, grid.n_cells, grid.n_cells, grid.cell_size,
                           self._measure_work(whole), is_plain=True)

    def split(self, n_ranks: int) -> list[GridBlock]:
        """Split as the case says, by default into as many as ranks; InputError where there are not enough cells."""
        solver = self.inputs.case.solver
        if solver.method == "monolithic":
            return split_grid(self.grid, 1)
        if solver.blocks is not None:
            return split_grid_by_blocks(self.grid, solver.blocks)
        n_subdomains = solver.subdomains or n_ranks
        if n_subdomains > self.grid.n_cells:
            raise InputError(f"mesh: {self.grid.n_cells} cells for {n_subdomains} subdomains, one a rank at least; "
                             "start fewer ranks, use larger elements, or ask for fewer subdomains (solver.subdomains)")
        return split_grid(self.grid, n_subdomains)

    def cut(self, team: Team) -> tuple[list[Subdomain], Region]:
        """Make this rank's subdomains, which do not know yet what they share; collective.

        Raises InputError on all ranks, where there are not enough cells, or fewer subdomains than ranks.
        """
        blocks = team.alike(lambda: self.split(team.size))
        costs = np.array([self._measure_work(block) for block in blocks])
        mine = team.alike(lambda: split_evenly(costs, team.size))[team.rank]
        subdomains = team.together(lambda: [self._cut_block(number, blocks[number]) for number in mine])
        grid = self.grid
        shorter_side = min(float(np.ptp(line)) for line in grid.lines)
        return subdomains, Region(grid.n_nodes, grid.n_cells, grid.dim * grid.n_nodes, len(blocks), shorter_side,
                                  Similarity())

    def _measure_work(self, block: GridBlock) -> float:
        """Work of a block's cells, as ``estimate_cell_costs`` counts it, pixels."""
        n_pixels = prod(float(along[some.start:some.stop].sum())
                        for along, some in zip(self._pixels, block.ranges, strict=True))
        return n_pixels + NODE_PIXELS * block.n_cells

    def _cut_block(self, number: int, block: GridBlock) -> Subdomain:
        grid, section = self.grid, self.inputs.case.regularization
        mesh, node_ids, cell_ids = grid.cut_block(block)
        at_edge = np.zeros(len(node_ids), dtype=bool)
        for side in mesh.node_sets.values():
            at_edge[side] = True
        controlled = np.full(len(node_ids), section is not None)
        if section is not None:
            for name in section.not_controlled:
                controlled[at_edge if name == BOUNDARY else mesh.node_sets[name]] = False
            for box in section.boxes:
                controlled[is_in_box(mesh.nodes, box)] = False
        kinematics = NodalKinematics(mesh, component_numbers(node_ids, grid.dim))
        return begin_subdomain(number, kinematics, node_ids, cell_ids, np.repeat(controlled, grid.dim), ~at_edge)


def find_grid_region(inputs: Inputs) -> GridRegion | None:
    """Find the rectangle of Q4 whose nodes are measured, None if it is another mesh; InputError outside the image."""
    is_given = inputs.given_mesh is not None or inputs.updated is not None
    if is_given or inputs.choose_kinematics is not None or not is_plain_grid(inputs.case):
        return None
    grid, image = build_plain_grid(inputs.case), inputs.cameras[0].reference.image
    accept_mesh(grid.build_outline(), inputs.case.mesh.name, image.extent, is_built_in=True)
    return GridRegion(inputs, grid)
