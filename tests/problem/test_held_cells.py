"""Cells that mechanics hold off pull to where they are seen with M_e (u_seen - u), and with nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.functionals.view import View
from ddic.mesh.mesh import Mesh, pad_cells
from ddic.mesh.structured import build_structured_mesh
from ddic.parallel.field import ByView
from ddic.parallel.team import Team
from ddic.problem.held_cells import CAPTURED, RELEASED, HeldCells, sum_pulls
from ddic.problem.residual_model import ResidualModel
from ddic.synth.fields import Translation
from ddic.visibility.exclusions import HELD_OFF, SPOILT, Exclusions, exclude, pull_held_cells
from support.fields import field_of
from support.one_subdomain import model_of
from support.pictures import pair_of, source, square_mesh
from support.split_model import split_model

Array = NDArray[np.float64]
MESH = square_mesh(24.0, 88.0)
"""4 x 4 cells of 16 px."""

TRIANGLES = build_structured_mesh((24.0, 24.0, 88.0, 88.0), 16.0, "T3")
PAIR = pair_of(Translation((0.3, -0.2)), 128, 8)
HELD = np.array([2, 3, 9])
X = np.tile([1.0, 0.0], MESH.n_nodes)
"""A pixel to the right."""


def build(mesh: Mesh = MESH) -> ResidualModel:
    return model_of(source(PAIR.reference), source(PAIR.deformed), mesh)


def displace(mesh: Mesh, seed: int = 0, size: float = 3.0) -> Array:
    """Unknowns that are pixels off."""
    return np.random.default_rng(seed).normal(0.0, size, mesh.n_dofs)


def hold(model: ResidualModel, u_seen: Array, cells: NDArray[np.int64] = HELD) -> Exclusions:
    """Cells of one subdomain that are seen where a displacement of nodes puts them."""
    mesh = model.subdomains[0].mesh
    states = np.zeros(mesh.n_cells, dtype=np.uint8)
    states[cells] = HELD_OFF
    pulled = HeldCells(cells, u_seen.reshape(-1, 2)[pad_cells(mesh)[cells]])
    return replace(Exclusions.of_reference(model.views), cells=ByView([[states]]), pulled=ByView([[pulled]]))


def pull(model: ResidualModel, excluded: Exclusions, q: Array, at: Array) -> Array:
    pulled = pull_held_cells(model, excluded, field_of(model, [at])).pulled
    assert pulled is not None
    forces, = sum_pulls(pulled, [q])
    return forces


def assemble(view: View, mesh: Mesh, cells: NDArray[np.int64]) -> Array:
    """M of some cells, by loops."""
    matrix = np.zeros((mesh.n_dofs, mesh.n_dofs))
    corners, of_cells = pad_cells(mesh), view.correlation.compute_cell_hessians()
    for cell in cells:
        dofs = (2 * corners[cell][:, None] + np.arange(2)).ravel()
        np.add.at(matrix, np.ix_(dofs, dofs), of_cells[cell])
    return matrix


@pytest.mark.parametrize("mesh", [MESH, TRIANGLES], ids=["Q4", "T3"])
@pytest.mark.parametrize("follows", [False, True])
def test_the_pull_is_m_times_the_way_to_where_cells_are_seen(mesh: Mesh, follows: bool) -> None:
    model = replace(build(mesh), follows=follows)
    u_seen, q, at = displace(mesh, 0, 0.3), displace(mesh, 1, 0.3), displace(mesh, 2, 0.5)
    view = model.views[0][0]
    expected = assemble(view.with_moved_gradient(at) if follows else view, mesh, HELD) @ (u_seen - q)
    found = pull(model, hold(model, u_seen), q, at)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
    # Where the cells are seen nothing pulls; M is that of where the pull was prepared, wherever it pulls.
    assert np.abs(pull(model, hold(model, u_seen), u_seen, at)).max() <= 1e-10 * np.abs(expected).max()


def test_beyond_what_grey_levels_capture_the_pull_does_not_grow() -> None:
    model, away = build(), np.array([3.0, 4.0])
    near, far = (pull(model, hold(model, np.tile(share * away, MESH.n_nodes)), np.zeros(MESH.n_dofs),
                      np.zeros(MESH.n_dofs)) for share in (CAPTURED / 5.0, 1.0))
    np.testing.assert_allclose(far, near, atol=1e-10 * np.abs(near).max())


def test_the_pull_is_downhill_on_what_it_makes_least() -> None:
    model, u_seen, q = build(), displace(MESH, 0, 0.3), displace(MESH, 1, 0.3)
    matrix = assemble(model.views[0][0], MESH, HELD)

    def half_squared(u: Array) -> float:
        return 0.5 * float((u - u_seen) @ matrix @ (u - u_seen))

    direction, step = displace(MESH, 5, 0.3), 1e-3
    slope = (half_squared(q + step * direction) - half_squared(q - step * direction)) / (2 * step)
    found = pull(model, hold(model, u_seen), q, q)
    # A parabola: central differences are exact but for rounding.
    assert -found @ direction == pytest.approx(slope, rel=1e-8)
    # Two small displacements do the same work on each other's forces: M is symmetric.
    other = displace(MESH, 6, 0.3)
    work = [(pull(model, hold(model, u_seen), q + a, q) - found) @ b for a, b in ((direction, other),
                                                                                 (other, direction))]
    assert work[0] == pytest.approx(work[1], rel=1e-9)


def test_the_other_cells_pull_as_if_these_had_no_pixels() -> None:
    model, u_seen, q = build(), displace(MESH), displace(MESH, 1, 0.3)
    excluded = hold(model, u_seen)
    (found,), grey = pull_held_cells(model, excluded, field_of(model, [q])).linearize(field_of(model, [q]))
    states = np.zeros(16, dtype=np.uint8)
    states[HELD] = SPOILT
    others = exclude(model, replace(Exclusions.of_reference(model.views), cells=ByView([[states]])))
    (expected,), of_others = others.linearize(field_of(model, [q]))
    forces = pull(model, excluded, q, q)
    np.testing.assert_allclose(found, expected + forces, atol=1e-9 * np.abs(found).max())
    assert grey[0].n_pixels == of_others[0].n_pixels
    assert grey[0].residual_std == pytest.approx(of_others[0].residual_std, rel=1e-9)
    assert np.abs(forces).max() > 0.1 * np.abs(expected).max()


def test_a_field_is_pulled_to_where_its_cells_are_seen() -> None:
    # All of them, pixels off: linear steps find the way that no grey level tells, by what they capture at a time.
    model, truth = build(), np.tile([4.3, -3.2], MESH.n_nodes)
    hessian = model.views[0][0].assemble_hessian().toarray()
    q, left = np.zeros(MESH.n_dofs), []
    for _ in range(4):
        q = q + np.linalg.solve(hessian, pull(model, hold(model, truth, np.arange(16)), q, q))
        left.append(float(np.abs(q - truth).max() / 4.3))
    whole = float(np.hypot(4.3, 3.2))
    np.testing.assert_allclose(left, [max(1.0 - n * CAPTURED / whole, 0.0) for n in (1, 2, 3, 4)], atol=1e-8)


def test_cells_pull_until_the_field_is_near_where_they_were_seen() -> None:
    # A place is known to tenths of a pixel only: edge nodes of a clean pair stayed 0.26 px off where a cell that a
    # rough field had seen elsewhere pulled to the end.
    model, before = build(), np.tile([4.0, 0.0], MESH.n_nodes)
    once = hold(model, before)
    for distance, left in ((1.1 * RELEASED, HELD.tolist()), (0.9 * RELEASED, []), (CAPTURED, HELD.tolist())):
        now = Exclusions.of_reference(model.views)
        (held,), = now.keep_pulled(once, model, field_of(model, [before - distance * X])).pulled
        assert held.cells.tolist() == left
    # What is seen again is so where it is seen now.
    again = hold(model, before + X, HELD[:1])
    (held,), = again.keep_pulled(once, model, field_of(model, [np.zeros(MESH.n_dofs)])).pulled
    assert dict(zip(held.cells.tolist(), held.shown_at[:, 0, 0].tolist(), strict=True)) == {2: 5.0, 3: 4.0, 9: 4.0}


def test_nothing_pulls_where_nothing_is_held_off() -> None:
    model = build()
    at_rest = field_of(model, [np.zeros(MESH.n_dofs)])
    assert pull_held_cells(model, Exclusions.of_reference(model.views), at_rest).pulled is None


@pytest.mark.parallel([1, 3])
def test_subdomains_pull_together_as_the_whole_does() -> None:
    team, u_seen, q = Team.world(), displace(MESH), displace(MESH, 1)
    whole = build()
    expected = pull(whole, hold(whole, u_seen), q, q).reshape(-1, 2)
    model = split_model(team, source(PAIR.reference), source(PAIR.deformed), MESH, (2, 2))
    own = model.subdomains
    cells = [np.flatnonzero(np.isin(subdomain.cell_ids, HELD)) for subdomain in own]
    of_own = [u_seen.reshape(-1, 2)[subdomain.node_ids].ravel() for subdomain in own]
    seen = [(HeldCells(chosen, u.reshape(-1, 2)[pad_cells(subdomain.mesh)[chosen]]),)
            for subdomain, u, chosen in zip(own, of_own, cells, strict=True)]
    excluded = replace(Exclusions.of_reference(model.views), pulled=ByView(seen))
    q_own = field_of(model, [q.reshape(-1, 2)[subdomain.node_ids].ravel() for subdomain in own])
    # A rank of whose subdomains nothing is held off takes part.
    pulled = pull_held_cells(model, excluded, q_own).pulled
    assert pulled is not None
    total = np.zeros((MESH.n_nodes, 2))
    for subdomain, forces in zip(own, sum_pulls(pulled, q_own), strict=True):
        total[subdomain.node_ids] += forces.reshape(-1, 2)
    np.testing.assert_allclose(team.ordered_sum([total.ravel()]).reshape(-1, 2), expected,
                               atol=1e-9 * np.abs(expected).max())
