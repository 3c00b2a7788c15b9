"""What a subdomain knows of its interface."""

from __future__ import annotations

import pickle

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.functionals.regularization import Material, controlled_stiffness
from ddic.kinematics.nodal import NodalKinematics, NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.partition.sharing import build_subdomains
from ddic.partition.subdomain import interface_weights
from support.random_meshes import PARTITIONS, SEEDS, grid_mesh, grid_meshes, random_partition


def test_weights_of_both_kinds() -> None:
    m = np.array([1, 2, 4])
    np.testing.assert_array_equal(interface_weights(m, "paper"), [1.0, 1.0, 1.0])
    np.testing.assert_allclose(interface_weights(m, "consistent"), [1.0, np.sqrt(2.0), 2.0], rtol=1e-15)


@settings(max_examples=40)
@given(mesh=grid_meshes(most=4), kind=PARTITIONS, n=st.integers(1, 6), seed=SEEDS)
def test_mean_of_weighted_reactions_gives_the_one_domain_gap(mesh: Mesh, kind: str, n: int, seed: int) -> None:
    # Eliminating the reactions at a node of m subdomains leaves |sum_s (Kbar_s q)_i|^2 / m: with weights sqrt(m)
    # that is the one-domain gap |(K q)_i|^2.
    controlled = np.random.default_rng(seed).random(mesh.n_dofs) < 0.7
    q = np.random.default_rng(seed).normal(size=mesh.n_dofs)
    of_nodes = NodalKinematics(mesh, np.arange(mesh.n_dofs))
    whole = controlled_stiffness(of_nodes, Material(), controlled * 1.0) @ q
    total, multiplicity = np.zeros(mesh.n_dofs), np.ones(mesh.n_dofs)
    for s in build_subdomains(NodalRegion(mesh), random_partition(mesh, kind, n, seed), controlled):
        weights = interface_weights(s.multiplicity, "consistent") * s.controlled
        total[s.numbers] += controlled_stiffness(s.kinematics, Material(), weights) @ q[s.numbers]
        multiplicity[s.numbers] = s.multiplicity
    # Rounding of forces of order ten (distorted cells).
    np.testing.assert_allclose(total**2 / multiplicity, whole**2, rtol=1e-9, atol=1e-9)


def test_subdomains_travel_between_processes() -> None:
    mesh = grid_mesh(4, 3, (5.0, 5.0), cells="mixed", seed=1)
    for s in build_subdomains(NodalRegion(mesh), np.arange(mesh.n_cells) % 3, np.ones(mesh.n_dofs, dtype=bool)):
        copy = pickle.loads(pickle.dumps(s))
        np.testing.assert_array_equal(copy.mesh.cells, s.mesh.cells)
        np.testing.assert_array_equal(copy.jumps.first_row, s.jumps.first_row)
        assert (copy.index, copy.n_owned_rows) == (s.index, s.n_owned_rows)
