from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.images.window import Window
from ddic.io import result_schema as schema
from ddic.io.image_chunks import ChunkGrid
from ddic.io.result_pieces import Piece
from ddic.io.result_writer import ResultWriter
from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.mesh import Mesh, build_mesh
from support.residual_images import write_residual_image

COLUMNS, ROWS, SIDE = 4, 3, 10.0


def small_mesh() -> Mesh:
    """4 x 3 squares of 10 px from (5, 7); the last square of each row is cut into two triangles."""
    x, y = np.meshgrid(np.arange(COLUMNS + 1), np.arange(ROWS + 1))
    nodes = np.stack([5 + SIDE * x.ravel(), 7 + SIDE * y.ravel()], axis=1)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)))
    a = j * (COLUMNS + 1) + i
    squares = np.stack([a, a + 1, a + COLUMNS + 2, a + COLUMNS + 1], axis=1)
    cut = squares[i == COLUMNS - 1]
    return build_mesh(nodes, {Q4: squares[i < COLUMNS - 1],
                                   T3: np.concatenate([cut[:, :3], cut[:, [2, 3, 0]]])})


def quadratic(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """A displacement that no rigid motion explains, pixels."""
    x, y = points.T
    return np.stack([0.1 + 1e-3 * x**2 - 0.02 * y, -0.3 + 0.01 * x + 2e-3 * y**2], axis=1)


def subdomain_of(mesh: Mesh) -> NDArray[np.int64]:
    return (mesh.centroids[:, 0] > 25).astype(np.int64)


def pieces_of(mesh: Mesh, extra: str | None = None, unmeasured: Sequence[int] = ()) -> list[Piece]:
    pieces = []
    for s in (0, 1):
        cells = np.flatnonzero(subdomain_of(mesh) == s)[::-1].copy()
        sub, node_ids = mesh.create_submesh(cells)
        u = quadratic(sub.nodes)
        u[np.isin(node_ids, unmeasured)] = np.nan
        tensor = np.arange(6.0) + cells[:, None]
        points = {schema.DISPLACEMENT: u, schema.DISPLACEMENT_MESH_UNITS: u / 4, schema.GLOBAL_NODE_ID: node_ids}
        if extra is not None:
            points[schema.DISPLACEMENT_PHYSICAL] = u * 0.02
        pieces.append(Piece(sub.nodes, sub.connectivity, sub.offsets, sub.types, points, {
            schema.STRAIN_INFINITESIMAL: tensor, schema.STRAIN_GREEN_LAGRANGE: -tensor,
            schema.RESIDUAL_RMS: 1.0 + cells, schema.RESIDUAL_N_PIXELS: 100 + cells,
            schema.EQUIVALENT_ERROR: 0.01 * cells, schema.DOUBTFUL: (cells % 3 == 0).astype(np.uint8),
            schema.EXCLUDED: (cells % 2).astype(np.uint8),
            schema.SUBDOMAIN_ID: np.full(len(cells), s, np.int32), schema.GLOBAL_CELL_ID: cells}))
    return pieces


def residual_of(width: int, height: int) -> NDArray[np.float32]:
    image = np.random.default_rng(3).normal(0, 2, (height, width)).astype(np.float32)
    image[:3] = np.nan
    return image


@pytest.fixture
def mesh() -> Mesh:
    return small_mesh()


@pytest.fixture
def pieces(mesh: Mesh) -> list[Piece]:
    return pieces_of(mesh)


@pytest.fixture
def write_result() -> Callable[..., Path]:
    """Write a result in two pieces."""

    def write(path: Path, *, flip_y: bool = False, length_unit: str | None = None, residual: bool = True,
              reference: str = "", curves: bool = True, unmeasured: Sequence[int] = ()) -> Path:
        pieces = pieces_of(small_mesh(), length_unit, unmeasured)
        with ResultWriter(path, flip_y=flip_y) as writer:
            writer.write_pieces(pieces, schema.point_fields(length_unit), schema.cell_fields())
            if residual:
                write_residual_image(writer, ChunkGrid(Window.of_size(60, 50)), {0: residual_of(60, 50)})
            writer.write_table(schema.GAUSS_NEWTON, {"iteration": [1, 2], "residual_std_grey": [3.0, 2.5]})
            writer.write_curves(schema.KRYLOV, [[1.0, 0.1, 0.001], [1.0, 1e-4]] if curves else [[], []])
            writer.write_attributes(schema.CASE, {"toml": "title = 'é'\n" * 20_000, "eta": 0.5})
            writer.write_attributes(schema.PROVENANCE, {"reference_path": reference, "n_ranks": 2})
        return path

    return write


@pytest.fixture
def residual() -> NDArray[np.float32]:
    return residual_of(60, 50)


@pytest.fixture
def field() -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    return quadratic
