"""What the result file holds of a measurement: mesh and fields, tables, curves and attributes.

Each rank writes the pieces of its subdomains. The mesh is as a result shows it: parts of cut cells as triangles, so
that a discontinuity opens. Strains at the nodes are as the result file has them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.arrays import Array, IntArray
from ddic.functionals.correlation import Residual
from ddic.io import result_schema as schema
from ddic.io.new_hdf5 import Block
from ddic.io.result_pieces import Piece, PieceCounts, PieceLayout, add_counts, join_pieces
from ddic.io.result_writer import ResultWriter
from ddic.kinematics.nodal_gradients import recover_gradients
from ddic.kinematics.strain import (
    compute_green_lagrange,
    compute_hencky,
    compute_infinitesimal,
    compute_strain,
    compute_von_mises_strain,
    find_principal_strains,
)
from ddic.mesh.cell_type import T3
from ddic.mesh.interpolation import weigh_nodes_at
from ddic.mesh.mesh import Mesh, join_meshes
from ddic.parallel.distribution import sum_shared_nodes
from ddic.parallel.team import Team, require_held
from ddic.partition.subdomain import Subdomain
from ddic.results.near import describe_near_field
from ddic.results.publishing import write_case
from ddic.results.shared_file import write_blocks

if TYPE_CHECKING:
    from ddic.results.measurement import Measurement


def recover_nodal_gradients(team: Team, subdomains: Sequence[Subdomain], displacements: Sequence[Array]) -> list[Array]:
    """Recover the displacement gradient du_c / dx_j at the nodes of all subdomains, (n_nodes, dim, dim); collective.

    Displacements are those of nodes, (n_dofs,), pixels, the same at copies of a node. One value a node, whatever the
    partition; no unit.
    """
    mesh = join_meshes([subdomain.mesh for subdomain in subdomains])
    ends = np.cumsum([subdomain.mesh.n_nodes for subdomain in subdomains])[:-1]

    def sum_shared(sums: Sequence[Array]) -> list[Array]:
        parts = sum_shared_nodes(team, subdomains, np.split(sums[0], ends))
        # Where there is one, it need not be copied.
        return parts if len(parts) == 1 else [np.concatenate(parts)]

    gradients, = recover_gradients([mesh], [np.concatenate(displacements)], sum_shared)
    return np.split(gradients, ends)


def describe_nodal_strains(gradients: Array) -> dict[str, NDArray[Any]]:
    """Compute the result file's strains at points by name, (n,) or (n, 6), of gradients du_c / dx_j, (n, dim, dim)."""
    large = compute_green_lagrange(gradients)
    hencky = compute_hencky(large)
    return {
        schema.NODAL_INFINITESIMAL: convert_to_six_components(compute_infinitesimal(gradients)),
        schema.NODAL_GREEN_LAGRANGE: convert_to_six_components(large),
        schema.NODAL_HENCKY: convert_to_six_components(hencky),
        **dict(zip(schema.NODAL_PRINCIPAL, find_principal_strains(hencky).T, strict=False)),
        schema.NODAL_VON_MISES: compute_von_mises_strain(hencky),
    }


def convert_to_six_components(tensor: Array) -> Array:
    """Write tensors in the plane, xx, yy, xy, (n, 3), as VTK and those in space do: xx, yy, zz, xy, yz, xz, (n, 6)."""
    if tensor.shape[1] == schema.SYMMETRIC_TENSOR:
        return tensor
    zero = np.zeros(len(tensor))
    return np.stack([tensor[:, 0], tensor[:, 1], zero, tensor[:, 2], zero, zero], axis=1)


@dataclass(frozen=True, eq=False)
class DrawnMesh:
    """Cells and points of a subdomain as they are written, parts of cut cells as triangles about their first corner.

    Attributes
    ----------
    mesh : Mesh
        The cells, and the points as its nodes.
    node_ids : (mesh.n_nodes,) array of int64
        Numbers of the points over the whole region, those of nodes before parts' corners.
    cells : (mesh.n_cells,) array of int64
        Cells of the subdomain that these are, or are parts of.
    weights : (mesh.n_nodes, n_nodes) csr_matrix or None
        From values at the subdomain's nodes to those at the points; None where they are the same.
    """

    mesh: Mesh
    node_ids: IntArray
    cells: IntArray
    weights: sparse.csr_matrix | None = None

    def interpolate(self, values: Array) -> Array:
        """Interpolate values at the subdomain's nodes, (n_nodes, k), at the points, (mesh.n_nodes, k)."""
        return values if self.weights is None else np.asarray(self.weights @ values)

    def project_factors(self, factors: sparse.csr_matrix) -> sparse.csr_matrix:
        """Turn factors of values at the points, (n, mesh.n_nodes), into those of values at the nodes, (n, n_nodes)."""
        return factors if self.weights is None else factors @ self.weights


