"""Averages of the copies at interface nodes, section 5.3.2 of [BP17]."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from ddic.parallel.distribution import split_evenly
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.subdomain import Subdomain
from ddic.solvers.exchange import average_copies
from support.linear import StepProblem, linear_step, split

RANKS = [1, 2, 3, 4]


def _own(problem: StepProblem, everything: list[Subdomain]) -> list[Subdomain]:
    team = Team.world()
    return [everything[s] for s in split_evenly(np.ones(len(everything)), team.size)[team.rank]]


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("wavelength", [None, 32.0])
@pytest.mark.parametrize("kind", ["blocks", "metis"])
def test_mean_of_copies_and_largest_jump(kind: str, wavelength: float | None) -> None:
    problem = linear_step(wavelength=wavelength)
    everything = build_subdomains(problem.region, split(problem.mesh, kind, 9), problem.controlled)
    # Every subdomain's own field, known on all ranks so that each can form the means by itself.
    rng = np.random.default_rng(0)
    fields = [rng.normal(size=s.mesh.n_dofs) for s in everything]
    dofs = [(s.node_ids[:, None] * 2 + np.arange(2)).ravel() for s in everything]
    copies: list[list[float]] = [[] for _ in range(problem.mesh.n_dofs)]
    for d, field in zip(dofs, fields, strict=True):
        for dof, value in zip(d, field, strict=True):
            copies[dof].append(value)
    mean = np.array([np.mean(values) for values in copies])
    jump = max(max(values) - min(values) for values in copies)
    mine = _own(problem, everything)
    found = average_copies(Field(Team.world(), mine, [fields[s.index] for s in mine]))
    for s, q in zip(mine, found.q, strict=True):
        # The mean of at most 9 numbers of order 1.
        np.testing.assert_allclose(q, mean[dofs[s.index]], rtol=0, atol=1e-14)
    assert found.largest_jump == pytest.approx(jump, rel=1e-15)


@pytest.mark.parallel(RANKS)
def test_copies_agree_to_the_last_bit_and_a_continuous_field_has_no_jump() -> None:
    problem = linear_step()
    everything = build_subdomains(problem.region, split(problem.mesh, "metis", 9), problem.controlled)
    mine = _own(problem, everything)
    rng = np.random.default_rng(MPI.COMM_WORLD.rank)
    once = average_copies(Field(Team.world(), mine, [rng.normal(size=s.mesh.n_dofs) for s in mine]))
    twice = average_copies(once.q)
    assert once.largest_jump > 0
    assert twice.largest_jump == 0.0


@pytest.mark.parallel(RANKS)
def test_the_fields_that_went_in_are_left_alone() -> None:
    problem = linear_step()
    everything = build_subdomains(problem.region, split(problem.mesh, "blocks", 4), problem.controlled)
    mine = _own(problem, everything)
    fields = [np.full(s.mesh.n_dofs, float(s.index)) for s in mine]
    average_copies(Field(Team.world(), mine, fields))
    assert all((q == s.index).all() for q, s in zip(fields, mine, strict=True))
