"""An image pair in blocks of pixels, the sides of these blocks, and the square grid on which they are measured.

What surrounds a small region is looked at in smaller blocks than the whole images.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.images.binned import bin_image, bin_window, join_blocks
from ddic.images.rigid import GridField, fill_absent
from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window
from ddic.mesh.cell_parts import Lines
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize

CELLS = {2: 16, 3: 10}
"""Side of the grid's cells, blocks, by the number of dimensions. A larger value gives smoother fields, found more
surely."""

LARGEST_COARSE_IMAGE = {2: 1_000_000, 3: 4_000_000}
"""Pixels of the finest image of the pyramid: what one rank is asked to hold and correlate. A larger value gives a
better start later. A volume of as many has fewer cells along its sides."""

LARGEST_FFT_IMAGE = 500_000
"""Most blocks of the image in which a rigid translation is sought. A larger value takes longer."""

ENOUGH_FFT_IMAGE = 200_000
"""Blocks of the image enough for a rigid translation, if ENOUGH_BLOCKS of them show the region. A larger value takes
longer."""

ENOUGH_BLOCKS = {2: 2000, 3: 10_000}
"""Blocks of the region enough for a rigid translation: coefficients of unrelated images then stay below 0.11 (2000
samples, 200 000 translations; 0.2 in volumes, of which 20 smoothed blocks are a sample), far from LEAST_COEFFICIENT. A
larger value keeps more blocks of small regions."""

SMALLEST_SIDE = 1.5
"""Least side of the region on the coarsest level, cells: there the grid is hardly more than an affine map. A larger
value leaves out coarse levels."""

COARSEST = 64
"""Largest block, pixels. A level finds displacements of about a block beyond its start; a larger value reaches
further."""

FINEST = 8
"""Blocks, pixels, that the finest level need not be smaller than: it finds displacements to a part of a pixel. A larger
value starts large images from farther off, a smaller one takes longer."""

MARGIN = 0.5
"""What is seen around the region, times its longer side: it may turn by any angle about its middle, and grow by two
thirds beside what the translation takes. A larger value finds larger motions, in larger blocks."""


@dataclass(frozen=True)
class BinnedPair:
    """An image pair binned over blocks, ``factor`` pixels a side; blocks are the unit of meshes on it.

    Attributes
    ----------
    reference, deformed : MaskedSource
        The images, a pixel a block.
    factor : int
        Side of a block, pixels.
    pixels : BinnedPair, optional
        The images as they were taken, where parts of them may be looked at in smaller blocks.
    """

    reference: MaskedSource
    deformed: MaskedSource
    factor: int
    pixels: BinnedPair | None = None

    @property
    def size(self) -> IntArray:
        """Sizes of both images along x, y, and z in a volume, blocks."""
        return np.array(self.reference.extent.sizes)

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return len(self.reference.extent.sizes)

    @property
    def cell(self) -> int:
        """Side of the cells of grids on it, blocks."""
        return CELLS[self.dim]

    @property
    def centre(self) -> float:
        """Position of block 0's centre along either axis, pixels."""
        return (self.factor - 1) / 2

    def scale(self, mesh: Mesh) -> Mesh:
        """Scale a mesh from pixels to blocks; it is not cut."""
        nodes = (mesh.nodes - self.centre) / self.factor
        return Mesh(nodes, mesh.connectivity, mesh.offsets, mesh.types)

    def scale_to_pixels(self, mesh: Mesh) -> Mesh:
        """Scale a mesh in blocks, perhaps cut, to pixels."""
        return _map_mesh(mesh, self.factor, self.centre)

    def find_active(self, mesh: Mesh, window: Window | None = None) -> NDArray[np.uint8]:
        """Mark the blocks of a window, or all, whose centre lies in a mesh, itself in blocks, and that are not masked.

        Returns 1 on active blocks, 0 elsewhere, an array of the window's shape.
        """
        window = self.reference.extent if window is None else window
        covered = rasterize(mesh).draw_cells(np.arange(mesh.n_cells), window)
        usable = self.reference.find_usable(window)
        return covered if usable is None else covered & usable

    def bin_at_sizes(self, sizes: Iterable[int]) -> dict[int, BinnedPair]:
        """Bin both images at all block sizes (powers of 2), pixels, each from the one before."""
        pairs: dict[int, BinnedPair] = {}
        finer = self
        for size in sorted(set(sizes)):
            ratio = size // finer.factor
            finer = BinnedPair(bin_image(finer.reference, ratio), bin_image(finer.deformed, ratio), size)
            pairs[size] = finer
        return pairs

    def can_bin_finer(self, mesh: Mesh) -> bool:
        """Tell whether the surroundings of a region, blocks being pixels, are so small that they have finer levels."""
        of_part = self._find_extent(mesh)
        return find_finest_level(of_part) < find_finest_level(self.size)

    def bin_surroundings(self, mesh: Mesh, translation: Array) -> Surroundings:
        """Bin what surrounds a region, moved by about ``translation``, (dim,), pixels, as finely as its size allows."""
        extent = self._find_extent(mesh)
        factor = choose_finest_block(extent)
        extent -= extent % factor
        middle = (mesh.nodes.min(axis=0) + mesh.nodes.max(axis=0)) / 2
        origin, moved = (np.clip(np.rint(place - extent / 2).astype(int), 0, self.size - extent)
                         for place in (middle, middle + translation))
        reference, deformed = (join_blocks(source, [bin_window(source, factor, Window.between(begin, begin + extent))])
                               for source, begin in ((self.reference, origin), (self.deformed, moved)))
        return Surroundings(BinnedPair(reference, deformed, factor), origin.astype(float),
                            (moved - origin).astype(float))

    def _find_extent(self, mesh: Mesh) -> IntArray:
        """Sizes of what is seen around a region, pixels."""
        sides = np.ptp(mesh.nodes, axis=0)
        return np.minimum(np.ceil(sides + 2 * MARGIN * sides.max()).astype(int), self.size)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Parts of both images, of the same size, that show a region and what is around it.

    Attributes
    ----------
    pair : BinnedPair
        The parts, positions counted from where each begins.
    origin, translation : (dim,) array
        Where the reference image's part begins, and where the deformed image's part begins from there, pixels.
    """

    pair: BinnedPair
    origin: Array
    translation: Array

    def describe(self) -> str:
        """Say for the log what is looked at."""
        sizes = " x ".join(map(str, (self.pair.size * self.pair.factor).tolist()))
        origin = ", ".join(f"{place:.0f}" for place in self.origin)
        return (f"start: the region and what surrounds it, {sizes} px from ({origin}) px on, in blocks of "
                f"{self.pair.factor} px")


def move_mesh(mesh: Mesh, vector: Array) -> Mesh:
    """Give a mesh, perhaps cut, at another place: moved by ``vector``, (dim,), pixels."""
    return _map_mesh(mesh, 1, vector)


def _map_mesh(mesh: Mesh, factor: int, origin: float | Array) -> Mesh:
    """The same cells, all points times a factor and then moved."""
    parts = mesh.parts
    if parts is not None:
        lines = Lines(tuple(line * factor + origin for line in parts.lines.polylines),
                      tuple(bend * factor + origin for bend in parts.lines.bends))
        parts = replace(parts, corners=parts.corners * factor + origin, lines=lines)
    return replace(mesh, nodes=mesh.nodes * factor + origin, parts=parts)


@dataclass(frozen=True)
class BlockGrid:
    """Square or cubic cells that hold active blocks, within a regular grid.

    Attributes
    ----------
    lines : GridLines
        The full grid's, blocks.
    mesh : Mesh
        The cells, blocks.
    numbers : (mesh.n_nodes,) array of int64
        Numbers of its nodes in the full grid, row after row.
    """

    lines: GridLines
    mesh: Mesh
    numbers: IntArray

    def place_on_grid(self, displacement: Array) -> Array:
        """Write displacements of the cells' nodes, (mesh.n_dofs,), on the full grid, nan where there is no cell."""
        values = np.full(find_grid_shape(self.lines), np.nan)
        dim = self.lines.dim
        values.reshape(-1, dim)[self.numbers] = displacement.reshape(-1, dim)
        return values