def draw_mesh(subdomain: Subdomain, n_nodes: int) -> DrawnMesh:
    """Draw a subdomain's mesh, perhaps with parts of cut cells: the mesh itself where no cell is cut.

    ``n_nodes`` are those of the whole region's mesh, after which corners of parts are numbered.
    """
    mesh, parts = subdomain.mesh, subdomain.mesh.parts
    if parts is None or not parts.n_parts:
        return DrawnMesh(mesh, subdomain.node_ids, np.arange(mesh.n_cells))
    whole = np.setdiff1d(np.arange(mesh.n_cells), parts.cells)
    whole_mesh, kept = mesh.create_submesh(whole)
    n_corners = np.diff(parts.offsets)
    part_of_corner = np.repeat(np.arange(len(parts.cells)), n_corners)
    part_of_triangle = np.repeat(np.arange(len(parts.cells)), n_corners - 2)
    place = np.arange(len(part_of_triangle)) - np.searchsorted(part_of_triangle, part_of_triangle)
    apex = parts.offsets[part_of_triangle]
    triangles = np.stack([apex, apex + place + 1, apex + place + 2], axis=1) + len(kept)
    drawn = Mesh(
        np.concatenate([whole_mesh.nodes, parts.corners]),
        np.concatenate([whole_mesh.connectivity, triangles.ravel()]),
        np.concatenate([whole_mesh.offsets, whole_mesh.offsets[-1] + 3 * np.arange(1, len(triangles) + 1)]),
        np.concatenate([whole_mesh.types, np.full(len(triangles), T3.vtk, np.uint8)]),
        mapping=mesh.mapping)
    numbers = parts.first_numbers[part_of_corner] + np.arange(len(parts.corners)) - parts.offsets[part_of_corner]
    node_ids = np.concatenate([subdomain.node_ids[kept], n_nodes + numbers])
    cells = np.concatenate([whole, parts.cells[part_of_triangle]])
    at_nodes = sparse.csr_matrix((np.ones(len(kept)), (np.arange(len(kept)), kept)), (len(kept), mesh.n_nodes))
    weights = sparse.vstack([at_nodes, weigh_nodes_at(mesh, parts.cells[part_of_corner], parts.corners)])
    return DrawnMesh(drawn, node_ids, cells, weights.tocsr())


BATCH_POINTS = 1 << 14
"""Points from which on pieces are made and written together (about 6 MB); a larger value takes memory."""


def write_pieces(measurement: Measurement, writer: ResultWriter | None) -> None:
    """Write the mesh and the fields of all subdomains; collective, the writer is rank 0's."""
    team, images = measurement.team, measurement.inputs.case.imaging
    n_nodes, dim = measurement.region.n_nodes, measurement.inputs.case.dim
    drawn = [draw_mesh(subdomain, n_nodes) for subdomain in measurement.subdomains]
    counts = [PieceCounts(1, piece.mesh.n_nodes, piece.mesh.n_cells, len(piece.mesh.connectivity)) for piece in drawn]
    mine = np.array(add_counts(counts))
    before, total = (PieceCounts(*(int(n) for n in found)) for found in (team.sum_below(mine), team.sum(mine)))
    length_unit = None if images.pixel_size is None else images.length_unit
    at_points = (*schema.point_fields(length_unit, independent=measurement.independent is not None),
                 *schema.nodal_strain_fields(dim))
    at_points += () if measurement.modes is None else schema.list_mode_fields(len(measurement.modes.fields))
    on_cells = schema.cell_fields(len(measurement.cameras), plastic=measurement.plastic_strain is not None)
    uncertainty = measurement.uncertainty
    if uncertainty is not None:
        at_points = (*at_points, *schema.uncertainty_point_fields(dim, regularized=uncertainty.bias is not None))
        at_points += () if measurement.comparison is None else schema.list_comparison_fields()
        on_cells = (*on_cells, *schema.uncertainty_cell_fields(dim))
    layout = team.on_root(lambda: require_held(writer).create_mesh(total, at_points, on_cells))
    gradients = recover_nodal_gradients(team, measurement.subdomains, measurement.displacements)
    write_blocks(team, writer, _place_batches(layout, before, counts, _make_batches(measurement, drawn, gradients)))


