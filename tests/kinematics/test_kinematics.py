"""What every kinematics keeps: tangent, fit, projections and values anywhere, of subdomains and of whole regions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import InputError
from ddic.images.camera import CameraMapping
from ddic.kinematics.camera import CameraSetup, MotionKind, place_before_camera
from ddic.kinematics.kinematics import Kinematics, RegionKinematics
from ddic.kinematics.linear import LinearRegion, TiedKinematics, TiedRegion
from ddic.kinematics.nodal import NodalKinematics, NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.partition.ties import Tying, tie_meshes
from support.random_meshes import SEEDS, delaunay_meshes, grid_mesh, grid_meshes

MESHES = st.one_of(grid_meshes(most=4), delaunay_meshes())
TILTED = CameraMapping(np.array([[4.9, -0.3, -1300.0], [0.4, 5.1, -900.0], [2e-5, -1.5e-5, 1.0]]))
Array = NDArray[np.float64]


def tied() -> tuple[Mesh, Tying]:
    return tie_meshes(build_structured_mesh((20, 20, 116, 116), 8), {1: build_structured_mesh((44, 36, 84, 76), 3.1)})


def fix_every_third_along_y(mesh: Mesh) -> LinearRegion:
    """Unknowns are the components of displacements, but every third node is fixed along y."""
    moves = np.ones(mesh.nodes.shape, dtype=bool)
    moves[::3, 1] = False
    free = np.flatnonzero(moves)
    return LinearRegion(mesh, sparse.identity(mesh.n_dofs, format="csr")[:, free])


def move_affinely(mesh: Mesh) -> LinearRegion:
    """Six unknowns of the whole region: translations, and a displacement gradient over half of its extent."""
    x, y = ((mesh.nodes - mesh.nodes.mean(axis=0)) / np.ptp(mesh.nodes, axis=0).max() * 2).T
    one, nothing = np.ones_like(x), np.zeros_like(x)
    modes = [(one, nothing), (nothing, one), (x, nothing), (y, nothing), (nothing, x), (nothing, y)]
    return LinearRegion(mesh, sparse.csr_matrix(np.stack([np.column_stack(m).ravel() for m in modes], axis=1)))


def restrict(region: RegionKinematics, cells: NDArray[np.int64]) -> tuple[Kinematics, NDArray[np.int64]]:
    """Kinematics of some cells, and their nodes in the whole mesh."""
    part, node_ids = region.mesh.create_submesh(cells)
    numbers = np.unique(region.unknowns_at(node_ids)[0])
    return region.restrict(part, node_ids, numbers), node_ids


def of_camera(motion: MotionKind) -> Kinematics:
    mesh = grid_mesh(6, 5, (20.0, 16.0), origin=(330.0, 180.0), seed=1, jitter=0.15)
    setup = CameraSetup(TILTED, motion, np.array([390.0, 225.0]), 140.0)
    field = restrict(fix_every_third_along_y(mesh), np.arange(mesh.n_cells))[0]
    return place_before_camera(field, setup, mesh.n_dofs + np.arange(setup.n_motion_unknowns))


def of_near_mesh() -> Kinematics:
    mesh, tying = tied()
    return restrict(TiedRegion(mesh, tying.weights), np.flatnonzero(tying.cameras == 1))[0]


def of_region(choose: Callable[[Mesh], RegionKinematics]) -> Kinematics:
    mesh = grid_mesh(5, 4, (14.0, 11.0), origin=(30.0, 50.0), cells="mixed", seed=4, jitter=0.2)
    return restrict(choose(mesh), np.arange(12))[0]


IMPLEMENTATIONS: dict[str, Callable[[], Kinematics]] = {
    "nodal": lambda: of_region(NodalRegion),
    "linear": lambda: of_region(fix_every_third_along_y),
    "modes": lambda: of_region(move_affinely),
    "tied": of_near_mesh,
    "camera": lambda: of_camera("none"),
    "moving camera": lambda: of_camera("rigid"),
}
EVERY = pytest.mark.parametrize("make", IMPLEMENTATIONS.values(), ids=IMPLEMENTATIONS)


@EVERY
def test_tangent_is_the_derivative_of_the_displacement_at_rest(make: Callable[[], Kinematics]) -> None:
    kinematics = make()
    assert kinematics.n_unknowns == len(kinematics.numbers)
    assert kinematics.tangent.shape == (kinematics.mesh.n_dofs, kinematics.n_unknowns)
    step = 1e-3
    numeric = np.stack([(kinematics.displacement(step * e) - kinematics.displacement(-step * e)) / (2 * step)
                        for e in np.eye(kinematics.n_unknowns)], axis=1)
    # Rounding of positions of 1e3 px over the step gives 1e-10; third derivatives times step^2 are less.
    np.testing.assert_allclose(kinematics.tangent.toarray(), numeric, atol=2e-9)


@EVERY
def test_fit_inverts_the_displacement(make: Callable[[], Kinematics]) -> None:
    kinematics = make()
    q = np.random.default_rng(0).normal(size=kinematics.n_unknowns)
    # What moves a camera is not found by a fit.
    q[kinematics.hold_still().n_unknowns:] = 0.0
    # Positions of 1e3 px round to 1e-13 px, weights of ties and normal equations of modes have conditions below 1e3.
    np.testing.assert_allclose(kinematics.fit(kinematics.displacement(q)), q, atol=1e-10)


@pytest.mark.parametrize("name", ["nodal", "linear", "modes", "tied"])
def test_fit_leaves_nothing_that_an_unknown_could_explain(name: str) -> None:
    kinematics = IMPLEMENTATIONS[name]()
    u = np.random.default_rng(1).normal(size=kinematics.mesh.n_dofs)
    rest = u - kinematics.displacement(kinematics.fit(u))
    left = kinematics.project_vector(rest)
    if isinstance(kinematics, TiedKinematics):
        # Free nodes are taken as they are, only the masters fit in least squares.
        depends = kinematics.tangent.toarray() != 0
        free = depends.sum(axis=1) == 1
        assert np.abs(rest[free]).max() <= 1e-14
        masters = np.flatnonzero(~depends[free].any(axis=0))
        assert 0 < len(masters) < kinematics.n_unknowns
        left = left[masters]
    # Rounding of sums of some dozen numbers of order one.
    np.testing.assert_allclose(left, 0.0, atol=1e-12)


@EVERY
def test_projections_are_adjoint_to_the_tangent(make: Callable[[], Kinematics]) -> None:
    kinematics = make()
    rng = np.random.default_rng(2)
    n = kinematics.mesh.n_dofs
    q, p = rng.normal(size=(2, kinematics.n_unknowns))
    force = rng.normal(size=n)
    matrix = sparse.random(n, n, 0.05, random_state=3, format="csr")
    u, v = kinematics.tangent @ q, kinematics.tangent @ p
    # Rounding of sums of a few hundred terms, of the camera's five pixels squared.
    assert kinematics.project_vector(force) @ q == pytest.approx(force @ u, rel=1e-12, abs=1e-10)
    assert p @ (kinematics.project_matrix(matrix) @ q) == pytest.approx(v @ (matrix @ u), rel=1e-12, abs=1e-10)


@EVERY
def test_values_at_nodes_are_those_of_the_nodes(make: Callable[[], Kinematics]) -> None:
    kinematics = make()
    q = np.random.default_rng(4).normal(size=kinematics.n_unknowns)
    nodal = kinematics.displacement(q).reshape(-1, 2)
    # The mapping of a point into a cell is found to 1e-12 of its size.
    np.testing.assert_allclose(kinematics.at(kinematics.mesh.nodes, q), nodal, atol=1e-9)
    beyond = kinematics.mesh.nodes.max(axis=0) + 1.0
    assert np.isnan(kinematics.at(beyond[None], q)).all()


def test_values_are_interpolated_by_shape_functions_and_never_across_a_hole() -> None:
    mesh = build_structured_mesh((0, 0, 100, 100), 5, circles=[((50.0, 50.0), 20.0)])
    kinematics = restrict(move_affinely(mesh), np.arange(mesh.n_cells))[0]
    q = np.random.default_rng(5).normal(size=6)
    points = np.random.default_rng(6).uniform(0.1, 99.9, (500, 2))
    found = kinematics.at(points, q)
    gradient = np.array([[q[2], q[3]], [q[4], q[5]]]) * 2 / np.ptp(mesh.nodes, axis=0).max()
    expected = (points - mesh.nodes.mean(axis=0)) @ gradient.T + q[:2]
    radius = np.linalg.norm(points - 50.0, axis=1)
    # Chords of 5 px cut the circle's edge by 5^2 / (8 x 20) = 0.16 px.
    in_hole, outside = radius < 19.7, radius > 20.3
    assert in_hole.sum() > 30
    assert np.isnan(found[in_hole]).all()
    # An affine field is exact on any cell.
    np.testing.assert_allclose(found[outside], expected[outside], atol=1e-10)


def check_restriction(region: RegionKinematics, cells: NDArray[np.int64], seed: int) -> None:
    """A subdomain's part of a field is the field on its nodes; unknowns_at names the columns of its rows."""
    q = np.random.default_rng(seed).normal(size=region.n_unknowns)
    everything, all_ids = restrict(region, np.arange(region.mesh.n_cells))
    whole = np.full((region.mesh.n_nodes, 2), np.nan)
    whole[all_ids] = everything.displacement(q[everything.numbers]).reshape(-1, 2)
    part, node_ids = restrict(region, cells)
    np.testing.assert_allclose(part.displacement(q[part.numbers]).reshape(-1, 2), whole[node_ids], atol=1e-13)
    # Every unknown of the part moves one of its nodes.
    assert (np.diff(part.tangent.tocsc().indptr) > 0).all()
    unknowns, counts = region.unknowns_at(node_ids)
    assert len(counts) == len(node_ids)
    assert counts.sum() == len(unknowns)
    for node, found in enumerate(np.split(unknowns, np.cumsum(counts)[:-1])):
        columns = part.numbers[np.unique(part.tangent[2 * node: 2 * node + 2].indices)]
        assert set(columns.tolist()) == set(found.tolist())


