from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.io import result_schema as schema
from ddic.io.result_reader import Result
from ddic.kinematics.nodal_gradients import recover_gradients
from ddic.kinematics.strain import compute_green_lagrange, compute_hencky, compute_infinitesimal
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh

Array = NDArray[np.float64]
Field = Callable[[Array], Array]
MakeResult = Callable[..., Result]


def to_file(tensors: Array, dim: int) -> Array:
    """xx, yy, xy, or all components in space, as the file has them: XX YY ZZ XY YZ XZ."""
    six = np.zeros((len(tensors), 6))
    six[:, list(schema.list_components(dim).values())] = tensors
    return six


@pytest.fixture
def make_result() -> MakeResult:
    """A result whose displacement is known: of a square of 200 px with a hole of 20 px about (150, 150), or a mesh."""

    def make(field: Field, name: str = "known", element_size: float = 10.0, doubtful: bool = False,
             mesh: Mesh | None = None, **attributes: Any) -> Result:
        if mesh is None:
            mesh = build_structured_mesh((0, 0, 200, 200), element_size, circles=[((150.0, 150.0), 20.0)])
        u = field(mesh.nodes)
        (gradient,) = recover_gradients([mesh], [u.ravel()], list)
        green = compute_green_lagrange(gradient)
        strains = {schema.NODAL_INFINITESIMAL: compute_infinitesimal(gradient), schema.NODAL_GREEN_LAGRANGE: green,
                   schema.NODAL_HENCKY: compute_hencky(green)}
        at_nodes = {schema.DISPLACEMENT: np.pad(u, ((0, 0), (0, 3 - mesh.dim))),
                    schema.GLOBAL_NODE_ID: np.arange(mesh.n_nodes),
                    **{key: to_file(value, mesh.dim) for key, value in strains.items()}}
        on_cells = {schema.DOUBTFUL: np.full(mesh.n_cells, doubtful, np.uint8),
                    schema.GLOBAL_CELL_ID: np.arange(mesh.n_cells),
                    schema.STRAIN_INFINITESIMAL: np.zeros((mesh.n_cells, 6))}
        return Result(Path(f"{name}.vtkhdf"), mesh, u, at_nodes, on_cells, np.zeros(mesh.n_cells, np.int64), {}, (),
                      attributes, False)

    return make
