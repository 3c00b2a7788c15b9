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
from ddic.mesh.cell_type import Q4
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.raster import rasterize

CELL = 16
"""Side of the grid's cells, blocks. A larger value gives smoother fields, found more surely."""

LARGEST_COARSE_IMAGE = 1_000_000
"""Pixels of the finest image of the pyramid: what one rank is asked to hold and correlate. A larger value gives a
better start later."""

LARGEST_FFT_IMAGE = 500_000
"""Most blocks of the image in which a rigid translation is sought. A larger value takes longer."""

ENOUGH_FFT_IMAGE = 200_000
"""Blocks of the image enough for a rigid translation, if ENOUGH_BLOCKS of them show the region. A larger value takes
longer."""

ENOUGH_BLOCKS = 2000
"""Blocks of the region enough for a rigid translation: coefficients of unrelated images then stay below 0.11 (2000
samples, 200 000 translations), far from LEAST_COEFFICIENT. A larger value keeps more blocks of small regions."""

SMALLEST_SIDE = 1.5 * CELL
"""Least side of the region on the coarsest level, blocks: there the grid is hardly more than an affine map. A larger
value leaves out coarse levels."""

COARSEST = 64
"""Largest block, pixels. A level finds displacements of about a block beyond its start; a larger value reaches
further."""

MARGIN = 0.5
"""What is seen around the region, times its longer side: it may turn by any angle about its middle, and grow by two
thirds beside what the translation takes. A larger value finds larger motions, in larger blocks."""


@dataclass(frozen=True)
class BinnedPair:
    """An image pair binned over blocks of factor x factor pixels; blocks are the unit of meshes on it.

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
        """Width and height of both images, blocks."""
        return np.array([self.reference.image.width, self.reference.image.height])

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

    def find_active(self, mesh: Mesh) -> NDArray[np.uint8]:
        """Mark the blocks whose centre lies in a mesh, itself in blocks, and that are not masked.

        Returns 1 on active blocks, 0 elsewhere, (rows, columns).
        """
        covered = rasterize(mesh).find_covered(self.reference.image.width, self.reference.image.height)
        usable = self.reference.find_usable(self.reference.extent)
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
        """Tell whether what surrounds a region is so small that the pyramid has finer levels there than on all pixels.

        The blocks are pixels.
        """
        of_part = self._find_extent(mesh)
        return find_finest_level(int(of_part.prod())) < find_finest_level(int(self.size.prod()))

    def bin_surroundings(self, mesh: Mesh, translation: Array) -> Surroundings:
        """Bin what surrounds a region, in blocks as small as those of an image of that size; from pixels.

        ``translation``, (2,), pixels, is about that of the region.
        """
        extent = self._find_extent(mesh)
        factor = choose_finest_block(int(extent.prod()))
        extent -= extent % factor
        middle = (mesh.nodes.min(axis=0) + mesh.nodes.max(axis=0)) / 2
        origin, moved = (np.clip(np.rint(place - extent / 2).astype(int), 0, self.size - extent)
                         for place in (middle, middle + translation))
        reference, deformed = (join_blocks(source, [bin_window(source, factor, Window.between(begin, begin + extent))])
                               for source, begin in ((self.reference, origin), (self.deformed, moved)))
        return Surroundings(BinnedPair(reference, deformed, factor), origin.astype(float),
                            (moved - origin).astype(float))

    def _find_extent(self, mesh: Mesh) -> IntArray:
        """Width and height of what is seen around a region, pixels."""
        sides = np.ptp(mesh.nodes, axis=0)
        return np.minimum(np.ceil(sides + 2 * MARGIN * sides.max()).astype(int), self.size)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Parts of both images, of the same size, that show a region and what is around it.

    Attributes
    ----------
    pair : BinnedPair
        The parts, positions counted from where each begins.
    origin, translation : (2,) array
        Where the reference image's part begins, and where the deformed image's part begins from there, pixels.
    """

    pair: BinnedPair
    origin: Array
    translation: Array

    def describe(self) -> str:
        """Say for the log what is looked at."""
        x, y = self.origin
        width, height = self.pair.size * self.pair.factor
        return (f"start: the region and what surrounds it, {width} x {height} px from ({x:.0f}, {y:.0f}) px on, in "
                f"blocks of {self.pair.factor} px")


