"""Kbar = P K and the weight of a cut-off wavelength."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from ddic.functionals import regularization
from ddic.functionals.correlation import read_correlation
from ddic.functionals.regularization import (
    Material,
    assemble_stiffness,
    controlled_stiffness,
    evaluate_plane_waves,
    find_cut_off_weight,
    find_edge_weight,
    measure_gap_energies,
    measure_texture_energies,
)
from ddic.images.sub_image import MaskedSource
from ddic.kinematics.nodal import NodalKinematics, NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.partition.sharing import build_subdomains
from support.pictures import source
from support.random_meshes import PARTITIONS, SEEDS, grid_mesh, random_partition


def speckle(side: int = 140) -> MaskedSource:
    noise = ndimage.gaussian_filter(np.random.default_rng(0).normal(size=(side, side)), 1.5)
    return source(128 + 50 * noise / noise.std())


def interior(mesh: Mesh) -> NDArray[np.bool_]:
    inside = np.ones(mesh.n_nodes, dtype=bool)
    inside[find_boundary_nodes(mesh)] = False
    return inside


def dense_stiffness(mesh: Mesh) -> NDArray[np.float64]:
    return np.asarray(assemble_stiffness(mesh, Material()).toarray())


def nodal(mesh: Mesh) -> NodalKinematics:
    return NodalKinematics(mesh, np.arange(mesh.n_dofs))


def region() -> Mesh:
    return grid_mesh(8, 7, (13.0, 15.0), origin=(15.0, 15.0), cells="mixed", seed=3, jitter=0.15)


def test_rows_that_are_not_controlled_are_dropped() -> None:
    mesh = region()
    weights = np.random.default_rng(0).choice([0.0, 1.0, np.sqrt(2.0)], mesh.n_dofs)
    kbar = controlled_stiffness(nodal(mesh), Material(), weights).toarray()
    np.testing.assert_allclose(kbar, weights[:, None] * dense_stiffness(mesh), atol=1e-14)
    assert (kbar[weights == 0] == 0).all()


def test_waves_are_longitudinal_and_shear_with_both_phases() -> None:
    nodes, wavelength = np.random.default_rng(1).uniform(0, 100, (9, 2)), 40.0
    waves = evaluate_plane_waves(nodes, wavelength).reshape(9, 2, 8)
    expected = [(a, b, phi) for a in range(2) for b in range(2) for phi in (0.0, np.pi / 2)]
    for k, (a, b, phi) in enumerate(expected):
        np.testing.assert_allclose(waves[:, a, k], np.cos(2 * np.pi * nodes[:, b] / wavelength + phi), atol=1e-14)
        assert (waves[:, 1 - a, k] == 0).all()


def test_energies_equal_a_dense_evaluation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(regularization, "_GAP_CHUNK_CELLS", 13)  # several batches on a small mesh
    mesh, wavelength = region(), 60.0
    hessian = read_correlation(mesh, speckle(), 3).assemble_hessian()
    waves, rows = evaluate_plane_waves(mesh.nodes, wavelength), np.repeat(interior(mesh), 2)
    forces = (dense_stiffness(mesh) @ waves)[rows]
    texture = (waves * (hessian.toarray() @ waves))[rows]
    # Rounding: interior forces are differences of terms a hundred times larger.
    np.testing.assert_allclose(measure_gap_energies(mesh, Material(), interior(mesh), wavelength),
                               (forces**2).sum(axis=0), rtol=1e-11)
    np.testing.assert_allclose(measure_texture_energies(mesh.nodes, hessian, interior(mesh), wavelength),
                               texture.sum(axis=0), rtol=1e-12)


@settings(max_examples=30)
@given(kind=PARTITIONS, n=st.integers(1, 8), seed=SEEDS)
def test_weight_does_not_depend_on_the_partition(kind: str, n: int, seed: int) -> None:
    mesh, image, wavelength = region(), speckle(), 60.0
    gap = measure_gap_energies(mesh, Material(), interior(mesh), wavelength)
    hessian = read_correlation(mesh, image, 3).assemble_hessian()
    whole = measure_texture_energies(mesh.nodes, hessian, interior(mesh), wavelength)
    parts = random_partition(mesh, kind, n, seed)
    subdomains = build_subdomains(NodalRegion(mesh), parts, np.ones(mesh.n_dofs, dtype=bool))
    hessians = [read_correlation(s.mesh, image, 3).assemble_hessian() for s in subdomains]
    by_parts = sum(measure_texture_energies(s.mesh.nodes, hessian, s.interior, wavelength)
                   for s, hessian in zip(subdomains, hessians, strict=True))
    # Sums in another order; gradients of different windows may round to neighbouring float32 numbers, one among
    # ten thousand pixels: 1e-11.
    assert find_cut_off_weight(np.asarray(by_parts), gap) == pytest.approx(find_cut_off_weight(whole, gap), rel=1e-10)


def test_weight_grows_with_the_fourth_power_of_the_wavelength() -> None:
    # |K v|^2 ~ (h^2 (2 pi / l_c)^2)^2 while v^T M v keeps its size; few nodes per wave and few waves per region
    # leave some percent.
    mesh = grid_mesh(40, 40, (8.0, 8.0), origin=(15.0, 15.0))
    hessian = read_correlation(mesh, speckle(360), 3).assemble_hessian()
    weights = [find_cut_off_weight(measure_texture_energies(mesh.nodes, hessian, interior(mesh), wavelength),
                              measure_gap_energies(mesh, Material(), interior(mesh), wavelength))
               for wavelength in (64.0, 128.0)]
    assert np.log2(weights[1] / weights[0]) == pytest.approx(4.0, abs=0.1)


@given(seed=SEEDS, contrast=st.floats(0.1, 10))
def test_weight_lies_between_those_of_the_single_waves(seed: int, contrast: float) -> None:
    rng = np.random.default_rng(seed)
    gap = rng.uniform(0.1, 10, 8)
    texture = rng.uniform(0.1, 10, 8) * rng.choice([-1, 1], 8)
    eta = find_cut_off_weight(texture, gap)
    single = np.abs(texture) / gap
    assert single.min() <= eta <= single.max()
    # Rounding of a sum of eight.
    assert find_cut_off_weight(contrast**2 * texture, gap) == pytest.approx(contrast**2 * eta, rel=1e-12)
    assert find_cut_off_weight(-3.5 * gap, gap) == pytest.approx(3.5, rel=1e-12)


def test_edges_weigh_as_much_as_a_shorter_wavelength() -> None:
    # eta of 16 px is (16 / 64)^4 of that of 64 px, and the weight of a row enters as its square.
    assert find_edge_weight(5.0, (64.0, 5.0), 16.0) == pytest.approx((16.0 / 64.0)**2, rel=1e-14)
    # Where eta was given: 16 times that of 64 px is that of 128 px.
    assert find_edge_weight(80.0, (64.0, 5.0), 16.0) == pytest.approx((16.0 / 128.0)**2, rel=1e-14)
    assert find_edge_weight(5.0, (64.0, 5.0), 0.0) == 0.0
    # Never more than an inner node.
    assert find_edge_weight(5.0, (64.0, 5.0), 100.0) == 1.0
