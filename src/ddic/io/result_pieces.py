"""Mesh and fields of a result file, one piece per subdomain, and where in the file each of them goes.

Pieces follow each other in every array of the file. Whoever knows how much comes before a piece places it, whether or
not it has the others.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.io import result_schema as schema
from ddic.io.hdf5_file import Arrays
from ddic.io.new_hdf5 import Block, NewHdf5, Rows
from ddic.io.result_schema import FieldSpec


class PieceCounts(NamedTuple):
    """How much there is in some pieces.

    Attributes
    ----------
    n_pieces, n_points, n_cells, n_connectivity : int
        The last is the sum of the points per cell.
    """

    n_pieces: int
    n_points: int
    n_cells: int
    n_connectivity: int


NOTHING = PieceCounts(0, 0, 0, 0)


@dataclass(frozen=True)
class Piece:
    """A subdomain's mesh and fields, or those of several subdomains that follow each other.

    Attributes
    ----------
    points : (n_points, dim) array
        Pixels, y down.
    connectivity : (n_connectivity,) array
        Numbers of the piece's own points.
    offsets : (n_cells + 1,) array
        Of each piece.
    types : (n_cells,) array
        VTK cell types.
    point_data, cell_data : dict of (n,), (n, dim), (n, 3) or (n, 6) array
        By name: scalars, vectors, symmetric tensors.
    """

    points: Array
    connectivity: IntArray
    offsets: IntArray
    types: NDArray[np.uint8]
    point_data: Arrays
    cell_data: Arrays


def count_piece(piece: Piece) -> PieceCounts:
    """Count what one subdomain's piece has."""
    return PieceCounts(1, len(piece.points), len(piece.types), len(piece.connectivity))


def add_counts(counts: Sequence[PieceCounts]) -> PieceCounts:
    """Count what several pieces have together."""
    return PieceCounts(*(sum(column) for column in zip(*counts, strict=True))) if counts else NOTHING


def join_pieces(pieces: Sequence[Piece]) -> Piece:
    """Join pieces, at least one, as the file holds them: one after the other, each numbering its own points from 0."""
    if len(pieces) == 1:
        return pieces[0]

    def fields(all_of: Sequence[Arrays]) -> dict[str, NDArray[Any]]:
        return {name: np.concatenate([one[name] for one in all_of]) for name in all_of[0]}

    return Piece(np.concatenate([p.points for p in pieces]), np.concatenate([p.connectivity for p in pieces]),
                 np.concatenate([p.offsets for p in pieces]), np.concatenate([p.types for p in pieces]),
                 fields([p.point_data for p in pieces]), fields([p.cell_data for p in pieces]))