def _place_batches(layout: PieceLayout, before: PieceCounts, counts: Sequence[PieceCounts],
                   batches: Iterator[tuple[range, Piece]]) -> Iterator[list[Block]]:
    """What is to be written of this rank's pieces, of which there are ``counts``, behind what comes ``before``."""
    for numbers, joined in batches:
        of_batch = counts[numbers.start:numbers.stop]
        yield layout.place(before, of_batch, joined)
        before = add_counts([before, *of_batch])


def _group(counts: Sequence[int]) -> Iterator[range]:
    """Numbers of pieces that follow each other, up to a size that bounds what a rank holds at a time."""
    first, n_points = 0, 0
    for number, count in enumerate(counts, start=1):
        n_points += count
        if n_points >= BATCH_POINTS or number == len(counts):
            yield range(first, number)
            first, n_points = number, 0


def _make_batches(measurement: Measurement, drawn: Sequence[DrawnMesh],
                  gradients: Sequence[Array]) -> Iterator[tuple[range, Piece]]:
    """Pieces of owned subdomains in a row, and joined to one; ``gradients`` at nodes are (n_nodes, dim, dim) each."""
    dim = measurement.inputs.case.dim
    displacements, subdomains = measurement.displacements, measurement.subdomains
    for numbers in _group([piece.mesh.n_nodes for piece in drawn]):
        joined = join_pieces([_make_piece(measurement, drawn[number], number, displacements[number])
                              for number in numbers])
        # Strains of all at once: for one small piece after the other, numpy's calls take longer than their sums.
        of_points = np.concatenate([drawn[number].interpolate(gradients[number].reshape(-1, dim * dim))
                                    for number in numbers])
        meshes = [subdomains[number].mesh for number in numbers]
        strain = compute_strain(join_meshes(meshes), np.concatenate([displacements[number] for number in numbers]))
        first_cells = np.cumsum([0, *(mesh.n_cells for mesh in meshes)])
        cells = np.concatenate([drawn[number].cells + first_cells[k] for k, number in enumerate(numbers)])
        on_cells = {schema.STRAIN_INFINITESIMAL: convert_to_six_components(strain.infinitesimal[cells]),
                    schema.STRAIN_GREEN_LAGRANGE: convert_to_six_components(strain.green_lagrange[cells])}
        at_points = describe_nodal_strains(of_points.reshape(-1, dim, dim))
        yield numbers, replace(joined, point_data={**joined.point_data, **at_points},
                               cell_data={**joined.cell_data, **on_cells})


def _make_piece(measurement: Measurement, drawn: DrawnMesh, number: int, u: Array) -> Piece:
    """The piece of an owned subdomain, given by its place, without the strains of its field."""
    mesh = drawn.mesh
    return Piece(mesh.nodes, mesh.connectivity, mesh.offsets, mesh.types, _point_data(measurement, drawn, number, u),
                 {name: values[drawn.cells] for name, values in _cell_data(measurement, number).items()})


def _point_data(measurement: Measurement, drawn: DrawnMesh, number: int, u: Array) -> dict[str, NDArray[Any]]:
    """Fields at the points of an owned subdomain, given by its place, but for strains."""
    pixel_size, uncertainty = measurement.inputs.case.imaging.pixel_size, measurement.uncertainty
    vectors = drawn.interpolate(u.reshape(-1, drawn.mesh.dim))
    data: dict[str, NDArray[Any]] = {
        schema.DISPLACEMENT: vectors,
        schema.DISPLACEMENT_MESH_UNITS: measurement.region.mapping.map_vectors_to_mesh_units(vectors),
        schema.GLOBAL_NODE_ID: drawn.node_ids,
    }
    if pixel_size is not None:
        data[schema.DISPLACEMENT_PHYSICAL] = vectors * pixel_size
    if measurement.independent is not None:
        data[schema.INDEPENDENT] = drawn.interpolate(measurement.independent[number].reshape(-1, drawn.mesh.dim))
    if uncertainty is not None:
        found = uncertainty.deviations[number]
        for names, values in ((schema.SIGMA_DISPLACEMENT[:drawn.mesh.dim], found.displacement),
                              (schema.list_sigma_strains(drawn.mesh.dim), found.nodal_strain)):
            data |= dict(zip(names, drawn.interpolate(values).T, strict=True))
        if uncertainty.bias is not None:
            data[schema.REGULARIZATION_BIAS] = drawn.interpolate(uncertainty.bias[number])
    if measurement.modes is not None:
        is_out = measurement.unmeasured[number][:, None]
        data |= {schema.get_mode_name(k): drawn.interpolate(
                     np.where(is_out, np.nan, of_mode.displacements[number].reshape(len(is_out), -1)))
                 for k, of_mode in enumerate(measurement.modes.fields, start=1)}
    if measurement.comparison is not None:
        compared = measurement.comparison
        data |= {name: drawn.interpolate(of_subdomains[number])
                 for name, of_subdomains in ((schema.SIMULATED, compared.simulated),
                                             (schema.SIMULATION_DIFFERENCE, compared.difference),
                                             (schema.NORMALISED_DIFFERENCE, compared.normalised))}
    return data


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
    if measurement.plastic_strain is not None:
        data[schema.PLASTIC_STRAIN] = measurement.plastic_strain[number]
    if measurement.uncertainty is not None:
        deviations = measurement.uncertainty.deviations[number].cell_strain
        data |= dict(zip(schema.list_cell_sigma_strains(subdomain.mesh.dim), deviations.T, strict=True))
    return data


