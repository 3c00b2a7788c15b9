"""Nodes that Gauss-Newton has not found yet where it has found all others: these are iterated where they are.

A pass over the pixels is confined to the cells about slow nodes and their neighbours. The forces on the others follow q
as the linear theory says, b - M (q - q_0): they were small already, and the next pass over all pixels checks them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddic.arrays import Array, BoolArray
from ddic.functionals.grey_statistics import GreyState
from ddic.functionals.view import FrameView
from ddic.images.noise import NOISE_OF_SLOPE
from ddic.mesh.mesh import Mesh, pad_cells, sum_about_nodes
from ddic.parallel.distribution import sum_shared_nodes
from ddic.parallel.field import Field, add_views
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import find_displaced_nodes
from ddic.problem.residual_model import ResidualModel
from ddic.solvers.correction_size import CorrectionSize, Tolerances, measure_node_corrections
from ddic.solvers.gauss_newton import Correction
from ddic.solvers.local_system import LocalSystem

LEAST_KNOWN = 0.2
"""Least share of a node's diagonal that is taken for texture: a node that is lost in noise drags its neighbours too. A
smaller one leaves these, with 0.1, by 0.12 of their standard deviation from where they would come to rest."""

MOST_VISITED = 0.3
"""Share of the pixels that are visited where a few nodes are slow: of more, a pass over all of them tells more."""


@dataclass(frozen=True)
class SlowNodes:
    """What Gauss-Newton asks of the images where only a few nodes are not found yet.

    Attributes
    ----------
    near : ResidualModel
        Of the cells about these nodes.
    rows : list of (n_unknowns,) bool array
        Unknowns whose forces these cells tell, those of slow nodes and their neighbours, of each owned subdomain.
    q, b : Field
        Where all pixels were visited last, and the forces there.
    systems : list of LocalSystem
        With M_s.
    """

    near: ResidualModel
    rows: list[BoolArray]
    q: Field
    b: Field
    systems: list[LocalSystem]

    @property
    def team(self) -> Team:
        """All ranks."""
        return self.near.team

    def linearize(self, q: Field) -> tuple[Field, tuple[GreyState, ...]]:
        """Pass over the pixels of the cells about slow nodes; collective."""
        seen, grey = self.near.linearize(q)
        b = [np.where(is_seen, seen_s, b_s - system.hessian @ change)
             for is_seen, seen_s, b_s, system, change
             in zip(self.rows, seen, self.b, self.systems, q - self.q, strict=True)]
        return q.with_parts(b), grey

    def measure_correction(self, dq: Field, q: Field, tolerances: Tolerances) -> CorrectionSize:
        """Measure a correction of all nodes; collective."""
        return self.near.measure_correction(dq, q, tolerances)


def confine_to_slow_nodes(model: ResidualModel, correction: Correction, systems: list[LocalSystem],
                          tolerances: Tolerances) -> SlowNodes | None:
    """Confine Gauss-Newton to nodes that still move; None where these have too many pixels; collective."""
    team, subdomains = model.team, model.subdomains
    if team.sum(sum(subdomain.n_motion for subdomain in subdomains)):
        # A camera's motion moves all of its cells, and its force is that of all their pixels.
        return None
    weights = model.weigh_nodes()
    moved = measure_node_corrections(correction.dq, correction.q)
    if weights is not None:
        moved = [w * of_nodes for w, of_nodes in zip(weights, moved, strict=True)]
    # Copies of a node may differ by what the linear step left.
    slow = _join_copies(team, subdomains, [m > tolerances.largest for m in moved])
    # What a slow node does to its neighbours is no more linear than what it does itself.
    slow = _join_copies(team, subdomains, [_find_neighbours(*of_subdomain) for of_subdomain
                                           in zip(subdomains, slow, strict=True)])
    rows = [np.asarray(abs(s.kinematics.tangent).T @ np.repeat(nodes, s.mesh.dim).astype(float) > 0)
            for s, nodes in zip(subdomains, slow, strict=True)]
    # Those with a node that these unknowns displace.
    cells = [find_displaced_nodes(s, of_rows)[pad_cells(s.mesh)].any(axis=1)
             for s, of_rows in zip(subdomains, rows, strict=True)]
    n_pixels = model.views.map(lambda view: view.correlation.raster.pixel_counts)
    n_visited = sum(int(n[chosen].sum()) for n, chosen in zip(add_views(n_pixels), cells, strict=True))
    n_visited, n_all = team.sum(np.array([n_visited, sum(int(n.sum()) for n in n_pixels.flat)], dtype=float))
    if n_visited > MOST_VISITED * n_all:
        return None
    views = model.views.map(FrameView.confine, model.views.fill(cells))
    held = (replace(correction.grey[0], n_pixels=int(n_visited)), *correction.grey[1:])
    near = replace(model, views=views, held_grey=held, known=None)
    return SlowNodes(near, rows, correction.q, correction.b, systems)


def _join_copies(team: Team, subdomains: Sequence[Subdomain], nodes: Sequence[BoolArray]) -> list[BoolArray]:
    """Nodes of which any copy is among some nodes, (n_nodes,) of each owned subdomain; collective."""
    n_copies = sum_shared_nodes(team, subdomains, [of_subdomain.astype(float)[:, None] for of_subdomain in nodes])
    return [of_subdomain[:, 0] > 0 for of_subdomain in n_copies]


def _find_neighbours(subdomain: Subdomain, nodes: BoolArray) -> BoolArray:
    """Nodes that share a cell with some nodes, these included, (n_nodes,)."""
    corners = pad_cells(subdomain.mesh)
    found = np.array(nodes)
    found[corners[nodes[corners].any(axis=1)]] = True
    return found


def estimate_node_deviations(model: ResidualModel, systems: Sequence[LocalSystem], noise: float, *,
                             by_pixels_alone: bool = False) -> list[Array]:
    """Estimate the standard deviation of each node's displacement, (n_nodes,), pixels; collective.

    It is that of the larger component, from diagonals: sqrt(noise M_ii) / A_ii is what noise leaves if all other
    unknowns hold still, less than if they do not. Of M, what the noise of f gives to |grad f|^2 is no texture: the mean
    force does not change with it. ``noise`` is the variance of the residual that the noise of both images makes, grey
    levels squared. With ``by_pixels_alone`` mechanics hold nothing: they may hold a field of weak texture in a wrong
    place.
    """
    sums, degree = [], model.views[0][0].deformed.degree
    for system, of_views in zip(systems, model.views, strict=True):
        hessian = system.hessian.diagonal()
        operator = hessian if by_pixels_alone else system.diagonal
        sums.append(np.hstack([_take_to_nodes(system, hessian), _take_to_nodes(system, operator),
                               _sum_squared_shapes(system.subdomain.mesh, of_views)]))
    deviations = []
    for total in sum_shared_nodes(model.team, model.subdomains, sums):
        of_hessian, of_operator = total[:, :-1].T.reshape(2, -1, len(total))
        known = of_operator - NOISE_OF_SLOPE[degree] * 0.5 * noise * total[:, -1]
        of_noise = np.sqrt(noise * np.maximum(of_hessian, 0.0))
        known = np.maximum(known, LEAST_KNOWN * of_operator)
        # What neither pixels nor mechanics hold moves nowhere.
        deviations.append(np.divide(of_noise, known, out=np.zeros_like(known), where=known > 0).max(axis=0))
    return deviations


def _take_to_nodes(system: LocalSystem, diagonal: Array) -> Array:
    """Diagonal of a matrix on unknowns as it holds the nodes' components, (n_nodes, dim)."""
    subdomain = system.subdomain
    of_nodes = subdomain.kinematics.tangent.power(2) @ diagonal[:subdomain.n_field]
    return np.asarray(of_nodes).reshape(subdomain.mesh.nodes.shape)


def _sum_squared_shapes(mesh: Mesh, views: Sequence[FrameView]) -> Array:
    """Sum of the squared shape function of each node over the pixels about it, (n_nodes, 1), cameras weighted."""
    of_cells = np.sum([view.weight * view.correlation.raster.pixel_counts for view in views], axis=0)
    parts = np.empty(mesh.n_cells)
    for block in mesh.cell_blocks:
        parts[block.cells] = block.type.parts_of_squared_shape
    return sum_about_nodes(mesh, of_cells / parts)[:, None]
