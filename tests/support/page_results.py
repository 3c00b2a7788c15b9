"""Results of known fields on a square mesh, for pages: linear displacement, numbered cells, images where given."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.io import result_schema as schema
from ddic.io.result_pieces import Piece
from ddic.io.result_writer import ResultWriter
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh

Array = NDArray[np.float64]
MESH = build_structured_mesh((24.0, 24.0, 168.0, 168.0), 8.0)
NOISE = 0.004


@dataclass(frozen=True)
class Motion:
    """Displacement: a shift and a gradient about the middle of the mesh."""

    shift: tuple[float, float] = (0.4, -0.3)
    gradient: tuple[tuple[float, float], tuple[float, float]] = ((0.004, 0.001), (-0.002, -0.003))

    def displace(self, points: Array) -> Array:
        return np.asarray(self.shift + (points - 96.0) @ np.array(self.gradient).T)

    @property
    def strain(self) -> Array:
        """xx, yy, xy."""
        (xx, xy), (yx, yy) = self.gradient
        return np.array([xx, yy, 0.5 * (xy + yx)])


@dataclass(frozen=True)
class Content:
    """What a result file holds beside its displacement."""

    images: tuple[Path, Path] | None = None
    size: str = "192x192"
    residual: Array = field(default_factory=lambda: 1.0 + np.arange(MESH.n_cells) / MESH.n_cells)
    excluded: tuple[int, ...] = ()
    doubtful: tuple[int, ...] = ()
    unmeasured: tuple[int, ...] = ()
    with_uncertainty: bool = True
    mesh: Mesh = MESH


def write_known(path: Path, motion: Motion, content: Content = Content()) -> Path:
    """Write a result in one piece."""
    mesh = content.mesh
    u = motion.displace(mesh.nodes)
    u[list(content.unmeasured)] = np.nan
    xx, yy, xy = motion.strain
    tensor = np.array([xx, yy, 0.0, xy, 0.0, 0.0])
    points: dict[str, NDArray[Any]] = {
        schema.DISPLACEMENT: u, schema.DISPLACEMENT_MESH_UNITS: u, schema.GLOBAL_NODE_ID: np.arange(mesh.n_nodes)}
    points |= {spec.name: np.tile(tensor, (mesh.n_nodes, 1)) if spec.n_components > 1 else np.full(mesh.n_nodes, xx)
               for spec in schema.nodal_strain_fields()}
    specs = [*schema.point_fields(None), *schema.nodal_strain_fields()]
    if content.with_uncertainty:
        errors = schema.uncertainty_point_fields(regularized=True)
        points |= {spec.name: np.full((mesh.n_nodes, 2)[:1 + (spec.n_components > 1)], NOISE) for spec in errors}
        specs += errors
    cells = {spec.name: np.zeros((mesh.n_cells, spec.n_components)[:1 + (spec.n_components > 1)], spec.dtype)
             for spec in schema.cell_fields()}
    cells[schema.GLOBAL_CELL_ID] = np.arange(mesh.n_cells)
    cells[schema.RESIDUAL_RMS] = content.residual
    cells[schema.EXCLUDED][list(content.excluded)] = 2
    cells[schema.DOUBTFUL][list(content.doubtful)] = 1
    reference, deformed = map(str, content.images or ("", ""))
    with ResultWriter(path) as writer:
        writer.write_pieces([Piece(mesh.nodes, mesh.connectivity, mesh.offsets, mesh.types, points, cells)], specs,
                            schema.cell_fields())
        writer.write_table(schema.GAUSS_NEWTON, {"iteration": [1, 2], "rms_correction_px": [0.1, 1e-4],
                                               "residual_std_grey": [3.0, 2.0]})
        writer.write_curves(schema.KRYLOV, [[1.0, 0.1]])
        writer.write_attributes(schema.CASE, {"json": "{}", "toml": "", schema.NOISE_FLOOR: NOISE})
        writer.write_attributes(schema.PROVENANCE, {"reference_path": reference, "deformed_path": deformed,
                                                    "reference_size": content.size, "n_ranks": 1})
        writer.write_attributes(schema.TIME, {"reference": 0.0, "deformed": 2.5})
        writer.write_status("", schema.Verdict(schema.TRUST))
    return path