def find_grid_shape(lines: GridLines) -> tuple[int, ...]:
    """Find the shape of displacements on a grid: (rows, columns, 2), or (planes, rows, columns, 3)."""
    return (*map(len, lines.lines[::-1]), lines.dim)


def choose_grid_lines(region: Mesh, pair: BinnedPair) -> GridLines:
    """Choose the lines of a grid of cells with a side of about ``pair.cell`` blocks over a region in blocks."""
    # Pixels that fill no block may lie beyond the last one's edge.
    low, high = np.maximum(region.nodes.min(axis=0), -0.5), np.minimum(region.nodes.max(axis=0), pair.size - 0.5)
    n_along = np.maximum(np.round((high - low) / pair.cell).astype(int), 1)
    return GridLines(tuple(np.linspace(first, last, n + 1) for first, last, n in zip(low, high, n_along, strict=True)))


def build_grid(lines: GridLines, active: NDArray[np.uint8], window: Window) -> BlockGrid:
    """Build a grid without the cells that have no block of ``active``, which is 1 on those of the window that count."""
    full = lines.build_mesh()
    n_active = rasterize(full).sum_by_cell(active, window)
    return BlockGrid(lines, *full.create_submesh(np.flatnonzero(n_active > 0)))


def make_grid_field(lines: GridLines, values: Array, pair: BinnedPair) -> GridField:
    """Make a field, pixels, of displacements on the full grid, blocks; nan as the nearest node."""
    origin = tuple(float(line[0]) * pair.factor + pair.centre for line in lines.lines)
    steps = tuple(float(np.ptp(line)) / (len(line) - 1) * pair.factor for line in lines.lines)
    return GridField(origin, steps, fill_absent(values * pair.factor))


