"""What the start finds: a displacement at any node, whatever it is made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.images.grid_field import GridField
from ddic.mesh.mesh import Mesh
from ddic.start.cut_field import CutField
from ddic.start.level_mesh import move_mesh
from ddic.start.matched_field import MatchedField


@dataclass(frozen=True, eq=False)
class MovedField:
    """What was found in parts of both images that begin at other places.

    Attributes
    ----------
    field : CutField or MatchedField
        Pixels of these parts.
    origin : (2,) array
        Where the reference image's part begins, pixels.
    translation : (2,) array
        Where the deformed image's part begins, from there, pixels.
    """

    field: CutField | MatchedField
    origin: NDArray[np.float64]
    translation: NDArray[np.float64]

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate the displacement.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Displacement, pixels.
        """
        return np.asarray(self.field.at(points - self.origin) + self.translation)

    def interpolate_at_nodes(self, mesh: Mesh) -> NDArray[np.float64]:
        """Evaluate the displacement at the nodes of a mesh.

        Parameters
        ----------
        mesh : Mesh
            Perhaps with cut cells, pixels.

        Returns
        -------
        (n_nodes, 2) array
            Displacement, pixels.
        """
        return self.field.interpolate_at_nodes(move_mesh(mesh, -self.origin)) + self.translation


CoarseField = GridField | CutField | MatchedField | MovedField


@dataclass(frozen=True, eq=False)
class KeptResult:
    """An earlier result's displacement, taken as it is.

    Attributes
    ----------
    beyond : CutField or None
        What extends it, on the cells that the earlier mesh does not hold whole; None where there are none.
    """

    beyond: CutField | None


def move_field(field: CoarseField | KeptResult, origin: NDArray[np.float64],
               translation: NDArray[np.float64]) -> CoarseField:
    """Give what was found in parts of both images in pixels of the images.

    Parameters
    ----------
    field : GridField, CutField or MatchedField
        Pixels of these parts.
    origin : (2,) array
        Where the reference image's part begins, pixels.
    translation : (2,) array
        Where the deformed image's part begins, from there, pixels.

    Returns
    -------
    GridField or MovedField
        Pixels.

    Raises
    ------
    TypeError
        Where the field is not one that was found in a part.
    """
    if isinstance(field, GridField):
        x, y = np.asarray(field.origin) + origin
        return GridField((float(x), float(y)), field.spacing, field.values + translation)
    if isinstance(field, CutField | MatchedField):
        return MovedField(field, origin, translation)
    raise TypeError(f"a {type(field).__name__} is not found in a part of an image")


def evaluate_at_nodes(field: CoarseField, mesh: Mesh) -> NDArray[np.float64]:
    """Evaluate a coarse field at the nodes of a mesh.

    Parameters
    ----------
    field : GridField, CutField, MatchedField or MovedField
        Pixels.
    mesh : Mesh
        Perhaps with cut cells, pixels.

    Returns
    -------
    (n_nodes, 2) array
        Displacement, pixels.
    """
    return field.at(mesh.nodes) if isinstance(field, GridField) else field.interpolate_at_nodes(mesh)
