"""Separated operators against the finite element ones on the same grid."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.functionals.regularization import Material, assemble_stiffness, evaluate_plane_waves, measure_gap_energies
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.separated.field import LineElements
from ddic.separated.separated_regularization import (
    ControlledLines,
    build_equilibrium_gap,
    build_plane_waves,
    build_tikhonov,
    factorize_stiffness,
    measure_wave_gaps,
    measure_wave_gradients,
)
from support.separated import dense, dense_operator, random_field

# Stretched cells: 7 x 7 of 2.5 by 20 / 7 px.
MESH = build_structured_mesh((3.0, 5.0, 20.5, 25.0), 2.7)
ALONG_X, ALONG_Y = (LineElements(np.unique(MESH.nodes[:, axis])) for axis in range(2))
N = MESH.n_nodes
MATERIAL = Material(0.3, "strain")
ALONG_X_AXIS, ALONG_Y_AXIS = (Material(0.3, "stress", 3.0, 0.6, angle) for angle in (0.0, np.pi / 2))
MATERIALS = pytest.mark.parametrize("material", [MATERIAL, ALONG_X_AXIS, ALONG_Y_AXIS],
                                    ids=["isotropic", "axis 1 along x", "axis 1 along y"])
SAME = 1e-13
"""Sums of a few products of numbers of size 1 to 10."""


def _stiffness(material: Material = MATERIAL) -> np.ndarray:
    order = np.lexsort((MESH.nodes[:, 0], MESH.nodes[:, 1]))
    dofs = (2 * order[:, None] + np.arange(2)).ravel()
    return assemble_stiffness(MESH, material).toarray()[np.ix_(dofs, dofs)]


def _lines(sides: str) -> ControlledLines:
    lines = ControlledLines(np.ones(ALONG_X.n_nodes, bool), np.ones(ALONG_Y.n_nodes, bool))
    lines.x[0], lines.x[-1], lines.y[0], lines.y[-1] = (side not in sides for side in "lrtb")
    return lines


@MATERIALS
def test_stiffness_is_that_of_q4(material: Material) -> None:
    matrix = np.zeros((N, 2, N, 2))
    for (c, d), products in factorize_stiffness(ALONG_X, ALONG_Y, material).items():
        for x, y in products:
            matrix[:, c, :, d] += np.kron(dense(y), dense(x))
    assert np.abs(matrix.reshape(2 * N, 2 * N) - _stiffness(material)).max() <= SAME


@pytest.mark.parametrize("sides", ["", "lrtb", "l", "tb"])
@pytest.mark.parametrize("edge_weight", [0.0, 0.3])
@MATERIALS
def test_equilibrium_gap_is_that_of_q4(sides: str, edge_weight: float, material: Material) -> None:
    lines = _lines(sides)
    is_controlled = np.repeat(np.outer(lines.y, lines.x).ravel(), 2)
    p = np.where(is_controlled, 1.0, edge_weight)
    k = _stiffness(material)
    found = dense_operator(build_equilibrium_gap(ALONG_X, ALONG_Y, material, lines, edge_weight))
    assert np.abs(found - k.T @ (p[:, None]**2 * k)).max() <= 10 * SAME


def test_energy_is_that_of_the_field() -> None:
    operator = build_equilibrium_gap(ALONG_X, ALONG_Y, MATERIAL, _lines("lrtb"))
    field = random_field(ALONG_X, ALONG_Y, 3)
    u = field.evaluate_on_grid(ALONG_X.nodes, ALONG_Y.nodes).reshape(-1)
    expected = u @ dense_operator(operator) @ u
    # A sum of 1e4 terms.
    assert operator.measure_energy(field.scaled_x, field.y) == pytest.approx(expected, rel=1e-12)


def test_tikhonov_integrates_the_squared_gradient() -> None:
    # u = (x, 2 y): the squared gradient is 1 + 4.
    operator = build_tikhonov(ALONG_X, ALONG_Y)
    x = np.stack([ALONG_X.nodes, np.ones(ALONG_X.n_nodes)])[None]
    y = np.stack([np.ones(ALONG_Y.n_nodes), 2.0 * ALONG_Y.nodes])[None]
    assert operator.measure_energy(x, y) == pytest.approx(5.0 * ALONG_X.length * ALONG_Y.length, rel=1e-12)


def test_waves_have_the_energies_of_q4() -> None:
    inner = np.ones(N, bool)
    inner[find_boundary_nodes(MESH)] = False
    waves = build_plane_waves(ALONG_X, ALONG_Y, 11.0)
    columns = evaluate_plane_waves(MESH.nodes, 11.0)
    order = np.lexsort((MESH.nodes[:, 0], MESH.nodes[:, 1]))
    for wave, column in zip(waves, columns.T, strict=True):
        values = np.zeros((N, 2))
        values[:, wave.component] = np.outer(wave.y, wave.x).ravel()
        assert np.abs(values - column.reshape(N, 2)[order]).max() <= SAME
    expected = measure_gap_energies(MESH, MATERIAL, inner, 11.0)
    assert np.allclose(measure_wave_gaps(ALONG_X, ALONG_Y, MATERIAL, waves), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("material", [ALONG_X_AXIS, ALONG_Y_AXIS], ids=["axis 1 along x", "axis 1 along y"])
def test_waves_of_a_composite_have_the_energies_of_q4(material: Material) -> None:
    inner = np.ones(N, bool)
    inner[find_boundary_nodes(MESH)] = False
    waves = build_plane_waves(ALONG_X, ALONG_Y, 11.0)
    found = measure_wave_gaps(ALONG_X, ALONG_Y, material, waves).reshape(4, 2).sum(axis=1)
    expected = measure_gap_energies(MESH, material, inner, 11.0).reshape(4, 2).sum(axis=1)
    # Where axis 1 is along y, those of y come first.
    in_order = expected if material is ALONG_X_AXIS else expected[::-1]
    assert np.allclose(found, in_order, rtol=1e-12)


def test_gradients_of_waves_grow_with_their_inverse_length_squared() -> None:
    # On fine elements, over whole waves: of all four kinds the integral is (2 pi / l)^2 area / 2.
    lines = [LineElements(np.linspace(0.0, 64.0, 513))] * 2
    energies = measure_wave_gradients(build_tikhonov(*lines), build_plane_waves(*lines, 16.0))
    # Linear elements of an 128th of a wave lose (pi / 128)^2 / 3 = 2e-4 of it.
    assert np.allclose(energies, (2 * np.pi / 16.0)**2 * 64.0**2 / 2, rtol=4e-4)
