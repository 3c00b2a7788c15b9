"""A later frame in the place of the reference image, on the mesh that has moved; fields stay those since the first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.images.source import ImageSource
from ddic.mesh.mesh import Mesh
from ddic.mesh.repair import check_inside
from ddic.partition.subdomain import Subdomain
from ddic.partition.ties import Tying

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class UpdatedReference:
    """What the mesh was in the first reference image, and where it is now.

    Attributes
    ----------
    nodes : (n_nodes, 2) array
        In the first reference image, pixels.
    displacement : (n_nodes, 2) array
        From there to the frame, pixels.
    parts : (n_cells,) array of int64
        Subdomain of each cell, as in the first reference image.
    first_image : ImageSource
        The first reference image.
    build_first_mesh : callable
        Gives the whole mesh in the first reference image; called on rank 0 only.
    """

    nodes: Array
    displacement: Array
    parts: NDArray[np.int64]
    first_image: ImageSource
    build_first_mesh: Callable[[], tuple[Mesh, Tying | None]]

    def build_moved_mesh(self, width: int, height: int) -> Mesh:
        """Build the mesh where the frame shows it; on rank 0.

        Parameters
        ----------
        width, height : int
            Size of the images, pixels.

        Returns
        -------
        Mesh
            The same cells.

        Raises
        ------
        InputError
            Where it has left the image.
        """
        mesh, _ = self.build_first_mesh()
        moved = replace(mesh, nodes=mesh.nodes + self.displacement)
        check_inside(moved, width, height)
        return moved

    def place_first(self, subdomain: Subdomain) -> Subdomain:
        """Give a subdomain the nodes that it has in the first reference image.

        Parameters
        ----------
        subdomain : Subdomain
            Of the moved mesh.

        Returns
        -------
        Subdomain
            The same cells and unknowns.
        """
        return replace(subdomain, mesh=replace(subdomain.mesh, nodes=self.nodes[subdomain.node_ids]))

    def restrict(self, subdomains: Sequence[Subdomain]) -> list[Array]:
        """Give subdomains the displacement of their nodes to the frame.

        Parameters
        ----------
        subdomains : sequence of Subdomain
            Whose unknowns are displacements of nodes.

        Returns
        -------
        list of (n_dofs,) array
            Of each, node by node, pixels.
        """
        return [self.displacement[subdomain.node_ids].ravel() for subdomain in subdomains]
