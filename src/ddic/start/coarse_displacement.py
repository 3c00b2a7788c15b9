"""What the start finds: a displacement at any node, whatever it is made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.images.grid_field import GridField
from ddic.mesh.mesh import Mesh
from ddic.start.cut_field import CutField
from ddic.start.matched_field import MatchedField

CoarseField = GridField | CutField | MatchedField


@dataclass(frozen=True, eq=False)
class KeptResult:
    """An earlier result's displacement, taken as it is.

    Attributes
    ----------
    beyond : CutField or None
        What extends it, on the cells that the earlier mesh does not hold whole; None where there are none.
    """

    beyond: CutField | None


def evaluate_at_nodes(field: CoarseField, mesh: Mesh) -> NDArray[np.float64]:
    """Evaluate a coarse field at the nodes of a mesh.

    Parameters
    ----------
    field : GridField, CutField or MatchedField
        Pixels.
    mesh : Mesh
        Perhaps with cut cells, pixels.

    Returns
    -------
    (n_nodes, 2) array
        Displacement, pixels.
    """
    return field.at(mesh.nodes) if isinstance(field, GridField) else field.interpolate_at_nodes(mesh)
