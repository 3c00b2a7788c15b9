"""The result file of a measurement, streamed through rank 0 piece by piece."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.case.loader import LoadedCase
from ddic.functionals.correlation import Residual
from ddic.io import result_schema as schema
from ddic.io.image_chunks import ChunkGrid
from ddic.io.result_writer import Piece, PieceSize, ResultWriter, joined
from ddic.kinematics.strain import cell_strain
from ddic.methods.dd_dic import Measurement
from ddic.parallel.team import Team
from ddic.results.near_attributes import near_attributes
from ddic.results.phase_times import PhaseTimes
from ddic.results.provenance import provenance
from ddic.results.residual_image import PackedChunk, Patch, packed_chunks, to_root
from ddic.solvers.gauss_newton import IterationRecord, OwnedPart, gain_and_offset

BATCH_POINTS = 1 << 14
"""Points from which on pieces are sent and written together (about 6 MB)."""

_BATCH = 1


@dataclass(frozen=True)
class Batch:
    """Pieces that follow each other, joined."""

    n_pieces: int
    pieces: Piece


def publish(team: Team, loaded: LoadedCase, measurement: Measurement, times: PhaseTimes) -> None:
    """Write the result file; collective, only rank 0 touches the disk. times: of the phases before."""
    sizes = team.gather_lists([_size(part) for part in measurement.parts])
    owned = team.gather_lists([len(measurement.parts)])
    batches = _batches(_pieces(loaded, measurement))
    if not team.is_root:
        for batch in batches:
            with team.waiting.counted():
                team.comm.send(batch, dest=0, tag=_BATCH)
        for camera in range(len(measurement.pairs)):
            for _ in _chunks(team, loaded, measurement, camera):
                pass
        return
    length_unit = None if loaded.case.images.pixel_size is None else loaded.case.images.length_unit
    with ResultWriter(loaded.case.output.file, sizes, schema.point_fields(length_unit),
                      schema.cell_fields(len(measurement.pairs)), flip_y=loaded.case.output.flip_y) as writer:
        for indices, pieces in _all_batches(team, owned, batches):
            writer.write_pieces(indices, pieces)
        _write_histories(writer, measurement.records)
        _write_times(writer, times)
        _write_attributes(writer, team, loaded, measurement)
        for camera in range(len(measurement.pairs) if loaded.case.output.residual_image else 0):
            writer.create_residual_image(_grid(measurement, camera))
            for chunk in _chunks(team, loaded, measurement, camera):
                writer.write_residual_chunk(chunk.number, chunk.data)


def _batches(pieces: Iterator[Piece]) -> Iterator[Batch]:
    """Join pieces up to a size that bounds what rank 0 holds at a time."""
    held: list[Piece] = []
    for piece in pieces:
        held.append(piece)
        if sum(len(p.points) for p in held) >= BATCH_POINTS:
            yield Batch(len(held), joined(held))
            held = []
    if held:
        yield Batch(len(held), joined(held))


def _all_batches(team: Team, owned: Sequence[int], own: Iterator[Batch]) -> Iterator[tuple[range, Piece]]:
    """All ranks' batches on rank 0, in the order of subdomains, with their numbers."""
    begin = 0
    for rank, n_pieces in enumerate(owned):
        end = begin + n_pieces
        while begin < end:
            batch = next(own) if rank == 0 else _received(team, rank)
            yield range(begin, begin + batch.n_pieces), batch.pieces
            begin += batch.n_pieces


def _received(team: Team, rank: int) -> Batch:
    with team.waiting.counted():
        batch: Batch = team.comm.recv(source=rank, tag=_BATCH)
    return batch


def _size(part: OwnedPart) -> PieceSize:
    mesh = part.subdomain.mesh
    return PieceSize(mesh.n_nodes, mesh.n_cells, len(mesh.connectivity))


def _pieces(loaded: LoadedCase, measurement: Measurement) -> Iterator[Piece]:
    for part, q, residuals in zip(measurement.parts, measurement.field.q, measurement.residuals, strict=True):
        mesh, subdomain, residual = part.subdomain.mesh, part.subdomain, residuals[0]
        u = q.reshape(mesh.nodes.shape)
        point_data: dict[str, NDArray[Any]] = {
            schema.DISPLACEMENT: u,
            schema.DISPLACEMENT_MESH_UNITS: measurement.region.mapping.vector_to_mesh_units(u),
            schema.GLOBAL_NODE_ID: subdomain.mesh_node_ids,
        }
        if loaded.case.images.pixel_size is not None:
            point_data[schema.DISPLACEMENT_PHYSICAL] = u * loaded.case.images.pixel_size
        strain = cell_strain(mesh, q)
        cell_data: dict[str, NDArray[Any]] = {
            schema.STRAIN_INFINITESIMAL: _six_components(strain.infinitesimal),
            schema.STRAIN_GREEN_LAGRANGE: _six_components(strain.green_lagrange),
            schema.RESIDUAL_RMS: _residual_rms(loaded, measurement, part.view.camera, residual),
            schema.RESIDUAL_N_PIXELS: residual.cell_sums.n_pixels.astype(np.int64),
            schema.SUBDOMAIN_ID: np.full(mesh.n_cells, subdomain.index, dtype=np.int32),
            schema.GLOBAL_CELL_ID: subdomain.cell_ids,
        }
        if len(measurement.pairs) > 1:
            cell_data[schema.CAMERA] = np.full(mesh.n_cells, subdomain.camera, dtype=np.int32)
        yield Piece(mesh.nodes, mesh.connectivity, mesh.offsets, mesh.types, point_data, cell_data)


