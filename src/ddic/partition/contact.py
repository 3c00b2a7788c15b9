"""Where near fields' own meshes touch what they leave of the far mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.mesh.interpolation import is_inside_outline
from ddic.mesh.mesh import Mesh
from ddic.mesh.mortar import Mortar, Overlaps, Sides, find_overlaps, integrate_mortar
from ddic.mesh.topology import find_boundary_facets, find_facets

TOLERANCE = 1e-6
"""Distance below which points are one, as a share of the far mesh's larger side. A larger value joins edges that lie
further apart."""

COVERED = 1e-3
"""Share of an edge that may be missing from what runs along it. A larger value lets edges end further apart."""


@dataclass(frozen=True)
class FarSide:
    """The far mesh, in which near meshes take the place of some cells.

    Attributes
    ----------
    whole : Mesh
        The far mesh, pixels.
    replaced_by : (n_cells,) array of int64
        Number of the near camera whose mesh takes the place of each cell; 0 where the cell is kept.
    tolerance : float
        Distance below which points are one, pixels.
    """

    whole: Mesh
    replaced_by: NDArray[np.int64]
    tolerance: float

    @cached_property
    def kept_cells(self) -> NDArray[np.int64]:
        """Numbers of the cells that are kept, (n_kept,)."""
        return np.flatnonzero(self.replaced_by == 0)

    @cached_property
    def rest(self) -> Mesh:
        """The cells that are kept."""
        return self.whole.create_submesh(self.kept_cells)[0]

    @cached_property
    def node_ids(self) -> NDArray[np.int64]:
        """Numbers in the whole far mesh of the nodes of the rest, (rest.n_nodes,)."""
        return self.whole.create_submesh(self.kept_cells)[1]

    @cached_property
    def edges(self) -> NDArray[np.int64]:
        """Boundary of the rest, by its nodes, (n_edges, 2)."""
        return _boundary_edges(self.rest)


@dataclass(frozen=True)
class NearSide:
    """A near mesh beside the rest of the far one.

    Attributes
    ----------
    number : int
        Of its camera, from 1.
    mesh : Mesh
        Its cells, far-field pixels.
    edges : (n_edges, 2) array of int64
        Its boundary, by nodes.
    overlaps : Overlaps
        Pieces of line that its edges have in common with far ones.
    mortar : Mortar
        How its nodes on the common line follow far nodes.
    """

    number: int
    mesh: Mesh
    edges: NDArray[np.int64]
    overlaps: Overlaps
    mortar: Mortar

    @cached_property
    def cover(self) -> NDArray[np.float64]:
        """Share of each edge that far edges cover, (n_edges,)."""
        return self.overlaps.measure_near_cover(len(self.edges))

    @property
    def free_edges(self) -> NDArray[np.int64]:
        """Edges that touch no far cell, by nodes, (n, 2)."""
        return self.edges[self.cover <= COVERED]


@dataclass(frozen=True)
class Contact:
    """The far mesh and all near meshes beside it.

    Attributes
    ----------
    far : FarSide
        What is left of the far mesh.
    near : tuple of NearSide
        Near meshes, in the order in which they were given.
    """

    far: FarSide
    near: tuple[NearSide, ...]

    @cached_property
    def far_cover(self) -> NDArray[np.float64]:
        """Share of each far edge that near edges cover, (n_edges,)."""
        n_edges = len(self.far.edges)
        by_mesh = [near.overlaps.measure_far_cover(n_edges) for near in self.near]
        return np.asarray(np.sum(by_mesh, axis=0), dtype=np.float64)


def find_contact(far: Mesh, near: Mapping[int, Mesh]) -> Contact:
    """Find which far cells near meshes replace, and where they touch the others.

    Parameters
    ----------
    far : Mesh
        The far mesh, pixels.
    near : dict of Mesh
        Near meshes by the number of their camera, far-field pixels.

    Returns
    -------
    Contact
        Not checked yet for edges that do not follow each other.

    Raises
    ------
    InputError
        Where near meshes overlap or touch each other, leave no far cell, or touch none.
    """
    replaced_by = _find_replaced_cells(far, near)
    tolerance = TOLERANCE * float(np.ptp(far.nodes, axis=0).max())
    far_side = FarSide(far, replaced_by, tolerance)
    return Contact(far_side, tuple(_find_near_side(far_side, number, mesh) for number, mesh in near.items()))


def _find_replaced_cells(far: Mesh, near: Mapping[int, Mesh]) -> NDArray[np.int64]:
    """Number of the near camera whose mesh covers the centre of each far cell, (n_cells,), 0 for none."""
    replaced_by = np.zeros(far.n_cells, dtype=np.int64)
    for number, mesh in near.items():
        inside = is_inside_outline(far.centroids, mesh)
        earlier = int(replaced_by[inside].max(initial=0))
        if earlier > 0:
            raise InputError(f"near, entry {number}: its mesh overlaps that of entry {earlier}; "
                             "let them cover different far elements")
        replaced_by[inside] = number
    _refuse_neighbours(far, replaced_by)
    if (replaced_by > 0).all():
        raise InputError("near.mesh: the near fields' meshes cover every far element, which leaves none to the "
                         "far-field images; use smaller ones, or measure with the near-field images alone")
    return replaced_by


def _refuse_neighbours(far: Mesh, replaced_by: NDArray[np.int64]) -> None:
    """Raise InputError where two near meshes would have a boundary in common."""
    facets = find_facets(far)
    n_facets = len(facets.nodes)
    of_sides = replaced_by[facets.side_cells]
    # The least and the largest number among the cells of each facet.
    low = np.full(n_facets, np.iinfo(np.int64).max)
    high = np.zeros(n_facets, dtype=np.int64)
    np.minimum.at(low, facets.side_facets, of_sides)
    np.maximum.at(high, facets.side_facets, of_sides)
    between = np.flatnonzero((low > 0) & (low < high))
    if len(between):
        first = between[0]
        raise InputError(f"near, entry {high[first]}: its mesh touches that of entry {low[first]}; leave one far "
                         "element at least between them")


def _find_near_side(far: FarSide, number: int, mesh: Mesh) -> NearSide:
    edges = _boundary_edges(mesh)
    sides = Sides(far.rest.nodes, far.edges, mesh.nodes, edges, far.tolerance)
    overlaps = find_overlaps(sides)
    if len(overlaps.near) == 0:
        raise InputError(f"near, entry {number}: its mesh has no boundary in common with the far elements around it; "
                         "align its outline with edges of far elements")
    return NearSide(number, mesh, edges, overlaps, integrate_mortar(sides, overlaps))


def _boundary_edges(mesh: Mesh) -> NDArray[np.int64]:
    """Edges of one cell, by the nodes of their ends, (n, 2)."""
    return np.asarray(find_boundary_facets(mesh)[:, :2])
