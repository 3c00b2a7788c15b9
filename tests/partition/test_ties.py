"""Near meshes in place of far cells: what is joined, what is tied, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import InputError
from ddic.functionals.regularization import Material, controlled_stiffness
from ddic.kinematics.linear import TiedKinematics, TiedRegion
from ddic.kinematics.nodal import NodalKinematics, component_numbers
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_areas
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.partition.sharing import build_subdomains
from ddic.partition.ties import Tying, tie_meshes
from support.sharers import count_sharers

FAR = build_structured_mesh((20, 20, 116, 116), 8)
ISLAND, EDGE = (44.0, 36.0, 84.0, 76.0), (60.0, 20.0, 100.0, 60.0)


def near_mesh(region: tuple[float, ...], element: float, cell: str = "Q4") -> Mesh:
    return build_structured_mesh(region, element, "T3" if cell == "T3" else "Q4")


def by_dof(weights: sparse.csr_matrix) -> sparse.csr_matrix:
    return sparse.kron(weights, sparse.identity(2)).tocsr()


@settings(max_examples=30)
@given(region=st.sampled_from([ISLAND, EDGE]), element=st.floats(1.5, 7.9), cell=st.sampled_from(["Q4", "T3"]),
       gradient=st.lists(st.floats(-1, 1), min_size=4, max_size=4))
def test_a_linear_field_is_kept_and_in_equilibrium(region: tuple[float, ...], element: float, cell: str,
                                                   gradient: list[float]) -> None:
    """The patch test: no force on any unknown node inside, those on the common boundary among them."""
    mesh, tying = tie_meshes(FAR, {1: near_mesh(region, element, cell)})
    field = mesh.nodes @ np.array(gradient).reshape(2, 2) + (3.0, -1.0)
    unknown = field[:tying.n_unknown_nodes]
    np.testing.assert_allclose(tying.weights @ unknown, field, rtol=0, atol=1e-12)
    of_nodes = NodalKinematics(mesh, np.arange(mesh.n_dofs))
    k = controlled_stiffness(of_nodes, Material(), np.ones(mesh.n_dofs))
    forces = (by_dof(tying.weights).T @ k @ field.ravel()).reshape(-1, 2)
    inside = np.ones(tying.n_unknown_nodes, dtype=bool)
    inside[tying.boundary[tying.boundary < len(inside)]] = False
    # Forces of single elements are up to E times 8 px: rounding of sums of a few hundred of these.
    assert np.abs(forces[inside]).max() <= 1e-11
    assert np.abs(forces[~inside]).max() > 1e-3 * np.abs(gradient).max() or np.abs(gradient).max() < 1e-3


@pytest.mark.parametrize("region", [ISLAND, EDGE])
def test_the_joined_mesh(region: tuple[float, ...]) -> None:
    near = near_mesh(region, 3.1)
    mesh, tying = tie_meshes(FAR, {2: near})
    assert measure_areas(mesh).sum() == pytest.approx(96**2)
    assert int((tying.cameras == 2).sum()) == near.n_cells
    assert set(tying.cameras.tolist()) == {0, 2}
    # One boundary, that of the far mesh, but with the near mesh's nodes where that is part of it.
    outer = find_boundary_nodes(FAR)
    kept = FAR.nodes[outer]
    on_outline = (np.abs(mesh.nodes - 68) >= 48 - 1e-9).any(axis=1)
    assert tying.boundary.tolist() == np.flatnonzero(on_outline).tolist()
    if region == ISLAND:
        np.testing.assert_array_equal(np.sort(mesh.nodes[tying.boundary].ravel()), np.sort(kept.ravel()))
    assert mesh.node_sets["left"].tolist() == np.flatnonzero(
        np.isin(mesh.nodes[:, 0], [20, region[0]]) & ((mesh.nodes[:, 0] == 20) | (
            np.arange(mesh.n_nodes) >= mesh.n_nodes - near.n_nodes) & (mesh.nodes[:, 1] >= region[1])
            & (mesh.nodes[:, 1] <= region[3]) & _of(mesh, tying, 2))).tolist()


def _of(mesh: Mesh, tying: Tying, camera: int) -> NDArray[np.bool_]:
    nodes = np.zeros(mesh.n_nodes, dtype=bool)
    nodes[mesh.create_submesh(np.flatnonzero(tying.cameras == camera))[1]] = True
    return nodes


def test_matching_meshes_are_one() -> None:
    """The far mesh's own cells as the near mesh: every slave is the far node at its place."""
    centre = FAR.centroids
    inside = ((centre > ISLAND[:2]) & (centre < ISLAND[2:])).all(axis=1)
    mesh, tying = tie_meshes(FAR, {1: FAR.create_submesh(np.flatnonzero(inside))[0]})
    assert mesh.n_cells == FAR.n_cells
    assert tying.n_unknown_nodes == FAR.n_nodes
    slaves = tying.weights[tying.n_unknown_nodes:]
    assert np.diff(slaves.indptr).tolist() == [1] * slaves.shape[0]
    np.testing.assert_allclose(slaves.data, 1.0, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(mesh.nodes[slaves.indices], mesh.nodes[tying.n_unknown_nodes:])


def test_subdomains_have_the_masters_of_their_slaves() -> None:
    mesh, tying = tie_meshes(FAR, {1: near_mesh(ISLAND, 3.1)})
    parts = tying.cameras
    region = TiedRegion(mesh, tying.weights)
    slaves = tying.weights[tying.n_unknown_nodes:]
    masters = np.unique(slaves.indices)
    shared = np.flatnonzero(count_sharers(region, parts) == 2)
    assert shared.tolist() == component_numbers(masters.astype(np.int64), 2).tolist()
    far, near = build_subdomains(region, parts, np.ones(region.n_unknowns, dtype=bool))
    assert isinstance(far.kinematics, NodalKinematics)
    assert isinstance(near.kinematics, TiedKinematics)
    q = np.random.default_rng(0).normal(size=region.n_unknowns)
    everywhere = by_dof(tying.weights) @ q
    for part in (far, near):
        np.testing.assert_allclose(part.displacement(q[part.numbers]).reshape(-1, 2),
                                   everywhere.reshape(-1, 2)[part.node_ids], atol=1e-14)
        np.testing.assert_array_equal(mesh.nodes[part.node_ids], part.mesh.nodes)
    # The unknowns come back from what they make: condition numbers of the weights are below 100.
    found = near.kinematics.fit(near.displacement(q[near.numbers]))
    np.testing.assert_allclose(found, q[near.numbers], atol=1e-12)


@pytest.mark.parametrize(("region", "message"), [
    # Cells are numbered row by row, 12 a row: the near mesh begins in the middle of column 3.
    ((48, 36, 84, 76), r"near, entry 1: the outline of its mesh cuts 5 far elements \(numbered from 0: "
                       r"27, 39, 51, 63, 75; the first around column 48, row 40\)"),
    # Less than half of the cells of column 2: these stay far ones.
    ((41, 36, 84, 76), r"cuts 5 far elements \(numbered from 0: 26, 38, 50, 62, 74;"),
    ((47, 36, 84, 76), r"cuts 5 far elements \(numbered from 0: 27, 39, 51, 63, 75;"),
    ((45, 37, 47, 39), "no boundary in common"),
    ((20, 20, 116, 116), "which leaves none to the far-field images"),
])
def test_outlines_that_do_not_fit_are_refused(region: tuple[float, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        tie_meshes(FAR, {1: near_mesh(region, 2.0)})


def test_two_near_meshes() -> None:
    left, right = (36.0, 36.0, 60.0, 76.0), (76.0, 44.0, 100.0, 84.0)
    mesh, tying = tie_meshes(FAR, {1: near_mesh(left, 3.1), 2: near_mesh(right, 3.5)})
    assert measure_areas(mesh).sum() == pytest.approx(96**2)
    field = mesh.nodes @ np.array([[0.1, 0.4], [-0.2, 0.3]])
    np.testing.assert_allclose(tying.weights @ field[:tying.n_unknown_nodes], field, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("second", "message"), [
    ((60, 44, 100, 84), "near, entry 2: its mesh touches that of entry 1; leave one far element"),
    ((52, 44, 100, 84), "near, entry 2: its mesh overlaps that of entry 1"),
])
def test_near_meshes_that_touch_are_refused(second: tuple[float, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        tie_meshes(FAR, {1: near_mesh((36, 36, 60, 76), 3.1), 2: near_mesh(second, 3.5)})


def test_an_edge_that_sticks_out_is_refused() -> None:
    """The near mesh ends 4 px above the far one, with elements of 7.33 px."""
    with pytest.raises(InputError, match=r"its mesh around column 60\.0, row 19\.7 touches far elements in part"):
        tie_meshes(FAR, {1: build_structured_mesh((60, 16, 84, 60), 8)})


def test_curved_free_edges_may_differ() -> None:
    """A hole that both meshes have, in chords of different length: the far cells beside it stay whole."""
    hole = [((68.0, 68.0), 13.0)]
    far = build_structured_mesh((20, 20, 116, 116), 8, circles=hole)
    whole = build_structured_mesh((44, 44, 92, 92), 3, circles=hole)
    mesh, tying = tie_meshes(far, {1: whole})
    assert set(tying.cameras.tolist()) == {0, 1}
    radius = np.linalg.norm(mesh.nodes[tying.boundary] - 68.0, axis=1)
    assert (np.abs(radius - 13) < 0.5).sum() > 20
