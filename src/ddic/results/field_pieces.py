"""The mesh and the fields of a measurement, piece by piece, streamed through rank 0."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.correlation import Residual
from ddic.io import result_schema as schema
from ddic.io.result_writer import Piece, PieceSize, ResultWriter, join_pieces
from ddic.kinematics.strain import compute_strain
from ddic.mesh.mesh import Mesh, join_meshes
from ddic.parallel.distribution import stream_to_root
from ddic.parallel.team import require_held
from ddic.results.drawn_mesh import DrawnMesh, draw_mesh
from ddic.results.nodal_strain import convert_to_six_components, describe_nodal_strains, recover_nodal_gradients

if TYPE_CHECKING:
    from ddic.results.measurement import Measurement

BATCH_POINTS = 1 << 14
"""Points from which on pieces are sent and written together (about 6 MB); a larger value takes memory on rank 0."""


@dataclass(frozen=True)
class _Batch:
    """Pieces that follow each other, joined."""

    n_pieces: int
    pieces: Piece


def write_pieces(measurement: Measurement, writer: ResultWriter | None) -> None:
    """Write the mesh and the fields of all subdomains; collective.

    Parameters
    ----------
    measurement : Measurement
        What was measured.
    writer : ResultWriter or None
        On rank 0.
    """
    team, images = measurement.team, measurement.inputs.case.images
    n_nodes = measurement.region.n_nodes
    drawn = [draw_mesh(subdomain, n_nodes) for subdomain in measurement.subdomains]
    sizes = team.gather_lists([_size(piece.mesh) for piece in drawn])
    length_unit = None if images.pixel_size is None else images.length_unit
    at_points = (*schema.point_fields(length_unit), *schema.nodal_strain_fields())
    on_cells = schema.cell_fields(len(measurement.cameras))
    uncertainty = measurement.uncertainty
    if uncertainty is not None:
        at_points = (*at_points, *schema.uncertainty_point_fields(regularized=uncertainty.bias is not None))
        on_cells = (*on_cells, *schema.uncertainty_cell_fields())
    team.build_on_root(lambda: require_held(writer).create_pieces(sizes, at_points, on_cells))
    gradients = recover_nodal_gradients(team, measurement.subdomains, measurement.displacements)
    n_written = 0

    def write(batch: _Batch) -> None:
        nonlocal n_written
        numbers = range(n_written, n_written + batch.n_pieces)
        require_held(writer).write_pieces(numbers, batch.pieces)
        n_written = numbers.stop

    stream_to_root(team, _make_batches(measurement, drawn, gradients), write)


def _size(mesh: Mesh) -> PieceSize:
    return PieceSize(mesh.n_nodes, mesh.n_cells, len(mesh.connectivity))


def _group(counts: Sequence[int]) -> Iterator[range]:
    """Numbers of pieces that follow each other, up to a size that bounds what rank 0 holds at a time."""
    first, n_points = 0, 0
    for number, count in enumerate(counts, start=1):
        n_points += count
        if n_points >= BATCH_POINTS or number == len(counts):
            yield range(first, number)
            first, n_points = number, 0


def _make_batches(measurement: Measurement, drawn: Sequence[DrawnMesh],
                  gradients: Sequence[NDArray[np.float64]]) -> Iterator[_Batch]:
    """Pieces of owned subdomains, joined; gradients: of the displacement at their nodes, (n_nodes, 2, 2) each."""
    displacements, subdomains = measurement.displacements, measurement.subdomains
    for numbers in _group([piece.mesh.n_nodes for piece in drawn]):
        joined = join_pieces([_make_piece(measurement, drawn[number], number, displacements[number])
                              for number in numbers])
        # Strains of all at once: for one small piece after the other, numpy's calls take longer than their sums.
        of_points = np.concatenate([drawn[number].interpolate(gradients[number].reshape(-1, 4)) for number in numbers])
        meshes = [subdomains[number].mesh for number in numbers]
        strain = compute_strain(join_meshes(meshes), np.concatenate([displacements[number] for number in numbers]))
        first_cells = np.cumsum([0, *(mesh.n_cells for mesh in meshes)])
        cells = np.concatenate([drawn[number].cells + first_cells[k] for k, number in enumerate(numbers)])
        on_cells = {schema.STRAIN_INFINITESIMAL: convert_to_six_components(strain.infinitesimal[cells]),
                    schema.STRAIN_GREEN_LAGRANGE: convert_to_six_components(strain.green_lagrange[cells])}
        at_points = describe_nodal_strains(of_points.reshape(-1, 2, 2))
        yield _Batch(len(numbers), replace(joined, point_data={**joined.point_data, **at_points},
                                           cell_data={**joined.cell_data, **on_cells}))


def _make_piece(measurement: Measurement, drawn: DrawnMesh, number: int, u: NDArray[np.float64]) -> Piece:
    """The piece of an owned subdomain, given by its place, without the strains of its field."""
    mesh = drawn.mesh
    on_cells = {**_cell_data(measurement, number), **_cell_deviations(measurement, number)}
    return Piece(mesh.nodes, mesh.connectivity, mesh.offsets, mesh.types,
                 {**_point_data(measurement, drawn, u), **_point_deviations(measurement, drawn, number)},
                 {name: values[drawn.cells] for name, values in on_cells.items()})


def _point_data(measurement: Measurement, drawn: DrawnMesh, u: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    pixel_size = measurement.inputs.case.images.pixel_size
    vectors = drawn.interpolate(u.reshape(-1, drawn.mesh.dim))
    data: dict[str, NDArray[Any]] = {
        schema.DISPLACEMENT: vectors,
        schema.DISPLACEMENT_MESH_UNITS: measurement.region.mapping.map_vectors_to_mesh_units(vectors),
        schema.GLOBAL_NODE_ID: drawn.node_ids,
    }
    if pixel_size is not None:
        data[schema.DISPLACEMENT_PHYSICAL] = vectors * pixel_size
    return data


def _point_deviations(measurement: Measurement, drawn: DrawnMesh, number: int) -> dict[str, NDArray[Any]]:
    """Standard deviations and bias at the points of an owned subdomain, given by its place; nothing without them."""
    uncertainty = measurement.uncertainty
    if uncertainty is None:
        return {}
    found = uncertainty.deviations[number]
    data: dict[str, NDArray[Any]] = {}
    for names, values in ((schema.SIGMA_DISPLACEMENT, found.displacement),
                          (schema.SIGMA_NODAL_STRAIN, found.nodal_strain)):
        data |= dict(zip(names, drawn.interpolate(values).T, strict=True))
    if uncertainty.bias is not None:
        data[schema.REGULARIZATION_BIAS] = drawn.interpolate(uncertainty.bias[number])
    return data


def _cell_deviations(measurement: Measurement, number: int) -> dict[str, NDArray[Any]]:
    """Standard deviations on the cells of an owned subdomain, given by its place; nothing without them."""
    uncertainty = measurement.uncertainty
    if uncertainty is None:
        return {}
    return dict(zip(schema.SIGMA_CELL_STRAIN, uncertainty.deviations[number].cell_strain.T, strict=True))


def _cell_data(measurement: Measurement, number: int) -> dict[str, NDArray[Any]]:
    """Fields on the cells of an owned subdomain, given by its place, but for strains."""
    subdomain = measurement.subdomains[number]
    own_residual = measurement.evaluation.residuals[number][0]
    errors = measurement.cell_errors[number]
    n_cells = subdomain.mesh.n_cells
    data: dict[str, NDArray[Any]] = {
        schema.RESIDUAL_RMS: _residual_rms(measurement, subdomain.camera, own_residual),
        schema.RESIDUAL_N_PIXELS: own_residual.cell_sums.n_pixels.astype(np.int64),
        schema.EQUIVALENT_ERROR: errors.equivalent,
        schema.DOUBTFUL: errors.doubtful.astype(np.uint8),
        schema.EXCLUDED: measurement.excluded.cells[number][0],
        schema.SUBDOMAIN_ID: np.full(n_cells, subdomain.index, dtype=np.int32),
        schema.GLOBAL_CELL_ID: subdomain.cell_ids,
    }
    if len(measurement.cameras) > 1:
        data[schema.CAMERA] = np.full(n_cells, subdomain.camera, dtype=np.int32)
    return data


def _residual_rms(measurement: Measurement, camera: int, residual: Residual) -> NDArray[np.float64]:
    """Root mean square of each cell's residual, grey levels; nan where it has no pixel."""
    correction = measurement.model.find_correction(measurement.evaluation, camera, residual)
    _, squares = residual.cell_sums.sum_residual(*correction)
    n = residual.cell_sums.n_pixels
    return np.where(n > 0, np.sqrt(squares / np.maximum(n, 1.0)), np.nan)
