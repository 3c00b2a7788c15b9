"""Cells beside what is excluded that hold a node by few pixels."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.parallel.field import ByView
from ddic.parallel.team import Team
from ddic.problem.residual_model import ResidualModel
from ddic.synth.fields import Translation
from ddic.visibility.exclusions import (
    KEPT,
    LEAST_HELD,
    SPOILT,
    UNSEEN,
    Exclusions,
    exclude,
    exclude_weak_cells,
)
from support.pictures import pair_of, source, square_mesh
from support.split_model import split_model

MESH = square_mesh(24.0, 120.0)
"""6 x 6 cells of 16 px."""

IMAGE = pair_of(Translation((0.0, 0.0)), 144, 8).reference


def model_of(team: Team, blocks: tuple[int, int]) -> ResidualModel:
    return split_model(team, source(IMAGE), source(IMAGE), MESH, blocks)


def cut(model: ResidualModel, states: NDArray[np.uint8], pixels: NDArray[np.int64]) -> Exclusions:
    """What is excluded of the whole mesh, by subdomain; pixels : (n, 2) in cells that are kept."""
    cells, spots = [], []
    nothing = Exclusions.of_reference(model.views)
    for s in model.subdomains:
        cells.append((states[s.cell_ids].copy(),))
        low, high = s.mesh.nodes.min(axis=0), s.mesh.nodes.max(axis=0)
        spots.append((pixels[((pixels >= low) & (pixels < high)).all(axis=1)],))
    return Exclusions(ByView(cells), ByView(spots), nothing.pulled)


def find_slowly(states: NDArray[np.uint8], pixels: NDArray[np.int64]) -> NDArray[np.uint8]:
    """By M of the whole mesh, node by node."""
    model = model_of(Team.alone(), (1, 1))
    diagonal = exclude(model, cut(model, states, pixels)).views[0][0].assemble_hessian().diagonal()
    held = diagonal.reshape(-1, 2).sum(axis=1)
    mean = held.sum() / (held > 0).sum()
    cells = MESH.connectivity.reshape(-1, 4)
    found = states.copy()
    for node in range(MESH.n_nodes):
        about = [cell for cell in range(MESH.n_cells) if node in cells[cell]]
        if any(states[cell] != KEPT for cell in about) and held[node] < LEAST_HELD * mean:
            for cell in about:
                if found[cell] == KEPT:
                    found[cell] = UNSEEN
    return found


def scene() -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """2 x 2 cells in the middle are spoilt, and all but a strip of the cell at their corner, and of one far off."""
    states = np.zeros(MESH.n_cells, dtype=np.uint8)
    middle = ((MESH.centroids > 40) & (MESH.centroids < 72)).all(axis=1)
    assert middle.sum() == 4
    states[middle] = SPOILT
    y, x = np.mgrid[0:13, 0:16]
    beside = np.column_stack([(x + 40).ravel(), (y + 24).ravel()])
    far = np.column_stack([(x + 104).ravel(), (y + 104).ravel()])
    return states, np.concatenate([beside, far]).astype(np.int64)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("blocks", [(1, 1), (2, 2), (3, 2)])
def test_it_finds_what_the_whole_mesh_says(blocks: tuple[int, int]) -> None:
    team = Team.world()
    if blocks[0] * blocks[1] < team.size:
        pytest.skip("fewer subdomains than ranks")
    states, pixels = scene()
    expected = find_slowly(states, pixels)
    model = model_of(team, blocks)
    excluded = exclude_weak_cells(model, cut(model, states, pixels))
    for subdomain, (found,) in zip(model.subdomains, excluded.cells, strict=True):
        np.testing.assert_array_equal(found, expected[subdomain.cell_ids])


def test_the_oracle_finds_something_beside_and_nothing_far_off() -> None:
    states, pixels = scene()
    # Few pixels of the edge: each node there has two cells, of which one is spoilt or has a strip only.
    weak = find_slowly(states, pixels) == UNSEEN
    at_edge = states.copy()
    edge = (MESH.centroids[:, 1] < 40) & (MESH.centroids[:, 0] > 40) & (MESH.centroids[:, 0] < 72)
    at_edge[edge] = SPOILT
    assert not weak[MESH.centroids[:, 0] > 100].any()
    # All but the lower left pixels of a cell between spoilt ones: its nodes are held by almost nothing.
    states[:] = SPOILT
    states[0] = states[20] = states[21] = KEPT
    y, x = np.mgrid[24:40, 24:40]
    pixels = np.column_stack([x.ravel(), y.ravel()])[:250].astype(np.int64)
    assert (find_slowly(states, pixels) == UNSEEN)[0]
    assert not (find_slowly(states, pixels) == UNSEEN)[[20, 21]].any()


def test_nothing_is_weak_where_nothing_is_excluded() -> None:
    model = model_of(Team.alone(), (2, 2))
    excluded = exclude_weak_cells(model, Exclusions.of_reference(model.views))
    assert not excluded.is_any(Team.alone())