def _six_components(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    """In-plane (xx, yy, xy) as VTK's (xx, yy, zz, xy, yz, xz)."""
    zero = np.zeros(len(tensor))
    return np.stack([tensor[:, 0], tensor[:, 1], zero, tensor[:, 2], zero, zero], axis=1)


def _residual_rms(loaded: LoadedCase, measurement: Measurement, camera: int,
                  residual: Residual) -> NDArray[np.float64]:
    correction = loaded.case.correlation.grey_correction
    _, square = residual.cell_sums.sum_residual(*gain_and_offset(residual, measurement.grey[camera], correction))
    n = residual.cell_sums.n_pixels
    return np.where(n > 0, np.sqrt(square / np.maximum(n, 1.0)), np.nan)


def _grid(measurement: Measurement, camera: int) -> ChunkGrid:
    image = measurement.pairs[camera].reference.image
    return ChunkGrid(image.width, image.height)


def _chunks(team: Team, loaded: LoadedCase, measurement: Measurement, camera: int) -> Iterator[PackedChunk]:
    """Chunks of a camera's residual image on rank 0, nothing elsewhere and where the case wants no image."""
    if not loaded.case.output.residual_image:
        return
    windows = [view.correlation.reference.window for part in measurement.parts for view in part.views
               if view.camera == camera]
    patches = _patches(loaded, measurement, camera)
    yield from to_root(team, packed_chunks(team, _grid(measurement, camera), windows, patches))


def _patches(loaded: LoadedCase, measurement: Measurement, camera: int) -> Iterator[Patch]:
    correction = loaded.case.correlation.grey_correction
    for part, q, residuals in zip(measurement.parts, measurement.unknowns, measurement.residuals, strict=True):
        for view, residual in zip(part.views, residuals, strict=True):
            if view.camera == camera:
                gain, offset = gain_and_offset(residual, measurement.grey[camera], correction)
                yield Patch(view.correlation.reference.window, view.residual_image(q, gain, offset))


def _write_histories(writer: ResultWriter, records: Sequence[IterationRecord]) -> None:
    writer.write_table(schema.GAUSS_NEWTON, {
        "iteration": [r.number for r in records],
        "relative_correction": [r.relative for r in records],
        "rms_correction_px": [r.rms for r in records],
        "residual_std_grey": [r.grey.residual_std for r in records],
        "residual_rms_grey": [r.grey.residual_rms for r in records],
        "n_pixels": [r.grey.n_pixels for r in records],
        "gain": [r.grey.gain for r in records],
        "offset": [r.grey.offset for r in records],
        **{f"near_{k}_residual_std_grey": [r.cameras[k].residual_std for r in records]
           for k in range(1, len(records[0].cameras))},
        "krylov_iterations": [r.krylov_iterations for r in records],
        "linear_error_px": [r.linear_error for r in records],
    })
    writer.write_curves(schema.KRYLOV, [r.krylov_history for r in records])


def _write_times(writer: ResultWriter, times: PhaseTimes) -> None:
    writer.write_table(schema.PHASES, {
        "phase": list(times.seconds),
        "seconds": list(times.seconds.values()),
        "cpu_seconds": list(times.cpu_seconds.values()),
        "imbalance": list(times.imbalance.values()),
    })


def _write_attributes(writer: ResultWriter, team: Team, loaded: LoadedCase, measurement: Measurement) -> None:
    images = loaded.case.images
    writer.write_attributes(schema.CASE, {
        "path": str(loaded.path), "toml": loaded.text, "json": loaded.case.model_dump_json(),
        "eta": measurement.setting.eta, "largest_jump_px": measurement.field.largest_jump,
    })
    writer.write_attributes(schema.TIME, {"reference": images.reference_time, "deformed": images.deformed_time})
    writer.write_attributes(schema.UNITS, {"pixel_size": images.pixel_size or 1.0, "length_unit": images.length_unit})
    for motion in measurement.motions:
        writer.write_attributes(schema.near_group(motion.camera), near_attributes(measurement, motion))
    pair = measurement.pairs[0]
    writer.write_attributes(schema.PROVENANCE, provenance(
        pair.reference.image, pair.deformed.image, n_ranks=team.size, n_subdomains=measurement.region.n_subdomains))