@settings(max_examples=40)
@given(mesh=MESHES, seed=SEEDS, kind=st.sampled_from([NodalRegion, fix_every_third_along_y, move_affinely]))
def test_a_part_of_a_region_moves_as_the_region_does(mesh: Mesh, seed: int,
                                                     kind: Callable[[Mesh], RegionKinematics]) -> None:
    cells = np.flatnonzero(np.random.default_rng(seed).random(mesh.n_cells) < 0.6)
    check_restriction(kind(mesh), cells if len(cells) else np.array([0]), seed)


@pytest.mark.parametrize("camera", [0, 1])
def test_a_part_of_a_tied_region_moves_as_the_region_does(camera: int) -> None:
    mesh, tying = tied()
    check_restriction(TiedRegion(mesh, tying.weights), np.flatnonzero(tying.cameras == camera), 7)


@settings(max_examples=40)
@given(mesh=MESHES, seed=SEEDS)
def test_an_unknown_is_controlled_where_all_its_nodes_are(mesh: Mesh, seed: int) -> None:
    nodes = np.random.default_rng(seed).random(mesh.n_nodes) < 0.8
    np.testing.assert_array_equal(NodalRegion(mesh).controlled(nodes), np.repeat(nodes, 2))
    for region in (fix_every_third_along_y(mesh), move_affinely(mesh)):
        touched = region.matrix.toarray() != 0
        expected = [all(nodes[row // 2] for row in np.flatnonzero(column)) for column in touched.T]
        assert region.controlled(nodes).tolist() == expected


def test_an_unknown_of_tied_nodes_is_controlled_where_its_node_is() -> None:
    mesh, tying = tied()
    nodes = np.ones(mesh.n_nodes, dtype=bool)
    nodes[tying.boundary] = False
    controlled = TiedRegion(mesh, tying.weights).controlled(nodes)
    assert controlled.tolist() == np.repeat(nodes[:tying.n_unknown_nodes], 2).tolist()
    # Slaves lie inside the region: the far mesh's inner outline is no free edge.
    assert set(tying.boundary.tolist()) < set(find_boundary_nodes(mesh).tolist())


def test_a_nodal_part_costs_no_product() -> None:
    mesh = grid_mesh(3, 3, (4.0, 4.0))
    kinematics = NodalKinematics(mesh, np.arange(mesh.n_dofs))
    matrix, vector = sparse.identity(mesh.n_dofs, format="csr"), np.arange(mesh.n_dofs, dtype=float)
    assert kinematics.project_matrix(matrix) is matrix
    assert kinematics.project_vector(vector) is vector
    assert kinematics.hold_still() is kinematics


@pytest.mark.parametrize(("spoil", "message"), [
    (lambda t: t[:-1], "has 31 rows, the mesh 32 displacements"),
    (lambda t: sparse.hstack([t, sparse.csr_matrix((32, 1))]), "unknown 6 displaces no node"),
    (lambda t: t * np.nan, "not finite"),
])
def test_matrices_that_are_no_kinematics_are_refused(spoil: Callable[[sparse.csr_matrix], sparse.csr_matrix],
                                                     message: str) -> None:
    mesh = grid_mesh(3, 3, (4.0, 4.0))
    with pytest.raises(InputError, match=message):
        LinearRegion(mesh, spoil(move_affinely(mesh).matrix))


def test_a_part_too_small_to_tell_modes_apart_fits_what_they_do_there() -> None:
    mesh = grid_mesh(8, 6, (14.0, 11.0), origin=(30.0, 50.0), seed=4, jitter=0.2)
    x, y = ((mesh.nodes - mesh.nodes.mean(axis=0)) / 50.0).T
    modes = [np.column_stack([x**a * y**b, np.zeros_like(x)]).ravel() for a in range(4) for b in range(3)]
    region = LinearRegion(mesh, sparse.csr_matrix(np.stack(modes, axis=1)))
    # Twelve unknowns that move four nodes along x.
    kinematics = restrict(region, np.array([13]))[0]
    assert np.linalg.matrix_rank(kinematics.tangent.toarray()) == 4
    q = np.random.default_rng(8).normal(size=12)
    u = kinematics.displacement(q)
    found = kinematics.fit(u)
    # The share that is added to the normal equations, relative to their lowest eigenvalue of about 1e-3.
    np.testing.assert_allclose(kinematics.displacement(found), u, atol=1e-8)
    # No larger than need be.
    assert np.linalg.norm(found) <= np.linalg.norm(q) * (1 + 1e-6)
