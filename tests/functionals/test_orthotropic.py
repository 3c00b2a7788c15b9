"""Stiffness of an orthotropic material: its axes turn it, patch, tension, forces, and a field in equilibrium."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.functionals.regularization import (
    Material,
    assemble_stiffness,
    controlled_stiffness,
    evaluate_plane_waves,
    find_half_amplitudes,
    measure_gap_energies,
)
from ddic.kinematics.nodal import NodalKinematics
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_areas
from ddic.mesh.rotation import build_rotation
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import find_boundary_nodes
from support.random_meshes import Cells, grid_mesh, grid_meshes

ANGLES = st.floats(-np.pi, np.pi)
E1_E2, G12_E2, NU12 = 15.0, 0.5, 0.3


def composite(degrees: float = 0.0) -> Material:
    return Material(NU12, "stress", E1_E2, G12_E2, np.radians(degrees))


def transform_by_voigt(young_ratio: float, shear_ratio: float, nu12: float, angle: float) -> NDArray[np.float64]:
    """Reduced stiffness of a lamina along x, y and of the engineering shear, by the formulas of laminate theory."""
    nu21 = nu12 / young_ratio
    q11, q22 = young_ratio / (1 - nu12 * nu21), 1.0 / (1 - nu12 * nu21)
    q12, q66 = nu12 * q22, shear_ratio
    c, s = np.cos(angle), np.sin(angle)
    xx = q11 * c**4 + 2 * (q12 + 2 * q66) * s**2 * c**2 + q22 * s**4
    yy = q11 * s**4 + 2 * (q12 + 2 * q66) * s**2 * c**2 + q22 * c**4
    xy = (q11 + q22 - 4 * q66) * s**2 * c**2 + q12 * (s**4 + c**4)
    xs = (q11 - q12 - 2 * q66) * s * c**3 + (q12 - q22 + 2 * q66) * s**3 * c
    ys = (q11 - q12 - 2 * q66) * s**3 * c + (q12 - q22 + 2 * q66) * s * c**3
    ss = (q11 + q22 - 2 * q12 - 2 * q66) * s**2 * c**2 + q66 * (s**4 + c**4)
    return np.array([[xx, xy, xs], [xy, yy, ys], [xs, ys, ss]])


def stiffness(mesh: Mesh, material: Material) -> NDArray[np.float64]:
    return np.asarray(assemble_stiffness(mesh, material).toarray())


def inner_nodes(mesh: Mesh) -> NDArray[np.bool_]:
    inside = np.ones(mesh.n_nodes, dtype=bool)
    inside[find_boundary_nodes(mesh)] = False
    return inside


@given(young_ratio=st.floats(0.1, 40), shear_ratio=st.floats(0.05, 5), share=st.floats(-0.9, 0.9), angle=ANGLES)
def test_material_is_turned_as_laminate_theory_turns_it(young_ratio: float, shear_ratio: float, share: float,
                                                        angle: float) -> None:
    nu12 = max(share * np.sqrt(young_ratio), -0.99)
    found = Material(nu12, "stress", young_ratio, shear_ratio, angle).stiffness
    pairs = [(0, 0), (1, 1), (0, 1)]
    in_voigt = np.array([[found[i, k, j, l] for j, l in pairs] for i, k in pairs])
    expected = transform_by_voigt(young_ratio, shear_ratio, nu12, angle)
    # Sums of sixteen products.
    np.testing.assert_allclose(in_voigt, expected, atol=1e-14 * np.abs(expected).max())
    np.testing.assert_allclose(found, found.transpose(2, 3, 0, 1), atol=1e-14 * np.abs(expected).max())
    np.testing.assert_allclose(found, found.transpose(1, 0, 2, 3), atol=1e-14 * np.abs(expected).max())


@settings(max_examples=20)
@given(mesh=grid_meshes(most=4), degrees=st.floats(-180, 180))
def test_turned_material_is_the_same_one_in_a_mesh_turned_back(mesh: Mesh, degrees: float) -> None:
    turn = build_rotation(np.radians(degrees))
    turned_back = Mesh(mesh.nodes @ turn, mesh.connectivity, mesh.offsets, mesh.types)
    of_nodes = np.kron(np.eye(mesh.n_nodes), turn)
    expected = of_nodes @ stiffness(turned_back, composite()) @ of_nodes.T
    found = stiffness(mesh, composite(degrees))
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("nu", [-0.4, 0.3, 0.45])
def test_ratios_of_isotropy_are_isotropy(nu: float) -> None:
    mesh = grid_mesh(5, 4, (5.0, 4.0), cells="mixed", seed=2, jitter=0.2)
    by_ratios = Material(nu, "stress", 1.0, 1 / (2 * (1 + nu)), 0.7)
    assert not by_ratios.is_isotropic
    np.testing.assert_allclose(stiffness(mesh, by_ratios), stiffness(mesh, Material(nu)), atol=1e-14)
    np.testing.assert_allclose(by_ratios.stiffness, Material(nu).stiffness, atol=1e-15)
    # One ratio alone leaves the other at that of isotropy.
    assert Material(nu, "stress", 2.0).moduli[3] == Material(nu).moduli[3]


@settings(max_examples=20)
@given(mesh=grid_meshes(), degrees=st.floats(-180, 180), seed=st.integers(0, 99))
def test_homogeneous_strain_leaves_no_force_inside_and_has_its_energy(mesh: Mesh, degrees: float, seed: int) -> None:
    gradient = np.random.default_rng(seed).uniform(-1, 1, (2, 2))
    k, u = stiffness(mesh, composite(degrees)), (mesh.nodes @ gradient.T).ravel()
    scale = np.abs(k).max() * np.abs(mesh.nodes).max()
    np.testing.assert_allclose((k @ u).reshape(-1, 2)[inner_nodes(mesh)] / scale, 0.0, atol=1e-13)
    strain = np.array([gradient[0, 0], gradient[1, 1], gradient[0, 1] + gradient[1, 0]])
    density = strain @ transform_by_voigt(E1_E2, G12_E2, NU12, np.radians(degrees)) @ strain
    # Terms of a hundred times the energy cancel.
    assert u @ k @ u == pytest.approx(density * measure_areas(mesh).sum(), rel=1e-11)


@pytest.mark.parametrize(("degrees", "modulus", "contraction"), [(0, E1_E2, NU12), (90, 1.0, NU12 / E1_E2)])
@pytest.mark.parametrize("cells", ["Q4", "T3", "mixed"])
def test_tension_along_either_axis(cells: Cells, degrees: float, modulus: float, contraction: float) -> None:
    mesh, strain = grid_mesh(4, 3, (5.0, 4.0), cells=cells, seed=1), 1e-3
    u = mesh.nodes * [strain, -contraction * strain]
    force = (stiffness(mesh, composite(degrees)) @ u.ravel()).reshape(-1, 2)
    right = mesh.nodes[:, 0] == 20.0
    assert force[right, 0].sum() == pytest.approx(modulus * strain * 12.0, rel=1e-12)
    # Rounding of forces of order 0.1.
    np.testing.assert_allclose(force[(mesh.nodes[:, 0] != 0.0) & ~right], 0.0, atol=1e-15)


def test_forces_converge_to_the_divergence_of_stress() -> None:
    # On a regular grid K u / h^2 is a centred difference of -div sigma: its error falls by four when h halves. The
    # stress is that of laminate theory, its divergence taken by central differences.
    degrees, w, step = 35.0, 2 * np.pi / 64.0, 1e-3
    law = transform_by_voigt(E1_E2, G12_E2, NU12, np.radians(degrees))

    def find_stress(points: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y = w * points.T
        # Of (sin x cos y, cos x cos y).
        strain = w * np.stack([np.cos(x) * np.cos(y), -np.cos(x) * np.sin(y),
                               -np.sin(x) * np.sin(y) - np.sin(x) * np.cos(y)])
        return law @ strain

    errors = []
    for n in (16, 32):
        h = 64.0 / n
        mesh = grid_mesh(n, n, (h, h))
        x, y = w * mesh.nodes.T
        u = np.stack([np.sin(x) * np.cos(y), np.cos(x) * np.cos(y)], axis=1)
        force = (stiffness(mesh, composite(degrees)) @ u.ravel()).reshape(-1, 2) / h**2
        by_x, by_y = ((find_stress(mesh.nodes + shift) - find_stress(mesh.nodes - shift)) / (2 * step)
                      for shift in (np.array([step, 0.0]), np.array([0.0, step])))
        divergence = np.stack([by_x[0] + by_y[2], by_x[2] + by_y[1]], axis=1)
        inside = inner_nodes(mesh)
        errors.append(np.abs(force + divergence)[inside].max() / np.abs(divergence).max())
    assert errors[0] < 0.1
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("degrees", [0.0, 30.0, -75.0])
def test_a_quadratic_field_is_in_equilibrium_in_the_composite_alone(degrees: float) -> None:
    # u_1 = x_2^2 - (G12 / C11) x_1^2: C11 u_1,11 + G12 u_1,22 = 0. On a regular grid Q4 hold its forces exactly.
    material, mesh = composite(degrees), grid_mesh(8, 7, (5.0, 5.0))
    c11, _, _, g12 = material.moduli
    along, across = (mesh.nodes @ material.axes).T
    u = np.outer(across**2 - g12 / c11 * along**2, material.axes[:, 0]).ravel()
    inside = inner_nodes(mesh)
    force = (stiffness(mesh, material) @ u).reshape(-1, 2)[inside]
    # Of terms of some 1e4.
    np.testing.assert_allclose(force, 0.0, atol=1e-10)
    of_isotropy = (stiffness(mesh, Material(NU12)) @ u).reshape(-1, 2)[inside]
    # -h^2 (2 mu - (lambda + 2 mu) 2 G12 / C11) along axis 1 where that is an axis of isotropy, too.
    assert np.linalg.norm(of_isotropy, axis=1).min() > 10.0


def test_gradient_of_the_gap_is_that_of_its_energy() -> None:
    mesh, rng = grid_mesh(4, 3, (5.0, 4.0), cells="mixed", seed=4, jitter=0.2), np.random.default_rng(0)
    rows = np.repeat(inner_nodes(mesh), 2).astype(float)
    kbar = controlled_stiffness(NodalKinematics(mesh, np.arange(mesh.n_dofs)), composite(20.0), rows)
    q, direction = rng.normal(size=(2, mesh.n_dofs))
    energy = [0.5 * float(((kbar @ (q + step * direction))**2).sum()) for step in (-1e-3, 1e-3)]
    # A central difference of a quadratic is exact but for rounding, 1e-16 / 1e-3 of it.
    assert (energy[1] - energy[0]) / 2e-3 == pytest.approx(float(direction @ (kbar.T @ (kbar @ q))), rel=1e-10)


@pytest.mark.parametrize("kind", ["Q4", "T3"])
def test_cut_cells_have_the_energy_of_the_whole_mesh(kind: str) -> None:
    mesh = build_structured_mesh((20, 20, 180, 180), 16, kind)
    cut = cut_mesh(mesh, [np.array([[0.0, 50.3], [300.0, 140.2]])])
    u = np.random.default_rng(0).normal(size=(mesh.n_nodes, 2))
    u_cut = u[cut.node_of].ravel()
    expected = u.ravel() @ assemble_stiffness(mesh, composite(25.0)) @ u.ravel()
    # Sums of some thousand products in another order.
    assert u_cut @ assemble_stiffness(cut.mesh, composite(25.0)) @ u_cut == pytest.approx(expected, rel=1e-12)


def test_waves_run_along_the_axes() -> None:
    nodes, axes = np.random.default_rng(1).uniform(0, 100, (9, 2)), build_rotation(0.4)
    waves = evaluate_plane_waves(nodes, 40.0, axes).reshape(9, 2, 8)
    turned_back = evaluate_plane_waves(nodes @ axes, 40.0).reshape(9, 2, 8)
    np.testing.assert_allclose(waves, np.einsum("ip,npw->niw", axes, turned_back), atol=1e-14)


@pytest.mark.parametrize("degrees", [20.0, 45.0, 90.0])
def test_forces_of_waves_do_not_depend_on_where_the_axes_point(degrees: float) -> None:
    # Four waves in the region, of 30 cells each; on 12 cells the soft ones differ by a third.
    mesh = grid_mesh(120, 120, (5.0, 5.0))
    along_x, turned = (measure_gap_energies(mesh, composite(angle), inner_nodes(mesh), 150.0).reshape(4, 2).sum(axis=1)
                       for angle in (0.0, degrees))
    np.testing.assert_allclose(turned, along_x, rtol=0.07)


def test_half_amplitudes_of_the_documentation() -> None:
    told = find_half_amplitudes(composite(30.0), 1.0)
    assert told.shear == pytest.approx(0.87, abs=5e-3)
    assert told.longitudinal == pytest.approx(4.76, abs=5e-3)
    # The stiffer axis counts, whatever it is called.
    swapped = Material(NU12 / E1_E2, "stress", 1 / E1_E2, G12_E2 / E1_E2)
    assert find_half_amplitudes(swapped, 1.0).longitudinal == pytest.approx(told.longitudinal, rel=1e-14)
