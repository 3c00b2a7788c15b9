"""A field in parts against the vector of the whole problem, and its sums on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.kinematics.nodal import NodalRegion
from ddic.parallel.distribution import split_evenly
from ddic.parallel.field import ByView, Field, add_views, multiply_fields
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.subdomain import Subdomain
from support.pictures import square_mesh

Array = NDArray[np.float64]
RANKS = [1, 2, 3, 4]
MESH = square_mesh(0.0, 144.0)
# Cells of one subdomain lie apart: nodes are shared by up to four.
SUBDOMAINS = build_subdomains(NodalRegion(MESH), np.arange(MESH.n_cells) % 11, np.zeros(MESH.n_dofs, dtype=bool))


def own(team: Team) -> list[Subdomain]:
    return [SUBDOMAINS[k] for k in split_evenly(np.ones(len(SUBDOMAINS)), team.size)[team.rank]]


def random_field(team: Team, seed: int) -> Field:
    """Other values in each copy of an unknown, the same whoever owns it."""
    mine = own(team)
    return Field(team, mine, [np.random.default_rng([seed, s.index]).normal(size=s.n_unknowns) for s in mine])


def join(field: Field) -> Array:
    """All parts, one after the other, on all ranks."""
    return np.concatenate(field.team.gather_lists(field.parts))


def both(team: Team, seed: int) -> tuple[Field, Array]:
    """A field, and all of it as one vector."""
    return random_field(team, seed), join(random_field(Team.alone(), seed))


@pytest.mark.parallel(RANKS)
def test_linear_algebra_is_that_of_the_whole_vector() -> None:
    team = Team(MPI.COMM_WORLD)
    (q, q_whole), (dq, dq_whole) = both(team, 0), both(team, 1)
    for found, expected in ((q + dq, q_whole + dq_whole), (q - dq, q_whole - dq_whole), (q * 3.0, 3.0 * q_whole),
                            (q / 3.0, q_whole / 3.0), (0.5 * (q - 2.0 * dq), 0.5 * (q_whole - 2.0 * dq_whole)),
                            # A number of numpy's knows a field from rows of an array.
                            (np.float64(0.1) * q, 0.1 * q_whole)):
        assert isinstance(found, Field)
        np.testing.assert_array_equal(join(found), expected)
    # Fields are left as they are.
    np.testing.assert_array_equal(join(q), q_whole)


@pytest.mark.parallel(RANKS)
def test_a_field_of_zeros_and_one_from_parts() -> None:
    team = Team(MPI.COMM_WORLD)
    at_rest = Field.zero(team, own(team))
    assert not join(at_rest).any()
    q = random_field(team, 0)
    assert q.with_parts(q.parts).parts == q.parts
    assert len(q) == len(q.parts) == len(q.subdomains)
    assert q[0] is q.parts[0]
    assert list(q) == list(q.parts)
    assert q[:1] == q.parts[:1]


@pytest.mark.parallel(RANKS)
def test_parts_are_mapped_with_what_others_hold_for_their_subdomains() -> None:
    team = Team(MPI.COMM_WORLD)
    q, _ = both(team, 0)
    numbers = [s.index for s in q.subdomains]
    found = q.map(lambda s, q_s, number: q_s + 10.0 * s.index + 0.0 * number, numbers)
    for q_s, found_s, number in zip(q, found, numbers, strict=True):
        np.testing.assert_array_equal(found_s, q_s + 10.0 * number)
    with pytest.raises(ValueError, match="zip"):
        q.map(lambda s, q_s, other: q_s, [*numbers, 0])


@pytest.mark.parallel(RANKS)
def test_products_are_equal_to_the_last_bit_on_any_number_of_ranks() -> None:
    team, alone = Team(MPI.COMM_WORLD), Team.alone()
    (q, q_whole), (dq, dq_whole) = both(team, 0), both(team, 1)
    assert q.multiply(dq) == random_field(alone, 0).multiply(random_field(alone, 1))
    # Of some hundred numbers of order 1.
    assert q.multiply(dq) == pytest.approx(q_whole @ dq_whole, rel=1e-12, abs=1e-12)
    weights, of_all = ([np.full(s.n_unknowns, 1.0 + s.index) for s in subdomains]
                       for subdomains in (q.subdomains, SUBDOMAINS))
    gram = multiply_fields([q, dq], weights)
    np.testing.assert_array_equal(gram, multiply_fields([random_field(alone, 0), random_field(alone, 1)], of_all))
    vectors = np.array([q_whole, dq_whole])
    np.testing.assert_allclose(gram, (vectors * np.concatenate(of_all)) @ vectors.T, rtol=1e-12, atol=1e-12)


@pytest.mark.parallel(RANKS)
def test_one_number_of_one_rank_makes_another_field_on_all() -> None:
    team = Team(MPI.COMM_WORLD)
    q = random_field(team, 0)
    assert q.is_equal_to(random_field(team, 0))
    last = q.map(lambda s, q_s: q_s + (1e-15 if s.index == len(SUBDOMAINS) - 1 else 0.0))
    assert not q.is_equal_to(last)


@pytest.mark.parallel(RANKS)
def test_every_node_counts_once_in_the_size_of_a_field() -> None:
    team = Team(MPI.COMM_WORLD)
    u = np.random.default_rng(3).normal(size=(MESH.n_nodes, 2))
    fields = [Field(some, mine, [u[s.node_ids].ravel() for s in mine])
              for some, mine in ((team, own(team)), (Team.alone(), SUBDOMAINS))]
    for s, displacement in zip(fields[0].subdomains, fields[0].displacements, strict=True):
        np.testing.assert_array_equal(displacement.reshape(-1, 2), u[s.node_ids])
    assert fields[0].measure_rms() == pytest.approx(np.sqrt((u**2).sum(axis=1).mean()), rel=1e-13)
    assert fields[0].measure_rms() == fields[1].measure_rms()


def by_view(team: Team) -> ByView[Array]:
    """One view of even subdomains, three of odd ones, an array of three numbers of each."""
    return ByView([np.random.default_rng([s.index, view]).normal(size=3) for view in range(1 + 2 * (s.index % 2))]
                  for s in own(team))


@pytest.mark.parallel(RANKS)
def test_what_is_kept_by_view_is_mapped_and_listed_in_order() -> None:
    team = Team(MPI.COMM_WORLD)
    values, q = by_view(team), random_field(team, 0)
    doubled = values.map(lambda a, b: a + b, values)
    assert [len(row) for row in doubled] == [1 + 2 * (s.index % 2) for s in q.subdomains]
    np.testing.assert_array_equal(np.concatenate(doubled.flat), 2.0 * np.concatenate(values.flat))
    # Every view is given what its subdomain has.
    for of_views, q_s in zip(values.fill(q), q, strict=True):
        assert all(of_view is q_s for of_view in of_views)
    with pytest.raises(ValueError, match="zip"):
        values.map(lambda a, b: a, values[:-1])


@pytest.mark.parallel(RANKS)
def test_sums_over_views_are_equal_to_the_last_bit_on_any_number_of_ranks() -> None:
    team, alone = Team(MPI.COMM_WORLD), Team.alone()
    values = by_view(team)
    for added, of_views in zip(add_views(values), values, strict=True):
        np.testing.assert_array_equal(added, np.sum(of_views, axis=0))
    found, expected = team.ordered_sum(add_views(values)), alone.ordered_sum(add_views(by_view(alone)))
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_allclose(found, np.sum(by_view(alone).flat, axis=0), rtol=1e-13)
