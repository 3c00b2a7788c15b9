"""Results of volumes, written by one process: fields that grow linearly, so that all in a cell is known exactly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.images.window import Window
from ddic.io import result_schema as schema
from ddic.io.image_chunks import ChunkGrid
from ddic.io.result_pieces import Piece
from ddic.io.result_writer import ResultWriter
from ddic.mesh.cell_type import TET4
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.structured import build_grid_lines
from support.random_meshes import WAYS
from support.residual_images import write_residual_image

BOX = (6.0, 8.0, 10.0, 54.0, 40.0, 34.0)
"""Of the mesh: 6 x 4 x 3 cells of 8 voxels."""

SIZES = (60, 50, 45)
"""Voxels of the volume along x, y and z."""

HOLE = np.array([[22.0, 16.0, 18.0], [30.0, 24.0, 26.0]])
"""Opposite corners of a cube that is no part of the mesh."""


def build_volume_mesh(kind: str = "Hex8", box: tuple[float, ...] = BOX, size: float = 8.0) -> Mesh:
    """Cubes, or tetrahedra that fill them, without those in the hole."""
    cubes = build_grid_lines(box, size).build_mesh()
    kept = cubes.cells[~((cubes.centroids > HOLE[0]) & (cubes.centroids < HOLE[1])).all(axis=1)]
    cells = {TET4: kept[:, WAYS].reshape(-1, 4)} if kind == "Tet4" else {cubes.cell_blocks[0].type: kept}
    return build_mesh(cubes.nodes, cells)


def displace(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacement at points (n, 3), voxels."""
    return points @ np.array([[4.0, 1.0, 0.0], [-1.0, 2.0, 0.5], [0.5, -3.0, -2.0]]).T * 1e-3 + [0.4, -0.2, 0.1]


def strain(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """A tensor at points as a file has it, (n, 6), whose components are all unlike."""
    return 1e-4 * (np.arange(1.0, 7.0) + 0.01 * np.arange(6.0, 0.0, -1.0) * (points @ [1.0, 2.0, 3.0])[:, None])


def make_residual(sizes: tuple[int, ...] = SIZES) -> NDArray[np.float32]:
    """A residual volume, (z, y, x), nan in its first planes."""
    image = np.random.default_rng(3).normal(0.0, 2.0, sizes[::-1]).astype(np.float32)
    image[:2] = np.nan
    return image


def make_volume(sizes: tuple[int, ...] = SIZES) -> NDArray[np.uint8]:
    """Grey levels of a volume, (z, y, x)."""
    return np.random.default_rng(5).integers(20, 235, sizes[::-1], dtype=np.uint8)


def write_volume_result(path: Path, mesh: Mesh, *, residual: NDArray[np.float32] | None = None, reference: str = "",
                        length_unit: str | None = None) -> Path:
    """Write a result in two pieces, the cells before and after x = 30."""
    point_fields = (*schema.point_fields(length_unit), *schema.nodal_strain_fields(3),
                    *schema.uncertainty_point_fields(3, regularized=True))
    with ResultWriter(path, flip_y=False) as writer:
        writer.write_pieces([_cut(mesh, part, length_unit) for part in (0, 1)], point_fields, schema.cell_fields())
        if residual is not None:
            grid = ChunkGrid(Window.of_size(*residual.shape[::-1]))
            padded = np.full([-(-n // c) * c for n, c in zip(residual.shape, grid.shape, strict=True)], np.nan)
            padded[tuple(map(slice, residual.shape))] = residual
            whole = Window.of_size(*padded.shape[::-1])
            chunks = {number: padded[whole.locate(grid.locate_chunk(number))]
                      for number in grid.find_chunks(grid.extent)}
            write_residual_image(writer, grid, chunks)
        writer.write_table(schema.GAUSS_NEWTON, {"iteration": [1, 2], "residual_std_grey": [3.0, 2.5],
                                                  "rms_correction_px": [0.1, 0.01]})
        writer.write_curves(schema.KRYLOV, [[1.0, 0.1, 0.001]])
        writer.write_attributes(schema.CASE, {"json": '{"volumes": {"voxel_size": 0.5, "length_unit": "mm"}}',
                                              "toml": "title = 'foam'\n"})
        writer.write_attributes(schema.PROVENANCE, {"reference_path": reference, "n_ranks": 2,
                                                    "reference_size": "x".join(map(str, SIZES))})
        writer.write_attributes(schema.TIME, {"reference": 0.0, "deformed": 1.0})
        if length_unit is not None:
            writer.write_attributes(schema.UNITS, {"pixel_size": 0.5, "length_unit": length_unit})
        writer.write_status("", schema.Verdict(schema.TRUST))
    return path


def _cut(mesh: Mesh, part: int, length_unit: str | None) -> Piece:
    cells = np.flatnonzero((mesh.centroids[:, 0] > 30) == part)
    sub, node_ids = mesh.create_submesh(cells)
    u, tensor = displace(sub.nodes), strain(sub.nodes)
    points = {schema.DISPLACEMENT: u, schema.DISPLACEMENT_MESH_UNITS: u, schema.GLOBAL_NODE_ID: node_ids,
              schema.REGULARIZATION_BIAS: 0.1 * u}
    if length_unit is not None:
        points[schema.DISPLACEMENT_PHYSICAL] = 0.5 * u
    points |= dict.fromkeys(schema.NODAL_STRAINS.values(), tensor)
    for names in (schema.NODAL_PRINCIPAL, schema.SIGMA_DISPLACEMENT):
        points |= dict(zip(names, u.T, strict=True))
    points |= {name: 1e-5 * tensor[:, k] for k, name in enumerate(schema.list_sigma_strains(3))}
    points[schema.NODAL_VON_MISES] = tensor[:, 0]
    on_cells = {spec.name: np.zeros(len(cells), spec.dtype) for spec in schema.cell_fields()}
    of_cells = strain(sub.centroids)
    on_cells |= {schema.STRAIN_INFINITESIMAL: of_cells, schema.STRAIN_GREEN_LAGRANGE: of_cells,
                 schema.RESIDUAL_RMS: 1.0 + cells, schema.GLOBAL_CELL_ID: cells,
                 schema.SUBDOMAIN_ID: np.full(len(cells), part, np.int32)}
    return Piece(sub.nodes, sub.connectivity, sub.offsets, sub.types, points, on_cells)
