"""Result files of series on a small mesh, without images: frames of a bar that is pulled evenly."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ddic.images.window import Window
from ddic.io import result_schema as schema
from ddic.io.image_chunks import ChunkGrid
from ddic.io.replace_on_exit import replaced_together
from ddic.io.result_pieces import Piece
from ddic.io.result_writer import ResultWriter
from ddic.io.series_writer import SeriesFolder, join_frames
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.results.summary import FrameRecord
from support.residual_images import write_residual_image

MESH = build_structured_mesh((10.0, 10.0, 50.0, 30.0), 10.0)
STRAIN = 0.01
"""Along x, of a frame whose time is 1; half as much the other way along y, a quarter along z."""


@dataclass(frozen=True)
class FrameFile:
    """A frame of a series: its time, and into how many parts its mesh is cut; 0 parts where it was not measured."""

    time: float
    n_parts: int = 2
    mesh: Mesh = field(default=MESH, repr=False)


def displace(points: NDArray[np.float64], time: float) -> NDArray[np.float64]:
    """Displacement of points (n, dim) at a time, pixels."""
    return time * STRAIN * points * [1.0, -0.5, 0.25][:points.shape[1]]


def write_series_file(path: Path, frames: Sequence[FrameFile], *, flip_y: bool = False, length_unit: str | None = None,
                      residual: bool = False, estimated: Collection[int] = ()) -> Path:
    """Write a series by the way a run takes: a file for each frame, then one of all.

    ``estimated`` are the frames, from 1, that have a field of errors, their number at all nodes.
    """
    folder = SeriesFolder(path, len(frames))
    folder.path.mkdir()
    records = []
    for number, frame in enumerate(frames, start=1):
        image = f"/images/frame_{number}.tif"
        if frame.n_parts == 0:
            records.append(FrameRecord(number, image, frame.time, converged=False, failure="the images do not match"))
            continue
        records.append(FrameRecord(number, image, frame.time, converged=True, iterations=2 + number,
                                   residual_std_grey=1.0 + 0.1 * number, noise_floor_px=0.004,
                                   started_from="the last frame" if number > 1 else "a search"))
        _write_frame(folder.get_frame_path(number), frame, number, (flip_y, length_unit, residual))
        if number in estimated:
            with h5py.File(folder.get_frame_path(number), "r+") as file:
                of_points = file[schema.POINT_DATA]
                of_points[schema.SIGMA_DISPLACEMENT[0]] = np.full(len(of_points[schema.DISPLACEMENT]), float(number))
    with replaced_together() as files:
        join_frames(folder, [record.number for record in records if record.converged],
                    [record.as_json() for record in records], "{}", files)
    folder.remove()
    return path


def _write_frame(path: Path, frame: FrameFile, number: int, form: tuple[bool, str | None, bool]) -> None:
    flip_y, length_unit, residual = form
    pieces = [_cut(frame, part, length_unit) for part in range(frame.n_parts)]
    with ResultWriter(path, flip_y=flip_y) as writer:
        writer.write_pieces(pieces, (*schema.point_fields(length_unit), *schema.nodal_strain_fields(frame.mesh.dim)),
                            schema.cell_fields())
        if residual:
            grid = ChunkGrid(Window.of_size(*(60, 40, 20)[:frame.mesh.dim]))
            write_residual_image(writer, grid, {0: np.full(grid.shape, float(number))})
        iterations = list(range(1, 3 + number))
        writer.write_table(schema.GAUSS_NEWTON, {"iteration": iterations, "residual_std_grey": [2.5] * len(iterations)})
        writer.write_curves(schema.KRYLOV, [[1.0, 10.0**-number]])
        writer.write_attributes(schema.CASE, {"json": "{}", "toml": "title = 'bar'\n"})
        writer.write_attributes(schema.PROVENANCE, {"reference_path": "", "n_ranks": 1})
        writer.write_attributes(schema.TIME, {"reference": 0.0, "deformed": frame.time})
        if length_unit is not None:
            writer.write_attributes(schema.UNITS, {"pixel_size": 0.5, "length_unit": length_unit})
        writer.write_status("", schema.Verdict(schema.LOOK, (f"a place of frame {number}",)))


def _cut(frame: FrameFile, part: int, length_unit: str | None) -> Piece:
    """Part of a frame: cells are dealt out by columns."""
    mesh = frame.mesh
    rank = np.argsort(np.argsort(mesh.centroids[:, 0], kind="stable"))
    cells = np.flatnonzero(rank * frame.n_parts // mesh.n_cells == part)
    sub, node_ids = mesh.create_submesh(cells)
    u = displace(sub.nodes, frame.time)
    at_nodes: dict[str, NDArray[Any]] = {schema.DISPLACEMENT: u, schema.DISPLACEMENT_MESH_UNITS: u,
                                         schema.GLOBAL_NODE_ID: node_ids}
    if length_unit is not None:
        at_nodes[schema.DISPLACEMENT_PHYSICAL] = 0.5 * u
    dim = mesh.dim
    tensor = frame.time * STRAIN * np.array([1.0, -0.5, 0.25 if dim == 3 else 0.0, 0.0, 0.0, 0.0])
    for name in (schema.NODAL_INFINITESIMAL, schema.NODAL_GREEN_LAGRANGE, schema.NODAL_HENCKY):
        at_nodes[name] = np.tile(tensor, (len(sub.nodes), 1))
    values = (*sorted(tensor[:dim], reverse=True), tensor[0])
    for name, value in zip((*schema.NODAL_PRINCIPAL[:dim], schema.NODAL_VON_MISES), values, strict=True):
        at_nodes[name] = np.full(len(sub.nodes), value)
    on_cells = {spec.name: np.zeros(len(cells), spec.dtype) for spec in schema.cell_fields()}
    on_cells |= {schema.STRAIN_INFINITESIMAL: np.tile(tensor, (len(cells), 1)),
                 schema.STRAIN_GREEN_LAGRANGE: np.tile(tensor, (len(cells), 1)),
                 schema.RESIDUAL_RMS: frame.time + cells / 100, schema.GLOBAL_CELL_ID: cells,
                 schema.SUBDOMAIN_ID: np.full(len(cells), part, np.int32)}
    return Piece(sub.nodes, sub.connectivity, sub.offsets, sub.types, at_nodes, on_cells)