def _residual_rms(measurement: Measurement, camera: int, residual: Residual) -> Array:
    """Root mean square of each cell's residual, grey levels; nan where it has no pixel."""
    correction = measurement.model.find_correction(measurement.evaluation, camera, residual)
    _, squares = residual.cell_sums.sum_residual(*correction)
    n = residual.cell_sums.n_pixels
    return np.where(n > 0, np.sqrt(squares / np.maximum(n, 1.0)), np.nan)


def list_iterations(measurement: Measurement) -> dict[str, list[Any]]:
    """List Gauss-Newton's iterations, columns by name; the residual is that before each correction."""
    records = measurement.records
    columns: dict[str, list[Any]] = {
        "iteration": [r.number for r in records],
        "relative_correction": [r.size.relative for r in records],
        "rms_correction_px": [r.size.rms for r in records],
        "largest_correction_px": [r.size.largest for r in records],
        "slow_nodes": [r.size.n_slow for r in records],
        "of_slow_nodes": [int(r.is_local) for r in records],
        "residual_std_grey": [r.grey.residual_std for r in records],
        "residual_rms_grey": [r.grey.residual_rms for r in records],
        "n_pixels": [r.grey.n_pixels for r in records],
        "gain": [r.grey.gain for r in records],
        "offset": [r.grey.offset for r in records],
    }
    for camera in measurement.cameras[1:]:
        columns[f"near_{camera.number}_residual_std_grey"] = [r.cameras[camera.number].residual_std for r in records]
    columns["krylov_iterations"] = [r.krylov_iterations for r in records]
    columns["linear_error_px"] = [r.linear_error for r in records]
    return columns


def write_tables(measurement: Measurement, writer: ResultWriter) -> None:
    """Write the table of Gauss-Newton's iterations, the Krylov residuals of each, and all attributes; on rank 0."""
    writer.write_table(schema.GAUSS_NEWTON, list_iterations(measurement))
    writer.write_curves(schema.KRYLOV, [r.krylov_history for r in measurement.records])
    write_case(measurement, writer, {"largest_jump_px": measurement.largest_jump,
                                     "notes": "\n".join(measurement.inputs.notes)})
    if measurement.uncertainty is not None:
        from ddic.results.field_uncertainty import list_uncertainty

        writer.write_attributes(schema.UNCERTAINTY, list_uncertainty(measurement.uncertainty))
        if measurement.uncertainty.opening_deviations:
            writer.write_table(schema.OPENING_DEVIATIONS, measurement.uncertainty.opening_deviations)
    if measurement.comparison is not None:
        writer.write_attributes(schema.COMPARISON, measurement.comparison.origin)
        writer.write_table(schema.COMPARED_REGIONS, measurement.comparison.regions)
    if measurement.identification is not None:
        found = measurement.identification
        writer.write_table(schema.IDENTIFICATION, found.table)
        writer.write_attributes(schema.IDENTIFICATION, {"iterations": found.n_iterations,
                                                        "iterations_of_fields": found.n_iterations_of_fields})
    if measurement.modes is not None:
        writer.write_table(schema.TIME_MODES, measurement.modes.table)
    if measurement.detection is not None:
        writer.write_arrays(schema.DETECTION, measurement.detection.to_arrays())
    for motion in measurement.motions:
        writer.write_attributes(schema.near_group(motion.camera), describe_near_field(measurement, motion))
    writer.write_status(measurement.failure, measurement.verdict)
