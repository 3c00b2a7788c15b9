"""One level of the pyramid: R-DIC on a square grid over binned images, of the whole region or in tiles.

A tile is correlated with what surrounds it, by one rank alone. The level before has left an error of about a block, so
that nothing farther off matters, and tiles need not know of each other.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from ddic.arrays import Array
from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.images.rigid import GridField
from ddic.images.window import Window
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh
from ddic.solvers.correction_size import Tolerances
from ddic.solvers.gauss_newton import Report, stay_silent
from ddic.start.binned_pair import (
    BinnedPair,
    BlockGrid,
    build_grid,
    choose_grid_lines,
    find_grid_shape,
    make_grid_field,
)
from ddic.start.coarse_displacement import CoarseField, CutField, LevelMesh, cut_level, evaluate_at_nodes
from ddic.start.helpers import Helpers, PairOfRank
from ddic.start.independent import Images, correlate_alone

CUT_OFF = 4.0
"""Cut-off wavelength of a level, cells. A larger value finds smoother fields, and strays less where texture is poor."""

DEGREE = 3
"""Of the splines between blocks."""

TOLERANCES = Tolerances(relative=1e-12, rms=0.01, max_iterations=30, largest=np.inf)
"""Of Gauss-Newton on a level: the RMS of a correction, in blocks, decides."""

TILE = {2: 20, 3: 14}
"""Most cells along the side of a tile, by the number of dimensions. A larger one is more work for one rank, a smaller
one more in all."""

HALO = 2
"""Cells around a tile that are correlated with it. More take longer; with fewer its edge shows."""

LARGEST_WHOLE = 1 << 17
"""Blocks of the region's box from which on a level is correlated in tiles: then one takes some hundredths of a second
on one rank."""

NO_LINES = Discontinuities()

MeasurementError = ConvergenceError | SingularSubdomainError


def correlate_level(pair: BinnedPair, mesh: Mesh, starts: Sequence[CoarseField], correction: GreyCorrection,
                    discontinuities: Discontinuities, report: Report = stay_silent) -> CoarseField:
    """Correlate one level from the best of some starts; displacements, the whole mesh and the lines are in pixels.

    Of ``starts``, at least one, that of least residual is taken; ``discontinuities`` cut the level's grid; ``report``
    is told of every iteration, in blocks. Raises ConvergenceError where Gauss-Newton does not converge,
    SingularSubdomainError where the blocks do not determine the displacement.
    """
    region = pair.scale(mesh)
    lines = choose_grid_lines(region, pair)
    grid, cells, images = _open_level(pair, region, lines, pair.reference.extent, discontinuities, correction)
    in_pixels = pair.scale_to_pixels(cells.mesh)
    candidates = [evaluate_at_nodes(start, in_pixels).ravel() / pair.factor for start in starts]
    displacement = _correlate(images, cells, candidates, pair, report)
    if cells.mesh.parts is None:
        return make_grid_field(lines, grid.place_on_grid(displacement), pair)
    return CutField(in_pixels, displacement.reshape(in_pixels.nodes.shape) * pair.factor)


def _open_level(pair: BinnedPair, region: Mesh, lines: GridLines, window: Window, discontinuities: Discontinuities,
                correction: GreyCorrection) -> tuple[BlockGrid, LevelMesh, Images]:
    """The cells of a grid that hold blocks of the region, in a window, their unknowns, and the images there."""
    active = pair.find_active(region, window)
    if not active.any():
        raise SingularSubdomainError("no block of the region is usable: everything is masked")
    grid = build_grid(lines, active, window)
    cells = cut_level(grid.mesh, discontinuities.scale(pair.centre, pair.factor), active, DEGREE)
    images = Images(pair.reference, pair.deformed, active, DEGREE, correction, window.lower)
    return grid, cells, images


def _correlate(images: Images, cells: LevelMesh, candidates: Sequence[Array], pair: BinnedPair,
               report: Report = stay_silent) -> Array:
    """Displacement of the nodes, blocks, from the best of the candidates."""
    where = f"pyramid level with blocks of {pair.factor} px"
    return correlate_alone(images, cells, CUT_OFF * pair.cell, TOLERANCES, candidates, where, report)


@dataclass(frozen=True, eq=False)
class _Tile:
    """A part of a level's grid of blocks of ``size`` pixels; lengths are blocks.

    ``lines`` are those of its cells and those around it, ``own`` rows and columns of those nodes that are its own,
    ``on_level`` where these are on the level's grid; ``region`` are the cells of the region that it may show,
    ``starts``, (rows, columns, 2) each, or (planes, rows, columns, 3), displacements of all its nodes to start from.
    """

    size: int
    lines: GridLines
    own: tuple[slice, ...]
    on_level: tuple[slice, ...]
    region: Mesh
    starts: list[Array]
    correction: GreyCorrection

    @property
    def window(self) -> Window:
        """Blocks whose centres it may hold."""
        low, high = ([line[k] for line in self.lines.lines] for k in (0, -1))
        return Window.between(np.ceil(low), np.floor(high) + 1)


def _correlate_tile(images: PairOfRank, tile: _Tile) -> Array | MeasurementError:
    """Correlate a tile, from the best of its starts; displacements of its own nodes, as starts are, blocks.

    Nodes without a cell are nan. What keeps it from being correlated is returned.
    """
    pair = images.get_pair(tile.size)
    window = tile.window.intersection(pair.reference.extent)

    try:
        grid, cells, level = _open_level(pair, tile.region, tile.lines, window, NO_LINES, tile.correction)
        candidates = [start.reshape(-1, pair.dim)[grid.numbers].ravel() for start in tile.starts]
        displacement = _correlate(level, cells, candidates, pair)
    except (ConvergenceError, SingularSubdomainError) as error:
        return error
    return grid.place_on_grid(displacement)[tile.own]


@dataclass(frozen=True, eq=False)
class TiledLevel:
    """What tiles found.

    Attributes
    ----------
    field : GridField
        Pixels.
    n_tiles : int
        How many there are.
    errors : list of Exception
        What kept some of them at their first start.
    """

    field: GridField
    n_tiles: int
    errors: list[MeasurementError]


def correlate_in_tiles(helpers: Helpers, size: int, mesh: Mesh, starts: Sequence[CoarseField],
                       correction: GreyCorrection) -> TiledLevel:
    """Correlate a level without discontinuities as ``correlate_level`` does, in tiles, each from its best start.

    Raises the error of the first tile where none can be correlated.
    """
    pair = helpers.get_pair(size)
    region = pair.scale(mesh)
    lines = choose_grid_lines(region, pair)
    nodes = pair.scale_to_pixels(lines.build_mesh())
    shape = find_grid_shape(lines)
    on_grid = [evaluate_at_nodes(start, nodes).reshape(shape) / pair.factor for start in starts]
    tiles = list(_cut_tiles(size, region, lines, on_grid, correction))
    values, errors = np.full(shape, np.nan), []
    for tile, found in zip(tiles, helpers.apply(_correlate_tile, tiles), strict=True):
        if isinstance(found, Exception):
            errors.append(found)
            values[tile.on_level] = on_grid[0][tile.on_level]
        else:
            values[tile.on_level] = found
    if len(errors) == len(tiles):
        raise errors[0]
    return TiledLevel(make_grid_field(lines, values, pair), len(tiles), errors)


def _cut_tiles(size: int, region: Mesh, lines: GridLines, starts: Sequence[Array],
               correction: GreyCorrection) -> Iterator[_Tile]:
    """Tiles, row by row, where there are cells of the region; ``starts``, blocks, are of all nodes of the grid."""
    lowest, highest = region.outlines.find_boxes()
    # Arrays on grids have rows before columns.
    for stretches in product(*(_split_line(line, TILE[lines.dim]) for line in lines.lines[::-1])):
        part = GridLines(tuple(line[some.wide] for line, some in zip(lines.lines, stretches[::-1], strict=True)))
        low, high = ([line[k] for line in part.lines] for k in (0, -1))
        cells = np.flatnonzero(((lowest <= high) & (highest >= low)).all(axis=1))
        if len(cells):
            wide, own, on_level = zip(*stretches, strict=True)
            yield _Tile(size, part, own, on_level, region.create_submesh(cells)[0], [start[wide] for start in starts],
                        correction)


class _Stretch(NamedTuple):
    """Nodes of a line: with those around, in them those of a tile's own, and these on the whole line."""

    wide: slice
    own: slice
    on_level: slice


def _split_line(line: Array, longest: int) -> Iterator[_Stretch]:
    """Stretches of a line of nodes, about as long, each with a halo; a node between two is of the second."""
    n_cells = len(line) - 1
    for cells in np.array_split(np.arange(n_cells), -(-n_cells // longest)):
        begin, end = int(cells[0]), int(cells[-1]) + 1
        first, last = max(begin - HALO, 0), min(end + HALO, n_cells)
        stop = end if end < n_cells else end + 1
        yield _Stretch(slice(first, last + 1), slice(begin - first, stop - first), slice(begin, stop))
