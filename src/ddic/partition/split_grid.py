"""Splits a grid of cells into rectangles, all of which every rank can work out."""

import numpy as np

from ddic.arrays import Array
from ddic.mesh.grid import GridBlock, GridLines


def split_grid(grid: GridLines, n_subdomains: int) -> list[GridBlock]:
    """Split into rectangles of about as many cells, at most one for each cell, by halving along the longer side."""
    return _halve(GridBlock(range(len(grid.x) - 1), range(len(grid.y) - 1)), n_subdomains)


def _halve(block: GridBlock, n: int) -> list[GridBlock]:
    """Rectangles of a block, n of them."""
    if n == 1:
        return [block]
    along, across = block if len(block.columns) >= len(block.rows) else block[::-1]
    half = n // 2
    middle = min(max(round(len(along) * half / n), 1), len(along) - 1)
    # Where there are few cells, each of the rectangles on either side needs one.
    half = min(max(half, n - (len(along) - middle) * len(across)), middle * len(across))
    low, high = along[:middle], along[middle:]
    sides = [GridBlock(low, across), GridBlock(high, across)]
    if along is not block.columns:
        sides = [GridBlock(across, low), GridBlock(across, high)]
    return [*_halve(sides[0], half), *_halve(sides[1], n - half)]


def split_grid_by_blocks(grid: GridLines, blocks: tuple[int, int]) -> list[GridBlock]:
    """Split into columns and rows of blocks, as ``split_by_blocks`` splits a mesh of the grid."""
    columns, rows = (_split_line(line, n) for line, n in zip((grid.x, grid.y), blocks, strict=True))
    # The first axis varies fastest.
    return [GridBlock(of_columns, of_rows) for of_rows in rows for of_columns in columns]


def _split_line(line: Array, n: int) -> list[range]:
    """Ranges of cells along a line whose middles lie in each of n equal parts of it, where there are any."""
    middles = (line[1:] + line[:-1]) / 2
    place = np.minimum(np.floor((middles - line[0]) / (line[-1] - line[0]) * n), n - 1)
    _, first, counts = np.unique(place, return_index=True, return_counts=True)
    return [range(int(begin), int(begin + count)) for begin, count in zip(first, counts, strict=True)]
