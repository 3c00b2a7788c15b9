"""Repair of meshes and refusal of bad cells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.errors import InputError
from ddic.images.window import Window
from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.quality import measure_areas, measure_shape_quality
from ddic.mesh.repair import check_inside, check_pixels, repair
from ddic.mesh.structured import build_structured_mesh

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5], [2.0, 0.0]])


def _cells_of(mesh: Mesh) -> list[list[tuple[float, ...]]]:
    return [sorted(map(tuple, mesh.nodes[cell[cell >= 0]])) for cell in mesh.cells]


def _refusal(quads: list[list[int]]) -> str:
    with pytest.raises(InputError) as caught:
        repair(build_mesh(SQUARE, {Q4: np.array(quads)}))
    return str(caught.value)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 7))
def test_orientation_and_numbering_are_repaired(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    good = build_structured_mesh((0, 0, 20.0 * n, 20.0 * n), 10, circles=[((10.0 * n, 10.0 * n), 8.0 * n)])
    n_extra = int(rng.integers(0, 5))
    place = rng.permutation(good.n_nodes + n_extra)[:good.n_nodes]
    nodes = np.full((good.n_nodes + n_extra, 2), np.nan)  # unused nodes may even be nonsense
    nodes[place] = good.nodes
    blocks = {}
    for kind in (Q4, T3):
        k = kind.n_nodes
        cells = place[good.cells[good.types == kind.vtk][:, :k]]
        turned = np.array([np.roll(c, rng.integers(k))[::rng.choice([1, -1])] for c in cells])
        blocks[kind] = turned.reshape(-1, k)
    sets = {name: np.sort(place[members]) for name, members in good.node_sets.items()}
    repaired = repair(build_mesh(nodes, blocks, sets))
    assert _cells_of(repaired) == _cells_of(good)
    assert measure_areas(repaired).min() > 0
    np.testing.assert_allclose(measure_areas(repaired), measure_areas(good), rtol=1e-12)
    assert repaired.n_nodes == good.n_nodes
    for name, members in good.node_sets.items():
        moved = repaired.nodes[repaired.node_sets[name]]
        assert sorted(map(tuple, moved)) == sorted(map(tuple, good.nodes[members]))


def test_sound_mesh_is_unchanged() -> None:
    mesh = build_structured_mesh((0, 0, 50, 50), 10)
    repaired = repair(mesh)
    assert np.array_equal(repaired.connectivity, mesh.connectivity)
    assert np.array_equal(repaired.nodes, mesh.nodes)


@pytest.mark.parametrize(("quad", "words"), [
    ([0, 2, 1, 3], "flat, crossed or not convex"),  # bow tie
    ([0, 1, 4, 3], "flat, crossed or not convex"),  # node 4 on the diagonal: a corner of 180 degrees
    ([0, 1, 5, 3], "flat, crossed or not convex"),  # 0, 1, 5 in line
    ([0, 1, 1, 3], "have a node twice"),
    ([0, 1, 2, 9], "name nodes that do not exist"),
    ([0, 1, 2, -1], "name nodes that do not exist"),
])
def test_bad_cells_are_refused_by_number(quad: list[int], words: str) -> None:
    message = _refusal([[0, 1, 2, 3], quad])
    assert words in message
    assert "numbered from 0: 1)" in message


def test_reentrant_quad_is_refused_whatever_its_sense() -> None:
    nodes = np.array([[0.0, 0.0], [4.0, 0.0], [1.0, 1.0], [0.0, 4.0]])
    for quad in ([0, 1, 2, 3], [3, 2, 1, 0]):
        with pytest.raises(InputError, match="not convex"):
            repair(build_mesh(nodes, {Q4: np.array([quad])}))


def test_duplicates_are_refused_whatever_their_order() -> None:
    assert "repeat an earlier cell" in _refusal([[0, 1, 2, 3], [2, 1, 0, 3]])


def test_all_problems_and_ten_numbers_are_listed() -> None:
    message = _refusal([[0, 1, 1, 3]] * 12)
    assert "12 cells (numbered from 0: 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, ...) have a node twice" in message
    assert "11 cells (numbered from 0: 1, 2" in message


def test_used_nodes_must_be_finite() -> None:
    nodes = SQUARE.copy()
    nodes[2, 1] = np.inf
    with pytest.raises(InputError, match="nodes 2 have coordinates"):
        repair(build_mesh(nodes, {Q4: np.array([[0, 1, 2, 3]])}))


def test_mesh_without_cells_is_refused() -> None:
    with pytest.raises(InputError, match="no cell"):
        repair(build_mesh(SQUARE, {}))


def test_quality_of_mixed_cells() -> None:
    nodes = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [2.0, 0.0]])
    mesh = build_mesh(nodes, {Q4: np.array([[0, 1, 2, 3]]), T3: np.array([[1, 4, 2]])})
    np.testing.assert_allclose(measure_areas(mesh), [1.0, 0.5], rtol=1e-15)
    np.testing.assert_allclose(measure_shape_quality(mesh), [1.0, np.sqrt(0.5)], rtol=1e-14)


def test_first_and_last_half_pixels_belong_to_the_image() -> None:
    check_inside(build_structured_mesh((-0.5, -0.5, 99.5, 49.5), 10), Window.of_size(100, 50))


@pytest.mark.parametrize("region", [(0, 0, 100, 49), (-1, 0, 90, 40), (0, -1, 90, 40), (0, 0, 90, 50)])
def test_mesh_outside_the_image_is_refused(region: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"outside the image.*image 100 x 50 px"):
        check_inside(build_structured_mesh(region, 10), Window.of_size(100, 50))


def test_cells_without_pixels_are_refused_by_number() -> None:
    mesh = build_structured_mesh((0, 0, 30, 10), 10)
    check_pixels(mesh, np.array([1, 5, 3]), "a.msh")
    with pytest.raises(InputError, match=r"a\.msh: 2 cells \(numbered from 0: 0, 2\) of 3 hold no pixel"):
        check_pixels(mesh, np.array([0, 5, 0]), "a.msh")