def choose_finest_block(size: IntArray | tuple[int, ...]) -> int:
    """Find the side of the smallest blocks that the start looks at, pixels, in an image of a size along each axis."""
    return 1 if np.prod(size) <= LARGEST_FFT_IMAGE else find_finest_level(size)


def choose_held_block(size: IntArray | tuple[int, ...]) -> int:
    """Find the side of the smallest blocks of all levels, of those too that several ranks go on to, pixels."""
    return min(choose_finest_block(size), FINEST)


def find_finest_level(size: IntArray | tuple[int, ...]) -> int:
    """Find the side of the smallest blocks of the pyramid, pixels, in an image of a size along each axis."""
    finest, dim = 2, len(size)
    while np.prod(size) / finest**dim > LARGEST_COARSE_IMAGE[dim]:
        finest *= 2
    return finest


def choose_block_sizes(size: IntArray | tuple[int, ...], mesh: Mesh) -> list[int]:
    """Choose the block sizes of the pyramid's levels, pixels, coarsest first, in an image of a size along each axis.

    There are none where the region of the whole mesh, pixels, is smaller than a cell of each.
    """
    n_cells = float(np.ptp(mesh.nodes, axis=0).min()) / CELLS[mesh.dim]
    sizes = [find_finest_level(size)]
    while sizes[-1] < COARSEST and n_cells / (2 * sizes[-1]) >= SMALLEST_SIDE:
        sizes.append(2 * sizes[-1])
    return [of_level for of_level in reversed(sizes) if n_cells / of_level >= 1]


def choose_further_block_sizes(sizes: list[int]) -> list[int]:
    """Choose the block sizes of levels finer than some, coarsest first, for several ranks."""
    all_sizes = list(sizes)
    while all_sizes and all_sizes[-1] > FINEST:
        all_sizes.append(all_sizes[-1] // 2)
    return all_sizes[len(sizes):]


def choose_rigid_block(size: IntArray | tuple[int, ...], mesh: Mesh) -> int:
    """Choose the side of the blocks, pixels, in which a rigid translation of the whole mesh is sought."""
    region = float(np.prod(np.ptp(mesh.nodes, axis=0)))
    side = 1
    while True:
        n_blocks = np.prod(size) / side**mesh.dim
        n_larger_blocks_of_region = region / (2 * side) ** mesh.dim
        is_too_large = n_blocks > LARGEST_FFT_IMAGE
        is_more_than_enough = n_blocks > ENOUGH_FFT_IMAGE and n_larger_blocks_of_region >= ENOUGH_BLOCKS[mesh.dim]
        if not (is_too_large or is_more_than_enough):
            return side
        side *= 2