def move_mesh(mesh: Mesh, vector: Array) -> Mesh:
    """Give a mesh, perhaps cut, at another place: moved by ``vector``, (2,), pixels."""
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
    """Square cells that hold active blocks, within a regular grid over the region's bounding box.

    Attributes
    ----------
    mesh : Mesh
        The cells, blocks.
    numbers : (mesh.n_nodes,) array of int64
        Numbers of its nodes in the full grid, row after row.
    shape : (rows, columns)
        Nodes of the full grid.
    origin, spacing : (2,) array
        The full grid's first node, and what is between its nodes, blocks.
    """

    mesh: Mesh
    numbers: IntArray
    shape: tuple[int, int]
    origin: Array
    spacing: Array

    def make_field(self, displacement: Array, pair: BinnedPair) -> GridField:
        """Make a field on the full grid, pixels, of displacements of the cells' nodes, (mesh.n_dofs,), blocks.

        Nodes without a cell have the nearest node's value.
        """
        values = np.full((*self.shape, 2), np.nan)
        values.reshape(-1, 2)[self.numbers] = displacement.reshape(-1, 2) * pair.factor
        x0, y0 = self.origin * pair.factor + pair.centre
        step_x, step_y = self.spacing * pair.factor
        return GridField((x0, y0), (step_x, step_y), fill_absent(values))


def build_grid(region: Mesh, active: NDArray[np.uint8]) -> BlockGrid:
    """Build a grid over a region in blocks, without the cells that have no active block.

    Its cells have a side of about ``CELL`` blocks; ``active``, (rows, columns), is 1 on the blocks that count.
    """
    # Pixels that fill no block may lie beyond the last one's edge.
    n_rows_of_blocks, n_columns_of_blocks = active.shape
    edge = np.array([n_columns_of_blocks, n_rows_of_blocks]) - 0.5
    low, high = np.maximum(region.nodes.min(axis=0), -0.5), np.minimum(region.nodes.max(axis=0), edge)
    n_columns, n_rows = np.maximum(np.round((high - low) / CELL).astype(int), 1)
    grid = GridLines(np.linspace(low[0], high[0], n_columns + 1), np.linspace(low[1], high[1], n_rows + 1))
    full = build_mesh(grid.nodes, {Q4: grid.quads})
    n_active = rasterize(full).sum_by_cell(active)
    mesh, numbers = full.create_submesh(np.flatnonzero(n_active > 0))
    shape = (int(n_rows) + 1, int(n_columns) + 1)
    spacing = (high - low) / (n_columns, n_rows)
    return BlockGrid(mesh, numbers, shape, low, spacing)


def choose_finest_block(n_pixels: int) -> int:
    """Find the side of the smallest blocks that the start looks at, pixels, in an image of ``n_pixels``."""
    return 1 if n_pixels <= LARGEST_FFT_IMAGE else find_finest_level(n_pixels)


def find_finest_level(n_pixels: int) -> int:
    """Find the side of the smallest blocks of the pyramid, pixels, in an image of ``n_pixels``."""
    finest = 2
    while n_pixels / finest**2 > LARGEST_COARSE_IMAGE:
        finest *= 2
    return finest


def choose_block_sizes(n_pixels: int, mesh: Mesh) -> list[int]:
    """Choose the block sizes of the pyramid's levels, pixels, coarsest first, in an image of ``n_pixels``.

    There are none where the region of the whole mesh, pixels, is smaller than a cell of each.
    """
    side = float(np.ptp(mesh.nodes, axis=0).min())
    sizes = [find_finest_level(n_pixels)]
    while sizes[-1] < COARSEST and side / (2 * sizes[-1]) >= SMALLEST_SIDE:
        sizes.append(2 * sizes[-1])
    return [size for size in reversed(sizes) if side / size >= CELL]


def choose_rigid_block(n_pixels: int, mesh: Mesh) -> int:
    """Choose the side of the blocks, pixels, in which a rigid translation of the whole mesh is sought."""
    region = float(np.prod(np.ptp(mesh.nodes, axis=0)))
    size = 1
    while True:
        n_blocks = n_pixels / size**2
        n_larger_blocks_of_region = region / (2 * size) ** 2
        is_too_large = n_blocks > LARGEST_FFT_IMAGE
        is_more_than_enough = n_blocks > ENOUGH_FFT_IMAGE and n_larger_blocks_of_region >= ENOUGH_BLOCKS
        if not (is_too_large or is_more_than_enough):
            return size
        size *= 2
