"""Meshes whose cells do not meet side to side."""

from __future__ import annotations

import re

import numpy as np
import pytest

from ddic.errors import InputError
from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.raster import list_pixels, rasterize
from ddic.mesh.repair import _is_covered_twice, check_joints
from ddic.mesh.topology import find_facets
from support.random_meshes import box_mesh

SQUARE = [(10, 10), (30, 10), (50, 10), (10, 30), (30, 30), (50, 30)]
TWO = [(0, 1, 4, 3), (1, 2, 5, 4)]


def _build(nodes: list[tuple[float, float]], quads: list[tuple[int, ...]], triangles: tuple[tuple[int, ...], ...] = (),
           ) -> Mesh:
    blocks = [(Q4, np.array(quads, np.int64).reshape(-1, 4)), (T3, np.array(triangles, np.int64).reshape(-1, 3))]
    return build_mesh(np.array(nodes, np.float64), blocks)


def test_cells_side_to_side_and_a_slit_between_nodes_at_one_place_are_sound() -> None:
    check_joints(_build(SQUARE, TWO))
    check_joints(_build([*SQUARE, (30, 10), (30, 30)], [TWO[0], (6, 2, 5, 7)]))


BAD = {
    "a side of three cells": (_build([*SQUARE, (40, 24)], TWO, ((1, 6, 4),)), "belong to more than two cells"),
    "a node on a side": (_build([(10, 10), (30, 10), (10, 30), (30, 30), (50, 10), (50, 20), (30, 20)],
                                [(0, 1, 3, 2), (1, 4, 5, 6)]), r"1 nodes lie on a side .* \(30, 20\)"),
    "a cell over others": (_build([*SQUARE, (15, 12), (45, 12), (30, 28)], TWO, ((6, 7, 8),)),
                           r"3 cells .*0, 1, 2\) lie over others"),
}


@pytest.mark.parametrize(("mesh", "reason"), BAD.values(), ids=BAD)
def test_others_are_refused(mesh: Mesh, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as caught:
        check_joints(mesh)
    # Three cells at a side lie over one another as well, which is no other fault.
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize("seed", range(12))
def test_pixels_of_two_cells_are_told_by_the_edge_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns, rows = np.meshgrid(np.arange(5), np.arange(4))
    nodes = 20 + 15.0 * np.stack([columns.ravel(), rows.ravel()], axis=1) + rng.uniform(-3, 3, (20, 2))
    corners = [(a, a + 1, a + 6, a + 5) for a in range(14) if a % 5 < 4]
    # From far outside to right inside: a cell of its own, whose nodes no other has.
    alone = rng.uniform(0, 90, 2) + np.array([(0, 0), (8, 0), (2, 7)])
    mesh = _build([*nodes, *alone], corners, ((20, 21, 22),))
    pixels, _ = list_pixels(rasterize(mesh), np.arange(mesh.n_cells))
    assert _is_covered_twice(mesh, find_facets(mesh)) == (len(np.unique(pixels, axis=0)) < len(pixels))
    twice = _build([*nodes], [*corners, corners[0]])
    assert _is_covered_twice(twice, find_facets(twice))


def join(*meshes: Mesh) -> Mesh:
    """Meshes beside each other, nodes at one place made one."""
    nodes = np.concatenate([mesh.nodes for mesh in meshes])
    places, numbers = np.unique(nodes.round(9), axis=0, return_inverse=True)
    first = np.cumsum([0, *(mesh.n_nodes for mesh in meshes)])
    connectivity = np.concatenate([numbers[first[k] + mesh.connectivity] for k, mesh in enumerate(meshes)])
    sizes = np.concatenate([np.diff(mesh.offsets) for mesh in meshes])
    return Mesh(places, connectivity, np.concatenate([[0], np.cumsum(sizes)]),
                np.concatenate([mesh.types for mesh in meshes]))


def box_of(low: tuple[float, float, float], high: tuple[float, float, float], n: tuple[int, int, int]) -> Mesh:
    return GridLines(tuple(np.linspace(*ends, k + 1) for *ends, k in zip(low, high, n, strict=True))).build_mesh()


def test_boxes_in_a_volume_that_meet_node_to_node_are_accepted() -> None:
    check_joints(join(box_of((2, 2, 2), (10, 10, 10), (2, 2, 2)), box_of((10, 2, 2), (18, 10, 10), (2, 2, 2))))
    check_joints(box_mesh(3, "Tet4"))
    check_joints(box_mesh(3, "Hex8"))
    # No voxel is in it: others say so.
    check_joints(box_of((0.1, 0.1, 0.1), (0.3, 0.3, 0.3), (2, 2, 2)))


@pytest.mark.parametrize(("other", "words"), [
    # Twice as fine beside it: nodes in the middle of its faces, and on their edges.
    (box_of((10, 2, 2), (18, 10, 10), (4, 4, 4)), "16 nodes lie on a side of a cell"),
    (box_of((10, 2, 2), (18, 10, 10), (2, 4, 2)), "6 nodes lie on a side of a cell"),
    (box_of((8, 2, 2), (16, 10, 10), (2, 2, 2)), "8 cells (numbered from 0: 1, 3, 5, 7, 8, 10, 12, 14)"),
])
def test_boxes_in_a_volume_that_do_not_are_refused(other: Mesh, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        check_joints(join(box_of((2, 2, 2), (10, 10, 10), (2, 2, 2)), other))
