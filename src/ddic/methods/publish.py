"""The result file of a measurement, streamed through rank 0 piece by piece."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.case.loader import LoadedCase
from ddic.functionals.correlation import Residual
from ddic.functionals.strain import cell_strain
from ddic.io import result_schema as schema
from ddic.io.result_writer import Piece, PieceSize, ResultWriter
from ddic.methods.dd_dic import Measurement
from ddic.methods.provenance import provenance
from ddic.parallel.distribution import owners
from ddic.parallel.team import Team
from ddic.solvers.gauss_newton import IterationRecord, OwnedPart

STRIP_ROWS = 512
_PIECE = 1


@dataclass(frozen=True)
class Patch:
    """A rectangle of the residual image, NaN where its subdomain has no pixel; x0, y0: its first pixel."""

    x0: int
    y0: int
    values: NDArray[np.float32]


def publish(team: Team, loaded: LoadedCase, measurement: Measurement) -> None:
    """Write the result file; collective, only rank 0 touches the disk."""
    sizes = team.gather_lists([_size(part) for part in measurement.parts])
    pieces = _pieces(loaded, measurement)
    patches = _patches(loaded, measurement) if loaded.case.output.residual_image else []
    if not team.is_root:
        for piece in pieces:
            team.comm.send(piece, dest=0, tag=_PIECE)
        if loaded.case.output.residual_image:
            for _ in _strips(team, measurement, patches):
                pass
        return
    length_unit = None if loaded.case.images.pixel_size is None else loaded.case.images.length_unit
    with ResultWriter(loaded.case.output.file, sizes, schema.point_fields(length_unit), schema.cell_fields(),
                      flip_y=loaded.case.output.flip_y) as writer:
        for rank, owned in enumerate(owners(measurement.region.n_subdomains, team.size)):
            for index in owned:
                writer.write_piece(index, next(pieces) if rank == 0 else team.comm.recv(source=rank, tag=_PIECE))
        _write_histories(writer, measurement.records)
        _write_attributes(writer, team, loaded, measurement)
        if loaded.case.output.residual_image:
            writer.create_residual_image(measurement.pair.reference.image.width,
                                         measurement.pair.reference.image.height)
            for y0, strip in _strips(team, measurement, patches):
                writer.write_residual_strip(y0, strip)


def _size(part: OwnedPart) -> PieceSize:
    mesh = part.subdomain.mesh
    return PieceSize(mesh.n_nodes, mesh.n_cells, len(mesh.connectivity))


def _pieces(loaded: LoadedCase, measurement: Measurement) -> Iterator[Piece]:
    for part, q, residual in zip(measurement.parts, measurement.field.q, measurement.residuals, strict=True):
        mesh, subdomain = part.subdomain.mesh, part.subdomain
        u = q.reshape(mesh.nodes.shape)
        point_data: dict[str, NDArray[Any]] = {
            schema.DISPLACEMENT: u,
            schema.DISPLACEMENT_MESH_UNITS: measurement.region.mapping.vector_to_mesh_units(u),
            schema.GLOBAL_NODE_ID: subdomain.node_ids,
        }
        if loaded.case.images.pixel_size is not None:
            point_data[schema.DISPLACEMENT_PHYSICAL] = u * loaded.case.images.pixel_size
        strain = cell_strain(mesh, q)
        cell_data: dict[str, NDArray[Any]] = {
            schema.STRAIN_INFINITESIMAL: _six_components(strain.infinitesimal),
            schema.STRAIN_GREEN_LAGRANGE: _six_components(strain.green_lagrange),
            schema.RESIDUAL_RMS: _residual_rms(loaded, measurement, residual),
            schema.RESIDUAL_N_PIXELS: residual.cell_sums.n_pixels.astype(np.int64),
            schema.SUBDOMAIN_ID: np.full(mesh.n_cells, subdomain.index, dtype=np.int32),
            schema.GLOBAL_CELL_ID: subdomain.cell_ids,
        }
        yield Piece(mesh.nodes, mesh.connectivity, mesh.offsets, mesh.types, point_data, cell_data)


def _six_components(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    """In-plane (xx, yy, xy) as VTK's (xx, yy, zz, xy, yz, xz)."""
    zero = np.zeros(len(tensor))
    return np.stack([tensor[:, 0], tensor[:, 1], zero, tensor[:, 2], zero, zero], axis=1)


def _gain_and_offset(loaded: LoadedCase, measurement: Measurement,
                     residual: Residual) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if loaded.case.correlation.grey_correction == "element":
        return residual.cell_sums.gain_and_offset()
    return np.array(measurement.grey.gain), np.array(measurement.grey.offset)


def _residual_rms(loaded: LoadedCase, measurement: Measurement, residual: Residual) -> NDArray[np.float64]:
    _, square = residual.cell_sums.residual(*_gain_and_offset(loaded, measurement, residual))
    n = residual.cell_sums.n_pixels
    return np.where(n > 0, np.sqrt(square / np.maximum(n, 1.0)), np.nan)


def _patches(loaded: LoadedCase, measurement: Measurement) -> list[Patch]:
    patches = []
    for part, q, residual in zip(measurement.parts, measurement.field.q, measurement.residuals, strict=True):
        gain, offset = _gain_and_offset(loaded, measurement, residual)
        window = part.correlation.reference.window
        patches.append(Patch(window.x0, window.y0, part.correlation.residual_image(part.deformed, q, gain, offset)))
    return patches


def _strips(team: Team, measurement: Measurement,
            patches: Sequence[Patch]) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Gather the residual image strip by strip on rank 0 (y0, rows); elsewhere the strips are empty."""
    image = measurement.pair.reference.image
    for y0 in range(0, image.height, STRIP_ROWS):
        y1 = min(y0 + STRIP_ROWS, image.height)
        mine = [Patch(p.x0, max(p.y0, y0) - y0, p.values[max(y0 - p.y0, 0): max(y1 - p.y0, 0)]) for p in patches]
        gathered = team.comm.gather([p for p in mine if p.values.size], root=0)
        strip = np.full((y1 - y0 if team.is_root else 0, image.width), np.nan, dtype=np.float32)
        for patch in (p for part in gathered or () for p in part):
            target = strip[patch.y0: patch.y0 + patch.values.shape[0], patch.x0: patch.x0 + patch.values.shape[1]]
            np.copyto(target, patch.values, where=~np.isnan(patch.values))
        yield y0, strip


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
        "krylov_iterations": [r.krylov_iterations for r in records],
        "linear_error_px": [r.linear_error for r in records],
    })
    writer.write_curves(schema.KRYLOV, [r.krylov_history for r in records])


def _write_attributes(writer: ResultWriter, team: Team, loaded: LoadedCase, measurement: Measurement) -> None:
    images = loaded.case.images
    writer.write_attributes(schema.CASE, {
        "path": str(loaded.path), "toml": loaded.text, "json": loaded.case.model_dump_json(),
        "eta": measurement.setting.eta, "largest_jump_px": measurement.field.largest_jump,
    })
    writer.write_attributes(schema.TIME, {"reference": images.reference_time, "deformed": images.deformed_time})
    writer.write_attributes(schema.UNITS, {"pixel_size": images.pixel_size or 1.0, "length_unit": images.length_unit})
    writer.write_attributes(schema.PROVENANCE, provenance(
        images, n_ranks=team.size, n_subdomains=measurement.region.n_subdomains))