@dataclass(frozen=True)
class PieceLayout:
    """Where the arrays of a mesh in pieces are in a file, and which fields every piece brings.

    Attributes
    ----------
    rows : dict of Rows
        Places of the arrays, by their names in the file.
    fields : dict of tuple of FieldSpec
        Those at the points and on the cells, by group.
    flip_y : bool
        Whether the file has y upwards.
    """

    rows: dict[str, Rows]
    fields: dict[str, tuple[FieldSpec, ...]]
    flip_y: bool

    def place(self, before: PieceCounts, counts: Sequence[PieceCounts], pieces: Piece) -> list[Block]:
        """Place joined pieces, ``counts`` of each, behind what comes ``before``; raises ValueError for other counts."""
        return [block for block in self._place(before, counts, pieces) if len(block.data)]

    def _place(self, before: PieceCounts, counts: Sequence[PieceCounts], pieces: Piece) -> Iterator[Block]:
        n_pieces, n_points, n_cells, n_connectivity = add_counts(counts)

        def place(name: str, first: int, n_rows: int, values: NDArray[Any]) -> Block:
            if len(values) != n_rows:
                raise ValueError(f"{name}: {len(values)} rows, {n_rows} announced")
            return self.rows[name].place_values(first, values)

        for name, column in zip(schema.PIECES, list(zip(*counts, strict=True))[1:], strict=True):
            yield place(f"{schema.VTKHDF}/{name}", before.n_pieces, n_pieces, np.array(column))
        points = self._orient(_three_components(np.asarray(pieces.points, np.float64)))
        yield place(f"{schema.VTKHDF}/Points", before.n_points, n_points, points)
        yield place(f"{schema.VTKHDF}/Connectivity", before.n_connectivity, n_connectivity, pieces.connectivity)
        # Each piece has one offset more than cells.
        yield place(f"{schema.VTKHDF}/Offsets", before.n_cells + before.n_pieces, n_cells + n_pieces, pieces.offsets)
        yield place(f"{schema.VTKHDF}/Types", before.n_cells, n_cells, pieces.types)
        for group, first, n_rows, arrays in ((schema.POINT_DATA, before.n_points, n_points, pieces.point_data),
                                             (schema.CELL_DATA, before.n_cells, n_cells, pieces.cell_data)):
            if {field.name for field in self.fields[group]} != set(arrays):
                announced = sorted(field.name for field in self.fields[group])
                raise ValueError(f"{group}: fields {sorted(arrays)}, {announced} announced")
            for field in self.fields[group]:
                arranged = self._arrange(field, np.asarray(arrays[field.name]))
                yield place(f"{group}/{field.name}", first, n_rows, arranged)

    def _arrange(self, field: FieldSpec, values: NDArray[Any]) -> NDArray[Any]:
        """A field as the file has it."""
        if field.n_components == schema.VECTOR:
            values = _three_components(values)
        return self._orient(values) if field.axes == schema.AXES_OF_IMAGE else values

    def _orient(self, values: NDArray[Any]) -> NDArray[Any]:
        """Vectors and tensors in the file's axes."""
        return schema.flip_components(values) if self.flip_y else values


def create_mesh(new: NewHdf5, total: PieceCounts, point_fields: Sequence[FieldSpec], cell_fields: Sequence[FieldSpec],
                *, flip_y: bool) -> PieceLayout:
    """Make room in a file for a mesh in pieces, ``total`` of all, and for the fields that every piece brings."""
    group = schema.create_vtk_group(new.file, "UnstructuredGrid").name.strip("/")
    rows: dict[str, Rows] = {}
    for name in schema.PIECES:
        rows[f"{group}/{name}"] = new.create_rows(f"{group}/{name}", (total.n_pieces,), np.int64)[1]
    for name, shape, dtype in (("Points", (total.n_points, 3), np.float64),
                               ("Connectivity", (total.n_connectivity,), np.int64),
                               ("Offsets", (total.n_cells + total.n_pieces,), np.int64),
                               ("Types", (total.n_cells,), np.uint8)):
        rows[f"{group}/{name}"] = new.create_rows(f"{group}/{name}", shape, dtype)[1]
    new.file[f"{group}/Points"].attrs["unit"] = "px"
    fields = {schema.POINT_DATA: tuple(point_fields), schema.CELL_DATA: tuple(cell_fields)}
    for name, n_rows in ((schema.POINT_DATA, total.n_points), (schema.CELL_DATA, total.n_cells)):
        new.file.create_group(name)
        for field in fields[name]:
            shape = (n_rows,) if field.n_components == 1 else (n_rows, field.n_components)
            created, rows[f"{name}/{field.name}"] = new.create_rows(f"{name}/{field.name}", shape, field.dtype)
            created.attrs.update(unit=field.unit, description=field.description, axes=field.axes)
    return PieceLayout(rows, fields, flip_y)


def _three_components(vectors: NDArray[Any]) -> NDArray[Any]:
    """Vectors with zeros for the components that they do not have, (n, 3)."""
    if vectors.ndim != 2 or vectors.shape[1] > 3:
        raise ValueError(f"vectors of shape {vectors.shape}, (n, dim) expected")
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
