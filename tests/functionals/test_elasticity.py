"""Stiffness: symmetry, rigid modes, patch test, uniaxial tension, convergence."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_boundary_nodes
from support.random_meshes import Cells, grid_mesh, grid_meshes

Plane = Literal["stress", "strain"]
PLANES = pytest.mark.parametrize("plane", ["stress", "strain"])


def stiffness(mesh: Mesh, material: Material | None = None) -> NDArray[np.float64]:
    return np.asarray(assemble_stiffness(mesh, material or Material()).toarray())


def inner_dofs(mesh: Mesh) -> NDArray[np.bool_]:
    inside = np.ones(mesh.n_nodes, dtype=bool)
    inside[find_boundary_nodes(mesh)] = False
    return np.repeat(inside, 2)


@settings(max_examples=40)
@given(mesh=grid_meshes(most=4), nu=st.floats(-0.5, 0.45), plane=st.sampled_from(["stress", "strain"]))
def test_symmetric_with_the_rigid_motions_alone_in_its_null_space(mesh: Mesh, nu: float, plane: Plane) -> None:
    k = stiffness(mesh, Material(nu, plane))
    # E = 1, so that entries are of order one up to the cells' distortion (aspect 7 with shear: a few tens).
    np.testing.assert_allclose(k, k.T, atol=1e-12 * np.abs(k).max())
    x, y = (mesh.nodes - mesh.nodes.mean(axis=0)).T
    rigid = np.zeros((mesh.n_dofs, 3))
    rigid[::2, 0] = rigid[1::2, 1] = 1.0
    rigid[::2, 2], rigid[1::2, 2] = -y, x
    rigid /= np.linalg.norm(rigid, axis=0)
    np.testing.assert_allclose(k @ rigid, 0.0, atol=1e-11 * np.abs(k).max())
    values = np.linalg.eigvalsh(k)
    assert values[2] < 1e-11 * values[-1]
    assert values[3] > 1e-6 * values[-1]


@settings(max_examples=40)
@given(mesh=grid_meshes(), plane=st.sampled_from(["stress", "strain"]), seed=st.integers(0, 99))
def test_patch_of_uniform_strain_leaves_no_force_inside(mesh: Mesh, plane: Plane, seed: int) -> None:
    gradient = np.random.default_rng(seed).uniform(-1, 1, (2, 2))
    k = stiffness(mesh, Material(0.3, plane))
    force = k @ (mesh.nodes @ gradient.T).ravel()
    scale = np.abs(k).max() * np.abs(mesh.nodes).max()
    np.testing.assert_allclose(force[inner_dofs(mesh)] / scale, 0.0, atol=1e-13)


@PLANES
@pytest.mark.parametrize("cells", ["Q4", "T3", "mixed"])
def test_uniaxial_tension(plane: Plane, cells: Cells) -> None:
    nu, strain = 0.3, 1e-3
    mesh = grid_mesh(4, 3, (5.0, 4.0), cells=cells, seed=1)
    # Free to contract in y; sigma_xx = E' exx with E' = E, or E / (1 - nu^2) where ezz is held at zero.
    modulus, contraction = (1.0, nu) if plane == "stress" else (1 / (1 - nu**2), nu / (1 - nu))
    u = mesh.nodes * [strain, -contraction * strain]
    force = (stiffness(mesh, Material(nu, plane)) @ u.ravel()).reshape(-1, 2)
    right = mesh.nodes[:, 0] == 20.0
    # Rounding of forces of order 1e-2.
    assert force[right, 0].sum() == pytest.approx(modulus * strain * 12.0, rel=1e-12)
    free = (mesh.nodes[:, 0] != 0.0) & ~right
    np.testing.assert_allclose(force[free], 0.0, atol=1e-15)
    np.testing.assert_allclose(force[:, 1], 0.0, atol=1e-15)


@PLANES
def test_shear_modulus(plane: Plane) -> None:
    assert Material(0.25, plane).lame[1] == pytest.approx(0.4, rel=1e-15)


@pytest.mark.parametrize("cells", ["Q4", "T3"])
def test_forces_converge_to_the_divergence_of_stress(cells: Cells) -> None:
    # On a regular grid K u / h^2 is a centred difference of -div sigma: its error falls by four when h halves.
    nu, wavelength = 0.3, 64.0
    w = 2 * np.pi / wavelength
    errors = []
    for n in (16, 32):
        h = wavelength / n
        mesh = grid_mesh(n, n, (h, h))
        if cells == "T3":
            mesh = regular_triangles(mesh)
        x, y = mesh.nodes.T
        u = np.stack([np.sin(w * x) * np.cos(w * y), np.cos(w * x) * np.cos(w * y)], axis=1)
        force = (stiffness(mesh, Material(nu)) @ u.ravel()).reshape(-1, 2) / h**2
        # (u, v) = (s c, c c): div sigma by hand, with Hooke's matrix of plane stress.
        axial, cross, shear = 1 / (1 - nu**2), nu / (1 - nu**2), 1 / (2 * (1 + nu))
        ux_xx = ux_yy = -(w**2) * np.sin(w * x) * np.cos(w * y)
        uy_xx = uy_yy = -(w**2) * np.cos(w * x) * np.cos(w * y)
        ux_xy, uy_xy = -(w**2) * np.cos(w * x) * np.sin(w * y), w**2 * np.sin(w * x) * np.sin(w * y)
        div = np.stack([axial * ux_xx + cross * uy_xy + shear * (ux_yy + uy_xy),
                        axial * uy_yy + cross * ux_xy + shear * (uy_xx + ux_xy)], axis=1)
        inside = inner_dofs(mesh)[::2]
        errors.append(np.abs(force + div)[inside].max() / np.abs(div).max())
    assert errors[0] < 0.05
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def regular_triangles(mesh: Mesh) -> Mesh:
    """All diagonals one way: the same stencil at every node."""
    triangles = mesh.cells[:, [0, 1, 2, 0, 2, 3]].ravel()
    n = 2 * mesh.n_cells
    return Mesh(mesh.nodes, triangles, 3 * np.arange(n + 1), np.full(n, 5, dtype=np.uint8))
